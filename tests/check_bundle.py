"""Compares a neumip bundle with the answers of the program that wrote it.

    python check_bundle.py CONSUMERS BUNDLE QUERIES.json

CONSUMERS is the folder of neumip_onnx.py and reference_numpy.py; QUERIES has arrays u, wi, wo [N, 2], level [N],
rgb [N, 3] and, for a decoder that reads neighbours, images [3]. The graphs have to pass onnx.checker. Prints one line of JSON: versions, and the largest
|difference| / (1 + |rgb|) of

    material   material.onnx in onnxruntime
    decoder    decoder.onnx in onnxruntime, given the features that the reference looks up, where a domain led it
    steps      prepare.onnx and evaluate.onnx in onnxruntime, where the decoder does not read neighbours
    reference  the numpy reference, from model.safetensors alone
"""

import json
import sys
from pathlib import Path

import numpy as np


def main(consumers, folder, queries):
    sys.path.insert(0, consumers)
    import onnx
    import onnxruntime
    from neumip_onnx import INPUTS, Bundle, as_fed, check_graphs, read_queries
    from reference_numpy import Material

    class Recording(Material):
        """Keeps the features that it looked up, and where a domain led it."""

        def led(self, u, level):
            self.place = super().led(u, level)
            return self.place

        def features(self, u, level):
            self.looked_up = super().features(u, level)
            return self.looked_up

    if not check_graphs(folder):
        raise RuntimeError("the graphs were not checked")
    queries = read_queries(queries)
    inputs = [queries[name] for name in INPUTS]
    images = queries.get("images")
    reference = Recording(Path(folder) / "model.safetensors")
    bundle = Bundle(folder)
    answers = {
        "material": bundle.evaluate(*inputs, images),
        "reference": reference.evaluate(*inputs, images),
    }
    decoder = onnxruntime.InferenceSession(
        str(Path(folder) / "decoder.onnx"), providers=["CPUExecutionProvider"]
    )
    if images is None:
        prepared = bundle.prepare(*(queries[name] for name in ("u", "wo", "level")))
        answers["steps"] = bundle.light(prepared, queries["wi"])
    place = dict(zip(("u", "level"), reference.place)) if reference.domain else {}
    led = [place.get(name, queries[name]) for name in INPUTS]
    feeds = as_fed(zip(("features", *INPUTS), (reference.looked_up, *led)), images)
    answers["decoder"] = decoder.run(["rgb"], feeds)[0].reshape(-1, 3)

    differences = {}
    for name, rgb in answers.items():
        if rgb.shape != queries["rgb"].shape:
            raise RuntimeError(f"{name}: shape {rgb.shape} where {queries['rgb'].shape} was asked")
        # A NaN comes through the maximum.
        differences[name] = float(np.max(np.abs(rgb - queries["rgb"]) / (1 + np.abs(queries["rgb"]))))
    versions = {module.__name__: module.__version__ for module in (np, onnx, onnxruntime)}
    print(json.dumps({"queries": len(queries["rgb"]), "versions": versions, **differences}))


if __name__ == "__main__":
    main(*sys.argv[1:])
