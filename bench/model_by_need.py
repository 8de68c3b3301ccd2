#!/usr/bin/python3
"""What each saving saves, and that it costs no accuracy: with and without it, on every view.

    bench/model_by_need.py --build BUILD --out FOLDER [--scenes FOLDER] [--views kitchen,...]
        [--savings depth,...] [--size 96x54] [--spp 128] [--seeds 3] [--reference-spp 1024]

Each saving is a set of flags of `tessera render` beside another set. By view: CPU seconds of the
whole process, load and filter included; bytes of deltas; peak memory; relMSE of the served picture
against two references of many samples and 64 bounces, with one standard error between seeds in per
cent. Renders with and without alternate. The last row has geometric means of the ratios, first over
second. relMSE is without the worst 0.1 % of pixels. Needs python3-numpy and python3-openimageio.
"""

import argparse
import dataclasses
import json
import math
import os
import subprocess
import sys

sys.dont_write_bytecode = True  # the source folder stays clean

import numpy

from compare_builds import view_flags
from peers import accuracy, views


@dataclasses.dataclass(frozen=True)
class Saving:
    what: str
    with_it: tuple  # flags
    without: tuple


TARGET = ("--target-error", "0.05", "--spp", "1024")
SAVINGS = {
    "features": Saving("features of the first 64 samples, against all", (),
                       ("--feature-spp", "all")),
    "sampling": Saving("samples by need, against uniform ones, to an error of 0.05",
                       TARGET + ("--sampling", "adaptive"), TARGET + ("--sampling", "uniform")),
    "depth": Saving("--max-depth auto, against 64", ("--max-depth", "auto"), ("--max-depth", "64")),
    "depth_8": Saving("--max-depth auto, against 8", ("--max-depth", "auto"),
                      ("--max-depth", "8")),
    "preview": Saving("--quality preview, against final", ("--quality", "preview"),
                      ("--quality", "final")),
    "filter": Saving("the denoiser, against none", (), ("--denoiser", "none")),
}


def parse_arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    views.add_arguments(parser, size="96x54")
    parser.add_argument("--savings", default=",".join(SAVINGS))
    parser.add_argument("--spp", type=int, default=128)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--reference-spp", type=int, default=1024)
    parser.add_argument("--threads", type=int, default=2)
    args = parser.parse_args()
    args.savings = args.savings.split(",")
    unknown = [saving for saving in args.savings if saving not in SAVINGS]
    if unknown:
        parser.error(f"--savings {','.join(unknown)}: no such saving; there are "
                     f"{', '.join(SAVINGS)}")
    if args.seeds < 2:
        parser.error(f"--seeds {args.seeds}: errors are between seeds; use 2 or more")
    return args


@dataclasses.dataclass
class Render:
    picture: numpy.ndarray
    cpu: float
    megabytes: float
    delta_bytes: int
    max_depth: int | None  # what --max-depth auto has found


def render(args, view, seed: int, flags: tuple) -> Render:
    scene = (args.build / "scenes" if view.own else args.scenes) / view.file
    environment = view_flags(view)
    if view.env:
        environment[environment.index("--env") + 1] = str(scene.parent / view.env)
    out, answer = args.out / "picture.exr", args.out / "answer.json"
    command = [str(args.build / "bin" / "tessera"), "render", str(scene), "-o", str(out), "--json",
               "--quiet", "--size", args.size, "--seed", str(seed), "--threads", str(args.threads),
               *environment, *flags]
    if "--spp" not in flags:
        command += ["--spp", str(args.spp)]
    with answer.open("w+", encoding="utf-8") as text:
        child = subprocess.Popen(command, stdout=text)
        _, status, usage = os.wait4(child.pid, 0)
    child.returncode = os.waitstatus_to_exitcode(status)
    if child.returncode != 0:
        raise RuntimeError(f"failed: {' '.join(command)}")
    result = json.loads(answer.read_text(encoding="utf-8"))
    return Render(accuracy.read_rgb(out), usage.ru_utime + usage.ru_stime,
                  usage.ru_maxrss * 1024 / 1e6, result["bytes"]["deltas"],
                  result.get("max_depth"))


class Figures:
    """Of one view, with or without one saving: means over seeds."""

    def __init__(self, renders: list[Render], references: list[numpy.ndarray]):
        errors = [accuracy.rel_mse(r.picture, *references)[1] for r in renders]
        self.rel_mse = max(float(numpy.mean(errors)), 1e-12)
        self.rel_mse_error = float(numpy.std(errors, ddof=1)) / math.sqrt(len(errors))
        self.cpu = sum(r.cpu for r in renders) / len(renders)
        self.megabytes = sum(r.megabytes for r in renders) / len(renders)
        self.delta_bytes = sum(r.delta_bytes for r in renders) / len(renders)
        self.max_depth = renders[0].max_depth

    def all(self) -> tuple[float, ...]:
        return self.cpu, self.delta_bytes, self.megabytes, self.rel_mse


def row(name: str, pair: tuple[Figures, Figures]) -> str:
    def both(form) -> str:
        return " / ".join(form(figures) for figures in pair)

    return (f"| {name} | {both(lambda f: f'{f.cpu:.2f}')} "
            f"| {both(lambda f: f'{f.delta_bytes / 1e6:.3f}')} "
            f"| {both(lambda f: f'{f.megabytes:.0f}')} "
            f"| {both(lambda f: f'{f.rel_mse:.3g} +- {100 * f.rel_mse_error / f.rel_mse:.0f} %')} "
            f"| {both(lambda f: '-' if f.max_depth is None else str(f.max_depth))} |")


def main() -> int:
    args = parse_arguments()
    args.out.mkdir(parents=True, exist_ok=True)
    found = {saving: [] for saving in args.savings}
    rows = {saving: [] for saving in args.savings}
    for view in views.chosen(args.views, args.scenes):
        references = [
            render(args, view, seed, ("--denoiser", "none", "--max-depth", "64", "--spp",
                                      str(args.reference_spp))).picture
            for seed in (1001, 1002)]
        for saving in args.savings:
            renders = ([], [])
            for seed in range(args.seeds):
                for flags, some in zip((SAVINGS[saving].with_it, SAVINGS[saving].without), renders):
                    some.append(render(args, view, seed, flags))
            pair = tuple(Figures(some, references) for some in renders)
            found[saving].append(pair)
            rows[saving].append(row(view.name, pair))
            print(f"{saving}: {rows[saving][-1]}", file=sys.stderr, flush=True)
    for saving in args.savings:
        print(f"\n{saving}: {SAVINGS[saving].what}\n")
        print("| view | CPU s | deltas MB | peak MB | relMSE | bounces |\n|---|---|---|---|---|---|")
        print("\n".join(rows[saving]))
        ratios = numpy.array([numpy.divide(a.all(), b.all()) for a, b in found[saving]])
        cells = [f"{mean:.3f}" for mean in numpy.exp(numpy.log(ratios).mean(axis=0))]
        print(f"| ratio | {' | '.join(cells)} | |")
    return 0


if __name__ == "__main__":
    sys.exit(main())
