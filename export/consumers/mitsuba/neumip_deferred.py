"""Deferred shading of a neural material: Mitsuba 3 gives buffers, onnxruntime all answers in one batch.

    python neumip_deferred.py BUNDLE --scene sphere --tiling 8 4 --spp 4 --out sphere.exr

Needs the variant scalar_rgb only: no LLVM, no GPU, no plugin. Every sample is rendered into a buffer of its own, since a mean
of two places is neither of them. Direct light of one distant or point light, with shadows.
"""

import argparse
import sys
import time

import mitsuba as mi
import numpy as np
import onnxruntime

import neumip_scene
from neumip_bundle import Bundle
from neumip_llvm import one_line

AOVS = {"position": 3, "uv": 2, "sh_normal": 3, "dp_du": 3, "dp_dv": 3, "duv_dx": 2, "duv_dy": 2}
# Shadow rays start this much of a scene's size off the surface.
OFFSET = 1e-4


def buffers(world, seed):
    """One sample of every pixel: a dict of [H * W, k], and which pixels see a surface."""
    names = ",".join(f"{name}:{name}" for name in AOVS)
    integrator = mi.load_dict({"type": "aov", "aovs": names, "inner": {"type": "depth"}})
    image = np.array(mi.render(world, integrator=integrator, spp=1, seed=seed), np.float64)
    image = image.reshape(-1, image.shape[2])
    ends = np.cumsum(list(AOVS.values())) + image.shape[1] - sum(AOVS.values())
    values = {name: image[:, end - AOVS[name] : end] for name, end in zip(AOVS, ends)}
    return values, np.linalg.norm(values["sh_normal"], axis=1) > 0.5


def frames(values):
    """x along u, y along v, z along the normal: [N, 3] each. Where u has no direction any frame is as good."""
    z = unit(values["sh_normal"])
    x = values["dp_du"] - z * dot(z, values["dp_du"])
    lost = np.linalg.norm(x, axis=1, keepdims=True) < 1e-12
    other = np.where(np.abs(z[:, :1]) < 0.9, [[1.0, 0.0, 0.0]], [[0.0, 1.0, 0.0]])
    x = unit(np.where(lost, other - z * dot(z, other), x))
    y = np.cross(z, x)
    return x, np.where(dot(y, values["dp_dv"]) < 0, -y, y), z


def unit(w):
    return w / np.linalg.norm(w, axis=1, keepdims=True)


def dot(a, b):
    return np.sum(a * b, axis=1, keepdims=True)


def shade(world, bundle, session, origin, light, tiling, seed):
    """The radiance of one sample of every pixel: [H * W, 3]."""
    values, hit = buffers(world, seed)
    rgb = np.zeros((len(hit), 3))
    values = {name: value[hit] for name, value in values.items()}
    position = values["position"]
    if light["kind"] == "directional":
        towards = np.broadcast_to(unit(np.array([light["towards"]])), position.shape)
        distance, irradiance = np.full(len(position), np.inf), 1.0
    else:
        towards = np.array([light["position"]]) - position
        distance = np.linalg.norm(towards, axis=1)
        towards, irradiance = towards / distance[:, None], 1.0 / distance[:, None] ** 2
    x, y, z = frames(values)
    local = [np.concatenate([dot(w, a) for a in (x, y, z)], 1) for w in (towards, unit(np.array([origin]) - position))]
    height, width = bundle.tile
    dx, dy = (values[name] * tiling for name in ("duv_dx", "duv_dy"))
    area = np.abs(dx[:, 0] * dy[:, 1] - dx[:, 1] * dy[:, 0]) * width * height
    level = 0.5 * np.log2(np.maximum(area, 1e-20))

    facing = (local[0][:, 2] > 0) & (local[1][:, 2] > 0)
    facing[facing] = visible(world, position[facing], z[facing], towards[facing], distance[facing])
    feeds = {"u": values["uv"] * tiling, "wi": local[0][:, :2], "wo": local[1][:, :2], "level": level}
    feeds = {name: np.ascontiguousarray(a[facing], np.float32) for name, a in feeds.items()}
    answers = np.zeros_like(position)
    if facing.any():
        answers[facing] = session.run(["rgb"], feeds)[0]
    rgb[hit] = answers * irradiance
    return rgb


def visible(world, position, normal, towards, distance):
    """True where nothing stands between a point and the light."""
    start = position + normal * OFFSET
    rays = zip(start.tolist(), towards.tolist(), distance.tolist())
    return [not world.ray_test(mi.Ray3f(o, d, (1 - OFFSET) * far, 0.0, [])) for o, d, far in rays]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scene", choices=["plane", "sphere"], default="sphere")
    parser.add_argument("--spp", type=int, default=4, help="samples a pixel")
    parser.add_argument("--light", type=float, nargs=3, metavar=("X", "Y", "Z"), help="towards a distant light")
    parser.add_argument("--point", type=float, nargs=3, metavar=("X", "Y", "Z"), help="where a light of intensity 1 is")
    parser.add_argument("--tiling", type=float, nargs=2, default=[1.0, 1.0])
    neumip_scene.picture_arguments(parser)
    options = parser.parse_args()

    mi.set_variant("scalar_rgb")
    bundle = Bundle(options.bundle)
    session = onnxruntime.InferenceSession(bundle.read("material.onnx"), providers=["CPUExecutionProvider"])
    sensor, camera = neumip_scene.sensor_of(options)
    towards = options.light or neumip_scene.LIGHT[0]
    light = {"kind": "directional", "towards": towards}
    if options.point:
        light = {"kind": "point", "position": options.point}
    world = mi.load_dict(neumip_scene.scene(options.scene, {"type": "diffuse"}, sensor, towards))
    began = time.perf_counter()
    samples = (shade(world, bundle, session, camera.origin, light, options.tiling, k) for k in range(options.spp))
    image = (sum(samples) / options.spp).reshape(options.size[1], options.size[0], 3)
    print(f"{options.out}: {options.spp} samples in {time.perf_counter() - began:.2f} s", file=sys.stderr)
    neumip_scene.write(options.out, image)


if __name__ == "__main__":
    try:
        main()
    except (OSError, RuntimeError, ValueError) as problem:
        sys.exit(f"neumip: {one_line(problem)}")
