"""Runs a bundle's golden queries through its WebGL shader in headless Chromium, and says how far the answers are.

    python check_shader.py BUNDLE SHADERS MODE [--chromium PROGRAM] [--alter] [--timing SIDE]

SHADERS is the folder with MODE.es.glsl (exact or fast) and weights-f32.bin. Prints the largest |difference| / (1 + |value|)
over all golden answers, and its mean. --alter changes one weight first. Exits with 1 where an exact shader is further off than
the bundle's tolerance, with 3 where there is no browser. The standard library only.
"""

import argparse
import array
import base64
import html
import json
import pathlib
import shutil
import struct
import subprocess
import sys
import tempfile

FLAGS = """--headless=new --no-sandbox --use-angle=swiftshader --enable-unsafe-swiftshader --disable-background-networking
 --disable-component-update --disable-sync --no-first-run --disable-quic --disable-extensions --disable-gpu-process-crash-limit
 --virtual-time-budget=1000000""".split()
PROGRAMS = ["chromium", "chromium-browser", "google-chrome", "google-chrome-stable"]
# Seconds before a browser that does not answer is given up.
PATIENCE = 300
ANSWER = "answer = vec4(neumip_evaluate(neumip_prepare(a.xy, a.z, b.zw), b.xy), 1.0);"


def read_safetensors(path):
    """The metadata and the tensors (shape, numbers) of a file of 32-bit floats."""
    data = path.read_bytes()
    (length,) = struct.unpack("<Q", data[:8])
    header = json.loads(data[8 : 8 + length])
    metadata = header.pop("__metadata__", {})
    tensors = {}
    for name, entry in header.items():
        begin, end = entry["data_offsets"]
        tensors[name] = (entry["shape"], array.array("f", data[8 + length + begin : 8 + length + end]))
    return metadata, tensors


def encoded(numbers):
    return base64.b64encode(array.array("f", numbers).tobytes()).decode()


def planes(tensor):
    """Channels of one level, four a layer, layer after layer."""
    (height, width, channels), data = tensor
    layers = -(-channels // 4)
    out = array.array("f", bytes(16 * layers * height * width))
    for c in range(channels):
        start = (c // 4) * 4 * height * width + c % 4
        out[start : start + 4 * height * width : 4] = data[c::channels]
    return out


def texture(tensors, names):
    height, width, channels = tensors[names[0]][0]
    levels = [encoded(planes(tensors[name])) for name in names]
    return {"width": width, "height": height, "layers": -(-channels // 4), "levels": levels}


def page(bundle, shaders, mode, alter, timing, side):
    """The page's text."""
    metadata, tensors = read_safetensors(bundle / "model.safetensors")
    golden = json.loads((bundle / "golden.json").read_text())
    weights = array.array("f", (shaders / "weights-f32.bin").read_bytes())
    if alter:
        # The last layer's bias of the first output, wherever the block has it: the decoder's weights are the longest run.
        weights[alter] += 0.01
    levels = sum(name.startswith("texture.level") for name in tensors)
    count = len(golden["u"])
    rows = -(-count // side)
    rest = [0.0] * 4 * (rows * side - count)
    first = [v for u, level in zip(golden["u"], golden["level"]) for v in (*u, level, 0.0)] + rest
    second = [v for wi, wo in zip(golden["wi"], golden["wo"]) for v in (*wi, *wo)] + rest
    data = {
        "source": (shaders / f"{mode}.es.glsl").read_text(),
        "main": ANSWER,
        "exact": mode == "exact",
        "texture": texture(tensors, [f"texture.level{k}" for k in range(levels)]),
        "offset": texture(tensors, ["offset.texture"]) if "offset.texture" in tensors else None,
        "weights": encoded(weights),
        "queries": {"width": side, "height": rows, "first": encoded(first), "second": encoded(second)},
        "timing": timing,
    }
    template = pathlib.Path(__file__).with_name("check_shader.html").read_text()
    # "</" would end the script.
    return template.replace("/*DATA*/ null", json.dumps(data).replace("</", "<\\/")), golden


def browse(program, text, folder):
    """What the page says when it is done."""
    (folder / "page.html").write_text(text)
    command = [program, *FLAGS, f"--user-data-dir={folder / 'profile'}", "--dump-dom", (folder / "page.html").as_uri()]
    said = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE, check=False)
    _, mark, result = said.stdout.partition("RESULT")
    if not mark:
        sys.exit(f"{program} gave no result: {said.stderr[-2000:]}")
    result = json.loads(html.unescape(result.partition("END")[0]))
    if "problem" in result:
        sys.exit(f"the page failed: {result['problem']}")
    return result


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("bundle", type=pathlib.Path)
    parser.add_argument("shaders", type=pathlib.Path)
    parser.add_argument("mode", choices=["exact", "fast"])
    parser.add_argument("--chromium")
    parser.add_argument("--alter", type=int, default=0)
    parser.add_argument("--timing", type=int, default=0)
    arguments = parser.parse_args()
    program = arguments.chromium or next(filter(None, map(shutil.which, PROGRAMS)), None)
    if program is None:
        print("no Chromium: " + ", ".join(PROGRAMS))
        sys.exit(3)
    text, golden = page(arguments.bundle, arguments.shaders, arguments.mode, arguments.alter, arguments.timing, 32)
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        result = browse(program, text, pathlib.Path(folder))
    answers = result["answers"]
    found = [
        abs(answers[4 * i + c] - value) / (1 + abs(value))
        for i, rgb in enumerate(golden["rgb"])
        for c, value in enumerate(rgb)
    ]
    # A comparison with NaN is false: it must not pass for small.
    worst = max(v if v == v else float("inf") for v in found)
    print(f"{arguments.mode}: largest {worst:.3e}, mean {sum(found) / len(found):.3e} of {len(found)} values; {result['renderer']}")
    if arguments.timing:
        frames = sorted(result["frames"])
        print(f"{arguments.timing}^2: median {frames[len(frames) // 2]:.1f} ms, first {result['compiled']:.0f} ms; {frames}")
    if arguments.mode == "exact" and worst > golden["tolerance"]:
        sys.exit(1)


if __name__ == "__main__":
    main()
