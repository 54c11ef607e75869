"""Times PyTorch and onnxruntime on the work of `neumip bench` and adds their ratios to its rows.

    neumip bench --json bench.json --onnx material.onnx
    python scripts/peers.py bench.json --onnx material.onnx --neumip target/release/neumip --out bench.json

PyTorch (eager, fused Adam) trains and answers with the default model of the bench: the same networks, textures, losses,
batches and pieces. onnxruntime answers through the graph that `--onnx` of the bench wrote: the same weights. Either is
left out, with a line that says so, where it is not installed. Peers are given their best setting: a batch is answered whole
or in parts that stay in the cache, whichever is faster, and a row is compared with the fastest that the peer is on as many
threads or on fewer.

All that does equal work is timed in turn, round by round; ratios are of medians. With `--neumip` the program itself takes
part in these rounds (`bench --bare`), so that a machine whose speed changes between two runs changes no ratio; without it
the rates of the file are compared.

Rows of train and infer without smoothing get `ratio_to_torch` and, for infer, `ratio_to_onnxruntime`: the row's samples a
second over the peer's.
"""

import argparse
import json
import math
import os
import statistics
import subprocess
import sys
import tempfile
import time

try:
    import numpy as np
except ImportError:
    sys.exit("numpy is not installed: install numpy, and torch or onnxruntime or both")

PIECE = 16
DISC = 0.99
LEVELS = 3.0
CHANNELS = 7
HIDDEN = (25, 25, 25)
U_BANDS, DIRECTION_BANDS = 10, 4
OFFSET_SCALE, MIN_Z = 0.1, 0.6
GUARD = 1e-7
SAMPLES_IN_TURN = 1 << 17
# Least seconds of one timing.
SECONDS = 0.1
# Queries answered at a time where a batch is answered in parts.
PART = 16384


def directions(random, n):
    radius, angle = np.sqrt(DISC * random.random(n)), 2 * np.pi * random.random(n)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], 1).astype(np.float32)


def queries(random, n):
    """u, wi, wo [n, 2] and level [n] of a jittered grid, every query with its own directions and level."""
    width = max(math.isqrt(n), 1)
    k = np.arange(n)
    grid = np.stack([k % width, k // width], 1)
    u = ((grid + random.random((n, 2))) / 512 + 0.13) % 1
    return u.astype(np.float32), directions(random, n), directions(random, n), (LEVELS * random.random(n)).astype(np.float32)


def pieces(random, n, resolution):
    """Queries of n samples in square pieces, each with one pair of directions and one level, and random targets [n, 3]."""
    count, area = n // PIECE**2, PIECE**2
    level = LEVELS * random.random(count)
    y, x = np.divmod(np.arange(area), PIECE)
    steps = np.stack([x, y], 1)[None] + 0.5
    corner = random.random((count, 1, 2))
    u = (corner + steps * 2.0 ** level[:, None, None] / np.array(resolution[::-1])) % 1
    wi, wo = directions(random, count), directions(random, count)
    each = lambda values: np.repeat(values, area, 0).astype(np.float32)
    return u.reshape(-1, 2).astype(np.float32), each(wi), each(wo), each(level), random.random((n, 3)).astype(np.float32)


class Torch:
    """The default model of the bench in PyTorch."""

    name = "torch"

    def __init__(self, resolution):
        import torch

        self.torch, self.version = torch, torch.__version__
        torch.manual_seed(1)
        height, width = resolution
        levels = min(resolution).bit_length()
        sizes = [(max(height >> l, 1), max(width >> l, 1)) for l in range(levels)]
        bases = np.cumsum([0] + [h * w for h, w in sizes])
        self.resolution, self.last = resolution, levels - 1
        # Of each level: width, height, first row of the table.
        self.of_level = torch.tensor([[w, h, b] for (h, w), b in zip(sizes, bases)], dtype=torch.float32)
        table = lambda texels, scale: torch.nn.Parameter(scale * torch.randn(texels, CHANNELS))
        self.pyramid, self.offset_texture = table(int(bases[-1]), 0.1), table(height * width, 0.0)

        def network(*widths):
            layers = []
            for inputs, outputs in zip(widths, widths[1:]):
                layers += [torch.nn.Linear(inputs, outputs), torch.nn.ReLU(inplace=True)]
            return torch.nn.Sequential(*layers[:-1])

        inputs = CHANNELS + 4 * U_BANDS + 8 * DIRECTION_BANDS
        self.offset, self.decoder = network(CHANNELS + 2, *HIDDEN, 1), network(inputs, *HIDDEN, 3)
        self.parameters = [self.pyramid, self.offset_texture, *self.offset.parameters(), *self.decoder.parameters()]
        self.adam = torch.optim.Adam(self.parameters, lr=1e-3, fused=True)
        x = torch.tensor([[-1.0, 0, 1], [-2, 0, 2], [-1, 0, 1]])
        self.sobel = torch.stack([x, x.T])[:, None].repeat(3, 1, 1, 1)

    def taps(self, u, size, base):
        """Table rows [n, 4] and weights [n, 4] of wrapped bilinear lookups; size [n, 2] or [2], base [n] or a number."""
        torch = self.torch
        x = u * size - 0.5
        low = x.detach().floor()
        f = x - low
        wrapped = lambda i: i - (i / size).floor() * size
        first, second = wrapped(low), wrapped(low + 1)
        width = size[..., 0]
        rows = [first[:, 1] * width + base, second[:, 1] * width + base]
        index = torch.stack([row + column[:, 0] for row in rows for column in (first, second)], 1)
        g = 1 - f
        weight = torch.stack([x[:, 0] * y[:, 1] for y in (g, f) for x in (g, f)], 1)
        return index.to(torch.int32), weight

    def encoded(self, x, bands):
        torch = self.torch
        y = (x[:, :, None] * (math.pi * 2.0 ** torch.arange(bands, dtype=torch.float32))).flatten(1)
        return [y.sin(), y.cos()]

    def rgb(self, u, wi, wo, level):
        torch = self.torch
        lookup = lambda table, index, weight: torch.nn.functional.embedding_bag(
            index, table, mode="sum", per_sample_weights=weight
        )
        size = torch.tensor(self.resolution[::-1], dtype=torch.float32)
        texel = lookup(self.offset_texture, *self.taps(u, size, 0.0))
        r = OFFSET_SCALE * self.offset(torch.cat([texel, wo], 1))
        z = (1 - (wo * wo).sum(1, keepdim=True)).clamp(min=MIN_Z**2).sqrt()
        moved = u + 0.5 * r * wo / z
        low = level.floor()
        f = (level - low)[:, None]
        both = []
        for at, share in ((low, 1 - f), ((low + 1).clamp(max=self.last), f)):
            of_level = self.of_level[at.long()]
            index, weight = self.taps(moved, of_level[:, :2], of_level[:, 2])
            both.append((index, weight * share))
        index, weight = (torch.cat(parts, 1) for parts in zip(*both))
        features = lookup(self.pyramid, index, weight)
        encoding = self.encoded(2 * u - 1, U_BANDS)
        encoding += self.encoded(wi, DIRECTION_BANDS) + self.encoded(wo, DIRECTION_BANDS)
        return self.decoder(torch.cat([features, *encoding], 1))

    def step(self, u, wi, wo, level, target):
        prediction = self.rgb(u, wi, wo, level)
        image = lambda x: x.clamp(min=GUARD).sqrt().sqrt().reshape(-1, PIECE, PIECE, 3).permute(0, 3, 1, 2)
        # Sobel is linear: one pass over the difference serves for both images.
        difference = image(prediction) - image(target)
        response = self.torch.nn.functional.conv2d(difference, self.sobel, groups=3)
        loss = (prediction - target).abs().mean() + 2 * (response * response).mean()
        self.adam.zero_grad(set_to_none=True)
        loss.backward()
        self.adam.step()

    def passes(self, work, batch, threads):
        """Ways to do one pass."""
        torch = self.torch
        random = np.random.default_rng(1)
        tensors = lambda arrays: [torch.from_numpy(a) for a in arrays]
        if work == "train":
            count = max(SAMPLES_IN_TURN // batch, 2)
            batches = [tensors(pieces(random, batch, self.resolution)) for _ in range(count)]
            turn = iter(range(sys.maxsize))
            return [lambda: self.step(*batches[next(turn) % count])]

        asked = tensors(queries(random, batch))

        def answer(part):
            with torch.inference_mode():
                return [self.rgb(*chunk).clamp(min=0) for chunk in zip(*(a.split(part) for a in asked))]

        return [lambda part=part: answer(part) for part in {batch, min(PART, batch)}]

    def use(self, threads):
        self.torch.set_num_threads(threads)


class Onnx:
    """The bench's model through the graph that it wrote."""

    name = "onnxruntime"

    def __init__(self, path):
        import onnxruntime

        self.runtime, self.version = onnxruntime, onnxruntime.__version__
        self.path = path

    def passes(self, work, batch, threads):
        if work != "infer":
            return []
        options = self.runtime.SessionOptions()
        options.intra_op_num_threads = threads
        session = self.runtime.InferenceSession(self.path, options, providers=["CPUExecutionProvider"])
        asked = dict(zip(("u", "wi", "wo", "level"), queries(np.random.default_rng(1), batch)))

        def answer(part):
            for start in range(0, batch, part):
                session.run(["rgb"], {name: values[start : start + part] for name, values in asked.items()})

        return [lambda part=part: answer(part) for part in {batch, min(PART, batch)}]

    def use(self, threads):
        # A session has its own threads.
        pass


class Timed:
    """One peer at one kind of work."""

    def __init__(self, peer, ways, threads):
        self.peer, self.threads, self.seconds = peer, threads, []
        self.peer.use(threads)
        # Twice each: the first time warms caches and allocators.
        took = {way: min(self.once(way, 1) for _ in range(2)) for way in ways}
        self.way = min(took, key=took.get)
        self.passes = max(1, math.ceil(SECONDS / took[self.way]))

    def once(self, way, passes):
        begun = time.perf_counter()
        for _ in range(passes):
            way()
        return (time.perf_counter() - begun) / passes

    def round(self):
        self.peer.use(self.threads)
        # Threads of whoever was timed last may still wait actively.
        time.sleep(0.02)
        self.seconds.append(self.once(self.way, self.passes))


def bench(program, work, batch, threads, resolution):
    """A round of the program itself: samples a second and the instruction set."""
    with tempfile.TemporaryDirectory() as folder:
        path = os.path.join(folder, "bench.json")
        line = [program, "bench", "--bare", "--rounds", "1", "--work", work, "--batches", str(batch)]
        line += ["--thread-counts", str(threads), "--resolution", str(resolution), "--json", path, "--quiet"]
        subprocess.run(line, check=True)
        with open(path) as file:
            (row,) = json.load(file)
        return row["samples_per_s"], row["isa"]


def rate(samples, seconds):
    return samples / statistics.median(seconds)


def compare(rows, peers, arguments):
    """Adds the ratios to the rows of one batch of one kind of work; they differ in threads and engine."""
    work, batch = rows[0]["work"], rows[0]["batch"]
    resolution = rows[0]["resolution"]
    thread_counts = sorted({row["threads"] for row in rows})
    timed = []
    for threads in thread_counts:
        for peer in peers:
            ways = peer.passes(work, batch, threads)
            if ways:
                timed.append(Timed(peer, ways, threads))
    own = {threads: [] for threads in thread_counts}
    for _ in range(arguments.rounds):
        for threads in thread_counts:
            if arguments.neumip:
                own[threads].append(bench(arguments.neumip, work, batch, threads, resolution[0]))
            for one in timed:
                if one.threads == threads:
                    one.round()
    for one in timed:
        # On a machine that others use too, two threads that wait for each other may be slower than one.
        rivals = [t for t in timed if t.peer is one.peer and t.threads <= one.threads]
        best = min(rivals, key=lambda t: statistics.median(t.seconds))
        theirs = rate(batch, best.seconds)
        ours = {row["isa"]: row["samples_per_s"] for row in rows if row["threads"] == one.threads}
        # How much faster or slower the machine was in these rounds than when the file was made.
        pace = 1.0
        if arguments.neumip:
            isa = own[one.threads][0][1]
            if isa in ours:
                pace = statistics.median(speed for speed, _ in own[one.threads]) / ours[isa]
        for row in rows:
            if row["threads"] == one.threads:
                row["ratio_to_" + one.peer.name] = pace * row["samples_per_s"] / theirs
        low, high = batch / max(one.seconds), batch / min(one.seconds)
        print(
            f"{work:<6} {batch:>7}  {one.threads:>2} threads  {one.peer.name:<12} "
            f"{rate(batch, one.seconds) / 1e6:>7.3f} M samples/s ({low / 1e6:.3f} to {high / 1e6:.3f}); "
            f"neumip {max(ours.values()) * pace / theirs:.2f} x its best",
            flush=True,
        )


def markdown(rows):
    """The rows that have a ratio to a peer."""
    columns = ["work", "batch", "set", "threads", "samples/s", "x candle", "x PyTorch", "x onnxruntime", "of peak"]
    lines = [columns, ["---"] + ["---:"] + ["---"] + ["---:"] * 6]
    number = lambda row, key: f"{row[key]:.1f}" if row.get(key) is not None else "-"
    for row in rows:
        if "ratio_to_torch" in row or "ratio_to_onnxruntime" in row:
            ratios = [number(row, "ratio_to_" + name) for name in ("candle", "torch", "onnxruntime")]
            name = "candle" if row["engine"] == "candle" else row["isa"]
            rate = f"{row['samples_per_s'] / 1e6:.2f} M"
            cells = [row["work"], row["batch"], name, row["threads"], rate, *ratios, f"{100 * row['peak_share']:.0f} %"]
            lines.append([str(cell) for cell in cells])
    return "".join("| " + " | ".join(line) + " |\n" for line in lines)


def main():
    about, _, notes = __doc__.partition("\n\n")
    parser = argparse.ArgumentParser(
        description=about, epilog=notes, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("bench", help="what neumip bench wrote with --json")
    parser.add_argument("--onnx", help="what neumip bench wrote with --onnx; absent: onnxruntime is left out")
    parser.add_argument("--neumip", help="the program, to take part in the rounds")
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--batches", help="only these, as 65536,262144")
    parser.add_argument("--out", help="where the rows with their ratios go")
    parser.add_argument("--markdown", help="where the table goes")
    arguments = parser.parse_args()
    if arguments.rounds < 1:
        parser.error("--rounds: at least 1 is needed")
    if arguments.onnx and not os.path.isfile(arguments.onnx):
        parser.error(f"--onnx {arguments.onnx}: no such file")
    try:
        with open(arguments.bench) as file:
            rows = json.load(file)
        only = {int(n) for n in arguments.batches.split(",")} if arguments.batches else None
        comparable = {}
        for row in rows:
            fits = row["model"] == "default" and row["smoothing"] == "none" and row["work"] in ("train", "infer")
            if fits and (only is None or row["batch"] in only):
                comparable.setdefault((row["work"], row["batch"]), []).append(row)
    except (OSError, ValueError, KeyError, TypeError) as error:
        parser.error(f"{arguments.bench}: not what neumip bench writes: {error!r}")
    if not comparable:
        parser.error(f"{arguments.bench}: has no rows of the default model to compare with")

    resolution = next(iter(comparable.values()))[0]["resolution"]
    peers = []
    for make in (lambda: Torch(resolution), lambda: Onnx(arguments.onnx)):
        try:
            peers.append(make())
        except ImportError as error:
            print(f"{error.name} is not installed: left out")
    if not arguments.onnx:
        peers = [peer for peer in peers if peer.name != "onnxruntime"]
        print("onnxruntime is left out: --onnx names no graph")
    if not peers:
        sys.exit("no peer to compare with")
    print(", ".join(f"{peer.name} {peer.version}" for peer in peers), flush=True)
    for group in comparable.values():
        compare(group, peers, arguments)
    if arguments.out:
        # Whole or not at all: it may be the file that was read.
        beside = arguments.out + ".part"
        with open(beside, "w") as file:
            json.dump(rows, file, indent=2)
            file.write("\n")
        os.replace(beside, arguments.out)
    if arguments.markdown:
        with open(arguments.markdown, "w") as file:
            file.write(markdown(rows))


if __name__ == "__main__":
    main()
