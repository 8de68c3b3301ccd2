#!/usr/bin/python3
"""What sampling by need saves: rays and CPU seconds to an error of the served picture, against
uniform sampling, and how true the promised error is.

    bench/samples_by_need.py --build build/release --out OUTPUT_FOLDER [--scenes FOLDER]
        [--views kitchen,bunny,...] [--size 256x144] [--references 1024] [--counts 32,128]
        [--targets 0.02,...] [--seeds 3] [--csv FILE]

For each view and each of --counts: the error that so many samples everywhere leave is the target
(or --targets are);
`tessera render --target-error` goes for it with `--sampling uniform` and `adaptive`, --seeds times
each. True errors (sqrt(relMSE)) are against two references of other seeds, free of their noise
(peers/accuracy.py). CPU seconds are those of the process without what a render of one sample takes
(loading, writing).

"rays" is the geometric mean over seeds and targets of the rays that adaptive sampling took over
those that uniform sampling takes to the same true error: rays of the uniform renders, along the
line of log error against log rays through them (errors of filtered pictures fall more slowly than
those of raw ones). "+-" is one standard error of the logarithm, from the spread over seeds. "bound":
that ratio for an oracle that knows the true error of each cell, measured with uniform counts of
other seeds, and gives samples by Neyman's rule, no cell fewer than the pilot; a cell's error falls
as the frame's, and a sample costs one ray where it meets the sky and equally many elsewhere. "CPU
seconds" is as "rays"; "as asked" are the ratios of rays and of CPU seconds for the same promise,
whatever the true error was.

What is finished is kept in OUTPUT_FOLDER, references for all builds, the rest for each: after
Ctrl-C (exit code 4) the same command goes on. Needs python3-numpy, python3-openimageio.
"""

import argparse
import csv
import dataclasses
import json
import math
import os
import pathlib
import signal
import sys

sys.dont_write_bytecode = True  # the source folder stays clean
ROOT = pathlib.Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT / "bench"), str(ROOT / "chart")]

import numpy
import OpenImageIO as oiio

from peers import accuracy, renderers, views
from tessera_chart import command, programs
from tessera_chart.errors import BadInput

CELL_PX = 16
PILOT_SPP = 8
REFERENCE_SEEDS = (101, 202)


def parse_arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    views.add_arguments(parser, size="256x144")
    parser.add_argument("--references", type=int, default=1024, help="samples of each reference")
    parser.add_argument("--counts", default="32,128")
    parser.add_argument("--targets", help="comma-separated errors; those of --counts without")
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--bound-seeds", type=int, default=4, help="of each uniform count; 0 = no bound")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--csv", type=pathlib.Path, help="every render, as a table")
    args = parser.parse_args()
    args.counts = [int(count) for count in args.counts.split(",")]
    args.targets = [float(target) for target in (args.targets or "").split(",") if target]
    if args.seeds < 2:
        parser.error(f"--seeds {args.seeds}: errors are between seeds; use 2 or more")
    if args.bound_seeds % 2:
        parser.error(f"--bound-seeds {args.bound_seeds}: one half chooses, the other says; use an "
                     "even number")
    return args


def write_whole(path: pathlib.Path, text: str) -> None:
    beside = path.with_suffix(".new")
    beside.write_text(text, encoding="utf-8")
    os.replace(beside, path)


def sums_by_cell(values: numpy.ndarray) -> list[float]:
    """Row by row of cells."""
    height, width = values.shape
    rows, columns = range(0, height, CELL_PX), range(0, width, CELL_PX)
    return numpy.add.reduceat(numpy.add.reduceat(values, rows, 0), columns, 1).ravel().tolist()


class Bench:
    """The renders of one view, measured once each."""

    def __init__(self, args, view):
        self.args, self.view = args, view
        self._tessera = programs.Tessera(str(args.build / "bin" / "tessera"))
        home = args.out / args.size / view.name
        self._references_folder = home
        self._folder = home / programs.digest_of(self._tessera.path)[:12]
        self._folder.mkdir(parents=True, exist_ok=True)
        self._scene = views.scene_path(view, args.scenes, args.build / "scenes")
        self._pair = None

    def _flags(self) -> list[str]:
        view, flags = self.view, []
        if view.position:
            for flag, v in (("--look-from", view.position), ("--look-at", view.target)):
                flags += [flag, ",".join(map(str, v))]
            flags += ["--fov-y", str(view.fov_y_degrees)]
        if view.env:
            flags += ["--env", str(renderers.environment_path(view, self._scene))]
        elif view.sky is not None:
            flags += ["--sky", f"{view.sky},{view.sky},{view.sky}"]
        return flags

    def _render(self, out: pathlib.Path, *goal) -> tuple[dict, float]:
        return self._tessera.run("render", self._scene, *self._flags(), "--size", self.args.size,
                                 "--threads", self.args.threads, "--quiet", *goal, "-o", out)

    def references(self) -> tuple[numpy.ndarray, numpy.ndarray]:
        if self._pair is None:
            pair = []
            for seed in REFERENCE_SEEDS:
                path = self._references_folder / f"reference_{self.args.references}_{seed}.exr"
                if not path.is_file():
                    part = path.with_name("part.exr")
                    self._render(part, "--spp", self.args.references, "--seed", seed,
                                 "--denoiser", "none")
                    os.replace(part, path)
                pair.append(accuracy.read_rgb(path))
            self._pair = tuple(pair)
        return self._pair

    def measured(self, name: str, *goal) -> dict:
        """A render's figures, rendered or taken up: rays, cpu_s, spp, target, estimate, relMSE as
        `true`, `raw_mean`, and by cell the sums of relative squared errors, the samples, and the
        pixels that hit something."""
        kept = self._folder / f"{name}.json"
        if kept.is_file():
            return json.loads(kept.read_text(encoding="utf-8"))
        out = self._folder / "part.exr"
        said, cpu_s = self._render(out, *goal, "--layers", "final,raw,samples,id")
        pair = self.references()
        errors = accuracy.relative_errors(accuracy.read_rgb(out), *pair)
        picture = oiio.ImageBuf(str(out))
        names = list(picture.spec().channelnames)
        pixels = picture.get_pixels(oiio.FLOAT).astype(numpy.float64)
        raw = pixels[:, :, [names.index(f"raw.{c}") for c in "RGB"]]
        # As floats, unsigned integers are parts of their maximum.
        counts = numpy.rint(pixels[::CELL_PX, ::CELL_PX, names.index("samples")] * (2 ** 32 - 1))
        found = {"rays": said["rays"], "spp": said["spp"], "cpu_s": cpu_s,
                 "target": said["error"]["promised"], "estimate": said["error"]["rel_rmse"],
                 "stopped_by": said["stopped_by"], "true": float(errors.mean()),
                 "raw_mean": float(raw.mean()), "cell_errors": sums_by_cell(errors),
                 "cell_samples": counts.ravel().tolist(),
                 "cell_hits": sums_by_cell((pixels[:, :, names.index("id")] > 0).astype(float))}
        write_whole(kept, json.dumps(found))
        out.unlink()
        return found

    def uniform_counts(self, spp: int, seed: int) -> dict:
        return self.measured(f"count_{spp}_{seed}", "--spp", spp, "--seed", seed)

    def loading(self) -> dict:
        """A render of one sample."""
        return self.measured("loading", "--spp", 1, "--seed", 1, "--denoiser", "none")

    def target(self, count: int) -> float:
        """The error that `count` samples everywhere leave, by two digits."""
        found = [self.uniform_counts(count, seed)["true"] for seed in (11, 12)]
        return float(f"{math.sqrt(max(sum(found) / len(found), 1e-8)):.2g}")

    def to_target(self, sampling: str, target: float, seed: int) -> dict:
        return self.measured(f"{sampling}_{target:g}_{seed}", "--target-error", target,
                             "--sampling", sampling, "--seed", seed)


@dataclasses.dataclass
class Found:
    """What one view says. Logarithms of ratios adaptive / uniform, by seed and target."""

    rays: list[float]
    seconds: list[float]
    rays_error: float
    seconds_error: float
    slope: float
    promise: dict[str, list[float]]  # by sampling: true over promised error
    asked: list[float]  # logs of the ratios of rays and of CPU seconds for the same promise
    bound: float | None = None


def line_through(runs: list[dict], figure: str):
    """log of `figure` that uniform sampling takes to log true relMSE, by least squares of log error
    over log rays; the slope too."""
    rays = numpy.log([run[figure] for run in runs])
    errors = numpy.log([max(run["true"], 1e-12) for run in runs])
    slope, offset = numpy.polyfit(rays, errors, 1)
    slope = min(slope, -0.3)  # few points are noisy: no error falls more slowly than that
    offset = float((errors - slope * rays).mean())
    return (lambda error: (error - offset) / slope), float(slope)


def standard_error(uniform: list[float], adaptive: list[float]) -> float:
    """Of the mean over seeds of the logarithm of a ratio, both sides' spread."""
    both = [numpy.var(uniform, ddof=1) / len(uniform), numpy.var(adaptive, ddof=1) / len(adaptive)]
    return math.sqrt(sum(both))


def compare(bench: Bench, runs: dict[str, list[dict]]) -> Found:
    fixed = bench.loading()["cpu_s"]
    for run in runs["uniform"] + runs["adaptive"]:
        run["work_s"] = max(run["cpu_s"] - fixed, 1e-3)
    logs, errors, slope = {}, {}, -1.0
    for figure in ("rays", "work_s"):
        rays_to, fitted = line_through(runs["uniform"], figure)
        residual = {kind: [math.log(run[figure]) - rays_to(math.log(max(run["true"], 1e-12)))
                           for run in runs[kind]] for kind in runs}
        logs[figure] = residual["adaptive"]
        errors[figure] = standard_error(residual["uniform"], residual["adaptive"])
        slope = fitted if figure == "rays" else slope
    promise = {kind: [math.sqrt(max(run["true"], 0)) / run["target"] for run in runs[kind]]
               for kind in runs}
    asked = [float(numpy.mean(numpy.log([run[figure] for run in runs["adaptive"]]))
                   - numpy.mean(numpy.log([run[figure] for run in runs["uniform"]])))
             for figure in ("rays", "work_s")]
    return Found(logs["rays"], logs["work_s"], errors["rays"], errors["work_s"], slope, promise,
                 asked)


def error_left(weights: numpy.ndarray, errors: numpy.ndarray, costs: numpy.ndarray, count: int,
               falls: float) -> float:
    """Of cells with `errors` at `count` samples each, when as many rays go to them by their
    weights, no fewer than the pilot's, over what equal numbers leave; errors ~ n^-falls."""
    low, high = 0.0, 1e12
    for _ in range(200):
        scale = (low + high) / 2 if low == 0 else math.sqrt(low * high)
        if (numpy.maximum(PILOT_SPP, scale * weights) * costs).sum() > count * costs.sum():
            high = scale
        else:
            low = scale
    samples = numpy.maximum(PILOT_SPP, low * weights)
    return float((errors * (count / samples) ** falls).sum() / errors.sum())


def bound(bench: Bench, slope: float, rays_per_spp: float) -> float:
    """The ratio of rays that Neyman's allocation by the cells' true errors would give: half of the
    seeds says what they are, the other half what comes of it."""
    half, falls = bench.args.bound_seeds // 2, min(1.0, -slope)
    # Pixels of the sky cost one ray a sample, all others share what is left.
    hits = numpy.array(bench.loading()["cell_hits"])
    width, height = map(int, bench.args.size.split("x"))
    pixels = numpy.array(sums_by_cell(numpy.ones((height, width))))
    costs = pixels - hits + hits * (rays_per_spp - (pixels - hits).sum()) / hits.sum()
    seeds = range(11, 11 + 2 * half)
    logs = []
    for count in bench.args.counts:
        cells = numpy.array([bench.uniform_counts(count, seed)["cell_errors"] for seed in seeds])
        for chosen, judged in ((cells[:half], cells[half:]), (cells[half:], cells[:half])):
            weights = (numpy.maximum(chosen.mean(axis=0), 0) / costs) ** (1 / (1 + falls))
            weights = numpy.maximum(weights, 1e-3 * weights.max())
            left = error_left(weights, judged.mean(axis=0), costs, count, falls)
            logs.append(math.log(max(left, 0.01)) / falls)
    return math.exp(sum(logs) / len(logs))


def measure(args, view) -> tuple[Found, list[dict]]:
    bench = Bench(args, view)
    runs: dict[str, list[dict]] = {"uniform": [], "adaptive": []}
    rows = []
    for target in args.targets or [bench.target(count) for count in args.counts]:
        for seed in range(1, 1 + args.seeds):
            for sampling, of in runs.items():  # in turn: a busy machine slows both
                of.append(bench.to_target(sampling, target, seed))
                rows.append({"view": view.name, "size": args.size, "sampling": sampling,
                             "seed": seed} | {k: v for k, v in of[-1].items()
                                              if not k.startswith("cell_")})
    found = compare(bench, runs)
    if args.bound_seeds:
        uniform = runs["uniform"][0]
        found.bound = bound(bench, found.slope, uniform["rays"] / uniform["spp"])
    return found, rows


def ratio(logs: list[float], error: float) -> str:
    return f"{math.exp(sum(logs) / len(logs)):.2f} +- {100 * error:.0f} %"


def as_asked(logs: list[float]) -> str:
    return ", ".join(f"{math.exp(log):.2f}" for log in logs)


def promise(values: list[float]) -> str:
    return f"{math.exp(numpy.mean(numpy.log(values))):.2f} ({min(values):.2f} to {max(values):.2f})"


HEADER = """\
| view | error ~ rays^ | rays | bound | CPU seconds | as asked: rays, CPU | true / promised, uniform | adaptive |
|---|---|---|---|---|---|---|---|"""


def row(name: str, found: Found) -> str:
    least = "" if found.bound is None else f"{found.bound:.2f}"
    return (f"| {name} | {found.slope / 2:.2f} | {ratio(found.rays, found.rays_error)} | {least} "
            f"| {ratio(found.seconds, found.seconds_error)} | {as_asked(found.asked)} "
            f"| {promise(found.promise['uniform'])} | {promise(found.promise['adaptive'])} |")


def run(args) -> None:
    """Errors: BadInput, KeyboardInterrupt."""
    args.out.mkdir(parents=True, exist_ok=True)
    print(HEADER, flush=True)
    all_found, rows = [], []
    for view in views.chosen(args.views, args.scenes):
        found, of_view = measure(args, view)
        print(row(view.name, found), flush=True)
        all_found.append(found)
        rows += of_view
    means = [[sum(f.rays) / len(f.rays) for f in all_found],
             [sum(f.seconds) / len(f.seconds) for f in all_found]]
    errors = [math.sqrt(sum(e * e for e in of)) / len(of)
              for of in ([f.rays_error for f in all_found], [f.seconds_error for f in all_found])]
    least = ""
    if args.bound_seeds:
        least = f"{math.exp(numpy.mean([math.log(f.bound) for f in all_found])):.2f}"
    kept = [promise([v for f in all_found for v in f.promise[kind]])
            for kind in ("uniform", "adaptive")]
    asked = as_asked([sum(logs) / len(logs) for logs in zip(*(f.asked for f in all_found))])
    print(f"| **geometric mean** | | **{ratio(means[0], errors[0])}** | {least} "
          f"| **{ratio(means[1], errors[1])}** | {asked} | {' | '.join(kept)} |")
    if args.csv:
        with args.csv.open("w", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, rows[0].keys(), lineterminator="\n")
            writer.writeheader()
            writer.writerows(rows)


def main() -> int:
    args = parse_arguments()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, signal.default_int_handler)
    try:
        run(args)
    except KeyboardInterrupt:
        print("samples_by_need: stopped; the same command goes on from here", file=sys.stderr)
        return command.EXIT_CANCELLED
    except BadInput as error:
        print(f"samples_by_need: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
