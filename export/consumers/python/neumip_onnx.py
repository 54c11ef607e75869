"""Evaluates and checks a neumip bundle with onnxruntime. Needs numpy and onnxruntime; onnx where installed.

    python neumip_onnx.py BUNDLE --check
    python neumip_onnx.py BUNDLE --queries QUERIES.json --out ANSWERS.json

QUERIES is JSON or npz with arrays u, wi, wo [N, 2], level [N] and, to compare with, rgb [N, 3]. For a decoder that reads
neighbours they are images one after another, and `images` says how many and how large: [count, height, width]. The exit
status is 1 where an answer is further off than the bundle's tolerance: |difference| > tolerance (1 + |rgb|).
"""

import argparse
import json
import sys
from pathlib import Path

import numpy as np
import onnxruntime

INPUTS = ("u", "wi", "wo", "level")


class Bundle:
    """A bundle's description, golden answers and whole-material graph."""

    def __init__(self, folder):
        self.folder = Path(folder)
        self.description = json.loads((self.folder / "material.json").read_text(encoding="utf-8"))
        if self.description["format"] != 1:
            raise ValueError(f"{self.folder}: bundle format {self.description['format']} is not known")
        self.golden = read_queries(self.folder / "golden.json")
        graph = str(self.folder / "material.onnx")
        self.session = onnxruntime.InferenceSession(graph, providers=["CPUExecutionProvider"])

    def evaluate(self, u, wi, wo, level, images=None):
        """Answers queries: [N, 2], [N, 2], [N, 2], [N] -> [N, 3]."""
        feeds = as_fed(zip(INPUTS, (u, wi, wo, level)), images)
        return self.session.run(["rgb"], feeds)[0].reshape(-1, 3)

    def largest_difference(self, queries):
        """Largest |difference| / (1 + |rgb|) between the graph's answers and the given ones."""
        rgb = self.evaluate(*(queries[name] for name in INPUTS), queries.get("images"))
        return float(np.max(np.abs(rgb - queries["rgb"]) / (1 + np.abs(queries["rgb"]))))


def as_fed(named, images=None):
    """Named arrays as a graph takes them: 32-bit floats, laid out as images where there are some."""
    feeds = {name: np.ascontiguousarray(a, np.float32) for name, a in named}
    if images is not None:
        feeds = {name: a.reshape(*(int(n) for n in images), *a.shape[1:]) for name, a in feeds.items()}
    return feeds


def read_queries(path):
    """The arrays of a JSON or npz file."""
    path = Path(path)
    if path.suffix == ".npz":
        return dict(np.load(path))
    return {name: np.asarray(values) for name, values in json.loads(path.read_text(encoding="utf-8")).items()}


def check_graphs(folder):
    """Runs onnx.checker (full) and strict shape inference on both graphs; False where onnx is missing."""
    try:
        import onnx
    except ImportError:
        return False
    for name in ("decoder.onnx", "material.onnx"):
        model = onnx.load(str(Path(folder) / name))
        onnx.checker.check_model(model, full_check=True)
        onnx.shape_inference.infer_shapes(model, check_type=True, strict_mode=True, data_prop=True)
        shape = [d.dim_param or d.dim_value for d in model.graph.output[0].type.tensor_type.shape.dim]
        if shape not in (["N", 3], ["N", "H", "W", 3]):
            raise ValueError(f"{name}: output shape {shape}")
    return True


def check(folder):
    """Checks graphs and golden answers. "checked": onnx was there; "ok": the answers are right."""
    bundle = Bundle(folder)
    tolerance = float(bundle.golden["tolerance"])
    difference = bundle.largest_difference(bundle.golden)
    # Written so that a NaN fails.
    return {
        "checked": check_graphs(folder),
        "difference": difference,
        "tolerance": tolerance,
        "ok": difference <= tolerance,
    }


def main():
    parser = argparse.ArgumentParser(description="Evaluate or check a neumip bundle with onnxruntime.")
    parser.add_argument("bundle", help="folder of the bundle")
    parser.add_argument("--check", action="store_true", help="check the graphs and the golden answers")
    parser.add_argument("--queries", help="JSON or npz with u, wi, wo, level and optionally rgb")
    parser.add_argument("--out", help="where to write the answers to --queries, as JSON")
    arguments = parser.parse_args()
    if not (arguments.check or arguments.queries):
        parser.error("nothing to do: give --check or --queries")

    ok = True
    if arguments.check:
        result = check(arguments.bundle)
        print(json.dumps(result))
        ok = result["ok"]
    if arguments.queries:
        bundle = Bundle(arguments.bundle)
        queries = read_queries(arguments.queries)
        if "rgb" in queries:
            tolerance = float(queries.get("tolerance", bundle.golden["tolerance"]))
            difference = bundle.largest_difference(queries)
            print(json.dumps({"difference": difference, "tolerance": tolerance}))
            ok = ok and difference <= tolerance
        rgb = bundle.evaluate(*(queries[name] for name in INPUTS), queries.get("images"))
        if arguments.out:
            Path(arguments.out).write_text(json.dumps({"rgb": rgb.tolist()}), encoding="utf-8")
        elif "rgb" not in queries:
            print(json.dumps({"rgb": rgb.tolist()}))
    return 0 if ok else 1


if __name__ == "__main__":
    sys.exit(main())
