"""A neural material in a white furnace: light of radiance 1 from everywhere.

    python neumip_furnace.py BUNDLE

For some view angles: the mean over the tile of what Mitsuba's path tracer sees through the plugin, and the integral of the
material's own answers over the hemisphere, by the numpy reference. Both are the albedo: at most 1 where no energy is made.
"""

import argparse
import json
import math
import sys
from pathlib import Path

import numpy as np

import neumip_llvm
from neumip_bundle import Bundle

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "python"))
from reference_numpy import Material  # noqa: E402, it is beside this folder

ANGLES = [0.0, 30.0, 60.0]


def viewer(angle):
    """The direction at `angle` degrees from the normal."""
    return np.array([math.sin(math.radians(angle)), 0.0, math.cos(math.radians(angle))])


def integrated(folder, angle, level, points=1 << 17):
    """The mean over the tile of the integral of f cos over the hemisphere: [3].

    Place and direction together are one lattice in four dimensions: the tile's fine detail would alias with a grid.
    """
    material = Material(Path(folder) / "model.safetensors")
    # Roberts' sequence: the powers of the root of x^5 = x + 1 fill the cube evenly, for any number of points.
    root = 1.1673039782614187
    lattice = (np.arange(points)[:, None] * root ** -np.arange(1.0, 5.0) + 0.5) % 1.0
    u, (z, turn) = lattice[:, :2], lattice[:, 2:].T
    # f cos dw = f cos dz dphi.
    radius, phi = np.sqrt(1.0 - z**2), 2.0 * math.pi * turn
    wi = np.stack([radius * np.cos(phi), radius * np.sin(phi)], -1)
    wo = np.broadcast_to(viewer(angle)[:2], wi.shape)
    return 2.0 * math.pi * material.evaluate(u, wi, wo, np.full(points, level)).mean(0)


def rendered(folder, angle, level, side=32, spp=64, seed=0):
    """The mean pixel of one tile, seen from `angle` with no perspective: [3]."""
    import mitsuba as mi

    matrix = np.eye(4)
    # The film is parallel to the plane and covers it; Mitsuba's film runs against the camera's x and y.
    matrix[:3, 0], matrix[:3, 1] = [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]
    matrix[:3, 2], matrix[:3, 3] = -viewer(angle), viewer(angle)
    film = {"type": "hdrfilm", "width": side, "height": side, "component_format": "float32"}
    sensor = {"type": "orthographic", "to_world": mi.ScalarTransform4f(matrix), "near_clip": 1e-3}
    world = mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": 2},
            "sensor": sensor | {"film": film | {"rfilter": {"type": "box"}}},
            "light": {"type": "constant", "radiance": {"type": "rgb", "value": 1.0}},
            "surface": {"type": "rectangle", "bsdf": {"type": "neumip", "bundle": str(folder), "level": float(level)}},
        }
    )
    return np.array(mi.render(world, spp=spp, seed=seed), np.float64)[..., :3].mean((0, 1))


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("bundle", help="folder that `neumip export` wrote")
    parser.add_argument("--variant", default="llvm_ad_rgb")
    parser.add_argument("--level", type=float, default=2.0)
    parser.add_argument("--spp", type=int, default=256)
    options = parser.parse_args()
    neumip_llvm.set_variant(options.variant)
    import neumip_bsdf  # noqa: F401, it registers the plugin

    Bundle(options.bundle)
    for angle in ANGLES:
        integral = integrated(options.bundle, angle, options.level)
        seen = rendered(options.bundle, angle, options.level, spp=options.spp)
        row = {"integral": integral, "rendered": seen, "ratio": seen / np.maximum(integral, 1e-9)}
        print(json.dumps({"angle": angle} | {name: values.round(4).tolist() for name, values in row.items()}))


if __name__ == "__main__":
    try:
        main()
    except (OSError, RuntimeError, ValueError) as problem:
        sys.exit(f"neumip: {neumip_llvm.one_line(problem)}")
