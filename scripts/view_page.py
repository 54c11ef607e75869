"""Opens a viewer's page in headless Chromium and takes something out of it. The standard library only.

    python view_page.py PAGE --selftest [--times]     golden answers by the page's shaders, milliseconds of a 256 x 256 frame
    python view_page.py PAGE --render SCENE.json --out picture.npy
                                                      linear RGB of a scene, [height, width, 3] floats, rows from the top
    python view_page.py PAGE --picture out.png [--size 1200x760] [--options "shape=torus&tiling=4,2"]

A scene is what window.neumip.render takes: {"shape", "tiling", "light", "irradiance", "camera": {"origin", "target", "up",
"fov"}, "width", "height", "mode"}. Exits with 3 where there is no browser; NEUMIP_CHROMIUM names one.
"""

import argparse
import base64
import html
import json
import os
import pathlib
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import urllib.parse

# The software rasteriser: the same pixels on every machine.
FLAGS = """--headless=new --no-sandbox --use-angle=swiftshader --enable-unsafe-swiftshader --disable-gpu-watchdog
 --disable-dev-shm-usage --disable-background-networking --disable-component-update --disable-sync --no-first-run --disable-quic
 --disable-extensions --hide-scrollbars --force-device-scale-factor=1""".split()
PROGRAMS = ["chromium", "chromium-browser", "google-chrome", "google-chrome-stable"]
# Seconds before a browser that does not answer is given up.
PATIENCE = 300
# Frames whose mean a picture is.
FRAMES = 16


def run(program, page, options, *flags):
    """The standard output of a browser that opens the page, and closes itself once it is loaded."""
    address = pathlib.Path(page).resolve().as_uri() + "#" + options
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        command = [program, *FLAGS, f"--user-data-dir={profile}", *flags, address]
        started = subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
        )
        try:
            said, complaints = started.communicate(timeout=PATIENCE)
        except subprocess.TimeoutExpired:
            os.killpg(started.pid, signal.SIGKILL)
            sys.exit(f"{program} did not answer in {PATIENCE} s")
    if started.returncode != 0:
        sys.exit(f"{program} failed: {complaints[-2000:]}")
    return said


def result(program, page, options):
    """What the page has to say."""
    said = run(program, page, options, "--dump-dom")
    found = re.search(r'<pre id="result"[^>]*>(.*?)</pre>', said, re.DOTALL)
    if not found or not found[1]:
        shown = re.search(r'<p id="message"[^>]*>(.*?)</p>', said, re.DOTALL)
        sys.exit(f"the page gave no result: {html.unescape(shown[1]) if shown else said[:500]}")
    return json.loads(html.unescape(found[1]))


def npy(shape, data):
    """32-bit floats as a file of numpy's."""
    header = f"{{'descr': '<f4', 'fortran_order': False, 'shape': {tuple(shape)}, }}"
    header += " " * (-(len(header) + 11) % 64) + "\n"
    return b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header.encode() + data


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("page")
    parser.add_argument("--selftest", action="store_true")
    parser.add_argument("--times", action="store_true")
    parser.add_argument("--render", type=pathlib.Path)
    parser.add_argument("--out", type=pathlib.Path)
    parser.add_argument("--picture", type=pathlib.Path)
    parser.add_argument("--size", default="1200x760")
    parser.add_argument("--options", default="")
    parser.add_argument("--chromium", default=os.environ.get("NEUMIP_CHROMIUM"))
    arguments = parser.parse_args()
    program = arguments.chromium or next(filter(None, map(shutil.which, PROGRAMS)), None)
    if program is None:
        print("no Chromium: " + ", ".join(PROGRAMS), file=sys.stderr)
        sys.exit(3)
    if arguments.selftest:
        print(json.dumps(result(program, arguments.page, "selftest=times" if arguments.times else "selftest")))
    if arguments.render:
        if not arguments.out:
            parser.error("--render needs --out")
        scene = json.dumps(json.loads(arguments.render.read_text()))
        found = result(program, arguments.page, "render=" + urllib.parse.quote(scene))
        if "problem" in found:
            sys.exit(f"the page failed: {found['problem']}")
        shape = (found["height"], found["width"], 3)
        arguments.out.write_bytes(npy(shape, base64.b64decode(found["pixels"])))
    if arguments.picture:
        options = f"{arguments.options}&still={FRAMES}"
        size = arguments.size.replace("x", ",")
        out = arguments.picture.resolve()
        out.unlink(missing_ok=True)
        run(program, arguments.page, options, f"--window-size={size}", f"--screenshot={out}")
        if not out.exists():
            sys.exit(f"{program} wrote no picture")


if __name__ == "__main__":
    main()
