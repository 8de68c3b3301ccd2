"""Errors of pictures against references, and how error falls with samples."""

import math
import pathlib

import numpy
import OpenImageIO as oiio

TRIMMED_SHARE = 0.001


def read_rgb(path: pathlib.Path) -> numpy.ndarray:
    """Height x width x 3 linear radiance, double. Errors: RuntimeError."""
    # Not by ImageBuf, whose cache takes a file of the same name and second for the one before.
    picture = oiio.ImageInput.open(str(path))
    if picture is None:
        raise RuntimeError(f"{path}: {oiio.geterror()}")
    names = list(picture.spec().channelnames)

    def channel(letter: str) -> int:
        return next(i for i, n in enumerate(names) if n == letter or n.endswith("Combined." + letter))

    pixels = picture.read_image(oiio.FLOAT)
    if pixels is None:
        raise RuntimeError(f"{path}: {picture.geterror()}")
    picture.close()
    return pixels.astype(numpy.float64)[:, :, [channel(c) for c in "RGB"]]


def relative_errors(x: numpy.ndarray, r1: numpy.ndarray, r2: numpy.ndarray) -> numpy.ndarray:
    """By pixel: mean over channels of (x - r1)(x - r2) / (((r1 + r2) / 2)^2 + 0.01).

    Its mean is relMSE without the noise of the two independent references.
    """
    mean = (r1 + r2) / 2
    return ((x - r1) * (x - r2) / (mean * mean + 0.01)).mean(axis=2)


def rel_mse(x, r1, r2) -> tuple[float, float]:
    """relMSE, and trimmed: without the worst 0.1 % of pixels."""
    errors = numpy.sort(relative_errors(x, r1, r2).ravel())
    kept = errors[:max(1, round(errors.size * (1 - TRIMMED_SHARE)))]
    return float(errors.mean()), float(kept.mean())


def samples_for_error(counts: list[int], errors: list[float], wanted: float) -> float:
    """Samples at which `errors` falls to `wanted`: log-log interpolation; beyond the ends as 1/n."""
    for i in range(len(counts) - 1):
        n0, n1, e0, e1 = counts[i], counts[i + 1], errors[i], errors[i + 1]
        if e0 >= wanted >= e1 and e0 > e1:
            share = math.log(e0 / wanted) / math.log(e0 / e1)
            return n0 * (n1 / n0) ** share
    if wanted > errors[0]:
        return counts[0] * errors[0] / wanted
    return counts[-1] * errors[-1] / wanted


def slope(counts: list[int], errors: list[float]) -> float:
    """Least-squares slope of log error against log samples; NaN if an error is not positive."""
    if min(errors) <= 0:
        return math.nan
    return float(numpy.polyfit(numpy.log(counts), numpy.log(errors), 1)[0])
