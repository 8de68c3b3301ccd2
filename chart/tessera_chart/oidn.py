"""OIDN's network by a program that the user has: PROGRAM WEIGHTS.tza [--mode alb|nrm] IN.exr... OUT.exr.

Base filters colour with the film's albedo and normal; hq filters those first, each by its own
network, and then colour by the large one.
"""

import hashlib
import pathlib
import re

import numpy
import OpenImageIO as oiio

from tessera_chart import methods, programs
from tessera_chart.errors import BadInput

WEIGHTS = {methods.OIDN: ("rt_hdr_alb_nrm",),
           methods.OIDN_HQ: ("rt_alb_large", "rt_nrm_large", "rt_hdr_calb_cnrm_large")}


def check(folder: pathlib.Path) -> None:
    """Errors: BadInput naming the weights that are missing."""
    for names in WEIGHTS.values():
        for name in names:
            if not (folder / f"{name}.tza").is_file():
                raise BadInput(f"--oidn-weights {folder}: has no {name}.tza")


def identity(program: str, weights: pathlib.Path, method: str) -> str:
    """Another one for another program or other weights of `method`. Errors: OSError."""
    files = [program, *(weights / f"{name}.tza" for name in WEIGHTS[method])]
    digests = " ".join(programs.digest_of(file) for file in files)
    return hashlib.sha256(digests.encode()).hexdigest()[:12]


def _split(layers: pathlib.Path, beside: pathlib.Path) -> list[pathlib.Path]:
    """Colour, albedo and normal of a picture with layers, as files of three channels."""
    picture = oiio.ImageBuf(str(layers))
    names = list(picture.spec().channelnames)
    pixels = picture.get_pixels(oiio.FLOAT)
    paths = []
    for part, channels in (("color", "RGB"), ("albedo", ("albedo.R", "albedo.G", "albedo.B")),
                           ("normal", ("normal.X", "normal.Y", "normal.Z"))):
        planes = numpy.ascontiguousarray(pixels[:, :, [names.index(c) for c in channels]])
        spec = oiio.ImageSpec(planes.shape[1], planes.shape[0], 3, oiio.FLOAT)
        spec.channelnames = ("R", "G", "B")
        paths.append(beside.with_suffix(f".{part}.exr"))
        file = oiio.ImageOutput.create(str(paths[-1]))
        if not (file.open(str(paths[-1]), spec) and file.write_image(planes) and file.close()):
            raise BadInput(f"{paths[-1]}: {file.geterror()}")
    return paths


def denoise(program: str, weights: pathlib.Path, method: str, film: pathlib.Path,
            out: pathlib.Path, threads: int | None) -> tuple[float, float]:
    """Writes `out`; wall-clock and CPU seconds of the networks.

    Errors: BadInput, also if the program does not print total_ms and cpu_ms.
    """
    wall_s = cpu_s = 0.0
    # Threads that wait must not be charged as if they worked.
    variables = {"OMP_WAIT_POLICY": "passive", **({"OMP_NUM_THREADS": str(threads)} if threads else {})}

    def apply(name: str, *arguments) -> None:
        nonlocal wall_s, cpu_s
        said = programs.run([program, str(weights / f"{name}.tza"), *map(str, arguments)],
                            variables).stdout
        wall = re.search(r"(?<!network_ms )total_ms ([0-9.]+)", said)
        cpu = re.search(r"cpu_ms ([0-9.]+)", said)
        if not wall or not cpu:
            raise BadInput(f"--oidn {program}: prints no total_ms and cpu_ms")
        wall_s += float(wall.group(1)) / 1e3
        cpu_s += float(cpu.group(1)) / 1e3

    color, albedo, normal = parts = _split(film, out)
    if method == methods.OIDN:
        apply(WEIGHTS[method][0], color, albedo, normal, out)
    else:
        clean = [p.with_suffix(".clean.exr") for p in (albedo, normal)]
        for name, mode, noisy, filtered in zip(WEIGHTS[method], ("alb", "nrm"), (albedo, normal),
                                               clean):
            apply(name, noisy, filtered, "--mode", mode)
        apply(WEIGHTS[method][2], color, *clean, out)
        parts += clean
    for part in parts:
        part.unlink()
    return wall_s, cpu_s
