#!/usr/bin/python3
"""What each step of the path tracer gives, on every view: a table of gains.

    ninja -C BUILD ablation_bench
    bench/ablation.py --build BUILD --out FOLDER [--scenes FOLDER] [--views kitchen,...]
        [--steps mis,...] [--size 64x36] [--spp 16] [--seeds 4]

A step's gain on a view is (relMSE x CPU time) without it over that with it: how many times as long
the path tracer would take to the same error if it lacked the step. All else stays, the number of
branches included. relMSE is the variance between seeds over (mean of all)^2 + 0.01, without the
worst 0.1 % of pixels. Seeds are the same with and without, so that a step that a view does not need
gains 1.00 but for the clock's noise. "+-" is one standard error of the gain's logarithm, in per
cent, by leaving out one seed after the other (jackknife). Z: the difference of the frame's means over
its standard error; all steps but energy_compensation must leave the mean (|Z| > 4 means that it
moved). Renders alternate. Needs python3-numpy and python3-openimageio.
"""

import argparse
import math
import re
import sys

sys.dont_write_bytecode = True  # the source folder stays clean

import numpy

from compare_builds import view_flags
from peers import accuracy, renderers, views

STEPS = {
    "owen_sobol": "Owen-scrambled Sobol' points, against independent ones",
    "mis": "both strategies weighted, against light samples alone",
    "sky_by_cells": "the sky by cosine and visibility, against luminance alone",
    "guide": "the pilot's guide (windows, groups of lights), against none",
    "light_tree": "lights by the hierarchy, against power",
    "visible_normals": "visible normals, against all",
    "energy_compensation": "multiple scattering in rough surfaces (moves the mean)",
    "roulette": "Russian roulette, against none",
    "second_light_sample": "two light samples at the first surface, against one",
    "splitting": "branches at the first surface, against one path",
}


def parse_arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    views.add_arguments(parser, size="64x36")
    parser.add_argument("--steps", default=",".join(STEPS))
    parser.add_argument("--spp", type=int, default=16)
    parser.add_argument("--seeds", type=int, default=4)
    parser.add_argument("--threads", type=int, default=2)
    args = parser.parse_args()
    args.steps = args.steps.split(",")
    unknown = [step for step in args.steps if step not in STEPS]
    if unknown:
        parser.error(f"--steps {','.join(unknown)}: no such step; there are {', '.join(STEPS)}")
    if args.seeds < 3:
        parser.error(f"--seeds {args.seeds}: errors are between seeds; use 3 or more")
    args.bench = args.build / "bin" / "ablation_bench"
    if not args.bench.is_file():
        parser.error(f"{args.bench} is not built: ninja -C {args.build} ablation_bench")
    return args


class Variant:
    """What the path tracer made of one view, whole or without one step."""

    def __init__(self, args, view, step: str | None):
        self._args, self._view, self._step = args, view, step
        self.pictures, self.cpu, self.branches = [], [], "0"

    def render(self, seed: int, branches: str) -> None:
        args, view = self._args, self._view
        out = args.out / "picture.exr"
        scene = (args.build / "scenes" if view.own else args.scenes) / view.file
        command = [str(args.bench), str(scene), "--size", args.size, "--spp", str(args.spp),
                   "--threads", str(args.threads), "--seed", str(seed), "--branches", branches,
                   "--out", str(out)] + view_flags(view)
        if self._step:
            command += ["--without", self._step]
        _, text = renderers.run(command, args.out / "ablation.log")
        self.cpu.append(float(re.search(r"\(CPU ([0-9.]+) s\)", text).group(1)))
        self.branches = re.search(r"(\d+) branches", text).group(1)
        self.pictures.append(accuracy.read_rgb(out))

    def work(self, seeds: list[int], mean: numpy.ndarray) -> float:
        """relMSE x CPU time, of these seeds."""
        pictures = [self.pictures[s] for s in seeds]
        variance = numpy.var(pictures, axis=0, ddof=1)
        errors = numpy.sort((variance / (mean * mean + 0.01)).mean(axis=2).ravel())
        kept = errors[:round(errors.size * (1 - accuracy.TRIMMED_SHARE))]
        return max(float(kept.mean()), 1e-12) * sum(self.cpu[s] for s in seeds) / len(seeds)


def log_gain(whole: Variant, without: Variant) -> tuple[float, float]:
    """Logarithm of the gain, and its standard error."""
    seeds = list(range(len(whole.pictures)))
    # Each against its own mean: one of the steps moves it.
    means = [numpy.mean(v.pictures, axis=0) for v in (whole, without)]

    def of(some: list[int]) -> float:
        return math.log(without.work(some, means[1]) / whole.work(some, means[0]))

    left_out = [of([s for s in seeds if s != out]) for out in seeds]
    spread = numpy.var(left_out) * (len(seeds) - 1)
    return of(seeds), math.sqrt(spread)


def z_score(whole: Variant, without: Variant) -> float:
    """Of the frame's mean, from the differences at equal seeds; 0 where there are none."""
    differences = numpy.subtract(without.pictures, whole.pictures)
    height, width = differences.shape[1:3]
    # Pixels are independent.
    variance = numpy.var(differences, axis=0, ddof=1).sum() / 3 / len(differences)
    return float(differences.mean() * height * width / math.sqrt(max(variance, 1e-30)))


def measure(args, view) -> dict[str, tuple[float, float, float]]:
    """By step: logarithm of the gain, its standard error, Z."""
    whole = Variant(args, view, None)
    without = {step: Variant(args, view, step) for step in args.steps}
    for seed in range(args.seeds):
        whole.render(seed, whole.branches)
        for step, variant in without.items():
            variant.render(seed, "1" if step == "splitting" else whole.branches)
    return {step: (*log_gain(whole, v), z_score(whole, v)) for step, v in without.items()}


def cell(log: float, error: float) -> str:
    return f"{math.exp(log):.2f} +- {100 * error:.0f} %"


def main() -> int:
    args = parse_arguments()
    args.out.mkdir(parents=True, exist_ok=True)
    for step in args.steps:
        print(f"- {step}: {STEPS[step]}")
    print(f"\n| view | {' | '.join(args.steps)} |\n|{'---|' * (len(args.steps) + 1)}", flush=True)
    found = []
    largest = {step: 0.0 for step in args.steps}
    for view in views.chosen(args.views, args.scenes):
        gains = measure(args, view)
        print(f"| {view.name} | {' | '.join(cell(*gains[s][:2]) for s in args.steps)} |", flush=True)
        found.append(gains)
        for step in args.steps:
            largest[step] = max(largest[step], gains[step][2], key=abs)
    cells = []
    for step in args.steps:
        mean = sum(gains[step][0] for gains in found) / len(found)
        error = math.sqrt(sum(gains[step][1] ** 2 for gains in found)) / len(found)
        cells.append(f"**{cell(mean, error)}**")
    print(f"| geometric mean | {' | '.join(cells)} |")
    print(f"| Z, the largest | {' | '.join(f'{largest[step]:.1f}' for step in args.steps)} |")
    return 0


if __name__ == "__main__":
    sys.exit(main())
