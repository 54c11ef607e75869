"""Answers a neural material in Mitsuba's own types: Dr.Jit arrays (llvm, cuda) or Python floats (scalar).

Import it after `mi.set_variant`. The steps are those of `../python/reference_numpy.py`, split as a renderer wants them:
`prepare` does what does not depend on the light, `evaluate` the rest. Where 32-bit floats would lose digits that the answer
needs, the argument is reduced first: u to the tile, angles to half a turn.
"""

import math

import drjit as dr
import mitsuba as mi
import numpy as np

from neumip_bundle import LOBE_BOUNDS

YUV_TO_RGB = np.array([[1.0, 0.0, 1.13983], [1.0, -0.39465, -0.5806], [1.0, 2.03211, 0.0]])


class Layers:
    """A multilayer perceptron, ReLU after every layer but the last. Values are lists of one number (per lane) a channel."""

    def __init__(self, layers):
        self.jit = dr.is_jit_v(mi.Float)
        # Weights are part of the compiled code: a load from a buffer for each costs twice the time.
        self.layers = [(w.tolist(), b.tolist()) if self.jit else (w, b) for w, b in layers]

    def __call__(self, x):
        return self.rest(self.add(0, range(len(x)), x, self.layers[0][1]))

    def add(self, layer, columns, x, y):
        """y + W x, where x are the given columns of the layer's input."""
        weight = self.layers[layer][0]
        if not self.jit:
            return y + weight[:, list(columns)] @ np.array(x, np.float32)
        sums = []
        for row, start in zip(weight, y):
            # Four sums: a single one waits for its last addition.
            parts = [start, 0.0, 0.0, 0.0]
            for k, (column, value) in enumerate(zip(columns, x)):
                parts[k % 4] = dr.fma(value, row[column], parts[k % 4])
            sums.append((parts[0] + parts[1]) + (parts[2] + parts[3]))
        return sums

    def rest(self, x):
        """What follows the first layer's sums."""
        for layer in range(1, len(self.layers)):
            x = [dr.maximum(v, 0.0) for v in x] if self.jit else np.maximum(x, 0.0)
            x = self.add(layer, range(len(x)), x, self.layers[layer][1])
        return x if self.jit else x.tolist()


class Pyramid:
    """Textures of one channel count, looked up bilinearly with repetition: [H, W, C] each, texel after texel in one buffer."""

    def __init__(self, textures):
        self.channels = textures[0].shape[2]
        self.textures = textures
        if not dr.is_jit_v(mi.Float):
            return
        # A texel of 2^n channels is one load.
        self.padded = 1 << (self.channels - 1).bit_length()
        texels = [np.pad(t, ((0, 0), (0, 0), (0, self.padded - self.channels))).reshape(-1) for t in textures]
        texels = np.concatenate(texels)
        self.texels = mi.Float(texels)
        starts = np.cumsum([0] + [t.shape[0] * t.shape[1] for t in textures])[:-1]
        sizes = [(start, *t.shape[:2]) for start, t in zip(starts, textures)]
        self.start, self.height, self.width = (mi.UInt32(np.array(column, np.uint32)) for column in zip(*sizes))
        self.count = len(textures)

    def __call__(self, u, which=0):
        """The channels of texture `which` at u, which lies in [0, 1]."""
        if not dr.is_jit_v(mi.Float):
            return self.scalar(u, which)
        if self.count == 1:
            height, width = self.textures[0].shape[:2]
            start = 0
        else:
            height, width, start = (dr.gather(mi.UInt32, table, which) for table in (self.height, self.width, self.start))
        (left, right, fx), (top, bottom, fy) = (taps(x, size) for x, size in zip(u, (width, height)))
        corners = [[self.texel(start + row * width + column) for column in (left, right)] for row in (top, bottom)]
        rows = [[mixed(a, b, fx) for a, b in zip(*row)] for row in corners]
        return [mixed(a, b, fy) for a, b in zip(*rows)]

    def texel(self, index):
        packet = dr.gather(mi.ArrayXf, self.texels, index, shape=(self.padded, dr.width(index)))
        return [packet[c] for c in range(self.channels)]

    def scalar(self, u, which):
        texture = self.textures[int(which)]
        height, width, _ = texture.shape
        x, y = u[0] * width - 0.5, u[1] * height - 0.5
        column, row = math.floor(x), math.floor(y)
        fx, fy = x - column, y - row
        pair = texture.take([row, row + 1], axis=0, mode="wrap").take([column, column + 1], axis=1, mode="wrap")
        rows = (1 - fx) * pair[:, 0].astype(float) + fx * pair[:, 1]
        return (1 - fy) * rows[0] + fy * rows[1]


def taps(x, size):
    """The texels around x in [0, 1] along one axis, and the second one's weight."""
    x = x * mi.Float(size) - 0.5
    first = dr.floor(x)
    fraction = x - first
    first = mi.Int32(first)
    size = mi.Int32(size)
    second = first + 1
    first = dr.select(first < 0, size - 1, dr.minimum(first, size - 1))
    return mi.UInt32(first), mi.UInt32(dr.select(second >= size, 0, second)), fraction


def mixed(a, b, fraction):
    return dr.fma(b - a, fraction, a)


def single(x):
    """Rounds to 32 bits where Python's floats have 64."""
    return x if dr.is_jit_v(mi.Float) else float(np.float32(x))


def wrapped(x):
    """x - floor(x); 0 for what is not a number, so that no address follows from it."""
    return dr.select(dr.isfinite(x), single(x - dr.floor(x)), 0.0)


def waves(values, bands, pi, amplitude):
    """For every octave the sines of all values, then their cosines."""
    encoded = []
    for k in range(bands):
        if pi:
            turns = [v * 2.0 ** (k - 1) for v in values]
            pairs = [dr.sincos((t - dr.round(t)) * (2 * math.pi)) for t in turns]
        else:
            pairs = [dr.sincos(v * 2.0**k) for v in values]
        for part in (0, 1):
            encoded += [pair[part] * a for pair, a in zip(pairs, amplitude(k))]
    return encoded


class Prepared:
    """What answers at one place seen from one direction share: the first layer's sums, what the sampler reads, wo."""

    def __init__(self, sums, features, wo):
        self.sums, self.features, self.wo = sums, features, wo


class Answerer:
    """A bundle's material. Directions are unit vectors of the local frame, wi to the light, wo to the viewer."""

    def __init__(self, bundle):
        self.model, self.resolution, self.tile = bundle.model, bundle.resolution, bundle.tile
        self.window, self.level_range = bundle.guide()
        self.finest, self.levels, self.coarsest = bundle.finest, bundle.levels, bundle.coarsest
        self.u_bands = bundle.u_bands()
        self.pyramid = Pyramid([bundle.tensors[f"texture.level{k}"] for k in range(self.levels)])
        self.decoder = Layers(bundle.network("decoder.mlp"))
        if self.model["parallax"]["kind"] == "offset":
            self.offset = Pyramid([bundle.tensors["offset.texture"]])
            self.offset_mlp = Layers(bundle.network("offset.mlp"))
        ends = np.cumsum([0, *bundle.decoder_inputs()])
        self.columns = [range(a, b) for a, b in zip(ends, ends[1:])]
        self.sampler = None
        if bundle.sampler:
            self.sampler, tensors = bundle.sampler
            self.sampler_mlp = Layers(bundle.network("sampler.mlp", tensors))

    def prepare(self, u, wo, level):
        """Everything that does not depend on wi: u (x, y) in tiles, wo, level."""
        u, level = self.led([single(x) for x in u], level)
        shifted = u
        if self.model["parallax"]["kind"] == "offset":
            parallax = self.model["parallax"]
            (ray,) = self.offset_mlp([*self.offset(u), wo.x, wo.y])
            depth = 0.5 * parallax["scale"] * ray / dr.maximum(wo.z, parallax["min_z"])
            shifted = [wrapped(dr.fma(depth, w, x)) for x, w in zip(u, (wo.x, wo.y))]
        stored = dr.maximum(level - self.finest, 0.0)
        fine = mi.UInt32(dr.floor(stored))
        coarse = dr.minimum(fine + 1, self.levels - 1)
        fraction = stored - mi.Float(fine)
        features = self.pyramid(shifted, fine)
        if self.levels > 1:
            features = [mixed(a, b, fraction) for a, b in zip(features, self.pyramid(shifted, coarse))]

        sums = self.decoder.add(0, self.columns[0], features, self.decoder.layers[0][1])
        sums = self.decoder.add(0, self.columns[1], self.encoded_u(u, level), sums)
        sums = self.decoder.add(0, self.columns[3], self.encoded_direction("wo", wo), sums)
        return Prepared(sums, features, wo)

    def led(self, u, level):
        """The position in [0, 1] and the level that answer: outside of a window of the tile the coarsest level does."""
        level = dr.clip(level, *self.level_range)
        if self.window is None:
            return [wrapped(x) for x in u], level
        # A position that is no number is in the window: it answers as elsewhere, at 0.
        local = [single(wrapped(single(x - corner)) * scale) for x, corner, scale in zip(u, *self.window[:2])]
        for x, part in zip(local, self.window[2]):
            level = dr.select(x < 1.0, level, float(self.coarsest)) if part else level
        return [wrapped(x) for x in local], level

    def evaluate(self, prepared, wi):
        """f cos(theta_i) as RGB; 0 where wi or wo is on or below the horizon."""
        wi_columns = self.encoded_direction("wi", wi)
        y = self.decoder.rest(self.decoder.add(0, self.columns[2], wi_columns, prepared.sums))
        output, rgb = self.model["output"], y[:3]
        if output["space"] == "yuv":
            rgb = [a * rgb[0] + b * rgb[1] + c * rgb[2] for a, b, c in YUV_TO_RGB.tolist()]
        if output["transform"] == "exp-minus-one":
            rgb = [dr.exp(v) - 1.0 for v in rgb]
        if output["mask"]:
            rgb = [v * (0.1 + 1.0 / (1.0 + dr.exp(-m))) for v, m in zip(rgb, y[3:6])]
        lit = (wi.z > 0.0) & (prepared.wo.z > 0.0)
        return mi.Color3f(*(dr.select(lit, dr.maximum(v, 0.0), 0.0) for v in rgb))

    def encoded_u(self, u, level):
        config = self.model["encoding"]
        p = [single(2.0 * x - 1.0) for x in u]
        base = math.pi if config["pi"] else 1.0
        size = dr.exp2(level)

        def damping(k):
            if not config["u"]["attenuate"]:
                return [1.0, 1.0]
            spread = [2.0**k * base * 2.0 / n / math.sqrt(12.0) for n in reversed(self.resolution)]
            return [dr.exp(-0.5 * dr.square(s * size)) for s in spread]

        return waves(p, self.u_bands, config["pi"], damping) + (p if config["u"]["raw"] else [])

    def encoded_direction(self, name, w):
        config = self.model["encoding"]
        own = config[name]
        components = [w.x, w.y, w.z][: config["components"]]
        encoded = waves(components, own["bands"], config["pi"], lambda _: [own["amplitude"]] * len(components))
        return encoded + (components if own["raw"] else [])


class Lobes:
    """The directions that a material is sampled in: a mixture of cosine lobes with affinely moved slopes.

    A lobe is (weight, matrix by rows, its inverse, determinant, centre); the first one is the plain cosine. Without a
    sampler in the bundle there is no other.
    """

    def __init__(self, answerer, prepared):
        self.wo = wo = prepared.wo
        self.lobes = [(1.0, None, None, 1.0, (0.0, 0.0))]
        if answerer.sampler is None:
            return
        config = answerer.sampler
        out = answerer.sampler_mlp([*prepared.features, wo.x, wo.y])
        groups = [out[k : k + len(LOBE_BOUNDS)] for k in range(0, len(out), len(LOBE_BOUNDS))]
        groups = [[dr.clip(v, *bounds) for v, bounds in zip(group, LOBE_BOUNDS)] for group in groups]
        shares = [dr.exp(group[0]) for group in groups]
        rest = (1.0 - config["cosine_floor"]) / (1.0 + sum(shares))
        self.lobes[0] = (config["cosine_floor"] + rest, *self.lobes[0][1:])
        m = [-w / dr.maximum(wo.z, config["min_z"]) for w in (wo.x, wo.y)]
        for frame, share, (_, cx, cy, p, r, q) in zip(config["lobes"], shares, groups):
            a, d = dr.exp(p), dr.exp(q)
            matrix, inverse = (a, 0.0, r * a, d), (1.0 / a, 0.0, -r / d, 1.0 / d)
            determinant, centre = a * d, (cx, cy)
            if frame == "mirror":
                square = 1.0 + m[0] * m[0] + m[1] * m[1]
                stretch = symmetric(m, 1.0)
                matrix, inverse = product(stretch, matrix), product(inverse, symmetric(m, -1.0 / square))
                determinant = determinant * square
                x, y = applied(stretch, cx, cy)
                centre = (m[0] + x, m[1] + y)
            self.lobes.append((rest * share, matrix, inverse, determinant, centre))

    def sample(self, sample1, sample2):
        """wi from a number that chooses the lobe and two that choose within it."""
        t = mi.warp.square_to_cosine_hemisphere(sample2)
        wi, end = t, self.lobes[0][0]
        for weight, matrix, _, _, (bx, by) in self.lobes[1:]:
            x, y = applied(matrix, t.x, t.y)
            moved = mi.Vector3f(x + bx * t.z, y + by * t.z, t.z)
            wi = dr.select(sample1 >= end, moved, wi)
            end = end + weight
        return dr.normalize(wi)

    def pdf(self, wi):
        """Density over solid angle; 0 where wi or wo is on or below the horizon."""
        density = self.lobes[0][0] * wi.z
        for weight, _, inverse, determinant, (bx, by) in self.lobes[1:]:
            x, y = applied(inverse, wi.x - bx * wi.z, wi.y - by * wi.z)
            spread = wi.z * wi.z + x * x + y * y
            density = density + weight * wi.z / (determinant * spread * spread)
        return dr.select((wi.z > 0.0) & (self.wo.z > 0.0), density / math.pi, 0.0)


def symmetric(m, factor):
    """I + factor m m^T, by rows."""
    off = factor * m[0] * m[1]
    return (1.0 + factor * m[0] * m[0], off, off, 1.0 + factor * m[1] * m[1])


def product(a, b):
    return (a[0] * b[0] + a[1] * b[2], a[0] * b[1] + a[1] * b[3], a[2] * b[0] + a[3] * b[2], a[2] * b[1] + a[3] * b[3])


def applied(matrix, x, y):
    return matrix[0] * x + matrix[1] * y, matrix[2] * x + matrix[3] * y
