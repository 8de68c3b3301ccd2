#!/usr/bin/python3
"""Two builds of the path tracer beside each other: error, speed, and whether the mean moved.

    bench/compare_builds.py --before BUILD --after BUILD --out FOLDER [--scenes FOLDER]
        [--views kitchen,bunny,...] [--size 128x72] [--spp 16] [--seeds 6]

Renders every view with `path_tracer_bench` under several seeds, the builds in turn. relMSE is the
variance between seeds over (mean of all)^2 + 0.01, without the worst 0.1 % of pixels; "efficiency"
is the ratio of 1 / (relMSE x CPU time). Z: difference of the frame's means over its standard error
(|Z| > 4 means that the mean moved). Needs python3-numpy and python3-openimageio.
"""

import argparse
import math
import pathlib
import re
import sys

sys.dont_write_bytecode = True  # the source folder stays clean

import numpy

from peers import accuracy, renderers, views


def parse_arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("--before", type=pathlib.Path, required=True)
    parser.add_argument("--after", type=pathlib.Path, required=True)
    parser.add_argument("--out", type=pathlib.Path, required=True)
    parser.add_argument("--scenes", type=pathlib.Path)
    parser.add_argument("--views", default="kitchen,apartment,bunny,ingenuity,material-ball")
    parser.add_argument("--size", default="128x72")
    parser.add_argument("--spp", type=int, default=16)
    parser.add_argument("--seeds", type=int, default=6)
    parser.add_argument("--threads", type=int, default=2)
    args = parser.parse_args()
    if args.seeds < 2:
        parser.error(f"--seeds {args.seeds}: errors are between seeds; use 2 or more")
    return args


def view_flags(view) -> list[str]:
    flags = []
    if view.position:
        for flag, v in (("--look-from", view.position), ("--look-at", view.target)):
            flags += [flag, ",".join(map(str, v))]
        flags += ["--fov-y", str(view.fov_y_degrees)]
    if view.env:
        flags += ["--env", view.env]
    elif view.sky is not None:
        flags += ["--sky", f"{view.sky},{view.sky},{view.sky}"]
    return flags


class Build:
    """What one build made of one view."""

    def __init__(self, name: str, folder: pathlib.Path, args, view):
        self._bench = folder / "bin" / "path_tracer_bench"
        self._args, self._name = args, name
        self._scene = (args.before / "scenes" if view.own else args.scenes) / view.file
        self._view = view
        self.pictures, self.cpu, self.rays = [], 0.0, 0.0

    def render(self, seed: int) -> None:
        args = self._args
        out = args.out / f"{self._name}.exr"
        command = [str(self._bench), str(self._scene), "--size", args.size, "--spp",
                   str(args.spp), "--threads", str(args.threads), "--seed", str(seed), "--out",
                   str(out)] + view_flags(self._view)
        _, text = renderers.run(command, args.out / f"{self._name}.log")
        self.cpu += float(re.search(r"\(CPU ([0-9.]+) s\)", text).group(1)) / args.seeds
        self.rays += float(re.search(r"([0-9.]+) rays/sample", text).group(1)) / args.seeds
        self.pictures.append(accuracy.read_rgb(out))

    def error(self, mean: numpy.ndarray) -> float:
        variance = numpy.var(self.pictures, axis=0, ddof=1)
        errors = numpy.sort((variance / (mean * mean + 0.01)).mean(axis=2).ravel())
        return float(errors[:round(errors.size * (1 - accuracy.TRIMMED_SHARE))].mean())


def z_score(before: Build, after: Build) -> float:
    means = [numpy.mean(b.pictures, axis=(1, 2, 3)) for b in (before, after)]
    # Pixels are independent: the standard error comes from their variances.
    error2 = sum((numpy.var(b.pictures, axis=0, ddof=1) / len(b.pictures)).sum() / 3
                 / b.pictures[0].shape[0] ** 2 / b.pictures[0].shape[1] ** 2
                 for b in (before, after))
    return float((means[1].mean() - means[0].mean()) / math.sqrt(max(error2, 1e-30)))


def main() -> int:
    args = parse_arguments()
    args.out.mkdir(parents=True, exist_ok=True)
    print("| view | relMSE before | after | ratio | CPU time ratio | rays/sample before | after "
          "| efficiency | Z |\n|---|---|---|---|---|---|---|---|---|")
    for view in views.chosen(args.views, args.scenes):
        before = Build("before", args.before, args, view)
        after = Build("after", args.after, args, view)
        for seed in range(args.seeds):
            before.render(seed)
            after.render(1000 + seed)
        mean = numpy.mean(before.pictures + after.pictures, axis=0)
        errors = before.error(mean), after.error(mean)
        if min(*errors, before.cpu, after.cpu) <= 0:
            sys.exit(f"{view.name}: nothing to divide by (relMSE {errors[0]:g} and {errors[1]:g}, CPU "
                     f"{before.cpu:g} and {after.cpu:g} s): use a larger --size or --spp")
        ratio, cpu = errors[1] / errors[0], after.cpu / before.cpu
        print(f"| {view.name} | {errors[0]:.5f} | {errors[1]:.5f} | {ratio:.2f} | {cpu:.2f} "
              f"| {before.rays:.2f} | {after.rays:.2f} | {1 / (ratio * cpu):.2f} "
              f"| {z_score(before, after):.1f} |", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
