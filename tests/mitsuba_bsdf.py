"""Checks the Mitsuba 3 consumer in one variant, for tests/mitsuba_bsdf.rs.

    python mitsuba_bsdf.py CONSUMERS VARIANT BUNDLE TWIN FOLDER RESULT.json

CONSUMERS holds the folders `mitsuba` and `python`; TWIN is a bundle that answers otherwise and has BUNDLE's golden answers;
FOLDER is for files made here. The result has differences, each beside that of a twin which must be larger, or
`missing`: why the variant cannot run. Differences of answers are |difference| / (1 + |answer|).
"""

import hashlib
import json
import shutil
import struct
import subprocess
import sys
from pathlib import Path

import numpy as np

# Lobes of the sampler that is made here, and standard deviation of its weights: widths between 0.1 and 1.
LOBES = ["surface", "mirror"]
SPREAD = 0.3
# Pixels of a compared picture: few where each is answered by Python alone.
SIDE = {"scalar_rgb": 16, "llvm_ad_rgb": 64}
# Of a lobe's logit, centre, log width, shear and log width, by the format.
BOUNDS = [(-20, 20), (-8, 8), (-8, 8), (-5, 2), (-4, 4), (-5, 2)]
TILING = [3.0, 2.0]
LIGHT = [0.4, -0.5, 0.8]


def difference(ours, theirs):
    """Largest; a NaN comes through."""
    return float(np.max(np.abs(ours - theirs) / (1 + np.abs(theirs))))


def z_of(w):
    """z as the answers' definition has it, in 32 bits."""
    square = w[:, 0] * w[:, 0] + w[:, 1] * w[:, 1]
    return np.sqrt(np.maximum(np.float32(1) - square, np.float32(0)))


class Plugin:
    """A loaded BSDF, called on arrays in every variant."""

    def __init__(self, bundle, **properties):
        self.bsdf = mi.load_dict({"type": "neumip", "bundle": str(bundle), **properties})

    def call(self, method, u, wo, level, *arguments):
        """Results as [N, k] arrays; u [N, 2], wo [N, 3], level [N], further arguments [N, k]."""
        if mi.variant().startswith("scalar"):
            rows = [self.one(method, *row) for row in zip(u, wo, level, *arguments)]
            return [np.array(column, np.float64).reshape(len(u), -1) for column in zip(*rows)]
        si = dr.zeros(mi.SurfaceInteraction3f, len(u))
        si.uv, si.wi = mi.Point2f(u.T.astype(np.float32)), mi.Vector3f(wo.T.astype(np.float32))
        self.bsdf.level = mi.Float(level.astype(np.float32))
        results = flat(getattr(self.bsdf, method)(mi.BSDFContext(), si, *map(typed, arguments), True))
        return [np.array(r, np.float64).reshape(-1, len(u)).T for r in results]

    def one(self, method, u, wo, level, *arguments):
        si = mi.SurfaceInteraction3f()
        si.uv, si.wi, self.bsdf.level = u.tolist(), wo.tolist(), float(level)
        return flat(getattr(self.bsdf, method)(mi.BSDFContext(), si, *(typed(a) for a in arguments), True))


def typed(a):
    a = np.asarray(a, np.float32)
    if a.ndim == 0:
        return float(a)
    kinds = {1: mi.Float, 2: mi.Point2f, 3: mi.Vector3f}
    if mi.variant().startswith("scalar"):
        return kinds[len(a)](a.tolist())
    return kinds[a.shape[1]](a.T) if a.ndim == 2 else mi.Float(a)


def flat(results):
    """A method's results as a flat list: a sample's direction and density, then its weight."""
    if not isinstance(results, tuple):
        return [results]
    return [part for r in results for part in ([r.wo, r.pdf] if isinstance(r, mi.BSDFSample3f) else [r])]


def golden(bundle):
    queries = json.loads((Path(bundle) / "golden.json").read_text())
    u, wi, wo, level, rgb = (np.array(queries[name], np.float32) for name in ("u", "wi", "wo", "level", "rgb"))
    wi, wo = (np.column_stack([w, z_of(w)]) for w in (wi, wo))
    (ours,) = Plugin(bundle).call("eval", u, wo, level, wi)
    return difference(ours, rgb), queries["tolerance"]


def with_sampler(bundle, folder):
    """A copy of a bundle that has a sampler of random weights."""
    shutil.copytree(bundle, folder)
    features = Bundle(bundle).model["texture"]["channels"]
    widths = [features + 2, 8, 6 * len(LOBES)]
    random = np.random.default_rng(5)
    tensors = {}
    for k, (a, b) in enumerate(zip(widths, widths[1:])):
        tensors[f"sampler.mlp.{k}.weight"] = random.normal(0, SPREAD, (b, a))
        tensors[f"sampler.mlp.{k}.bias"] = random.normal(0, SPREAD, b)
    # Widths around e^-1.
    tensors["sampler.mlp.1.bias"][3::2] -= 1.0
    config = {"features": features, "hidden": widths[1:-1], "lobes": LOBES, "cosine_floor": 0.1, "min_z": 0.1}
    write_tensors(folder / "sampler.safetensors", "neumip-sampler", {"format": 1, "config": config}, tensors)
    return folder


def write_tensors(path, key, header, tensors):
    """A safetensors file, and its line in the bundle's material.json."""
    entries, body = {"__metadata__": {key: json.dumps(header)}}, b""
    for name, tensor in tensors.items():
        data = np.asarray(tensor, "<f4").tobytes()
        entries[name] = {"dtype": "F32", "shape": list(np.shape(tensor)), "data_offsets": [len(body), len(body) + len(data)]}
        body += data
    text = json.dumps(entries).encode()
    path.write_bytes(struct.pack("<Q", len(text)) + text + body)
    list_file(path)


def list_file(path):
    """Lists a file in the material.json beside it as it now is."""
    description = json.loads((path.parent / "material.json").read_text())
    files = [f for f in description["files"] if f["name"] != path.name]
    data = path.read_bytes()
    files.append({"name": path.name, "bytes": len(data), "sha256": hashlib.sha256(data).hexdigest()})
    (path.parent / "material.json").write_text(json.dumps(description | {"files": files}))


def looks(count):
    """Places, viewers and levels, and numbers to sample with."""
    random = np.random.default_rng(9)
    z, phi = random.uniform(0.2, 1.0, count), random.uniform(0, 2 * np.pi, count)
    radius = np.sqrt(1 - z * z)
    wo = np.column_stack([radius * np.cos(phi), radius * np.sin(phi), z])
    return random.uniform(-1, 2, (count, 2)), wo, random.uniform(0, 4, count), random.uniform(size=(count, 3))


def sampling(bundle):
    """Largest relative disagreement of `sample` with `eval`, `pdf` and `eval_pdf`, and of the density's integral with 1."""
    count = 64 if mi.variant().startswith("scalar") else 4096
    plugin = Plugin(bundle)
    u, wo, level, numbers = looks(count)
    wi, density, weight = plugin.call("sample", u, wo, level, numbers[:, 0], numbers[:, 1:])
    (value,), (pdf,) = plugin.call("eval", u, wo, level, wi), plugin.call("pdf", u, wo, level, wi)
    both = plugin.call("eval_pdf", u, wo, level, wi)
    relative = [difference(weight * pdf, value), difference(both[0], value)]
    relative += [float(np.max(np.abs(p / pdf - 1))) for p in (density, both[1])]
    (blurred,) = plugin.call("eval", u, wo, level + 0.5, wi)
    result = {"consistency": max(relative), "inconsistency": difference(weight * pdf, blurred)}
    if (Path(bundle) / "sampler.safetensors").exists():
        defined = [defined_pdf(bundle, u, wo, level + bias, wi) for bias in (0.0, 0.5)]
        result["density"], result["density_twin"] = (float(np.max(np.abs(pdf / d - 1))) for d in defined)
    # Below the horizon, and from below it, nothing is.
    down = [1, 1, -1] * wi
    result["below"] = max(
        float(np.max(np.abs(a)))
        for a in plugin.call("eval_pdf", u, wo, level, down) + plugin.call("eval_pdf", u, wo * [1, 1, -1], level, wi)
    )
    if mi.variant().startswith("scalar"):
        return result
    # Midpoints along z and around: the density is smooth, its narrowest lobe a tenth wide.
    rings, spokes = 400, 400
    z, phi = (np.arange(rings) + 0.5) / rings, (np.arange(spokes) + 0.5) * 2 * np.pi / spokes
    z, phi = (a.ravel() for a in np.meshgrid(z, phi, indexing="ij"))
    radius = np.sqrt(1 - z * z)
    directions = np.column_stack([radius * np.cos(phi), radius * np.sin(phi), z])
    integrals = []
    for k in range(4):
        same = [np.broadcast_to(a[k], (len(z), *np.shape(a[k]))) for a in (u, wo, level)]
        (pdf,) = plugin.call("pdf", *same, directions)
        # The whole hemisphere, and all but its lowest tenth.
        integrals.append([np.mean(pdf[:, 0] * kept) * 2 * np.pi for kept in (1.0, z > 0.1)])
    result["integral"], result["part"] = (float(np.max(np.abs(i))) for i in np.transpose(integrals) - 1)
    result["chi2"], result["chi2_twin"] = chi2(plugin, u[0], wo[0], 1.0), chi2(plugin, u[0], wo[0], 1.2)
    return result


def defined_pdf(folder, u, wo, level, wi):
    """The mixture's density as the sampler's format defines it, in 64 bits."""

    class Recording(Material):
        def features(self, u, level):
            self.looked_up = super().features(u, level)
            return self.looked_up

    material = Recording(folder / "model.safetensors")
    material.evaluate(u, wi[:, :2], wo[:, :2], level)
    config, tensors = Bundle(folder).sampler
    x = np.column_stack([material.looked_up, wo[:, :2]])
    for k in (0, 1):
        x = np.maximum(x, 0) if k else x
        x = x @ tensors[f"sampler.mlp.{k}.weight"].T.astype(float) + tensors[f"sampler.mlp.{k}.bias"]
    values = x.reshape(len(u), len(LOBES), 6)
    logits = np.column_stack([np.zeros(len(u)), np.clip(values[..., 0], -20, 20)])
    weights = np.exp(logits) / np.exp(logits).sum(1, keepdims=True) * (1 - config["cosine_floor"])
    weights[:, 0] += config["cosine_floor"]
    density = np.zeros(len(u))
    for i, z in enumerate(wi[:, 2]):
        m = -wo[i, :2] / max(wo[i, 2], config["min_z"])
        for lobe, weight in zip([None, *range(len(LOBES))], weights[i]):
            a, b = np.eye(2), np.zeros(2)
            if lobe is not None:
                _, cx, cy, p, r, q = np.clip(values[i, lobe], *zip(*BOUNDS))
                a, b = np.array([[np.exp(p), 0], [r * np.exp(p), np.exp(q)]]), np.array([cx, cy])
                if LOBES[lobe] == "mirror":
                    t = np.eye(2) + np.outer(m, m)
                    a, b = t @ a, m + t @ b
            v = np.linalg.solve(a, wi[i, :2] - b * z)
            density[i] += weight * z / (np.pi * abs(np.linalg.det(a)) * (z * z + v @ v) ** 2)
    return density[:, None]


def chi2(plugin, u, wo, bend):
    """The p-value of the hypothesis that `sample` follows `pdf`; `bend` is a power that spoils the sample's first number."""
    si = dr.zeros(mi.SurfaceInteraction3f)
    si.uv, si.wi, plugin.bsdf.level = mi.Point2f(u.tolist()), mi.Vector3f(wo.tolist()), mi.Float(1.0)
    context = mi.BSDFContext()

    def sample(xi):
        drawn, _ = plugin.bsdf.sample(context, si, xi.z, mi.Point2f(dr.power(xi.x, bend), xi.y), True)
        return drawn.wo, mi.Float(1.0)

    test = mi.chi2.ChiSquareTest(
        domain=mi.chi2.SphericalDomain(),
        sample_func=sample,
        pdf_func=lambda w: plugin.bsdf.pdf(context, si, w, True),
        sample_dim=3,
        sample_count=200_000,
        res=40,
        ires=8,
    )
    test.run(0.01, quiet=True)
    return float(test.p_value)


def camera_rays(side, origin, target, fov):
    """Directions through the middle of every pixel, and a pixel further along each axis: three of [N, 3]."""
    forward = np.array(target, float) - origin
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    up = np.cross(right, forward)
    width = np.tan(np.radians(fov) / 2)
    y, x = np.meshgrid(np.arange(side) + 0.5, np.arange(side) + 0.5, indexing="ij")

    def through(x, y):
        a, b = (2 * x.ravel() / side - 1) * width, (1 - 2 * y.ravel() / side) * width
        d = forward + a[:, None] * right + b[:, None] * up
        return d / np.linalg.norm(d, axis=1, keepdims=True)

    return through(x, y), through(x + 1, y), through(x, y + 1)


def expected(bundle, name, side, flip=1.0, bias=0.0):
    """The picture by the contract's own formulas and the numpy reference; `flip` and `bias` spoil frame and level."""
    origin, target, fov = (np.array(a) for a in neumip_scene.CAMERAS[name])
    here, right, down = camera_rays(side, origin, target, fov)
    if name == "plane":
        far = -origin[2] / here[:, 2]
    else:
        b = here @ origin
        square = b * b - (origin @ origin - 1)
        far = np.where(square > 0, -b - np.sqrt(np.maximum(square, 0)), -1)
    point = origin + far[:, None] * here
    hit = far > 0
    if name == "plane":
        hit &= (np.abs(point[:, :2]) < 1).all(1)
        n, du, dv = (np.broadcast_to(a, point.shape) for a in ([0.0, 0, 1], [2.0, 0, 0], [0.0, 2, 0]))
        u = (point[:, :2] + 1) / 2
    else:
        x, y, z = point.T
        ring = np.maximum(np.hypot(x, y), 1e-9)
        n = point
        du = 2 * np.pi * np.stack([-y, x, 0 * x], 1)
        dv = np.pi * np.stack([z * x / ring, z * y / ring, -ring], 1)
        u = np.stack([np.arctan2(y, x) / (2 * np.pi) % 1, np.arccos(np.clip(z, -1, 1)) / np.pi], 1)

    def along(d):
        """How u moves to where a neighbouring ray meets the tangent plane."""
        reach = ((point - origin) * n).sum(1) / (d * n).sum(1)
        moved = origin + reach[:, None] * d - point
        return np.stack([(moved * a).sum(1) / (a * a).sum(1) for a in (du, dv)], 1)

    dx, dy = along(right) * TILING, along(down) * TILING
    height, width = Bundle(bundle).resolution
    area = np.abs(dx[:, 0] * dy[:, 1] - dx[:, 1] * dy[:, 0]) * height * width
    level = 0.5 * np.log2(np.maximum(area, 1e-20)) + bias
    x = du / np.linalg.norm(du, axis=1, keepdims=True)
    y = flip * dv / np.linalg.norm(dv, axis=1, keepdims=True)
    light = np.broadcast_to(np.array(LIGHT) / np.linalg.norm(LIGHT), point.shape)
    wi, wo = (np.stack([(w * a).sum(1) for a in (x, y, n)], 1) for w in (light, -here))
    rgb = Material(Path(bundle) / "model.safetensors").evaluate(u * TILING, wi[:, :2], wo[:, :2], level)
    up = hit & (wi[:, 2] > 0) & (wo[:, 2] > 0)
    return np.where(up[:, None], rgb, 0).reshape(side, side, 3)


def picture(bundle, name):
    """Mitsuba's picture against the formulas: the difference that 99 % of the pixels are within, since a silhouette or a
    shadow's edge moves by rounding."""
    side = SIDE[mi.variant()]
    origin, target, fov = neumip_scene.CAMERAS[name]
    sensor = neumip_scene.camera(origin, target, [0, 0, 1], fov, [side, side])
    bsdf = {"type": "neumip", "bundle": str(bundle), "tiling": " ".join(map(str, TILING))}
    world = mi.load_dict(neumip_scene.scene(name, bsdf, sensor, LIGHT))
    neumip_bsdf.check(world)
    ours = neumip_scene.render_centres(world)

    def most(theirs):
        return float(np.quantile(np.max(np.abs(ours - theirs) / (1 + np.abs(theirs)), axis=2), 0.99))

    result = {"lit": float((ours > 0).any(2).mean()), "difference": most(expected(bundle, name, side))}
    result["flipped"] = most(expected(bundle, name, side, flip=-1.0))
    result["blurred"] = most(expected(bundle, name, side, bias=0.5))
    return result


def deferred(consumers, bundle, folder):
    """The deferred picture against the formulas: the mean difference over the mean, and with the light moved."""
    side, finer = 32, 4
    out = str(folder / "deferred.npy")
    command = [sys.executable, "-B", str(consumers / "mitsuba/neumip_deferred.py"), str(bundle), "--out", out]
    command += ["--spp", str(finer**2), "--size", str(side), str(side), "--scene", "sphere", "--tiling", *map(str, TILING)]
    # A pixel is the mean of finer ones, each with the whole pixel's footprint.
    theirs = expected(bundle, "sphere", side * finer, bias=np.log2(finer))
    theirs = theirs.reshape(side, finer, side, finer, 3).mean((1, 3))
    differences = []
    for light in (LIGHT, [LIGHT[0], -LIGHT[1], LIGHT[2]]):
        subprocess.run([*command, "--light", *map(str, light)], check=True, capture_output=True)
        differences.append(float(np.abs(np.load(out) - theirs).mean() / theirs.mean()))
    return differences


def furnace(bundle):
    """Largest relative difference of the rendered albedo and the integrated one; and with the reference seen from elsewhere."""
    rows = []
    for angle in (10.0, 55.0):
        integrated = neumip_furnace.integrated(bundle, angle, 1.0, points=1 << 15)
        rows.append([neumip_furnace.rendered(bundle, angle, 1.0), integrated])
    rendered, integrated = (np.array(column) for column in zip(*rows))
    return {
        "albedo": integrated.mean(1).tolist(),
        "difference": float(np.max(np.abs(rendered / integrated - 1))),
        "twin": float(np.max(np.abs(rendered / integrated[::-1] - 1))),
    }


def refusals(consumers, bundle, folder):
    """What is said of bad input, where it is not what it should be."""
    wrong, count = [], iter(range(100))

    def said(problem, *parts):
        if "\n" in problem or not all(part in problem for part in parts):
            wrong.append(f"{parts}: {problem}")

    def refused(change, *parts):
        copy = folder / f"bad{next(count)}"
        shutil.copytree(bundle, copy)
        change(copy)
        try:
            Bundle(copy)
            wrong.append(f"{parts}: was read")
        except BundleError as problem:
            said(str(problem), str(copy), *parts)

    def edit(name, old, new):
        def change(copy):
            data = (copy / name).read_bytes()
            assert old in data, old
            data = data.replace(old, new, 1)
            if name.endswith(".safetensors"):
                (length,) = struct.unpack("<Q", data[:8])
                data = struct.pack("<Q", length + len(new) - len(old)) + data[8:]
            (copy / name).write_bytes(data)
            if name != "material.json":
                list_file(copy / name)

        return change

    def altered(copy):
        data = bytearray((copy / "model.safetensors").read_bytes())
        data[-1] ^= 1
        (copy / "model.safetensors").write_bytes(data)

    def poisoned(copy):
        data = (copy / "model.safetensors").read_bytes()
        (copy / "model.safetensors").write_bytes(data[:-4] + struct.pack("<f", np.nan))
        list_file(copy / "model.safetensors")

    model, sampler = "model.safetensors", "sampler.safetensors"
    refused(lambda copy: (copy / model).unlink(), model, "cannot be read")
    refused(altered, model, "altered")
    refused(poisoned, model, "not finite")
    refused(lambda copy: (copy / sampler).unlink(), sampler, "cannot be read")
    refused(lambda copy: (copy / "material.json").unlink(), "material.json", "cannot be read")
    refused(lambda copy: (copy / "material.json").write_text("{"), "material.json", "cannot be read")
    refused(edit("material.json", b'"format": 1', b'"format": 7'), "bundle format 7 is not known")
    refused(edit(model, rb"\"format\":1", rb"\"format\":8"), "format 8 is not known")
    refused(edit(sampler, rb"\"format\": 1", rb"\"format\": 9"), "format 9 is not known")
    refused(edit(sampler, b"mirror", b"morror"), sampler, "`morror` is not known")
    refused(edit(model, rb"\"kind\":\"mlp\"", rb"\"kind\":\"inception\""), "`inception` reads neighbours")
    refused(edit(model, rb"\"components\":2", rb"\"components\":3"), model, "do not lead from")
    refused(edit(model, b"decoder.mlp.1.bias", b"decoder.mlp.9.bias"), model, "decoder.mlp.1.bias")

    def command(*arguments):
        script = [sys.executable, "-B", str(consumers / "mitsuba/neumip_example.py"), *arguments]
        script += ["--out", str(folder / "x.png"), "--variant", mi.variant()]
        ended = subprocess.run(script, capture_output=True, text=True)
        said(ended.stderr.strip(), *(["neumip: "] if ended.returncode == 1 else ["exit status", str(ended.returncode)]))
        return ended.stderr

    said(command(str(folder / "nowhere")).strip(), "no such folder")
    said(command(str(bundle), "--tiling", "many").strip(), "tiling is `many`")
    said(command(str(bundle), "--tiling", "0").strip(), "no usable number")

    for uv in (None, np.zeros(6)):
        properties = mi.Properties()
        properties["bsdf"] = mi.load_dict({"type": "neumip", "bundle": str(bundle)})
        mesh = mi.Mesh("triangle", 3, 1, props=properties, has_vertex_texcoords=uv is not None)
        arrays = mi.traverse(mesh)
        arrays["vertex_positions"], arrays["faces"] = np.eye(3, dtype=np.float32).ravel(), np.arange(3, dtype=np.uint32)
        if uv is not None:
            arrays["vertex_texcoords"] = uv.astype(np.float32)
        arrays.update()
        try:
            neumip_bsdf.check(mi.load_dict({"type": "scene", "mesh": mesh}))
            wrong.append("a mesh without texture coordinates was taken")
        except BundleError as problem:
            said(str(problem), "texture coordinates")
    return wrong


def main(consumers, variant, bundle, twin, folder):
    result = {"version": mi.__version__, "golden": golden(bundle), "twin": golden(twin)}
    result["fitted"] = {name: golden(Path(folder) / name)[0] for name in ("window", "misplaced")}
    sampled = with_sampler(Path(bundle), folder / "sampled")
    result["sampling"] = {"cosine": sampling(bundle), "mixture": sampling(sampled)}
    result["pictures"] = {name: picture(bundle, name) for name in ("plane", "sphere")}
    if variant.startswith("scalar"):
        result["deferred"] = deferred(consumers, bundle, folder)
        result["refusals"] = refusals(consumers, sampled, folder)
    else:
        result["furnace"] = furnace(sampled)
    return result


if __name__ == "__main__":
    consumers, variant, bundle, twin, folder, out = sys.argv[1:]
    sys.path[:0] = [str(Path(consumers) / part) for part in ("mitsuba", "python")]
    import drjit as dr
    import mitsuba as mi
    import neumip_llvm

    try:
        neumip_llvm.set_variant(variant)
    except RuntimeError as problem:
        Path(out).write_text(json.dumps({"missing": str(problem)}))
        sys.exit(0)
    import neumip_bsdf
    import neumip_furnace
    import neumip_scene
    from neumip_bundle import Bundle, BundleError
    from reference_numpy import Material

    Path(out).write_text(json.dumps(main(Path(consumers), variant, bundle, twin, Path(folder))))
