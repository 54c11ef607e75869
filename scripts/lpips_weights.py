"""Writes the weights that `neumip evaluate --lpips-weights` reads, from the package of the authors of LPIPS.

    python3 lpips_weights.py lpips-alex.safetensors      # needs torch, lpips (which download AlexNet's weights), numpy

The file is safetensors of f32: conv<n>.weight [out, in, k, k], conv<n>.bias [out], linear<n>.weight [out], n = 1 to 5.
"""

import json
import sys

import numpy as np

# Names in the state dictionary of lpips.LPIPS(net="alex"), stage by stage.
CONVOLUTIONS = ["net.slice1.0", "net.slice2.3", "net.slice3.6", "net.slice4.8", "net.slice5.10"]
LINEAR = ["lin0.model.1", "lin1.model.1", "lin2.model.1", "lin3.model.1", "lin4.model.1"]


def tensors(state):
    """Our names and arrays of f32 of a state dictionary of arrays."""
    found = {}
    for n, (convolution, linear) in enumerate(zip(CONVOLUTIONS, LINEAR), start=1):
        found[f"conv{n}.weight"] = state[f"{convolution}.weight"]
        found[f"conv{n}.bias"] = state[f"{convolution}.bias"]
        # [1, out, 1, 1]: a convolution of 1 x 1 to one channel.
        found[f"linear{n}.weight"] = np.reshape(state[f"{linear}.weight"], -1)
    return {name: np.ascontiguousarray(value, dtype="<f4") for name, value in found.items()}


def write(path, arrays):
    """Writes arrays of f32 as safetensors."""
    header, start = {}, 0
    for name, array in arrays.items():
        end = start + array.nbytes
        header[name] = {"dtype": "F32", "shape": array.shape, "data_offsets": [start, end]}
        start = end
    text = json.dumps(header).encode()
    # The data begins at a multiple of 8.
    text += b" " * (-len(text) % 8)
    with open(path, "wb") as file:
        file.write(len(text).to_bytes(8, "little") + text)
        for array in arrays.values():
            file.write(array.tobytes())


def main(path):
    import lpips

    state = lpips.LPIPS(net="alex", version="0.1").state_dict()
    write(path, tensors({name: value.numpy() for name, value in state.items()}))


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    main(sys.argv[1])
