#!/usr/bin/python3
"""Every filter on the project's own renders: equivalent-sample multipliers and CPU seconds a megapixel.

    bench/compare_denoisers.py --build build/release --out OUTPUT_FOLDER [--scenes FOLDER]
        [--views kitchen,bunny,...] [--size 160x90] [--spp 4,16,64,256,1024]
        [--reference-spp 4096] [--filters regression,bilateral,...] [--timing-size 640x360]
        [--oidn PROGRAM --oidn-weights FOLDER]

A multiplier is the number of samples at which raw's error, a line fitted to its logarithms, is the
filtered picture's, over the samples that the filter had. Errors are relMSE against two independent
references of --reference-spp samples, free of their noise. Everything rendered or filtered is kept
in OUTPUT_FOLDER and used again, so a run that was stopped goes on; delete the files of a filter
that has changed. --scenes is the folder with apartment.glb, bunny.glb, ...; without it the
project's own scenes alone are measured. PROGRAM runs Intel Open Image Denoise's network:

    PROGRAM WEIGHTS.tza COLOR.exr [ALBEDO.exr NORMAL.exr] OUT.exr [--mode alb|nrm]

and prints "cpu_ms NUMBER".

"base" filters colour with the noisy albedo and normal, "hq" filters those first and uses the large
network. Needs python3-numpy and python3-openimageio.
"""

import argparse
import dataclasses
import json
import pathlib
import re
import subprocess
import sys

sys.dont_write_bytecode = True  # the source folder stays clean

import numpy
import OpenImageIO as oiio

from peers import accuracy, renderers, views

OWN_FILTERS = ("geometric", "bilateral", "nlm", "welch", "regression")
REFERENCE_SEEDS = (101, 202)
SEED = 7
MAX_DEPTH = 8
TIMING_VIEW, TIMING_SPP = "cornell", 16


def parse_arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    views.add_arguments(parser, size="160x90")
    parser.add_argument("--spp", default="4,16,64,256,1024")
    parser.add_argument("--reference-spp", type=int, default=4096)
    parser.add_argument("--filters", default=",".join(OWN_FILTERS))
    parser.add_argument("--timing-size", default="640x360")
    parser.add_argument("--threads", type=int, default=2, help="of renders; filters use all cores")
    parser.add_argument("--oidn", type=pathlib.Path, help="program that runs OIDN's network")
    parser.add_argument("--oidn-weights", type=pathlib.Path, help="folder with its *.tza")
    return parser.parse_args()


@dataclasses.dataclass(frozen=True)
class Own:
    """One of `tessera denoise`'s filters."""

    name: str
    program: pathlib.Path

    def filter(self, film: pathlib.Path, out: pathlib.Path) -> float:
        """Writes `out`; returns the filter's CPU seconds."""
        text = subprocess.run([self.program, "denoise", film, "-o", out, "--layers", "final",
                               "--denoiser", self.name, "--json"],
                              check=True, capture_output=True, text=True).stdout
        return json.loads(text)["cpu_seconds"]["filter"]


@dataclasses.dataclass(frozen=True)
class Oidn:
    """Intel Open Image Denoise's network."""

    name: str
    tessera: pathlib.Path
    program: pathlib.Path
    weights: pathlib.Path

    def _run(self, weights: str, *arguments) -> float:
        text = subprocess.run([self.program, self.weights / (weights + ".tza"), *arguments],
                              check=True, capture_output=True, text=True)
        milliseconds = re.search(r"cpu_ms ([0-9.]+)", text.stdout)
        return float(milliseconds.group(1)) / 1e3 if milliseconds else float("nan")

    def filter(self, film: pathlib.Path, out: pathlib.Path) -> float:
        """Writes `out`; returns the network's CPU seconds."""
        color, albedo, normal = split_layers(self.tessera, film)
        if self.name == "OIDN base":
            return self._run("rt_hdr_alb_nrm", color, albedo, normal, out)
        clean = [path.with_suffix(".clean.exr") for path in (albedo, normal)]
        seconds = self._run("rt_alb_large", albedo, clean[0], "--mode", "alb")
        seconds += self._run("rt_nrm_large", normal, clean[1], "--mode", "nrm")
        return seconds + self._run("rt_hdr_calb_cnrm_large", color, *clean, out)


def split_layers(tessera: pathlib.Path, film: pathlib.Path) -> list[pathlib.Path]:
    """Raw colour, albedo and normal of a film as files of three channels each, beside it."""
    parts = [film.with_suffix(f".{name}.exr") for name in ("color", "albedo", "normal")]
    if all(part.is_file() for part in parts):
        return parts
    layers = film.with_suffix(".layers.exr")
    subprocess.run([tessera, "denoise", film, "-o", layers, "--denoiser", "none", "--layers",
                    "final,albedo,normal"], check=True, capture_output=True)
    picture = oiio.ImageBuf(str(layers))
    names = list(picture.spec().channelnames)
    pixels = picture.get_pixels(oiio.FLOAT)
    for part, prefix, letters in zip(parts, ("", "albedo.", "normal."), ("RGB", "RGB", "XYZ")):
        planes = numpy.ascontiguousarray(
            pixels[:, :, [names.index(prefix + letter) for letter in letters]])
        spec = oiio.ImageSpec(planes.shape[1], planes.shape[0], 3, oiio.FLOAT)
        spec.channelnames = ("R", "G", "B")
        file = oiio.ImageOutput.create(str(part))
        if not (file.open(str(part), spec) and file.write_image(planes) and file.close()):
            raise RuntimeError(f"{part}: {file.geterror()}")
    return parts


def chosen_filters(args) -> list:
    tessera = args.build / "bin" / "tessera"
    filters = [Own(name, tessera) for name in args.filters.split(",") if name]
    if args.oidn and args.oidn_weights:
        filters += [Oidn(name, tessera, args.oidn, args.oidn_weights)
                    for name in ("OIDN base", "OIDN hq")]
    else:
        print("OIDN is left out: give --oidn and --oidn-weights", file=sys.stderr)
    return filters


class Films:
    """The renders of one view, made when they are asked for."""

    def __init__(self, view, args, size: str):
        width, height = map(int, size.split("x"))
        self._view, self._args = view, args
        self._frame = renderers.Frame(width, height, MAX_DEPTH, args.threads)
        self._scene = views.scene_path(view, args.scenes, args.build / "scenes")
        self.folder = args.out / size / view.name
        self.folder.mkdir(parents=True, exist_ok=True)

    def _render(self, spp: int, seed: int, layers: str) -> pathlib.Path:
        path = self.folder / f"{spp}_{seed}.exr"
        if not path.is_file():
            part = path.with_suffix(".part.exr")
            renderers.Tessera(self._args.build / "bin" / "tessera", layers).render(
                self._view, self._scene, self._frame, spp, seed, part)
            part.rename(path)
        return path

    def film(self, spp: int) -> pathlib.Path:
        return self._render(spp, SEED, "film")

    def references(self) -> list:
        return [accuracy.read_rgb(self._render(self._args.reference_spp, seed, "final"))
                for seed in REFERENCE_SEEDS]

    def filtered(self, spp: int, member) -> pathlib.Path:
        out = self.folder / f"{spp}_{SEED}.{member.name.replace(' ', '_')}.exr"
        if not out.is_file():
            part = out.with_suffix(".part.exr")
            member.filter(self.film(spp), part)
            part.rename(out)
        return out


def fitted_raw(counts: list[int], errors: list[float]):
    """The line through log error over log samples, as a function from an error to samples."""
    falling, at_one = numpy.polyfit(numpy.log(counts), numpy.log(errors), 1)
    return lambda error: float(numpy.exp((numpy.log(error) - at_one) / falling)), falling


def measure(view, args, filters: list, counts: list[int]) -> dict:
    """Multipliers by filter name, and of raw itself: one for each of `counts`."""
    films = Films(view, args, args.size)
    references = films.references()
    raw = [accuracy.rel_mse(accuracy.read_rgb(films.film(n)), *references)[0] for n in counts]
    samples, falling = fitted_raw(counts, raw)
    print(f"{view.name}: raw relMSE " + ", ".join(f"{e:.2e}" for e in raw)
          + f", slope {falling:.2f}", file=sys.stderr)
    # How far the fit is from raw's own points.
    multipliers = {"raw": [samples(e) / n for n, e in zip(counts, raw)]}
    # An error below what two references can tell from nothing counts as that.
    floor = reference_floor(*references)
    for member in filters:
        errors = [accuracy.rel_mse(accuracy.read_rgb(films.filtered(n, member)), *references)[0]
                  for n in counts]
        multipliers[member.name] = [samples(max(e, floor)) / n for n, e in zip(counts, errors)]
    return multipliers


def reference_floor(r1, r2) -> float:
    """The standard error of relMSE for a perfect picture, whose errors are the references' noise."""
    mean = (r1 + r2) / 2
    # (x - r1)(x - r2) of a perfect x has variance v^2, v = half the squared difference on average.
    noise = ((r1 - r2) ** 2 / 2 / (mean * mean + 0.01)).mean(axis=2)
    return float(numpy.sqrt((noise ** 2).sum()) / noise.size)


def row_of(label: str, count: int, values: list[float]) -> str:
    """A row of the table, the largest multiplier in bold."""
    cells = [f"**{v:.3g}**" if v == max(values) else f"{v:.3g}" for v in values]
    return f"| {label} | {count} | " + " | ".join(cells) + " |"


def print_table(args, filters: list, counts: list[int]) -> None:
    names = ["raw"] + [f.name for f in filters]
    print("| view | samples | " + " | ".join(names) + " |")
    print("|---|---|" + "---|" * len(names))
    logs = {name: [[] for _ in counts] for name in names}
    for view in views.chosen(args.views, args.scenes):
        multipliers = measure(view, args, filters, counts)
        for i, n in enumerate(counts):
            row = [multipliers[name][i] for name in names]
            for name, value in zip(names, row):
                logs[name][i].append(numpy.log(value))
            print(row_of(view.name, n, row), flush=True)
    for i, n in enumerate(counts):
        row = [float(numpy.exp(numpy.mean(logs[name][i]))) for name in names]
        print(row_of("geometric mean", n, row))


def print_cost(args, filters: list) -> None:
    view = next(v for v in views.VIEWS if v.name == TIMING_VIEW)
    films = Films(view, args, args.timing_size)
    film = films.film(TIMING_SPP)
    width, height = map(int, args.timing_size.split("x"))
    print(f"\nCPU seconds (all threads) a megapixel, {args.timing_size}, the best of three:")
    for member in filters:
        out = films.folder / "timed.exr"
        seconds = min(member.filter(film, out) for _ in range(3))
        print(f"{member.name}: {seconds / (width * height) * 1e6:.2f}", flush=True)


def main() -> int:
    args = parse_arguments()
    args.out.mkdir(parents=True, exist_ok=True)
    filters = chosen_filters(args)
    print_table(args, filters, [int(n) for n in args.spp.split(",")])
    print_cost(args, filters)
    return 0


if __name__ == "__main__":
    sys.exit(main())
