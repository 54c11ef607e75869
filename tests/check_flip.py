"""FLIP of pairs of images by its authors' code.

    python check_flip.py PAIRS.json

PAIRS is an array of {height, width, answer, reference}: linear RGB, [height * width, 3], clamped to [0, 1]. Prints one
line of JSON: for every pair {mean, map}.
"""

import json
import sys
from pathlib import Path

import flip_evaluator
import numpy as np


def encode(linear):
    """sRGB of linear light."""
    root = 1.055 * np.maximum(linear, 0.0031308) ** (1 / 2.4) - 0.055
    return np.where(linear <= 0.0031308, 12.92 * linear, root).astype(np.float32)


def main(path):
    found = []
    for pair in json.loads(Path(path).read_text()):
        shape = (pair["height"], pair["width"], 3)
        reference, answer = (encode(np.reshape(pair[name], shape)) for name in ("reference", "answer"))
        values, mean, _ = flip_evaluator.evaluate(reference, answer, "LDR", inputsRGB=True, applyMagma=False)
        found.append({"mean": mean, "map": np.ravel(values).tolist()})
    print(json.dumps(found))


main(*sys.argv[1:])
