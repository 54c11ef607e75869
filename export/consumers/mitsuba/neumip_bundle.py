"""Reads a neumip bundle: numpy and the standard library only.

    bundle = Bundle("BUNDLE")

Only the files that are asked for are read, and each must have the length and SHA-256 that material.json gives. Whatever is
wrong raises `BundleError`, whose text is one line that names the file.
"""

import hashlib
import json
import struct
from pathlib import Path

import numpy as np

BUNDLE_FORMAT = 1
CHECKPOINT_FORMAT = 1
SAMPLER_FORMAT = 1
MEASURE = "radiance-cosine"
# Bounds of the values that a sampler's network gives for one lobe: logit, centre's x and y, log width, shear, log width.
LOBE_BOUNDS = [(-20.0, 20.0), (-8.0, 8.0), (-8.0, 8.0), (-5.0, 2.0), (-4.0, 4.0), (-5.0, 2.0)]


class BundleError(ValueError):
    """What is wrong with a bundle, in one line."""


class Bundle:
    """A material's description, textures and networks.

    `model` is the model's configuration, `resolution` [height, width] of its textures, `levels` the stored ones, `tensors` the
    arrays of model.safetensors, `sampler` None or (configuration, arrays) of sampler.safetensors. A material that was fitted
    for a scene has a `domain`, else None; `tile` is [height, width] of the whole tile, of which its textures may be a window.
    """

    def __init__(self, folder):
        self.folder = Path(folder)
        self.description = self._json()
        path = self.folder / "model.safetensors"
        header, self.tensors = self._tensors("model.safetensors", "neumip", CHECKPOINT_FORMAT)
        with Naming(path):
            self.model = header["architecture"]["model"]
            self.resolution = [int(n) for n in header["architecture"]["resolution"]]
            self.domain = header["architecture"].get("domain")
            self.tile = [int(n) for n in self.domain["tile"]] if self.domain else self.resolution
            if header["measure"] != MEASURE:
                raise BundleError(f"{path}: answers are `{header['measure']}`; this program reads `{MEASURE}`")
            if self.model["decoder"]["kind"] != "mlp":
                raise BundleError(
                    f"{path}: the decoder `{self.model['decoder']['kind']}` reads neighbours and cannot answer a ray "
                    "tracer's single queries; export a material with an `mlp` decoder"
                )
            self.finest = int(self.model["texture"].get("finest", 0))
            self.levels = sum(name.startswith("texture.level") for name in self.tensors)
            self._check_model(path)
        self.sampler = self._sampler()

    @property
    def coarsest(self):
        """The largest level that is told apart."""
        return self.finest + self.levels - 1

    def guide(self):
        """How queries are led to those that were fitted: the window as its corner in tiles, windows in a tile and whether it
        is a part of the tile, (x, y) each, or None where it is the whole tile; and the range of levels."""
        if self.domain is None:
            return None, (0.0, float(self.coarsest))
        tile, corner, size = (np.float32(n[::-1]) for n in (self.tile, self.domain["corner"], self.resolution))
        window = None
        if self.tile != self.resolution:
            window = [values.tolist() for values in (corner / tile, tile / size, tile != size)]
        return window, tuple(np.float32(self.domain["levels"]).tolist())

    def network(self, prefix, tensors=None):
        """The (weight [out, in], bias [out]) of each layer."""
        tensors = self.tensors if tensors is None else tensors
        layers = sum(name.startswith(f"{prefix}.") and name.endswith(".weight") for name in tensors)
        return [(tensors[f"{prefix}.{k}.weight"], tensors[f"{prefix}.{k}.bias"]) for k in range(layers)]

    def u_bands(self):
        """Octaves of the position's encoding."""
        u = self.model["encoding"]["u"]
        return min(u["bands"], max(self.resolution).bit_length()) if u["limit_to_resolution"] else u["bands"]

    def decoder_inputs(self):
        """Numbers of inputs: features, of the position, of wi, of wo."""
        encoding = self.model["encoding"]
        components = encoding["components"]
        sizes = [components * (2 * encoding[w]["bands"] + encoding[w]["raw"]) for w in ("wi", "wo")]
        return [self.model["texture"]["channels"], 4 * self.u_bands() + 2 * encoding["u"]["raw"], *sizes]

    def read(self, name):
        """The bytes of a file that material.json lists."""
        path = self.folder / name
        entry = next((f for f in self.description["files"] if f["name"] == name), None)
        if entry is None:
            raise BundleError(f"{self.folder / 'material.json'}: does not list {name}; export the material again")
        data = read_bytes(path)
        if len(data) != entry["bytes"] or hashlib.sha256(data).hexdigest() != entry["sha256"]:
            raise BundleError(f"{path}: is not the file that material.json lists (altered or cut off); export it again")
        return data

    def _json(self):
        path = self.folder / "material.json"
        if not self.folder.is_dir():
            raise BundleError(f"{self.folder}: no such folder; give the folder that `neumip export` wrote")
        with Naming(path):
            description = json.loads(read_bytes(path))
            if description["format"] != BUNDLE_FORMAT:
                raise BundleError(
                    f"{path}: bundle format {description['format']} is not known; this program reads {BUNDLE_FORMAT}"
                )
            for entry in description["files"]:
                entry["name"], entry["bytes"], entry["sha256"]
        return description

    def _tensors(self, name, key, version):
        """The JSON of a file's metadata and its tensors."""
        path = self.folder / name
        data = self.read(name)
        with Naming(path):
            (length,) = struct.unpack("<Q", data[:8])
            entries = json.loads(data[8 : 8 + length])
            header = json.loads(entries.pop("__metadata__")[key])
            if header["format"] != version:
                raise BundleError(f"{path}: format {header['format']} is not known; this program reads {version}")
            tensors = {}
            for tensor, entry in entries.items():
                begin, end = (8 + length + offset for offset in entry["data_offsets"])
                if entry["dtype"] != "F32":
                    raise BundleError(f"{path}: tensor {tensor} is {entry['dtype']}; this program reads F32")
                tensors[tensor] = np.frombuffer(data[begin:end], "<f4").reshape(entry["shape"])
                if not np.isfinite(tensors[tensor]).all():
                    raise BundleError(f"{path}: tensor {tensor} has values that are not finite")
        return header, tensors

    def _check_model(self, path):
        height, width = self.resolution
        for k in range(self.levels):
            size = [max(1, n >> (self.finest + k)) for n in (height, width)]
            self._check_shape(path, f"texture.level{k}", [*size, self.model["texture"]["channels"]])
        if not self.levels:
            raise BundleError(f"{path}: has no texture.level0")
        outputs = 6 if self.model["output"]["mask"] else 3
        self._check_network(path, self.network("decoder.mlp"), sum(self.decoder_inputs()), outputs)
        offset = self.model["parallax"]
        if offset["kind"] == "offset":
            size = [max(1, n >> self.finest) for n in (height, width)]
            self._check_shape(path, "offset.texture", [*size, offset["channels"]])
            self._check_network(path, self.network("offset.mlp"), offset["channels"] + 2, 1)
        elif offset["kind"] != "none":
            raise BundleError(f"{path}: parallax `{offset['kind']}` is not known to this program")

    def _check_shape(self, path, name, shape):
        if list(self.tensors[name].shape) != shape:
            raise BundleError(f"{path}: {name} has shape {list(self.tensors[name].shape)} where {shape} is needed")

    @staticmethod
    def _check_network(path, layers, inputs, outputs):
        widths = [inputs] + [len(bias) for _, bias in layers]
        shapes = [list(weight.shape) for weight, _ in layers]
        if shapes != [[b, a] for a, b in zip(widths, widths[1:])] or widths[-1] != outputs or len(layers) < 2:
            raise BundleError(f"{path}: layers {shapes} do not lead from {inputs} inputs to {outputs} outputs")

    def _sampler(self):
        name = "sampler.safetensors"
        if not any(entry["name"] == name for entry in self.description["files"]):
            return None
        path = self.folder / name
        header, tensors = self._tensors(name, "neumip-sampler", SAMPLER_FORMAT)
        with Naming(path):
            config = header["config"]
            for frame in config["lobes"]:
                if frame not in ("surface", "mirror"):
                    raise BundleError(f"{path}: a lobe of frame `{frame}` is not known to this program")
            if config["features"] != self.model["texture"]["channels"]:
                raise BundleError(f"{path}: reads {config['features']} features where the texture has another number")
            if not (0 < config["cosine_floor"] <= 1 and 0 < config["min_z"] <= 1 and config["lobes"]):
                raise BundleError(f"{path}: cosine_floor, min_z or lobes are out of their bounds")
            layers = self.network("sampler.mlp", tensors)
            self._check_network(path, layers, config["features"] + 2, len(LOBE_BOUNDS) * len(config["lobes"]))
        return config, tensors


class Naming:
    """Turns what a damaged file makes Python raise into one line that names the file."""

    def __init__(self, path):
        self.path = path

    def __enter__(self):
        return self

    def __exit__(self, kind, problem, _):
        if isinstance(problem, (KeyError, TypeError, ValueError, struct.error)) and not isinstance(problem, BundleError):
            what = f"{problem} is missing" if isinstance(problem, KeyError) else " ".join(str(problem).split())
            raise BundleError(f"{self.path}: cannot be read: {what}") from problem


def read_bytes(path):
    try:
        return path.read_bytes()
    except OSError as problem:
        raise BundleError(f"{path}: cannot be read: {problem.strerror}") from problem
