#!/usr/bin/python3
"""What the path tracer chooses for a scene when it is loaded, and what that saves.

    ninja -C BUILD ablation_bench lean_bench path_tracer_bench
    bench/kernels.py --build BUILD --out FOLDER [--scenes FOLDER] [--views kitchen,...]
        [--size 96x54] [--spp 8] [--rounds 5] [--count] [--lean-only]

First table, by view: CPU time of rendering without one choice, and without all of them, over that
with all. Runs alternate; the median of the rounds' ratios, and half the distance of their quartiles.
Pictures must have the same bits (a view whose bits differ is named, and the exit code is 1).

With --count the same in instructions of a sample instead, as callgrind counts them, which has no
noise: the difference of two runs of one thread that differ in nothing but the number of samples.

Second table: instructions of a sample of the Cornell box, in the usual build and in one that lacks
what the box does not need (TESSERA_LEAN); and CPU time, by turns. Needs valgrind, python3-numpy and python3-openimageio.
"""

import argparse
import math
import re
import statistics
import subprocess
import sys

sys.dont_write_bytecode = True  # the source folder stays clean

import numpy

from compare_builds import view_flags
from peers import accuracy, renderers, views

CHOICES = {
    "eight_surfaces": "surfaces without glass and layers scatter eight at a time",
    "opaque_meshes": "traversal asks for alpha only where there is some",
    "plain_materials": "constants in place of questions for textures",
    "lone_solids": "no account of the solids that a path is in, where nothing refracts",
}
FEATURES_OFF = "textures, alpha, layers and glass, environment and point lights, instances, unlit"


def parse_arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    views.add_arguments(parser, size="96x54")
    parser.add_argument("--spp", type=int, default=8)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--count", action="store_true", help="instructions in place of seconds")
    parser.add_argument("--lean-only", action="store_true", help="the second table alone")
    args = parser.parse_args()
    args.bin = args.build / "bin"
    for name in ("ablation_bench", "lean_bench", "path_tracer_bench"):
        if not (args.bin / name).is_file():
            parser.error(f"{args.bin / name} is not built: ninja -C {args.build} {name}")
    return args


def command(args, program: str, view, size: str, spp: int) -> list[str]:
    scene = (args.build / "scenes" if view.own else args.scenes) / view.file
    return [str(args.bin / program), str(scene), "--size", size, "--spp", str(spp),
            "--threads", "1", "--build-threads", "1"] + view_flags(view)


class Variant:
    """The path tracer without some choices, on one view."""

    def __init__(self, args, view, left_out: list[str], branches: str):
        self._args, self._view = args, view
        self._flags = ["--branches", branches]
        for choice in left_out:
            self._flags += ["--without", choice]
        self.cpu, self.picture, self.branches = [], None, "0"

    def render(self) -> None:
        out = self._args.out / "picture.exr"
        _, text = renderers.run(
            command(self._args, "ablation_bench", self._view, self._args.size, self._args.spp)
            + self._flags + ["--out", str(out)], self._args.out / "kernels.log")
        self.cpu.append(float(re.search(r"\(CPU ([0-9.]+) s\)", text).group(1)))
        self.branches = re.search(r"(\d+) branches", text).group(1)
        self.picture = accuracy.read_rgb(out)


def measure(args, view) -> tuple[list[str], bool]:
    """The row of a view, and whether all pictures have the same bits."""
    first = Variant(args, view, [], "0")
    first.render()
    whole = Variant(args, view, [], first.branches)
    variants = [Variant(args, view, [choice], first.branches) for choice in CHOICES]
    variants.append(Variant(args, view, list(CHOICES), first.branches))
    cells, same = [], True
    for _ in range(args.rounds):
        whole.render()
        for variant in variants:
            variant.render()
    for variant in variants:
        ratios = [own / other for own, other in zip(variant.cpu, whole.cpu)]
        quartiles = statistics.quantiles(ratios, n=4)
        cells.append(f"{statistics.median(ratios):.3f} +- {(quartiles[2] - quartiles[0]) / 2:.3f}")
        same = same and numpy.array_equal(variant.picture, whole.picture)
    return cells, same


def instructions(args, program: str, view, *flags: str) -> float:
    """Of one sample, by callgrind."""
    def of_run(spp: int) -> int:
        counted = subprocess.run(
            ["valgrind", "--tool=callgrind", f"--callgrind-out-file={args.out / 'callgrind.out'}",
             *command(args, program, view, "32x18", spp), "--branches", "1", *flags],
            capture_output=True, text=True, check=True)
        return int(re.search(r"Collected : (\d+)", counted.stderr).group(1))
    return (of_run(16) - of_run(8)) / (32 * 18 * 8)


def count(args, view) -> list[str]:
    """The row of a view, in instructions."""
    out = ["--out", str(args.out / "picture.exr")]
    every = [flag for choice in CHOICES for flag in ("--without", choice)]
    whole = instructions(args, "ablation_bench", view, *out)
    return [f"{instructions(args, 'ablation_bench', view, *out, *without) / whole:.3f}"
            for without in [("--without", choice) for choice in CHOICES] + [every]]


def cost_of_the_unused(args) -> None:
    view = views.chosen("cornell", args.scenes)[0]
    per_sample, cpu = {}, {"path_tracer_bench": [], "lean_bench": []}
    for _ in range(4 * args.rounds):
        for program, seconds in cpu.items():
            _, text = renderers.run(command(args, program, view, args.size, 4 * args.spp)
                                    + ["--branches", "1"], args.out / "kernels.log")
            seconds.append(float(re.search(r"\(CPU ([0-9.]+) s\)", text).group(1)))
    ratios = [a / b for a, b in zip(*cpu.values())]
    spread = statistics.stdev(ratios) / math.sqrt(len(ratios))
    for program in cpu:
        per_sample[program] = instructions(args, program, view)
    usual, lean = per_sample["path_tracer_bench"], per_sample["lean_bench"]
    print("\n| Cornell box | instructions a sample |\n|---|---|")
    print(f"| the usual build | {usual:.0f} |")
    print(f"| without {FEATURES_OFF} | {lean:.0f} |")
    print(f"| cost of what it does not use | {100 * (usual / lean - 1):.2f} % |")
    print(f"| the same in CPU time, {len(ratios)} pairs by turns | "
          f"{100 * (statistics.median(ratios) - 1):.1f} +- {100 * spread:.1f} % |")


def main() -> int:
    args = parse_arguments()
    args.out.mkdir(parents=True, exist_ok=True)
    all_same = True
    if not args.lean_only:
        for choice, what in CHOICES.items():
            print(f"- {choice}: {what}")
        print(f"\n| view | {' | '.join(CHOICES)} | none of them |\n|{'---|' * (len(CHOICES) + 2)}",
              flush=True)
        for view in views.chosen(args.views, args.scenes):
            cells, same = (count(args, view), True) if args.count else measure(args, view)
            print(f"| {view.name} | {' | '.join(cells)} |", flush=True)
            if not same:
                print(f"{view.name}: the bits differ", file=sys.stderr)
            all_same = all_same and same
    cost_of_the_unused(args)
    return 0 if all_same else 1


if __name__ == "__main__":
    sys.exit(main())
