"""A neumip bundle in numpy and onnxruntime: the text to read before writing a reader of your own.

    python neumip_onnx.py BUNDLE --check
    python neumip_onnx.py BUNDLE --queries QUERIES.json --out ANSWERS.json

QUERIES is JSON or npz with arrays u, wi, wo [N, 2], level [N] and, to compare with, rgb [N, 3]. For a decoder that reads
neighbours they are images one after another, and `images` says how many and how large: [count, height, width]. The exit
status is 1 where an answer is further off than the bundle's tolerance: |difference| <= tolerance (1 + |rgb|).
"""

import argparse
import hashlib
import json
import sys
from pathlib import Path

import numpy as np
import onnxruntime

INPUTS = ("u", "wi", "wo", "level")


class Bundle:
    """A bundle whose files are all there and unaltered. Directions are x and y of unit vectors but where they are sampled."""

    def __init__(self, folder):
        self.folder = Path(folder)
        self.description = json.loads(self.read("material.json"))
        if self.description["format"] != 1:
            raise ValueError(f"{self.folder}: bundle format {self.description['format']} is not known")
        for file in self.description["files"]:
            if hashlib.sha256(self.read(file["name"])).hexdigest() != file["sha256"]:
                raise ValueError(f"{self.folder / file['name']}: was altered")
        self.golden = read_queries(self.folder / "golden.json")
        self.sessions = {}

    def read(self, name):
        """The bytes of a file."""
        try:
            return (self.folder / name).read_bytes()
        except OSError as error:
            raise ValueError(f"{self.folder / name}: cannot be read: {error.strerror}") from error

    def run(self, graph, outputs, **inputs):
        """Runs a graph of the bundle: arrays by name -> the outputs' arrays."""
        if graph not in self.sessions:
            path = str(self.folder / f"{graph}.onnx")
            self.sessions[graph] = onnxruntime.InferenceSession(path, providers=["CPUExecutionProvider"])
        return self.sessions[graph].run(outputs, as_fed(inputs.items()))

    def evaluate(self, u, wi, wo, level, images=None):
        """Answers queries: [N, 2], [N, 2], [N, 2], [N] -> rgb [N, 3]."""
        feeds = as_fed(zip(INPUTS, (u, wi, wo, level)), images)
        return self.run("material", ["rgb"], **feeds)[0].reshape(-1, 3)

    def prepare(self, u, wo, level):
        """Everything of N hits that does not depend on the light: a dictionary of arrays."""
        names = [port["name"] for port in self.graph("prepare")["outputs"]]
        return dict(zip(names, self.run("prepare", names, u=u, wo=wo, level=level)))

    def light(self, prepared, wi):
        """Answers prepared hits for one light each: wi [N, 2] -> rgb [N, 3]."""
        inputs = {name: prepared[name] for name in ("partial", "visible")}
        return self.run("evaluate", ["rgb"], wi=wi, **inputs)[0]

    def sample(self, prepared, xi):
        """Light directions by importance: xi [N, 2] in [0, 1) -> wi [N, 3] unit vectors, pdf [N] over solid angle."""
        if "lobes" in prepared:
            return self.run("sample", ["wi", "pdf"], lobes=prepared["lobes"], xi=xi)
        angle, radius = 2 * np.pi * xi[:, 0], np.sqrt(xi[:, 1])
        wi = np.stack([radius * np.cos(angle), radius * np.sin(angle), np.sqrt(1 - xi[:, 1])], 1)
        return wi, wi[:, 2] / np.pi

    def pdf(self, prepared, wi):
        """The density with which `sample` gives wi [N, 3]."""
        if "lobes" in prepared:
            return self.run("pdf", ["pdf"], lobes=prepared["lobes"], wi=wi)[0]
        return np.maximum(wi[:, 2], 0) / np.pi

    def graph(self, name):
        """The interface of a graph."""
        for graph in self.description["graphs"]:
            if graph["file"] == f"{name}.onnx":
                return graph
        raise ValueError(f"{self.folder}: has no {name}.onnx")

    def check(self):
        """Largest difference from the golden answers, and what is allowed, of every way to evaluate."""
        golden, tolerance = self.golden, float(self.golden["tolerance"])
        answers = {"material": self.evaluate(*(golden[name] for name in INPUTS), golden.get("images"))}
        if "images" not in golden:
            prepared = self.prepare(*(golden[name] for name in ("u", "wo", "level")))
            answers["prepare, evaluate"] = self.light(prepared, golden["wi"])
        report = {name: (difference(rgb, golden["rgb"]), tolerance) for name, rgb in answers.items()}
        if "sampler" in self.description:
            golden = read_queries(self.folder / self.description["sampler"]["golden"])
            prepared = self.prepare(*(golden[name] for name in ("u", "wo", "level")))
            apart = np.abs(self.sample(prepared, golden["xi"])[0] - golden["wi"])
            report["sample"] = (float(np.max(apart)), float(golden["tolerance"]))
            relative = np.abs(self.pdf(prepared, golden["wi"]) / golden["pdf"] - 1)
            report["pdf"] = (float(np.max(relative)), float(golden["pdf_tolerance"]))
        return report


def difference(answers, expected):
    """Largest |difference| / (1 + |expected|)."""
    return float(np.max(np.abs(answers - expected) / (1 + np.abs(expected))))


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
    """Runs onnx.checker (full) and strict shape inference on every graph; False where onnx is missing."""
    try:
        import onnx
    except ImportError:
        return False
    for path in sorted(Path(folder).glob("*.onnx")):
        model = onnx.load(str(path))
        onnx.checker.check_model(model, full_check=True)
        onnx.shape_inference.infer_shapes(model, check_type=True, strict_mode=True, data_prop=True)
    return True


def main():
    parser = argparse.ArgumentParser(description="Evaluate or check a neumip bundle with onnxruntime.")
    parser.add_argument("bundle", help="folder of the bundle")
    parser.add_argument("--check", action="store_true", help="check the graphs and the golden answers")
    parser.add_argument("--queries", help="JSON or npz with u, wi, wo, level and optionally rgb")
    parser.add_argument("--out", help="where to write the answers to --queries, as JSON")
    arguments = parser.parse_args()
    if not (arguments.check or arguments.queries):
        parser.error("nothing to do: give --check or --queries")
    try:
        return answer(Bundle(arguments.bundle), arguments)
    except (ValueError, KeyError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 1


def answer(bundle, arguments):
    ok = True
    if arguments.check:
        report = bundle.check()
        # Written so that a NaN fails.
        ok = all(off <= tolerance for off, tolerance in report.values())
        print(json.dumps({"checked": check_graphs(arguments.bundle), "ok": ok, "off and allowed": report}))
    if arguments.queries:
        queries = read_queries(arguments.queries)
        rgb = bundle.evaluate(*(queries[name] for name in INPUTS), queries.get("images"))
        if "rgb" in queries:
            tolerance = float(queries.get("tolerance", bundle.golden["tolerance"]))
            off = difference(rgb, queries["rgb"])
            print(json.dumps({"difference": off, "tolerance": tolerance}))
            ok = ok and off <= tolerance
        if arguments.out:
            Path(arguments.out).write_text(json.dumps({"rgb": rgb.tolist()}), encoding="utf-8")
        elif "rgb" not in queries:
            print(json.dumps({"rgb": rgb.tolist()}))
    return 0 if ok else 1


if __name__ == "__main__":
    sys.exit(main())
