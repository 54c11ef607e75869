"""LPIPS in numpy, on random weights of few channels.

    python lpips_numpy.py PAIRS.json SCRIPTS WEIGHTS.safetensors

PAIRS is an array of {height, width, answer, reference}: linear RGB, [height * width, 3]. Makes weights under the names
of the authors' package, writes them to WEIGHTS by SCRIPTS/lpips_weights.py, and prints the distance of every pair.
"""

import json
import sys
from pathlib import Path

import numpy as np

WIDTHS, KERNELS = [6, 8, 10, 7, 5], [11, 5, 3, 3, 3]
# AlexNet's: (stride, padding) of a convolution, and whether a pooling comes before it.
PLAN = [(4, 2, False), (1, 2, True), (1, 1, True), (1, 1, False), (1, 1, False)]
SLICES = ["net.slice1.0", "net.slice2.3", "net.slice3.6", "net.slice4.8", "net.slice5.10"]


def random_state():
    random = np.random.default_rng(5)
    state, inputs = {}, 3
    for k, (width, kernel, name) in enumerate(zip(WIDTHS, KERNELS, SLICES)):
        shape = (width, inputs, kernel, kernel)
        state[f"{name}.weight"] = random.normal(size=shape) / np.sqrt(np.prod(shape[1:]) / 2)
        state[f"{name}.bias"] = 0.1 * random.normal(size=width)
        state[f"lin{k}.model.1.weight"] = random.uniform(size=(1, width, 1, 1))
        inputs = width
    # What the package has besides.
    state["scaling_layer.shift"] = np.zeros((1, 3, 1, 1))
    return {name: value.astype(np.float32) for name, value in state.items()}


def windows(image, size, stride):
    """[channels, height, width] as [channels, rows, columns, size, size]."""
    view = np.lib.stride_tricks.sliding_window_view(image, (size, size), axis=(1, 2))
    return view[:, ::stride, ::stride]


def features(image, state):
    for name, (stride, padding, pooled) in zip(SLICES, PLAN):
        if pooled:
            image = windows(image, 3, 2).max(axis=(3, 4))
        weight = state[f"{name}.weight"].astype(np.float64)
        image = np.pad(image, ((0, 0), (padding, padding), (padding, padding)))
        image = np.einsum("cyxij,ocij->oyx", windows(image, weight.shape[2], stride), weight, optimize=True)
        image = np.maximum(image + state[f"{name}.bias"][:, None, None], 0)
        yield image


def seen(pixels, height, width):
    linear = np.clip(np.reshape(pixels, (height, width, 3)), 0, 1)
    root = 1.055 * np.maximum(linear, 0.0031308) ** (1 / 2.4) - 0.055
    encoded = np.where(linear <= 0.0031308, 12.92 * linear, root)
    scaled = (2 * encoded - 1 - np.array([-0.030, -0.088, -0.188])) / np.array([0.458, 0.448, 0.450])
    return np.moveaxis(scaled, 2, 0)


def distance(pair, state):
    images = [seen(pair[name], pair["height"], pair["width"]) for name in ("answer", "reference")]
    total = 0.0
    for k, pairs in enumerate(zip(*(features(image, state) for image in images))):
        a, b = (f / (np.sqrt((f**2).sum(axis=0)) + 1e-10) for f in pairs)
        weight = np.reshape(state[f"lin{k}.model.1.weight"], (-1, 1, 1))
        total += (weight * (a - b) ** 2).sum(axis=0).mean()
    return float(total)


def main(pairs, scripts, weights):
    sys.path.insert(0, scripts)
    import lpips_weights

    state = random_state()
    lpips_weights.write(weights, lpips_weights.tensors(state))
    print(json.dumps([distance(pair, state) for pair in json.loads(Path(pairs).read_text())]))


main(*sys.argv[1:])
