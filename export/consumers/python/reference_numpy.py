"""A neural material answered from its checkpoint alone: numpy, 64-bit floats, no neumip code.

    from reference_numpy import evaluate
    rgb = evaluate("model.safetensors", u, wi, wo, level)

u, wi, wo are [N, 2], level is [N]; the answer is [N, 3]. For a decoder that reads neighbours the N queries are periodic
images one after another: `images` is [count, height, width]. Four quantities are computed in 32-bit floats
because small differences in them grow (the highest bands turn a rounding of p into 2^k pi times as much, and
z near the horizon is a root of a difference): the wrapped u, p = 2 u - 1, x^2 + y^2 and z. Everything else is
in 64 bits, so what a renderer's 32-bit floats cost shows as the difference.
"""

import json
import struct

import numpy as np

YUV_TO_RGB = np.array([[1.0, 0.0, 1.13983], [1.0, -0.39465, -0.5806], [1.0, 2.03211, 0.0]])


def read_safetensors(path):
    """The metadata (a dict of strings) and the tensors (a dict of arrays) of a file of f32 tensors."""
    with open(path, "rb") as file:
        data = file.read()
    (length,) = struct.unpack("<Q", data[:8])
    header = json.loads(data[8 : 8 + length])
    metadata = header.pop("__metadata__", {})
    body = data[8 + length :]
    tensors = {}
    for name, entry in header.items():
        assert entry["dtype"] == "F32", name
        begin, end = entry["data_offsets"]
        tensors[name] = np.frombuffer(body[begin:end], "<f4").reshape(entry["shape"])
    return metadata, tensors


class Material:
    """A checkpoint in memory."""

    def __init__(self, path):
        metadata, tensors = read_safetensors(path)
        self.header = json.loads(metadata["neumip"])
        if self.header["format"] != 1:
            raise ValueError(f"{path}: format {self.header['format']} is not known")
        self.model = self.header["architecture"]["model"]
        self.resolution = self.header["architecture"]["resolution"]
        self.domain = self.header["architecture"].get("domain")
        self.tensors = {name: tensor.astype(np.float64) for name, tensor in tensors.items()}
        self.levels = sum(name.startswith("texture.level") for name in tensors)
        self.finest = self.model["texture"].get("finest", 0)

    def evaluate(self, u, wi, wo, level, images=None):
        """Answers queries: [N, 2], [N, 2], [N, 2], [N] -> [N, 3]."""
        u, wi, wo, level = (np.asarray(a, np.float32) for a in (u, wi, wo, level))
        u, level = self.led(u, level)
        level = np.clip(level.astype(np.float64), 0, self.finest + self.levels - 1)
        (wi, wi_z, wi_up), (wo, wo_z, wo_up) = direction(wi), direction(wo)

        shifted = u.astype(np.float64)
        offset = self.model["parallax"]
        if offset["kind"] == "offset":
            texture = bilinear(self.tensors["offset.texture"], shifted)
            depth = self.network("offset.mlp", np.concatenate([texture, wo], 1)) * offset["scale"]
            shifted = shifted + 0.5 * depth * wo / np.maximum(wo_z, offset["min_z"])

        features = self.features(shifted, np.maximum(level - self.finest, 0))
        encoded = self.encode(u, wi, wi_z, wo, wo_z, level)
        inputs = np.concatenate([features, *encoded], 1)
        if self.model["decoder"]["kind"] == "inception":
            count, height, width = images
            outputs = self.inception(inputs.reshape(count, height, width, -1)).reshape(len(u), -1)
        else:
            outputs = self.network("decoder.mlp", inputs)
        rgb = self.colour(outputs)
        return np.where(wi_up & wo_up, np.maximum(rgb, 0), 0)

    def led(self, u, level):
        """The position in [0, 1] and the level that answer in the place of a query's: a domain leads them to what was fitted."""
        if self.domain is None:
            return u - np.floor(u), level
        clamped = np.clip(level, *np.float32(self.domain["levels"]))
        # Sizes are (rows, columns), positions (column, row).
        tile, corner, size = (np.float32(a[::-1]) for a in (self.domain["tile"], self.domain["corner"], self.resolution))
        if (tile == size).all():
            return u - np.floor(u), clamped
        moved = u - corner / tile
        windows = (moved - np.floor(moved)) * (tile / size)
        inside = ((windows < 1) | (tile == size)).all(1)
        coarsest = np.float32(self.finest + self.levels - 1)
        return windows - np.floor(windows), np.where(inside, clamped, coarsest)

    def features(self, u, level):
        """Trilinear lookup of the pyramid."""
        fine = np.floor(level).astype(int)
        coarse = np.minimum(fine + 1, self.levels - 1)
        each = np.stack([bilinear(self.tensors[f"texture.level{i}"], u) for i in range(self.levels)])
        rows = np.arange(len(u))
        fraction = (level - fine)[:, None]
        return (1 - fraction) * each[fine, rows] + fraction * each[coarse, rows]

    def encode(self, u, wi, wi_z, wo, wo_z, level):
        """gamma(u), gamma(wi), gamma(wo)."""
        config = self.model["encoding"]
        base = np.pi if config["pi"] else 1.0
        p = (np.float32(2) * u - np.float32(1)).astype(np.float64)
        height, width = self.resolution
        bands = config["u"]["bands"]
        if config["u"]["limit_to_resolution"]:
            bands = min(bands, max(height, width).bit_length())
        footprint = 2.0 ** level[:, None] * 2 / np.array([width, height]) / np.sqrt(12)
        parts = []
        for k in range(bands):
            damping = np.exp(-((2.0**k * base * footprint) ** 2) / 2) if config["u"]["attenuate"] else 1.0
            parts += [np.sin(2.0**k * base * p) * damping, np.cos(2.0**k * base * p) * damping]
        if config["u"]["raw"]:
            parts.append(p)
        for name, w, z in (("wi", wi, wi_z), ("wo", wo, wo_z)):
            w = np.concatenate([w, z], 1) if config["components"] == 3 else w
            for k in range(config[name]["bands"]):
                amplitude = config[name]["amplitude"]
                parts += [np.sin(2.0**k * base * w) * amplitude, np.cos(2.0**k * base * w) * amplitude]
            if config[name]["raw"]:
                parts.append(w)
        return parts

    def network(self, prefix, x):
        """relu(x W^T + b) layer by layer, the last one linear."""
        layers = sum(name.startswith(prefix) and name.endswith("weight") for name in self.tensors)
        for layer in range(layers):
            x = x @ self.tensors[f"{prefix}.{layer}.weight"].T + self.tensors[f"{prefix}.{layer}.bias"]
            x = np.maximum(x, 0) if layer + 1 < layers else x
        return x

    def inception(self, x):
        """1x1, modules of four paths, 1x1, on periodic images [N, H, W, C]; ReLU after every convolution but the last."""
        x = np.maximum(self.convolved("decoder.in", x), 0)
        for module in range(self.model["decoder"]["modules"]):

            def path(name, x):
                return np.maximum(self.convolved(f"decoder.module{module}.{name}", x), 0)

            paths = [path("path1", x), path("path2", path("path2.reduce", x))]
            paths += [path("path3", path("path3.reduce", x)), path("path4", np.max(shifted(x, 3), 0))]
            x = np.concatenate(paths, 3)
        return self.convolved("decoder.out", x)

    def convolved(self, name, x):
        """A convolution of images."""
        weight = self.tensors[f"{name}.weight"]
        kernel = weight.reshape(*weight.shape[:2], -1)
        around = shifted(x, weight.shape[2])
        return sum(part @ kernel[:, :, k].T for k, part in enumerate(around)) + self.tensors[f"{name}.bias"]

    def colour(self, y):
        """RGB from the decoder's outputs, before the clamp."""
        output = self.model["output"]
        rgb = y[:, :3]
        if output["space"] == "yuv":
            rgb = rgb @ YUV_TO_RGB.T
        if output["transform"] == "exp-minus-one":
            rgb = np.expm1(rgb)
        if output["mask"]:
            rgb = rgb * (0.1 + 1 / (1 + np.exp(-y[:, 3:6])))
        return rgb


def shifted(x, side):
    """The neighbours of every pixel within a square, row by row of it: a list of images."""
    height, width = x.shape[1:3]
    margin = side // 2
    around = np.pad(x, ((0, 0), (margin, margin), (margin, margin), (0, 0)), mode="wrap")
    return [around[:, i : i + height, j : j + width] for i in range(side) for j in range(side)]


def direction(w):
    """(x, y), z and whether it is above the horizon; length and z in 32-bit floats."""
    square = w[:, :1] * w[:, :1] + w[:, 1:] * w[:, 1:]
    z = np.sqrt(np.maximum(np.float32(1) - square, np.float32(0)))
    return w.astype(np.float64), z.astype(np.float64), square < 1


def bilinear(texture, u):
    """Bilinear lookup with repetition: [H, W, C], [N, 2] -> [N, C]."""
    height, width, _ = texture.shape
    x, y = u[:, 0] * width - 0.5, u[:, 1] * height - 0.5
    column, row = np.floor(x).astype(int), np.floor(y).astype(int)
    fx, fy = (x - column)[:, None], (y - row)[:, None]

    def at(i, j):
        return texture[i % height, j % width]

    top = (1 - fx) * at(row, column) + fx * at(row, column + 1)
    bottom = (1 - fx) * at(row + 1, column) + fx * at(row + 1, column + 1)
    return (1 - fy) * top + fy * bottom


def evaluate(path, u, wi, wo, level, images=None):
    """Answers queries with the checkpoint at `path`: [N, 2], [N, 2], [N, 2], [N] -> [N, 3]."""
    return Material(path).evaluate(u, wi, wo, level, images)
