#!/usr/bin/python3
"""Filters films of another renderer with `tessera denoise --half-a ... --half-b ...`: relMSE x 1e5.

    bench/denoise_films.py --build build/release --films FOLDER [--filters regression,bilateral,...]
        [--halves-only]

FOLDER has a folder SCENE-SAMPLES for each film with colorA.exr, colorB.exr, colorVariance.exr and
the same of albedo, normal and depth, and SCENE-reference/color.exr. In brackets: without the worst
0.1 % of pixels. --halves-only gives the filters A and B of colour and nothing else.
"""

import argparse
import json
import pathlib
import subprocess
import sys
import tempfile

FEATURES = ("albedo", "normal", "depth")


def films(folder: pathlib.Path) -> list[tuple[pathlib.Path, str, int]]:
    """Folder, scene and samples of each film, in order."""
    found = []
    for film in folder.iterdir():
        scene, _, samples = film.name.rpartition("-")
        if samples.isdigit():
            found.append((film, scene, int(samples)))
    return sorted(found, key=lambda f: f[1:])


def denoise(tessera: pathlib.Path, film: pathlib.Path, samples: int, denoiser: str,
            halves_only: bool, out: pathlib.Path) -> None:
    command = [tessera, "denoise", "--half-a", film / "colorA.exr", "--half-b",
               film / "colorB.exr", "-o", out, "--layers", "final", "--denoiser", denoiser]
    if not halves_only:
        command += ["--variance", film / "colorVariance.exr", "--spp", str(samples)]
        for name in FEATURES:
            command += [f"--{name}", film / f"{name}A.exr", f"--{name}-b", film / f"{name}B.exr",
                        f"--{name}-variance", film / f"{name}Variance.exr"]
    subprocess.run(command, check=True, capture_output=True)


def cell(tessera: pathlib.Path, picture: pathlib.Path, reference: pathlib.Path) -> str:
    text = subprocess.run([tessera, "compare", picture, reference, "--json"], check=True,
                          capture_output=True, text=True).stdout
    errors = json.loads(text)
    return f"{errors['rel_mse'] * 1e5:.1f} ({errors['rel_mse_trimmed'] * 1e5:.1f})"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("--build", type=pathlib.Path, required=True)
    parser.add_argument("--films", type=pathlib.Path, required=True)
    parser.add_argument("--filters", default="none,nlm,welch,bilateral,regression")
    parser.add_argument("--halves-only", action="store_true")
    args = parser.parse_args()
    tessera = args.build / "bin" / "tessera"
    filters = args.filters.split(",")
    print("| input | " + " | ".join(filters) + " |\n|---|" + "---|" * len(filters))
    with tempfile.TemporaryDirectory() as folder:
        out = pathlib.Path(folder) / "out.exr"
        for film, scene, samples in films(args.films):
            cells = []
            for name in filters:
                denoise(tessera, film, samples, name, args.halves_only, out)
                cells.append(cell(tessera, out, args.films / f"{scene}-reference" / "color.exr"))
            print(f"| {film.name} | " + " | ".join(cells) + " |", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
