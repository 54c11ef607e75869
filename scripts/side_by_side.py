"""One material, one light, three programs: `neumip render`, Mitsuba 3 and the viewer's page in headless Chromium.

    target/mitsuba-environment/environment/bin/python scripts/side_by_side.py BUNDLE... --out docs/side-by-side.png

Every scene is rendered once by each program, one query in the middle of every pixel. The picture has a row for each bundle
and scene: the three pictures and ten times their differences from the first. Prints a table of the differences, and writes
it as JSON beside the picture. Needs numpy and mitsuba (the environment that the tests make has both); without a Chromium the browser is left out.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parent.parent
CAMERA = {"origin": [0.0, -2.0, 2.4], "target": [0.0, -0.05, 0.0], "up": [0.0, 0.0, 1.0], "fov": 42.0}
SCENES = {
    "plane": {"shape": "plane", "tiling": [2, 2], "light": [0.4, -0.3, 0.8], "camera": CAMERA},
    "sphere": {"shape": "sphere", "tiling": [6, 3], "light": [0.6, -0.6, 0.6], "camera": CAMERA},
}
# What differences are multiplied by to be seen.
SHOWN = 10.0
# Exit status of the page's driver where there is no browser.
NO_BROWSER = 3
# Light of irradiance pi, in which a white matte surface is white.
EXPOSURE = np.pi


def by_neumip(program, bundle, scene, size, folder):
    """`neumip render`."""
    written = {
        "version": 1,
        "objects": [{"shape": scene["shape"], "tiling": scene["tiling"]}],
        "lights": [{"directional": {"direction": scene["light"], "irradiance": 1}}],
        "camera": scene["camera"] | {"width": size, "height": size, "samples": 1},
    }
    (folder / "scene.json").write_text(json.dumps(written))
    run([program, "render", bundle, "--scene", folder / "scene.json", "--out", folder / "neumip", "--quiet"])
    import mitsuba as mi

    mi.set_variant("scalar_rgb")
    return np.array(mi.Bitmap(str(next((folder / "neumip").glob("*.exr")))))[..., :3].astype(np.float64)


def by_mitsuba(bundle, scene, size, folder, variant):
    """The plugin, in a process of its own: a variant is for the whole process."""
    camera = scene["camera"]
    words = [f"--{name}" for name in ("origin", "target", "up")]
    vectors = [[word, *camera[word[2:]]] for word in words] + [["--light", *scene["light"]]]
    script = ROOT / "export/consumers/mitsuba/neumip_example.py"
    command = [sys.executable, script, bundle, "--scene", scene["shape"], "--variant", variant]
    command += ["--size", size, size, "--fov", camera["fov"], "--out", folder / "mitsuba.npy"]
    command += ["--tiling", " ".join(map(str, scene["tiling"]))]
    run(command + [part for vector in vectors for part in vector])
    return np.load(folder / "mitsuba.npy")[..., :3].astype(np.float64)


def by_browser(program, bundle, scene, size, folder):
    """The viewer's page, read back as floats; nothing where there is no browser."""
    page = folder / "viewer.html"
    run([program, "view", bundle, "--out", page, "--quiet"])
    (folder / "view.json").write_text(json.dumps(scene | {"irradiance": 1, "width": size, "height": size}))
    script = ROOT / "scripts/view_page.py"
    command = [sys.executable, script, page, "--render", folder / "view.json", "--out", folder / "view.npy"]
    if run(command, (0, NO_BROWSER)) == NO_BROWSER:
        return None
    return np.load(folder / "view.npy").astype(np.float64)


def run(command, right=(0,)):
    finished = subprocess.run([str(part) for part in command], capture_output=True, text=True)
    if finished.returncode not in right:
        sys.exit(f"{' '.join(map(str, command))} failed:\n{finished.stdout}{finished.stderr}")
    return finished.returncode


def differences(picture, first):
    """Mean squared error of both clamped to [0, 1], and how far linear values are apart; `mirrored` is what it would be if the
    first were mirrored, which no match can survive."""
    apart = np.abs(picture - first) / (1.0 + np.abs(first))

    def mse(other):
        return float(np.mean((np.clip(picture, 0, 1) - np.clip(other, 0, 1)) ** 2))

    return {
        "mse": mse(first),
        "mirrored": mse(first[:, ::-1]),
        "mean": float(np.mean(apart)),
        "99.9 percent within": float(np.quantile(apart.max(axis=2), 0.999)),
        "largest": float(np.max(apart)),
    }


def shown(linear):
    """sRGB bytes."""
    x = np.clip(linear, 0, 1)
    return (255 * np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055) + 0.5).astype(np.uint8)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("bundles", nargs="+", type=Path)
    parser.add_argument("--out", type=Path, required=True, help="picture to write, PNG")
    parser.add_argument("--size", type=int, default=256)
    parser.add_argument("--neumip", default=ROOT / "target/release/neumip", type=Path)
    parser.add_argument("--variant", default="llvm_ad_rgb", help="of Mitsuba; scalar_rgb needs no LLVM and is slow")
    arguments = parser.parse_args()

    rows, table = [], []
    for bundle in arguments.bundles:
        for name, scene in SCENES.items():
            with tempfile.TemporaryDirectory() as folder:
                folder = Path(folder)
                common = (bundle, scene, arguments.size, folder)
                pictures = {
                    "neumip render": by_neumip(arguments.neumip, *common),
                    "Mitsuba 3": by_mitsuba(*common, arguments.variant),
                    "browser": by_browser(arguments.neumip, *common),
                }
            pictures = {program: picture for program, picture in pictures.items() if picture is not None}
            first = pictures["neumip render"]
            others = list(pictures.values())[1:]
            apart = [SHOWN * np.abs(picture - first) for picture in others]
            rows.append(np.concatenate([shown(EXPOSURE * p) for p in [*pictures.values(), *apart]], 1))
            for program, picture in list(pictures.items())[1:]:
                row = {"bundle": bundle.name, "scene": name, "program": program, **differences(picture, first)}
                table.append(row)
                print("  ".join(v if isinstance(v, str) else f"{v:.1e}" for v in row.values()), flush=True)

    import mitsuba as mi

    mi.Bitmap(np.concatenate(rows, 0)).write(str(arguments.out))
    temporary = arguments.out.with_suffix(".json.part")
    temporary.write_text(json.dumps(table, indent=1) + "\n")
    os.replace(temporary, arguments.out.with_suffix(".json"))


if __name__ == "__main__":
    main()
