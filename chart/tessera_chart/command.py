"""The command `tessera chart`."""

import argparse
import functools
import os
import pathlib
import shutil
import sys
import threading

from tqdm import tqdm

from tessera_chart import (ladder, lanes, measures, methods, oidn, peers_of, programs, results,
                           views)
from tessera_chart.errors import BadInput

EXIT_BAD_INPUT, EXIT_CANCELLED = 2, 4

DESCRIPTION = """\
Renders each scene at several sample counts (all of one run), applies every filter to each, measures
relMSE and FLIP against two independent references, and writes to DIR: report.html (charts and
pictures, opens in any browser), points.csv, points.json, and charts/ as SVG and PNG. Ctrl-C keeps
what is finished; the same command goes on from there."""

EPILOG = """\
A scene may carry a name and its own flags in one argument:
  tessera chart "kitchen=apartment.glb --sky 2,2,2 --look-from 7,1.7,-6.8 --look-at 10.8,0.9,-4.2
                 --fov-y 65" cornell.glb -o charts
Methods: raw; every filter of tessera (NAME, and NAME-preview where previews are another filter);
NAME-best, the best thresholds of a filter that has any, found with the reference in hand for each
scene and sample count; adaptive (--target-error) and cycles (Blender), if named; oidn and oidn-hq,
if given.
Exit codes: 0 done, 2 bad input, 4 stopped."""


def parse(arguments: list[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="tessera chart", description=DESCRIPTION, epilog=EPILOG,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", nargs="+", metavar="SCENE", help="[NAME=]SCENE.glb [FLAGS]")
    parser.add_argument("-o", "--output", required=True, type=pathlib.Path, metavar="DIR")
    parser.add_argument("--methods", metavar="LIST", help="comma-separated (all filters)")
    parser.add_argument("--spp", default="4,16,64,256", metavar="LIST",
                        help="sample counts (4,16,64,256)")
    parser.add_argument("--size", default="320x180", metavar="WxH", help="pixels (320x180)")
    parser.add_argument("--frame", metavar="WxH", help="say times and bytes for a frame of this size, "
                        "in proportion to pixels (--size)")
    parser.add_argument("--seeds", type=int, default=3, metavar="N",
                        help="runs for the error bars (3)")
    parser.add_argument("--reference", metavar="SPP|FILE[,FILE]",
                        help="samples of each of two references (4 times the most of --spp); or one "
                        "picture or two independent ones of the same view and size")
    parser.add_argument("--threads", type=int, metavar="N", help="of the renders (all)")
    parser.add_argument("--jobs", type=int, default=1, metavar="N", help="views measured side by side, "
                        "each with its share of the threads (1)")
    parser.add_argument("--oidn", metavar="PROGRAM", help="runs OIDN's network: PROGRAM WEIGHTS.tza "
                        "[--mode alb|nrm] IN.exr... OUT.exr, prints total_ms and cpu_ms")
    parser.add_argument("--oidn-weights", type=pathlib.Path, metavar="DIR",
                        help="with rt_hdr_alb_nrm.tza, rt_alb_large.tza, ...")
    parser.add_argument("--tessera", metavar="PROGRAM", help=argparse.SUPPRESS)
    parser.add_argument("--quiet", action="store_true", help="no progress, no sentences")
    view = parser.add_argument_group("views, of all scenes (as of tessera render)")
    for flag, takes_value in views.VIEW_FLAGS.items():
        view.add_argument(flag, action="store" if takes_value else "store_true")
    return parser.parse_args(arguments)


def whole_numbers(text: str, flag: str) -> list[int]:
    """Ascending. Errors: BadInput."""
    try:
        numbers = sorted({int(n) for n in text.split(",")})
    except ValueError as error:
        raise BadInput(f"{flag} {text}: must be whole numbers, comma-separated") from error
    if numbers[0] < 1 or numbers[-1] > 1 << 20:
        raise BadInput(f"{flag} {text}: each must be 1 to {1 << 20}")
    return numbers


def check_size(text: str, flag: str) -> None:
    """Errors: BadInput."""
    try:
        width, height = map(int, text.split("x"))
    except ValueError as error:
        raise BadInput(f"{flag} {text}: must be WIDTHxHEIGHT, such as 320x180") from error
    if min(width, height) < 16 or max(width, height) > 8192:
        raise BadInput(f"{flag} {text}: each side must be 16 to 8192 pixels")


def make_plan(args: argparse.Namespace) -> ladder.Plan:
    """Errors: BadInput."""
    check_size(args.size, "--size")
    if args.frame:
        check_size(args.frame, "--frame")
    if not 1 <= args.jobs <= 64:
        raise BadInput(f"--jobs {args.jobs}: must be 1 to 64")
    if not 1 <= args.seeds <= 100:
        raise BadInput(f"--seeds {args.seeds}: must be 1 to 100")
    spp = whole_numbers(args.spp, "--spp")
    references: list[pathlib.Path] = []
    reference_spp = 4 * spp[-1]
    if args.reference and args.reference.isdigit():
        reference_spp = whole_numbers(args.reference, "--reference")[0]
    elif args.reference:
        references = [pathlib.Path(p) for p in args.reference.split(",")]
        for path in references:
            if not path.is_file():
                raise BadInput(f"--reference {path}: no such file; give sample counts or pictures")
            height, width = measures.read_rgb(path).shape[:2]
            has_region = args.region or any("--region" in scene for scene in args.scenes)
            if f"{width}x{height}" != args.size and not has_region:
                raise BadInput(f"--reference {path}: has {width}x{height} pixels: use --size "
                               f"{width}x{height}, or a reference of {args.size}")
        if len(references) > 2 or len(args.scenes) > 1:
            raise BadInput("--reference: one picture or two, of one scene")
    network = args.oidn and shutil.which(args.oidn)
    if args.oidn:
        if network is None:
            raise BadInput(f"--oidn {args.oidn}: no such program")
        if args.oidn_weights is None:
            raise BadInput("--oidn: needs --oidn-weights FOLDER")
        oidn.check(args.oidn_weights)
    tessera = programs.Tessera(args.tessera)
    chosen = methods.choose(args.methods, tessera.denoisers(), network is not None)
    if any(m.name == methods.ADAPTIVE for m in chosen) and not any(
            m.name == "regression" for m in chosen):
        raise BadInput("--methods adaptive: is given regression's errors as targets: name both")
    threads = args.threads
    if args.jobs > 1 and not threads:
        threads = max(1, os.cpu_count() // args.jobs)
    return ladder.Plan(tessera, chosen, spp, list(range(1, args.seeds + 1)), args.size,
                       reference_spp, references, threads, network, args.oidn_weights, args.frame,
                       jobs=args.jobs)


def view_flags(args: argparse.Namespace) -> list[str]:
    flags = []
    for flag, takes_value in views.VIEW_FLAGS.items():
        value = getattr(args, flag[2:].replace("-", "_"))
        if value:
            flags += [flag, value] if takes_value else [flag]
    return flags


def work_through(ladders: list[ladder.Ladder], quiet: bool, num_lanes: int = 1) -> None:
    """Runs all tasks with a bar, `num_lanes` ladders at once; a task that is done already takes no
    time."""
    work = [(each, each.tasks()) for each in ladders]
    total = sum(task.weight for _, tasks in work for task in tasks)
    shown = "{desc}: {percentage:3.0f}% |{bar}| {elapsed}, {remaining} left"
    with tqdm(total=total, bar_format=shown, disable=quiet or not sys.stderr.isatty(),
              leave=False) as bar:
        lock = threading.Lock()

        def climb(each: ladder.Ladder, tasks: list[ladder.Task]) -> None:
            for task in tasks:
                with lock:
                    bar.set_description_str(f"{each.view.name}, {task.label}")
                task.run()
                with lock:
                    bar.update(task.weight)

        lanes.run([functools.partial(climb, *piece) for piece in work], num_lanes)


def _counted(count: int, noun: str) -> str:
    return f"{count} {noun}" + ("" if count == 1 else "s")


def intro(plan: ladder.Plan, version: str) -> list[str]:
    reference = (" and ".join(map(str, plan.references)) if plan.references
                 else f"two pictures of {plan.reference_spp} samples per pixel with other seeds")
    scaled = (f" Times and bytes are in proportion to pixels, for a frame of {plan.frame}; loading is "
              "counted once." if plan.frame else "")
    return [
        f"{version}, {plan.size} pixels, {_counted(len(plan.seeds), 'seed')}, "
        f"{_counted(os.cpu_count(), 'core')}.{scaled} "
        f"References: {reference}. relMSE is (x-r1)(x-r2) / (r^2 + 0.01), free of the references' "
        "own noise on average; below the dotted line it is uncertain all the same. Points are means "
        "over the seeds, bars reach from the least seed to the greatest.",
        "Time is that of the render up to so many samples plus that of the filter. CPU time of "
        "the render is that of loading and of samples as the last two steps tell them apart, less "
        "what a process costs that adds none: start-up, files and encoding are in no curve. Yellow marks the Pareto front: "
        "no method has both less cost and less error. Methods ending in -best were tuned with "
        "the reference in hand and are left out of it, as is another renderer.",
        "Who wins is read off the mean curves, straight between points in log-log, beyond the last "
        "point by the last two (said so)."]


def title_of(name: str, size: str, frame: str | None) -> str:
    """Of a scene's charts."""
    return f"{name}, {size} pixels" + (f", times for a frame of {frame}" if frame else "")


def write_all(ladders: list[ladder.Ladder], plan: ladder.Plan, folder: pathlib.Path) -> list[str]:
    """Writes everything from what is finished; returns the sentences."""
    rows = [row for each in ladders for row in each.points()]
    for line in (line for each in ladders for line in each.left_out):
        print(f"tessera chart: {line}", file=sys.stderr)
    finished = [each for each in ladders if any(r["scene"] == each.view.name for r in rows)]
    version = plan.tessera.version()
    settings = {"version": version, "size": plan.size, "frame": plan.frame, "spp": plan.spp, "seeds": plan.seeds,
                "reference_spp": None if plan.references else plan.reference_spp,
                "cores": os.cpu_count(),
                "noise_floor": {e.view.name: e.reference().noise_floor() for e in finished},
                "uncertainty": {e.view.name: e.reference().uncertainty() for e in finished}}
    results.write_points(rows, settings, folder)
    if not finished:
        return []
    # Only here, because matplotlib takes longer to load than bad input to be told.
    from tessera_chart import drawing, report
    charts = folder / "charts"
    charts.mkdir(exist_ok=True)
    scenes, sentences = [], []
    for each in finished:
        name, floor = each.view.name, settings["noise_floor"][each.view.name]
        by_method = results.means_of(rows, name)
        drawing.draw_scene(by_method, title_of(name, plan.size, plan.frame), floor, charts / name)
        sentences.append(results.sentence(name, by_method,
                                          uncertainty=settings["uncertainty"][name]))
        scenes.append({"name": name, "sentence": sentences[-1], "chart": charts / f"{name}.svg",
                       "multipliers": results.multipliers(by_method),
                       "pictures": report.pictures_of(each)})
    names = [s["name"] for s in scenes]
    drawing.draw_main(rows, names, settings["noise_floor"], charts / "all-scenes")
    drawing.draw_multipliers(rows, names, charts / "multipliers")
    report.write(folder / "report.html", intro(plan, version), scenes)
    return sentences


def run(args: argparse.Namespace) -> int:
    """Errors: BadInput."""
    plan = make_plan(args)
    chosen = views.parse_views(args.scenes, view_flags(args))
    if any(m.name == methods.CYCLES for m in plan.methods):
        for view in chosen:
            peers_of.check(view)
    try:
        args.output.mkdir(parents=True, exist_ok=True)
        (args.output / ".writable").touch()
        (args.output / ".writable").unlink()
    except OSError as error:
        raise BadInput(f"-o {args.output}: {error.strerror}; choose another folder") from error
    ladders = [ladder.Ladder(plan, view, args.output / "work") for view in chosen]
    stopped = False
    try:
        work_through(ladders, args.quiet, args.jobs)
    except KeyboardInterrupt:
        stopped = True
        print("tessera chart: stopped; writing what is finished", file=sys.stderr)
    sentences = write_all(ladders, plan, args.output)
    if not args.quiet:
        print("\n".join(sentences))
    print(args.output / ("report.html" if sentences else "points.csv"))
    if stopped:
        print("tessera chart: the same command goes on from here", file=sys.stderr)
    return EXIT_CANCELLED if stopped else 0


def main(arguments: list[str]) -> int:
    args = parse(arguments)
    try:
        return run(args)
    except BadInput as error:
        print(f"tessera chart: {error}", file=sys.stderr)
        return EXIT_BAD_INPUT
    except KeyboardInterrupt:
        return EXIT_CANCELLED
