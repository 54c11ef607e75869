"""Runs a bundle's golden queries through WebGL shaders in headless Chromium, and says how far the answers are.

    python check_shader.py SOURCE... [--bundle FOLDER] [--chromium PROGRAM] [--timing SIDE]

A SOURCE is an .es.glsl file in its bundle (or of the bundle that is named), with weights-f32.bin beside it where it binds
weights; one whose name starts with `fast` is given half-float textures and the hardware's filter. SOURCE@FILE asks its sampler
instead: FILE, in the bundle, is a JSON object with u, level, wo, xi [x, y] and drawn [x, y, z, pdf]. For every source, the
largest and the mean |difference| / (1 + |value|) are printed.
Exits with 1 where there was no answer, with 3 where there is no browser. The standard library only.
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
 --disable-component-update --disable-sync --no-first-run --disable-quic --disable-extensions
 --virtual-time-budget=1000000""".split()
PROGRAMS = ["chromium", "chromium-browser", "google-chrome", "google-chrome-stable"]
NO_BROWSER = 3
# Seconds before a browser that does not answer is given up.
PATIENCE = 300
# Queries in a row of the picture that is drawn.
SIDE = 32
EVALUATE = "answer = vec4(neumip_evaluate(neumip_prepare(a.xy, a.z, b.zw), b.xy), 1.0);"
SAMPLE = "answer = neumip_sample(neumip_lobes(neumip_prepare(a.xy, a.z, b.zw)), b.xy);"


def read_safetensors(path):
    """The tensors (shape, numbers) of a file of 32-bit floats."""
    data = path.read_bytes()
    (length,) = struct.unpack("<Q", data[:8])
    header = json.loads(data[8 : 8 + length])
    header.pop("__metadata__", None)
    tensors = {}
    for name, entry in header.items():
        begin, end = entry["data_offsets"]
        tensors[name] = (entry["shape"], array.array("f", data[8 + length + begin : 8 + length + end]))
    return tensors


def encoded(numbers):
    return base64.b64encode(array.array("f", numbers).tobytes()).decode()


def planes(tensor):
    """Channels of one level, four a layer, layer after layer."""
    (height, width, channels), data = tensor
    texels = 4 * height * width
    out = array.array("f", bytes(4 * texels * -(-channels // 4)))
    for c in range(channels):
        start = c // 4 * texels
        out[start + c % 4 : start + texels : 4] = data[c::channels]
    return out


def texture(tensors, names):
    height, width, channels = tensors[names[0]][0]
    levels = [encoded(planes(tensors[name])) for name in names]
    return {"width": width, "height": height, "layers": -(-channels // 4), "levels": levels}


def job(source, tensors, queries):
    """What the page needs to run one source."""
    levels = sum(name.startswith("texture.level") for name in tensors)
    asked = queries.get("xi")
    lights = asked or queries["wi"]
    rows = -(-len(lights) // SIDE)
    rest = [0.0] * 4 * (rows * SIDE - len(lights))
    first = [v for u, level in zip(queries["u"], queries["level"]) for v in (*u, level, 0.0)]
    second = [v for wi, wo in zip(lights, queries["wo"]) for v in (*wi, *wo)]
    text = source.read_text()
    weights = source.with_name("weights-f32.bin").read_bytes() if "neumip_weights" in text else b""
    return {
        "source": text,
        "main": SAMPLE if asked else EVALUATE,
        "exact": not source.name.startswith("fast"),
        "texture": texture(tensors, [f"texture.level{k}" for k in range(levels)]),
        "offset": texture(tensors, ["offset.texture"]) if "offset.texture" in tensors else None,
        "weights": encoded(array.array("f", weights)),
        "queries": {"width": SIDE, "height": rows, "first": encoded(first + rest), "second": encoded(second + rest)},
    }


def browse(program, data):
    """What the page of the data says when it is done."""
    template = pathlib.Path(__file__).with_suffix(".html").read_text()
    # "</" would end the script.
    text = template.replace("/*DATA*/ null", json.dumps(data).replace("</", "<\\/"))
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as name:
        page = pathlib.Path(name) / "page.html"
        page.write_text(text)
        command = [program, *FLAGS, f"--user-data-dir={name}/profile", "--dump-dom", page.as_uri()]
        said = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE, check=False)
    _, mark, result = said.stdout.partition("RESULT")
    if not mark:
        sys.exit(f"{program} gave no result: {said.stderr[-2000:]}")
    result = json.loads(html.unescape(result.partition("END")[0]))
    if "problem" in result:
        sys.exit(f"the page failed: {result['problem']}")
    return result["results"]


def compared(answers, expected):
    """The largest and the mean difference; infinite where one is no number."""
    found = [
        abs((answers[4 * i + c] if answers[4 * i + c] is not None else float("inf")) - value) / (1 + abs(value))
        for i, row in enumerate(expected)
        for c, value in enumerate(row)
    ]
    return max(found), sum(found) / len(found)


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("sources", nargs="+")
    parser.add_argument("--bundle", type=pathlib.Path)
    parser.add_argument("--chromium")
    parser.add_argument("--timing", type=int, default=0)
    arguments = parser.parse_args()
    program = arguments.chromium or next(filter(None, map(shutil.which, PROGRAMS)), None)
    if program is None:
        print("no browser: none of " + ", ".join(PROGRAMS))
        sys.exit(NO_BROWSER)
    jobs, expected = [], []
    for named in arguments.sources:
        source, _, file = named.partition("@")
        bundle = arguments.bundle or pathlib.Path(source).parent
        queries = json.loads((bundle / (file or "golden.json")).read_text())
        jobs.append(job(pathlib.Path(source), read_safetensors(bundle / "model.safetensors"), queries))
        expected.append(queries["drawn"] if "xi" in queries else queries["rgb"])
    data = {"timing": arguments.timing, "jobs": jobs}
    for named, rows, result in zip(arguments.sources, expected, browse(program, data)):
        largest, mean = compared(result["answers"], rows)
        print(f"{named}: largest {largest:.3e} mean {mean:.3e}")
        if arguments.timing:
            frames = sorted(result["frames"])
            median = frames[len(frames) // 2]
            print(f"{arguments.timing} x {arguments.timing}: {median:.1f} ms; first frame and compiler {result['first']:.0f} ms")


if __name__ == "__main__":
    main()
