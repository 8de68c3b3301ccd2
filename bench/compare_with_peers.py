#!/usr/bin/python3
"""The path tracer beside its peers: CPU time to equal error against Blender's Cycles, and samples a
second against Embree's tutorial path tracer.

    bench/compare_with_peers.py --build build/release --scenes FOLDER --out OUTPUT_FOLDER
        [--views kitchen,bunny,...] [--size 192x108] [--references 512] [--embree] [--targets]

Each renderer draws each view at several sample counts and is measured against the mean of two
references of its own (materials differ), of other seeds; they are kept in OUTPUT_FOLDER and used
again (delete tessera's when its picture has changed). Runs of the two alternate. "render" is CPU
time in proportion to samples (user + system, from the difference of the longest and the shortest
run), "total" is that of the whole process. --targets adds a table of what the path tracer is
measured by, beside its targets: the two ratios, CPU time around Embree over that inside, loading,
memory. Needs python3-numpy, python3-openimageio and, for the
peers, blender and embree-tools (Debian packages); for the time around Embree linux-perf.
"""

import argparse
import pathlib
import sys

sys.dont_write_bytecode = True  # the source folder stays clean

from peers import accuracy, own_figures, renderers, views

PEER_SPP = 64  # whose error in Cycles is to be reached
COUNTS = (16, 64, 256)
REFERENCE_SEEDS = (101, 202)
SEED = 7


def parse_arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    views.add_arguments(parser, size="192x108")
    parser.add_argument("--references", type=int, default=512, help="samples of each reference")
    parser.add_argument("--max-depth", type=int, default=8)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--repeat", action="store_true", help="render and time again all but the references")
    parser.add_argument("--embree", action="store_true", help="Embree's path tracer too")
    parser.add_argument("--targets", action="store_true", help="the table of targets too; needs --scenes")
    args = parser.parse_args()
    if args.targets and args.scenes is None:
        parser.error("--targets measures apartment.glb and others: give their folder by --scenes")
    return args


class Measurement:
    """The renders of one view by one renderer."""

    def __init__(self, renderer, view, scene, frame, args):
        self.name = renderer.name
        self._renderer, self._view, self._scene, self._frame = renderer, view, scene, frame
        self._folder = args.out / f"{args.size}_{args.max_depth}" / view.name / renderer.name
        self._folder.mkdir(parents=True, exist_ok=True)
        self._references = args.references
        self._repeat = args.repeat

    def _path(self, spp: int, seed: int) -> pathlib.Path:
        return self._folder / f"{spp}_{seed}.exr"

    def _render(self, spp: int, seed: int) -> None:
        """Unless a picture and its time are there already."""
        out = self._path(spp, seed)
        time_file = out.with_suffix(".cpu")
        if time_file.exists() and not (self._repeat and seed == SEED):
            return
        cpu = self._renderer.render(self._view, self._scene, self._frame, spp, seed, out)
        time_file.write_text(f"{cpu}\n", encoding="utf-8")

    def tasks(self) -> list:
        jobs = [(n, SEED) for n in COUNTS] + [(self._references, s) for s in REFERENCE_SEEDS]
        return [lambda job=job: self._render(*job) for job in jobs]

    def evaluate(self) -> None:
        references = [accuracy.read_rgb(self._path(self._references, s)) for s in REFERENCE_SEEDS]
        both = [accuracy.rel_mse(accuracy.read_rgb(self._path(n, SEED)), *references)
                for n in COUNTS]
        self.errors, self.trimmed = [e[0] for e in both], [e[1] for e in both]
        cpu = [float(self._path(n, SEED).with_suffix(".cpu").read_text()) for n in COUNTS]
        self.cpu_per_spp = (cpu[-1] - cpu[0]) / (COUNTS[-1] - COUNTS[0])
        self.cpu_fixed = max(0.0, cpu[0] - self.cpu_per_spp * COUNTS[0])
        self.mean = float((sum(references) / 2).mean())
        self.slope = accuracy.slope(list(COUNTS), self.trimmed)

    def cpu_to(self, errors: list[float], wanted: float) -> float:
        return accuracy.samples_for_error(list(COUNTS), errors, wanted) * self.cpu_per_spp


def ratios(ours: Measurement, peer: Measurement) -> tuple[float, float]:
    """CPU time to the peer's error at PEER_SPP samples over the peer's: plain, trimmed."""
    at = COUNTS.index(PEER_SPP)
    return tuple(ours.cpu_to(own, theirs[at]) / (PEER_SPP * peer.cpu_per_spp)
                 for own, theirs in ((ours.errors, peer.errors), (ours.trimmed, peer.trimmed)))


def row(view, ours: Measurement, peer: Measurement | None, pixels: int) -> str:
    at = COUNTS.index(PEER_SPP)
    speed = pixels / ours.cpu_per_spp / 1e6
    if peer is None:
        return f"| {view.name} | {ours.errors[at]:.5f} | - | {speed:.2f} | - | {ours.slope:.2f} | - | - | - |"
    plain, trimmed = ratios(ours, peer)
    total = (ours.cpu_to(ours.trimmed, peer.trimmed[at]) + ours.cpu_fixed) / (
        PEER_SPP * peer.cpu_per_spp + peer.cpu_fixed)
    return (f"| {view.name} | {ours.errors[at]:.5f} ({ours.trimmed[at]:.5f}) "
            f"| {peer.errors[at]:.5f} ({peer.trimmed[at]:.5f}) | {speed:.2f} "
            f"| {pixels / peer.cpu_per_spp / 1e6:.2f} | {ours.slope:.2f} | {plain:.2f} "
            f"| {trimmed:.2f} | {total:.2f} |")


HEADER = f"""\
| view | relMSE at {PEER_SPP} spp (trimmed) | Cycles' | M samples per CPU second | Cycles' \
| slope | render CPU to equal relMSE | trimmed | total, trimmed |
|---|---|---|---|---|---|---|---|---|"""


def compare(args, frame: renderers.Frame) -> dict[str, tuple[float, float]]:
    """Prints a row for each view; returns the ratios to Cycles, by view."""
    found = {}
    has_cycles = renderers.Cycles.available()
    if not has_cycles:
        print("blender is not installed (apt-get install --no-install-recommends blender): "
              "tessera alone is measured", file=sys.stderr)
    ours_renderer = renderers.Tessera(args.build / "bin" / "tessera")
    print(HEADER, flush=True)
    for view in views.chosen(args.views, args.scenes):
        scene = views.scene_path(view, args.scenes, args.build / "scenes")
        ours = Measurement(ours_renderer, view, scene, frame, args)
        pair = [ours]
        if has_cycles and not views.is_compressed(scene):
            pair.append(Measurement(renderers.Cycles(), view, scene, frame, args))
        for tasks in zip(*(m.tasks() for m in pair)):
            for task in tasks:
                task()
        for measurement in pair:
            measurement.evaluate()
        peer = pair[1] if len(pair) > 1 else None
        print(row(view, ours, peer, frame.width * frame.height), flush=True)
        if peer:
            found[view.name] = ratios(ours, peer)
            print(f"{view.name}: mean brightness over Cycles' {ours.mean / peer.mean:.3f}",
                  file=sys.stderr)
    return found


def compare_with_embree(args) -> float | None:
    theirs = renderers.embree_samples_per_cpu_second(args.out, args.threads)
    if theirs is None:
        print("Embree's pathtracer is not installed (apt-get install embree-tools)",
              file=sys.stderr)
        return None
    ours = renderers.tessera_samples_per_cpu_second(
        args.build / "bin" / "path_tracer_bench", args.build / "scenes" / "cornell.glb",
        args.threads, args.out)
    print(f"\nCornell box, 512x512, 8 rays a path: {ours / 1e6:.2f} M samples per CPU second, "
          f"Embree's tutorial {theirs / 1e6:.2f}: ratio {ours / theirs:.2f}")
    return ours / theirs


def print_targets(args, beside_cycles: dict, beside_embree: float | None) -> None:
    bench = args.build / "bin" / "path_tracer_bench"
    kitchen, apartment = views.chosen("kitchen,apartment", args.scenes)
    scene = args.scenes / kitchen.file
    around = own_figures.outside_over_inside(bench, kitchen, scene, args.out)
    milliseconds, attributes = own_figures.loading(bench, apartment, scene, args.out)
    of_users = [name for name in beside_cycles
                if not next(v for v in views.VIEWS if v.name == name).own]
    cycles = ", ".join(f"{name} {beside_cycles[name][1]:.2f}" for name in of_users) or "not measured"
    embree = "not measured" if beside_embree is None else f"{beside_embree:.2f}x"
    middle = "not measured: perf is missing" if around is None else (
        f"{around[len(around) // 2]:.2f}x ({around[0]:.2f} to {around[-1]:.2f})")
    print("\n| what | measured | target |\n|---|---|---|\n"
          f"| CPU time to equal trimmed relMSE against Cycles' at {PEER_SPP} spp | {cycles} "
          "| at most 0.5x |\n"
          f"| samples a CPU second against Embree's tutorial, Cornell box | {embree} "
          "| at least 1.5x |\n"
          f"| CPU time outside Embree against inside, kitchen | {middle} | at most 0.7x |\n"
          f"| loading and building apartment.glb | {milliseconds:.0f} ms | under 300 ms |\n"
          f"| memory above what Embree needs | {attributes:.0f} B a triangle | under 64 B |")


def main() -> int:
    args = parse_arguments()
    width, height = map(int, args.size.split("x"))
    args.out.mkdir(parents=True, exist_ok=True)
    beside_cycles = compare(args, renderers.Frame(width, height, args.max_depth, args.threads))
    beside_embree = compare_with_embree(args) if args.embree or args.targets else None
    if args.targets:
        print_targets(args, beside_cycles, beside_embree)
    return 0


if __name__ == "__main__":
    sys.exit(main())
