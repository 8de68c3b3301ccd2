#!/usr/bin/python3
"""Makes the committed charts of docs/charts again, and the tables of the pages that show them.

    bench/regenerate_charts.py --build build/release [--scenes FOLDER]
        [--oidn PROGRAM --oidn-weights FOLDER] [--only statistics,...] [--out FOLDER] [--quick]

Parts: scale (docs/charts.md), statistics and filters (docs/stability.md), bytes
(docs/model-by-need.md), scenes (docs/charts.md and the README's chart). Under half an hour on two idle cores. What is finished is kept in
BUILD/charts: after Ctrl-C (exit code 4), or anything else that ends it, the same command goes on.
docs/ is written to when everything is made, and not before. --scenes is the folder of scenes that
are not the project's own (apartment.glb, ...); without it they are left out. Cycles is measured
where blender is installed. --quick makes everything tiny, to try the command itself: never commit
its output. Needs python3-matplotlib, python3-numpy, python3-openimageio, python3-tqdm.
"""

import argparse
import json
import pathlib
import resource
import shutil
import signal
import sys
import time

sys.dont_write_bytecode = True  # the source folder stays clean
ROOT = pathlib.Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT / "bench"), str(ROOT / "chart"), str(ROOT / "scenes")]

from charts import filters, job_bytes, scale, scenes, statistics
from charts.runs import Run
from tessera_chart import command
from tessera_chart.errors import BadInput

# Scale has a clock to watch, so nothing runs beside it.
PARTS = {"scale": scale.make, "statistics": statistics.make, "filters": filters.make,
         "bytes": job_bytes.make, "scenes": scenes.make}


def parse_arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("--build", type=pathlib.Path, required=True)
    parser.add_argument("--out", type=pathlib.Path, default=ROOT / "docs" / "charts")
    parser.add_argument("--scenes", type=pathlib.Path)
    parser.add_argument("--oidn", help="as of tessera chart")
    parser.add_argument("--oidn-weights", type=pathlib.Path)
    parser.add_argument("--only", default=",".join(PARTS))
    parser.add_argument("--quick", action="store_true")
    args = parser.parse_args()
    args.only = args.only.split(",")
    if set(args.only) - set(PARTS):
        parser.error(f"--only {','.join(args.only)}: use some of {','.join(PARTS)}")
    if bool(args.oidn) != bool(args.oidn_weights):
        parser.error("--oidn and --oidn-weights go together")
    if args.scenes and not args.scenes.is_dir():
        parser.error(f"--scenes {args.scenes}: no such folder")
    return args


def used_cpu_s() -> float:
    """Of this program and all of its children that have ended."""
    usages = [resource.getrusage(w) for w in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(u.ru_utime + u.ru_stime for u in usages)


class Spent:
    """Seconds and CPU seconds that this build's charts have taken, those of runs that were stopped
    included."""

    def __init__(self, run):
        self._path, self._version = run.work / "spent.json", run.version
        before = json.loads(self._path.read_text()) if self._path.is_file() else {}
        self._before = before.get(run.version, [0, 0])
        self._start, self._start_cpu_s = time.monotonic(), used_cpu_s()

    def now(self) -> tuple[float, float]:
        return (self._before[0] + time.monotonic() - self._start,
                self._before[1] + used_cpu_s() - self._start_cpu_s)

    def keep(self) -> None:
        self._path.write_text(json.dumps({self._version: self.now()}), encoding="utf-8")


def make_parts(run, names: list[str]) -> None:
    for name, part in PARTS.items():
        if name in names:
            print(f"{name} from {time.strftime('%H:%M:%S')} on", flush=True)
            begin, before_s = time.monotonic(), used_cpu_s()
            part(run)
            print(f"{name}: {time.monotonic() - begin:.0f} s, CPU {used_cpu_s() - before_s:.0f} s",
                  flush=True)


def make(args) -> None:
    """Errors: BadInput, RuntimeError, KeyboardInterrupt."""
    work = args.build / ("charts-quick" if args.quick else "charts")
    if args.quick:
        shutil.rmtree(work, ignore_errors=True)  # nothing is taken up: all of it is tried
    into_docs = args.out.resolve() == ROOT / "docs" / "charts"
    run = Run(args.build, work, args.out, ROOT / "docs" if into_docs else None, args.scenes,
              args.quick, args.oidn, args.oidn_weights)
    spent = Spent(run)
    try:
        make_parts(run, args.only)
    finally:
        spent.keep()
    wall_s, cpu_s = spent.now()
    print(f"together: {wall_s:.0f} s, CPU {cpu_s:.0f} s: at least {cpu_s / 2:.0f} s on two cores")
    for page in ("charts.md", "stability.md"):
        run.add_part(page, "made", f"Made with {run.version}, in {wall_s / 60:.0f} minutes "
                     f"and {cpu_s / 60:.0f} CPU minutes (parts: {', '.join(args.only)}).")
    run.publish()


def main() -> int:
    args = parse_arguments()
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # as Ctrl-C
    try:
        make(args)
    except KeyboardInterrupt:
        print("regenerate_charts: stopped; the same command goes on from here", file=sys.stderr)
        return command.EXIT_CANCELLED
    except (BadInput, RuntimeError) as error:
        print(f"regenerate_charts: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
