"""Renders one picture of a Lambert heightfield in Mitsuba 3 for every line on standard input, and says how long it took.

Arguments: file of float32 heights, samples a side, pixels a side, samples a pixel, part of the tile that is shown, and the
x, y of the light's and the viewer's unit vectors. Variant scalar_rgb, one thread, direct light with shadows.
"""

import sys
import time

import drjit as dr
import mitsuba as mi
import numpy as np

mi.set_variant("scalar_rgb")
dr.set_thread_count(0)

side, pixels, samples = (int(float(v)) for v in sys.argv[2:5])
shown, *xy = (float(v) for v in sys.argv[5:10])
wi, wo = (np.array([x, y, (1 - x * x - y * y) ** 0.5]) for x, y in (xy[:2], xy[2:]))

heights = np.fromfile(sys.argv[1], np.float32).reshape(side, side)
centre = (np.arange(side) + 0.5) / side
positions = np.stack([*np.meshgrid(centre, centre), heights], -1).reshape(-1, 3)
first = (np.arange(side - 1)[:, None] * side + np.arange(side - 1)).ravel()
faces = np.concatenate([np.stack([first, first + 1, first + side + 1], 1), np.stack([first, first + side + 1, first + side], 1)])
mesh = mi.Mesh("field", len(positions), len(faces))
parameters = mi.traverse(mesh)
parameters["vertex_positions"] = positions.ravel().astype(np.float32)
parameters["faces"] = faces.ravel().astype(np.uint32)
parameters.update()

middle = np.array([0.5, 0.5, 0.0])
scene = mi.load_dict({
    "type": "scene",
    "integrator": {"type": "path", "max_depth": 2},
    "field": mesh,
    "light": {"type": "directional", "direction": (-wi).tolist(), "irradiance": 1.0},
    "sensor": {
        "type": "orthographic",
        "to_world": mi.ScalarTransform4f().look_at(origin=(middle + 2 * wo).tolist(), target=middle.tolist(), up=[0, 1, 0])
        @ mi.ScalarTransform4f().scale([shown / 2, shown / 2, 1]),
        "film": {"type": "hdrfilm", "width": pixels, "height": pixels, "rfilter": {"type": "box"}},
        "sampler": {"type": "independent", "sample_count": samples},
    },
})
print("ready", flush=True)
for _ in sys.stdin:
    begun = time.perf_counter()
    mi.render(scene)
    print(time.perf_counter() - begun, flush=True)
