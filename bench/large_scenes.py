#!/usr/bin/python3
"""Scenes of measured size: what 10^7 triangles and 10^5 emitters cost the path tracer.

    bench/large_scenes.py --build BUILD --out FOLDER [--size 192x108] [--spp 16] [--seeds 4]

Makes the scenes with scenes/make_large_scenes.py (280 MB) unless they are in FOLDER, renders them
with `path_tracer_bench`, and prints Markdown tables: loading, memory, speed; for the halls of equal
power the error. relMSE is the variance between seeds over (mean of all)^2 + 0.01, without the worst
0.1 % of pixels; "x CPU time" is the error at equal time, relative to the first hall. Leaves a
picture of each. Needs python3-numpy and python3-openimageio.
"""

import argparse
import pathlib
import re
import subprocess
import sys

sys.dont_write_bytecode = True  # the source folder stays clean

import numpy

from peers import accuracy, renderers

SKY = "1.0,1.1,1.3"
HALLS = [100, 10_000, 100_000]


def parse_arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("--build", type=pathlib.Path, required=True)
    parser.add_argument("--out", type=pathlib.Path, required=True)
    parser.add_argument("--size", default="192x108")
    parser.add_argument("--spp", type=int, default=16)
    parser.add_argument("--seeds", type=int, default=4)
    parser.add_argument("--threads", type=int, default=1)
    return parser.parse_args()


def make_scenes(folder: pathlib.Path) -> None:
    names = ["triangles_10m"] + [f"hall_{n}" for n in HALLS]
    missing = [name for name in names if not (folder / f"{name}.glb").is_file()]
    script = pathlib.Path(__file__).parents[1] / "scenes" / "make_large_scenes.py"
    if missing:
        subprocess.run([sys.executable, str(script), "--out", str(folder)] + missing, check=True)


class Run:
    """Renders of one scene under several seeds, and what the bench printed of them."""

    def __init__(self, args, name: str, seeds: int, flags: list[str]):
        self.file = args.out / f"{name}.glb"
        self.pictures, self.texts, self._spp = [], [], args.spp
        for seed in range(seeds):
            out = args.out / f"{name}.exr"
            command = [str(args.build / "bin" / "path_tracer_bench"), str(self.file), "--size",
                       args.size, "--spp", str(args.spp), "--threads", str(args.threads), "--seed",
                       str(seed), "--out", str(out), "--png", str(args.out / f"{name}.png")] + flags
            self.texts.append(renderers.run(command, args.out / f"{name}.log")[1])
            self.pictures.append(accuracy.read_rgb(out))

    def printed(self, pattern: str) -> float:
        """The median over the seeds of the number that `pattern` finds."""
        return float(numpy.median([float(re.search(pattern, t).group(1)) for t in self.texts]))

    def error(self) -> float:
        mean = numpy.mean(self.pictures, axis=0)
        variance = numpy.var(self.pictures, axis=0, ddof=1)
        errors = numpy.sort((variance / (mean * mean + 0.01)).mean(axis=2).ravel())
        return float(errors[:round(errors.size * (1 - accuracy.TRIMMED_SHARE))].mean())

    def costs(self) -> str:
        n = r"([0-9.]+)"
        cells = [f"{self.file.stat().st_size / 1e6:.1f} MB", f"{self.printed(n + ' triangles'):.0f}",
                 f"{self.printed('load ' + n):.2f} + {self.printed('build ' + n):.2f} s",
                 f"{self.printed(n + ' MB in all'):.0f} MB",
                 f"{self.printed('attributes ' + n):.0f} B",
                 f"{self.printed('[(]' + n + ' and'):.1f} + {self.printed('and ' + n):.1f} B",
                 f"{self.printed('ray, ' + n):.2f}", f"{self.printed(n + ' CPU ns'):.0f}",
                 f"{self.samples_per_second():.3f} M"]
        return " | ".join(cells)

    def cpu_seconds(self) -> float:
        return self.printed(r"CPU ([0-9.]+) s\)")

    def samples_per_second(self) -> float:
        pixels = self.pictures[0].shape[0] * self.pictures[0].shape[1]
        return pixels * self._spp / self.cpu_seconds() / 1e6


def main() -> int:
    args = parse_arguments()
    args.out.mkdir(parents=True, exist_ok=True)
    make_scenes(args.out)
    print("| scene | file | triangles | load + build | peak | attributes a triangle | scene + built "
          "a triangle | rays/sample | CPU ns/ray | samples/s of CPU |\n" + "|---" * 10 + "|")
    print(f"| triangles_10m | {Run(args, 'triangles_10m', 1, ['--sky', SKY]).costs()} |", flush=True)
    halls = [Run(args, f"hall_{n}", args.seeds, []) for n in HALLS]
    for number, hall in zip(HALLS, halls):
        print(f"| hall_{number} | {hall.costs()} |")
    print("\n| emitters | mean | relMSE (trimmed) | x CPU time |\n" + "|---" * 4 + "|")
    for number, hall in zip(HALLS, halls):
        relative = hall.error() * hall.cpu_seconds() / halls[0].error() / halls[0].cpu_seconds()
        print(f"| {number} | {numpy.mean(hall.pictures):.4f} | {hall.error():.5f} | "
              f"{relative:.2f} |")
    return 0


if __name__ == "__main__":
    sys.exit(main())
