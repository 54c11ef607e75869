"""Times PyTorch on the Inception decoders, beside the kernels of neumip.

    pip install torch --index-url https://download.pytorch.org/whl/cpu
    cargo build --release --example inception
    python scripts/inception_peer.py --beside "target/release/examples/inception {shape} {side} {work}"

Channels-last, float32, on all cores or `--threads`: eager, and compiled with `--compile` (which needs a C++ compiler).
Answering is the forward pass in inference mode; training is forward, and backward to weights and inputs. Outside a patch
are zeros, which costs PyTorch less than wrapping around (its circular padding leaves channels-last). Prints samples (pixels)
a second, medians.

With `--beside COMMAND` a program takes turns with PyTorch, round by round, so that a machine whose speed changes changes no
ratio. `{shape}`, `{side}` and `{work}` in the command become `inception` or `inception-small`, the side of the patch in
pixels, and `infer` or `train`; its last word must be samples a second.
"""

import argparse
import json
import shlex
import statistics
import subprocess
import sys
import time

try:
    import torch
    from torch import nn
    from torch.nn import functional
except ImportError:
    sys.exit("torch is not installed: pip install torch --index-url https://download.pytorch.org/whl/cpu")

INPUTS, OUTPUTS = 25, 3
# Paths, reductions and modules, as in the presets of the same names.
SHAPES = {
    "inception": ((64, 128, 32, 32), (96, 16), 6),
    "inception-small": ((7, 12, 3, 3), (9, 2), 2),
}
# Least seconds of one timing.
SECONDS = 0.3


class Module(nn.Module):
    def __init__(self, paths, reduce):
        super().__init__()
        width, (p1, p2, p3, p4), (r2, r3) = sum(paths), paths, reduce
        self.path1 = nn.Conv2d(width, p1, 1)
        self.reduce2, self.path2 = nn.Conv2d(width, r2, 1), nn.Conv2d(r2, p2, 3, padding=1)
        self.reduce3, self.path3 = nn.Conv2d(width, r3, 1), nn.Conv2d(r3, p3, 5, padding=2)
        self.path4 = nn.Conv2d(width, p4, 1)

    def forward(self, x):
        relu = functional.relu
        pooled = functional.max_pool2d(x, 3, 1, 1)
        parts = [
            self.path1(x),
            self.path2(relu(self.reduce2(x))),
            self.path3(relu(self.reduce3(x))),
            self.path4(pooled),
        ]
        return relu(torch.cat(parts, 1))


class Decoder(nn.Module):
    def __init__(self, paths, reduce, modules):
        super().__init__()
        width = sum(paths)
        self.first, self.last = nn.Conv2d(INPUTS, width, 1), nn.Conv2d(width, OUTPUTS, 1)
        self.modules_between = nn.Sequential(*(Module(paths, reduce) for _ in range(modules)))

    def forward(self, x):
        return self.last(self.modules_between(functional.relu(self.first(x))))


def steps(shape, side, work, compiled):
    """A function that does the work once."""
    torch.manual_seed(0)
    layout = {"memory_format": torch.channels_last}
    net = Decoder(*SHAPES[shape]).to(**layout)
    x = torch.randn(1, INPUTS, side, side).to(**layout)
    by_output = torch.randn(1, OUTPUTS, side, side).to(**layout)
    run = torch.compile(net) if compiled else net
    if work == "infer":

        def answer():
            with torch.inference_mode():
                run(x)

        return answer
    x.requires_grad_()

    def train():
        net.zero_grad(set_to_none=True)
        x.grad = None
        run(x).backward(by_output)

    return train


def seconds(step):
    """Seconds a step takes, over at least SECONDS."""
    start, count = time.perf_counter(), 0
    while count == 0 or time.perf_counter() - start < SECONDS:
        step()
        count += 1
    return (time.perf_counter() - start) / count


def beside(command, shape, side, work):
    command = command.format(shape=shape, side=side, work=work)
    try:
        done = subprocess.run(shlex.split(command), capture_output=True, text=True, check=False)
    except (OSError, ValueError) as error:
        sys.exit(f"{command}: {error}")
    try:
        return float(done.stdout.split()[-1])
    except (IndexError, ValueError):
        sys.exit(f"{command}: gave no number at its end: {done.stdout}{done.stderr}")


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--threads", type=int, default=torch.get_num_threads())
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--sides", type=int, nargs="+", default=[64, 128])
    parser.add_argument("--shapes", nargs="+", choices=SHAPES, default=list(SHAPES))
    parser.add_argument("--compile", action="store_true", help="time torch.compile too")
    parser.add_argument("--beside", metavar="COMMAND", help="a program that takes turns")
    parser.add_argument("--json", metavar="FILE", help="write the rows there")
    options = parser.parse_args()
    torch.set_num_threads(options.threads)
    rows = []
    for shape in options.shapes:
        for side in options.sides:
            for work in ("infer", "train"):
                kinds = {"eager": steps(shape, side, work, False)}
                if options.compile:
                    kinds["compiled"] = steps(shape, side, work, True)
                for step in kinds.values():
                    step()
                rates = {kind: [] for kind in kinds} | ({"beside": []} if options.beside else {})
                for _ in range(options.rounds):
                    for kind, step in kinds.items():
                        rates[kind].append(side * side / seconds(step))
                    if options.beside:
                        rates["beside"].append(beside(options.beside, shape, side, work))
                medians = {kind: statistics.median(of) for kind, of in rates.items()}
                row = {"shape": shape, "side": side, "work": work, "threads": options.threads}
                row |= {f"{kind}_samples_per_second": round(rate) for kind, rate in medians.items()}
                if options.beside:
                    best = max(rate for kind, rate in medians.items() if kind != "beside")
                    row["ratio_to_torch"] = round(medians["beside"] / best, 3)
                rows.append(row)
                print(" ".join(f"{key}={value}" for key, value in row.items()), flush=True)
    if options.json:
        with open(options.json, "w", encoding="utf-8") as file:
            json.dump({"torch": torch.__version__, "rows": rows}, file, indent=1)


if __name__ == "__main__":
    main()
