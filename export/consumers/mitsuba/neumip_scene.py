"""Scenes for a neural material in Mitsuba 3: shapes, camera, lights; and the command lines that name them.

Shapes are Mitsuba's own: `plane` is the square [-1, 1]^2 at z = 0, `sphere` has radius 1 around the origin.
"""

import argparse
import math
from collections import namedtuple

import mitsuba as mi
import numpy as np

View = namedtuple("View", "origin target fov")
# Where the camera stands, what it looks at, its horizontal field of view in degrees.
CAMERAS = {
    "plane": ([0.0, -1.6263456, 1.6263456], [0.0, 0.0, 0.0], 45.0),
    "sphere": ([0.0, -3.5, 1.5], [0.0, 0.0, 0.0], 40.0),
    "environment": ([0.0, -4.2, 1.9], [0.0, 0.0, -0.15], 38.0),
}
# Towards the light, and its irradiance on a plane that faces it.
LIGHT = ([0.5, -0.4, 0.8], 1.0)


def camera(origin, target, up, fov, size):
    """Pixels are square and fov is horizontal; a box filter, so that a pixel is its own samples' mean."""
    return {
        "type": "perspective",
        "fov": fov,
        "fov_axis": "x",
        "near_clip": 1e-2,
        "to_world": mi.ScalarTransform4f().look_at(origin, target, up),
        "film": {
            "type": "hdrfilm",
            "width": size[0],
            "height": size[1],
            "rfilter": {"type": "box"},
            "pixel_format": "rgb",
            "component_format": "float32",
        },
        "sampler": {"type": "independent"},
    }


def picture_arguments(parser):
    """The options of a picture and its camera; what is absent is the scene's own."""
    parser.add_argument("bundle", help="folder that `neumip export` wrote")
    parser.add_argument("--out", required=True, type=picture, help="picture to write: .exr, .png or .npy")
    parser.add_argument("--size", type=int, nargs=2, default=[512, 512], metavar=("W", "H"))
    parser.add_argument("--origin", type=float, nargs=3, metavar=("X", "Y", "Z"))
    parser.add_argument("--target", type=float, nargs=3, metavar=("X", "Y", "Z"))
    parser.add_argument("--up", type=float, nargs=3, default=[0.0, 0.0, 1.0], metavar=("X", "Y", "Z"))
    parser.add_argument("--fov", type=float, help="horizontal field of view in degrees")


def picture(path):
    """A path that `write` can write, for argparse."""
    if not path.endswith((".exr", ".png", ".npy")):
        raise argparse.ArgumentTypeError(f"{path}: pictures are .exr, .png or .npy")
    return path


def sensor_of(options):
    """The camera that a command's options name, and it as (origin, target, fov)."""
    origin, target, fov = CAMERAS[options.scene]
    view = View(options.origin or origin, options.target or target, options.fov or fov)
    return camera(*view[:2], options.up, view.fov, options.size), view


def write(path, image):
    """A linear picture [H, W, 3] as EXR, PNG (sRGB) or npy."""
    if path.endswith(".npy"):
        np.save(path, image)
    elif path.endswith(".png"):
        mi.util.write_bitmap(path, mi.TensorXf(image), write_async=False)
    else:
        mi.Bitmap(np.asarray(image, np.float32)).write(path)


def pixel_angle(fov, width):
    """Distance between pixels at distance 1, at the picture's middle."""
    return 2.0 * math.tan(math.radians(fov) / 2.0) / width


def directional(towards):
    return {"type": "directional", "direction": [-c for c in towards], "irradiance": {"type": "rgb", "value": LIGHT[1]}}


def sky(height=128):
    """A made-up environment: a blue sky over brown ground, a low sun, a window to the other side."""
    width = 2 * height
    theta, phi = ((np.arange(n) + 0.5) / n for n in (height, width))
    theta, phi = np.meshgrid(theta * math.pi, phi * 2.0 * math.pi, indexing="ij")
    up = np.cos(theta)
    blue, horizon, ground = (np.array(c) for c in ([0.25, 0.45, 0.9], [0.9, 0.9, 0.85], [0.20, 0.16, 0.12]))
    fade = np.clip(up, 0.0, 1.0)[..., None] ** 0.5
    image = np.where(up[..., None] > 0.0, 0.7 * (fade * blue + (1.0 - fade) * horizon), ground)
    d = np.stack([np.sin(theta) * np.sin(phi), up, -np.sin(theta) * np.cos(phi)], -1)
    sun = np.array([0.55, 0.60, 0.58]) / np.linalg.norm([0.55, 0.60, 0.58])
    image = image + 60.0 * np.exp((d @ sun - 1.0)[..., None] / 0.004) * np.array([1.0, 0.85, 0.6])
    window = (np.abs(phi - 1.5 * math.pi) < 0.5) & (np.abs(up - 0.35) < 0.25)
    image = image + 4.0 * window[..., None] * np.array([0.7, 0.85, 1.0])
    return {"type": "envmap", "bitmap": mi.Bitmap(image.astype(np.float32)), "to_world": upright()}


def upright():
    """Mitsuba's environment has y up; ours z."""
    return mi.ScalarTransform4f().rotate([1, 0, 0], 90)


def torus(bsdf, large=0.75, small=0.35, sides=(192, 96)):
    """Around z; u runs along the large circle, v along the small one."""
    m, n = sides
    i, j = np.meshgrid(np.arange(m + 1) / m, np.arange(n + 1) / n, indexing="ij")
    a, b = 2 * math.pi * i, 2 * math.pi * j
    normals = np.stack([np.cos(a) * np.cos(b), np.sin(a) * np.cos(b), np.sin(b)], -1)
    points = np.stack([large * np.cos(a), large * np.sin(a), np.zeros_like(a)], -1) + small * normals
    first = (np.arange(m)[:, None] * (n + 1) + np.arange(n)).ravel()
    quads = np.stack([first, first + n + 1, first + n + 2, first + 1], 1)
    properties = mi.Properties()
    properties["bsdf"] = bsdf
    has = {"has_vertex_normals": True, "has_vertex_texcoords": True}
    mesh = mi.Mesh("torus", points[..., 0].size, 2 * len(quads), props=properties, **has)
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = points.astype(np.float32).ravel()
    parameters["vertex_normals"] = normals.astype(np.float32).ravel()
    parameters["vertex_texcoords"] = np.stack([i, j], -1).astype(np.float32).ravel()
    parameters["faces"] = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]).astype(np.uint32).ravel()
    parameters.update()
    return mesh


def scene(name, bsdf, sensor, towards=LIGHT[0], shape="sphere", depth=6):
    """The dictionary of `plane` and `sphere` under a directional light, or of `environment`."""
    surface = {"type": "rectangle"} if name == "plane" else {"type": "sphere"}
    described = {"type": "scene", "integrator": {"type": "path", "max_depth": depth}, "sensor": sensor}
    if name != "environment":
        return described | {"light": directional(towards), "surface": surface | {"bsdf": bsdf}}
    if shape == "torus":
        surface = torus(mi.load_dict(bsdf))
        low = -0.35
    else:
        surface, low = surface | {"bsdf": bsdf}, -1.0
    ground = {
        "type": "rectangle",
        "to_world": mi.ScalarTransform4f().translate([0, 0, low]).scale(20.0),
        "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.35, 0.33, 0.3]}},
    }
    return described | {"light": sky(), "surface": surface, "ground": ground}


def render_centres(world):
    """Direct light through the middle of every pixel, with the pixel's whole footprint: no noise. [H, W, 3]."""
    sensor, context = world.sensors()[0], mi.BSDFContext()
    width, height = sensor.film().size()

    def radiance(x, y):
        middle = mi.Point2f((x + 0.5) / width, (y + 0.5) / height)
        ray, _ = sensor.sample_ray_differential(0.0, 0.5, middle, mi.Point2f(0.5))
        si = world.ray_intersect(ray)
        hit = si.is_valid()
        if not mi.variant().startswith("scalar"):
            si.compute_uv_partials(ray)
        elif hit:
            si.compute_uv_partials(ray)
        else:
            return mi.Color3f(0.0)
        sample, weight = world.sample_emitter_direction(si, mi.Point2f(0.5), True, hit)
        value = si.bsdf().eval(context, si, si.to_local(sample.d), hit)
        return mi.Color3f(value * weight)

    if mi.variant().startswith("scalar"):
        pixels = [radiance(float(x), float(y)) for y in range(height) for x in range(width)]
        return np.array(pixels, np.float32).reshape(height, width, 3)
    y = mi.Float(np.repeat(np.arange(height, dtype=np.float32), width))
    x = mi.Float(np.tile(np.arange(width, dtype=np.float32), height))
    return np.array(radiance(x, y)).T.reshape(height, width, 3)
