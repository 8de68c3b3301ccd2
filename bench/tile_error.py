#!/usr/bin/python3
"""How true the promise of `--target-tile-error` is: the true errors of the cells beside the target.

    bench/tile_error.py --build build/release --out OUTPUT_FOLDER [--scenes FOLDER]
        [--views kitchen,bunny,...] [--size 160x96] [--references 1024] [--targets 0.05,0.1]
        [--seeds 2] [--spp 1024]

A cell has 16 x 16 pixels and is judged with its eight neighbours, as `tessera render` judges it;
"alone" is without them. True errors (sqrt(relMSE) of the served picture) are against two references
of other seeds, free of their noise (peers/accuracy.py; a square below zero counts as zero). "kept"
is the share of cells whose true error is at most the target; then come the median, the 95th
percentile and the worst of true error over target, of all seeds together. "ended" says what stopped
the renders. What is finished is kept in OUTPUT_FOLDER. Needs python3-numpy, python3-openimageio.
"""

import argparse
import sys

sys.dont_write_bytecode = True  # the source folder stays clean

import numpy

import samples_by_need
from peers import views


def parse_arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    views.add_arguments(parser, size="160x96")
    parser.add_argument("--references", type=int, default=1024, help="samples of each reference")
    parser.add_argument("--targets", default="0.05,0.1")
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--spp", type=int, default=1024, help="the most that a pixel gets")
    parser.add_argument("--threads", type=int, default=2)
    args = parser.parse_args()
    args.targets = [float(target) for target in args.targets.split(",")]
    return args


def over_neighbours(values: numpy.ndarray) -> numpy.ndarray:
    """Sums over each cell and those around it, rows x columns."""
    around = numpy.pad(values, 1)
    rows, columns = values.shape
    return sum(around[y:y + rows, x:x + columns] for y in range(3) for x in range(3))


def true_errors(run: dict, size: str) -> tuple[numpy.ndarray, numpy.ndarray]:
    """Of each cell with its neighbours, and alone."""
    width, height = (int(side) for side in size.split("x"))
    pixels = numpy.array(samples_by_need.sums_by_cell(numpy.ones((height, width))))
    shape = (-(-height // samples_by_need.CELL_PX), -(-width // samples_by_need.CELL_PX))
    pixels, squares = pixels.reshape(shape), numpy.array(run["cell_errors"]).reshape(shape)
    judged = over_neighbours(squares) / over_neighbours(pixels)
    return tuple(numpy.sqrt(numpy.maximum(e, 0)).ravel() for e in (judged, squares / pixels))


def main() -> int:
    args = parse_arguments()
    print("| view | target | samples a pixel | kept | median | 95 % | worst | alone: kept | median "
          "| 95 % | ended |\n|---|---|---|---|---|---|---|---|---|---|---|")
    for view in views.chosen(args.views, args.scenes):
        bench = samples_by_need.Bench(args, view)
        for target in args.targets:
            runs = [bench.measured(f"tile_{target:g}_{args.spp}_{seed}", "--target-tile-error",
                                   target, "--spp", args.spp, "--seed", seed)
                    for seed in range(args.seeds)]
            cells = [true_errors(run, args.size) for run in runs]
            judged, alone = (numpy.concatenate(part) / target for part in zip(*cells))
            spp = sum(run["spp"] for run in runs) / len(runs)

            def shares(found: numpy.ndarray) -> str:
                return (f"{100 * (found <= 1).mean():.0f} % | {numpy.median(found):.2f} "
                        f"| {numpy.quantile(found, 0.95):.2f}")

            ended = ", ".join(sorted({run["stopped_by"] for run in runs}))
            print(f"| {view.name} | {target:g} | {spp:.0f} | {shares(judged)} "
                  f"| {judged.max():.2f} | {shares(alone)} | {ended} |", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
