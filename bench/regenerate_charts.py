#!/usr/bin/python3
"""Makes the committed charts of docs/charts again, and the tables of the pages that show them.

    bench/regenerate_charts.py --build build/release [--scenes FOLDER] [--only statistics,...]
        [--out docs/charts] [--quick]

Parts: statistics (docs/stability.md), filters (docs/stability.md), scenes (docs/charts.md and the
README's chart), scale (docs/charts.md). Under half an hour on two idle cores. What a part has
finished is kept in BUILD/charts and taken up by the next run. --scenes is the folder of scenes that
are not the project's own (apartment.glb, ...); without it they are left out. --quick makes
everything tiny, to try the command itself: never commit its output. Needs python3-matplotlib,
python3-numpy, python3-openimageio, python3-tqdm; blender for Cycles where it is there.
"""

import argparse
import pathlib
import shutil
import sys

sys.dont_write_bytecode = True  # the source folder stays clean
ROOT = pathlib.Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT / "bench"), str(ROOT / "chart"), str(ROOT / "scenes")]

from charts import filters, scale, scenes, statistics
from tessera_chart import programs

PARTS = ("statistics", "scale", "filters", "scenes")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("--build", type=pathlib.Path, required=True)
    parser.add_argument("--out", type=pathlib.Path, default=ROOT / "docs" / "charts")
    parser.add_argument("--scenes", type=pathlib.Path)
    parser.add_argument("--cycles", action="store_true", help="Blender's Cycles too, on two scenes")
    parser.add_argument("--oidn", help="as of tessera chart")
    parser.add_argument("--oidn-weights", type=pathlib.Path)
    parser.add_argument("--only", default=",".join(PARTS))
    parser.add_argument("--quick", action="store_true")
    args = parser.parse_args()
    chosen = args.only.split(",")
    if set(chosen) - set(PARTS):
        parser.error(f"--only {args.only}: use some of {','.join(PARTS)}")
    args.out.mkdir(parents=True, exist_ok=True)
    into_docs = args.out.resolve() == ROOT / "docs" / "charts"
    stability_page = ROOT / "docs" / "stability.md" if into_docs else None
    if "statistics" in chosen:
        statistics.make(args.build / "bin" / "statistics_stability", args.out, stability_page,
                        args.quick)
    tessera = programs.Tessera(str(args.build / "bin" / "tessera"))
    work = args.build / ("charts-quick" if args.quick else "charts")
    if args.quick:
        shutil.rmtree(work, ignore_errors=True)  # nothing is taken up: all of it is tried
    if "filters" in chosen:
        filters.make(tessera, work, args.out, stability_page, args.quick)
    if "scale" in chosen:
        scale.make(tessera, args.build / "bin", work, args.out, args.quick)
    if "scenes" in chosen:
        scenes.make(args, work, ROOT / "docs" / "charts.md" if into_docs else None)
    return 0


if __name__ == "__main__":
    sys.exit(main())
