"""Renders a neural material in Mitsuba 3.

    python neumip_example.py BUNDLE --scene environment --shape torus --tiling "8 4" --spp 64 --out torus.png
    python neumip_example.py BUNDLE --scene plane --size 256 256 --light 0.5 -0.4 0.8 --out plane.exr

`plane` and `sphere` stand under a distant light of irradiance 1. Without --spp they are seen through the middle of every
pixel, with the pixel's whole footprint, so that the picture can be compared with another renderer's; with --spp, and in
`environment` always, Mitsuba's path tracer makes it. OUT is EXR (linear), PNG (sRGB) or npy (linear).
"""

import argparse
import sys
import time

import numpy as np

import neumip_llvm
import neumip_scene


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    neumip_scene.picture_arguments(parser)
    parser.add_argument("--scene", choices=["plane", "sphere", "environment"], default="environment")
    parser.add_argument("--shape", choices=["sphere", "torus"], default="sphere", help="what stands in `environment`")
    parser.add_argument("--variant", default="llvm_ad_rgb", help="llvm_ad_rgb, cuda_ad_rgb or scalar_rgb (slow)")
    parser.add_argument("--spp", type=int, help="samples a pixel; absent: pixel centres, in `environment` 64")
    parser.add_argument("--depth", type=int, default=6, help="longest path, in segments")
    parser.add_argument("--light", type=float, nargs=3, metavar=("X", "Y", "Z"), help="towards the distant light")
    parser.add_argument("--tiling", default="1", help='tiles along u and v, such as "8 4"')
    parser.add_argument("--level", type=float, help="one level for every answer")
    parser.add_argument("--level-bias", type=float, default=0.0)
    parser.add_argument("--bsdf", choices=["neumip", "roughconductor"], default="neumip", help="to compare times")
    options = parser.parse_args()
    neumip_llvm.set_variant(options.variant)
    import mitsuba as mi
    import neumip_bsdf

    sensor, view = neumip_scene.sensor_of(options)
    bsdf = {"type": options.bsdf}
    if options.bsdf == "neumip":
        angle = neumip_scene.pixel_angle(view.fov, options.size[0])
        bsdf |= {"bundle": options.bundle, "tiling": options.tiling}
        bsdf |= {"level_bias": options.level_bias, "pixel_angle": angle}
        bsdf |= {} if options.level is None else {"level": options.level}
    else:
        bsdf |= {"alpha": 0.2, "material": "Au"}
    light = options.light or neumip_scene.LIGHT[0]
    world = mi.load_dict(neumip_scene.scene(options.scene, bsdf, sensor, light, options.shape, options.depth))
    neumip_bsdf.check(world)

    began = time.perf_counter()
    if options.spp is None and options.scene != "environment":
        image = neumip_scene.render_centres(world)
    else:
        image = np.array(mi.render(world, spp=options.spp or 64))
    print(f"{options.out}: {options.size[0]} x {options.size[1]} in {time.perf_counter() - began:.2f} s", file=sys.stderr)
    neumip_scene.write(options.out, image)


if __name__ == "__main__":
    try:
        main()
    except (OSError, RuntimeError, ValueError) as problem:
        sys.exit(f"neumip: {neumip_llvm.one_line(problem)}")
