"""Errors of pictures against references, as docs/command-line.md defines them, on numpy arrays.

FLIP: Andersson, Nilsson, Akenine-Moeller, Oskarsson, Astroem & Fairchild 2020, "FLIP: a difference
evaluator for alternating images". An implementation of its own: tests hold it against that of
`tessera compare`.
"""

import dataclasses
import pathlib

import numpy
import OpenImageIO as oiio

from tessera_chart.errors import BadInput

RELATIVE_FLOOR = 0.01
TRIMMED_SHARE = 0.001
BLOTCH_PX = 16  # wavelengths from here on count as blotches
PIXELS_PER_DEGREE = 0.7 * 3840 / 0.7 * numpy.pi / 180  # the paper's screen: 67.02


def read_rgb(path: pathlib.Path) -> numpy.ndarray:
    """Height x width x 3 linear radiance, double. Errors: BadInput naming the file."""
    # Not by ImageBuf, whose cache takes a file of the same name and second for the one before.
    picture = oiio.ImageInput.open(str(path))
    pixels = None if picture is None else picture.read_image(oiio.FLOAT)
    if pixels is None:
        why = oiio.geterror() if picture is None else picture.geterror()
        raise BadInput(f"{path}: cannot be read: {why}")
    picture.close()
    names = list(picture.spec().channelnames)
    found = [next((i for i, n in enumerate(names) if n == c or n.endswith("Combined." + c)), None)
             for c in "RGB"]
    if None in found:
        raise BadInput(f"{path}: has no channels R, G, B")
    return pixels.astype(numpy.float64)[:, :, found]


@dataclasses.dataclass(frozen=True)
class Errors:
    """Of one picture."""

    rel_mse: float
    rel_mse_trimmed: float
    flip: float
    blotches: float  # relMSE's part at wavelengths of BLOTCH_PX and more, the mean's error with it
    bias: float  # of the mean over the frame and channels, relative to the reference's


class Reference:
    """What pictures are measured against: two independent pictures, or one."""

    def __init__(self, first: numpy.ndarray, second: numpy.ndarray | None = None):
        self.first = first
        self.second = first if second is None else second
        self.mean = (self.first + self.second) / 2
        self.has_two = second is not None
        self._seen = _Seen(srgb_encode(self.mean))

    def noise_floor(self) -> float:
        """relMSE of the mean of the two by their own noise; 0 where only one is known."""
        square = (self.first - self.second) ** 2 / 4
        return float((square / (self.mean ** 2 + RELATIVE_FLOOR)).mean())

    def uncertainty(self) -> float:
        """Standard error of relMSE by the two references' noise, for a perfect picture, whose
        (x - r1)(x - r2) has the variance v^2; v is half the squared difference on average. 0 where
        only one is known."""
        noise = ((self.first - self.second) ** 2 / 2 / (self.mean ** 2 + RELATIVE_FLOOR)).mean(axis=2)
        return float(numpy.sqrt((noise ** 2).sum()) / noise.size)

    def relative_errors(self, picture: numpy.ndarray) -> numpy.ndarray:
        """By pixel, height x width: (x - r1)(x - r2) / (r^2 + 0.01), the mean over channels.

        Errors: BadInput if the sizes differ.
        """
        if picture.shape != self.mean.shape:
            raise BadInput(f"a picture of {picture.shape[1]}x{picture.shape[0]} pixels against a "
                           f"reference of {self.mean.shape[1]}x{self.mean.shape[0]}: use one size")
        product = (picture - self.first) * (picture - self.second)
        return (product / (self.mean ** 2 + RELATIVE_FLOOR)).mean(axis=2)

    def power(self, picture: numpy.ndarray) -> tuple[numpy.ndarray, numpy.ndarray]:
        """Frequencies (cycles a pixel, ascending) and the relative error's power at each, whose sum
        is relMSE (Parseval); with two references free of their noise on average."""
        scale = numpy.sqrt(self.mean ** 2 + RELATIVE_FLOOR)
        first, second = (numpy.fft.fft2((picture - r) / scale, axes=(0, 1), norm="forward")
                         for r in (self.first, self.second))
        power = (first * second.conj()).real.mean(axis=2)
        height, width = power.shape
        frequency = numpy.hypot(numpy.fft.fftfreq(height)[:, None], numpy.fft.fftfreq(width)).ravel()
        order = numpy.argsort(frequency, kind="stable")
        return frequency[order], power.ravel()[order]

    def errors(self, picture: numpy.ndarray) -> Errors:
        by_pixel = numpy.sort(self.relative_errors(picture).ravel())
        frequency, power = self.power(picture)
        num_trimmed = min(max(round(by_pixel.size * TRIMMED_SHARE), 1), by_pixel.size - 1)
        flip = _flip(_Seen(srgb_encode(picture)), self._seen)
        return Errors(float(by_pixel.mean()), float(by_pixel[:by_pixel.size - num_trimmed].mean()),
                      flip, float(power[frequency <= 1 / BLOTCH_PX].sum()),
                      float(picture.mean() / self.mean.mean() - 1))


def srgb_encode(linear: numpy.ndarray) -> numpy.ndarray:
    """Display values in [0, 1] of linear radiance."""
    x = numpy.clip(numpy.nan_to_num(linear), 0, 1)
    return numpy.where(x <= 0.0031308, 12.92 * x, 1.055 * numpy.power(x, 1 / 2.4) - 0.055)


def srgb_decode(encoded: numpy.ndarray) -> numpy.ndarray:
    return numpy.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)


# sRGB primaries to CIE XYZ, as FLIP's paper has them.
_TO_XYZ = numpy.array([[10135552 / 24577794, 8788810 / 24577794, 4435075 / 24577794],
                       [2613072 / 12288897, 8788810 / 12288897, 887015 / 12288897],
                       [1425312 / 73733382, 8788810 / 73733382, 70074185 / 73733382]])
_WHITE = _TO_XYZ.sum(axis=1)
_COLOR_EXPONENT = 0.7
_KNEE, _KNEE_ERROR = 0.4, 0.95
_FEATURE_EXPONENT = 0.5
_FEATURE_WIDTH_DEGREES = 0.082
_SENSITIVITY = (((1, 0.0047),), ((1, 0.0053),), ((34.1, 0.04), (13.5, 0.025)))


def _convolve(plane: numpy.ndarray, kernel_x: numpy.ndarray, kernel_y: numpy.ndarray) -> numpy.ndarray:
    """Separable correlation of height x width, the edge repeated outwards."""
    for axis, kernel in ((1, kernel_x), (0, kernel_y)):
        radius = len(kernel) // 2
        pad = [(radius, radius) if a == axis else (0, 0) for a in range(2)]
        padded = numpy.pad(plane, pad, mode="edge")
        size = plane.shape[axis]
        plane = sum(w * (padded[:, i:i + size] if axis else padded[i:i + size])
                    for i, w in enumerate(kernel))
    return plane


def _hunt_lab(linear: numpy.ndarray) -> numpy.ndarray:
    """CIE L*a*b* with chroma weighted by lightness (Hunt)."""
    q = linear @ _TO_XYZ.T / _WHITE
    delta = 6 / 29
    f = numpy.where(q > delta ** 3, numpy.cbrt(q), q / (3 * delta * delta) + 4 / 29)
    lightness = 116 * f[..., 1] - 16
    return numpy.stack([lightness, 0.01 * lightness * 500 * (f[..., 0] - f[..., 1]),
                        0.01 * lightness * 200 * (f[..., 1] - f[..., 2])], axis=-1)


def _hyab(a: numpy.ndarray, b: numpy.ndarray) -> numpy.ndarray:
    d = a - b
    return numpy.abs(d[..., 0]) + numpy.hypot(d[..., 1], d[..., 2])


class _Seen:
    """What FLIP compares of one display picture: colours as the eye resolves them, edges, points."""

    def __init__(self, display: numpy.ndarray):
        q = srgb_decode(display) @ _TO_XYZ.T / _WHITE
        opponent = [116 * q[..., 1] - 16, 500 * (q[..., 0] - q[..., 1]),
                    200 * (q[..., 1] - q[..., 2])]
        radius = int(numpy.ceil(3 * numpy.sqrt(0.04 / (2 * numpy.pi ** 2)) * PIXELS_PER_DEGREE))
        degrees = numpy.arange(-radius, radius + 1) / PIXELS_PER_DEGREE
        planes = []
        for plane, terms in zip(opponent, _SENSITIVITY):
            total, weight = 0, 0
            for a, b in terms:
                kernel = numpy.exp(-numpy.pi ** 2 * degrees ** 2 / b)
                scale = a * numpy.sqrt(numpy.pi / b)
                total = total + scale * _convolve(plane, kernel, kernel)
                weight += scale * kernel.sum() ** 2
            planes.append(total / weight)
        y = (planes[0] + 16) / 116
        xyz = numpy.stack([y + planes[1] / 500, y, y - planes[2] / 200], axis=-1) * _WHITE
        self.lab = _hunt_lab(numpy.clip(xyz @ numpy.linalg.inv(_TO_XYZ).T, 0, 1))
        achromatic = (opponent[0] + 16) / 116
        self.edges = _feature_strength(achromatic, points=False)
        self.points = _feature_strength(achromatic, points=True)


def _feature_strength(plane: numpy.ndarray, points: bool) -> numpy.ndarray:
    sigma = 0.5 * _FEATURE_WIDTH_DEGREES * PIXELS_PER_DEGREE
    radius = int(numpy.ceil(3 * sigma))
    x = numpy.arange(-radius, radius + 1)
    smooth = numpy.exp(-x * x / (2 * sigma * sigma))
    derivative = (x * x / (sigma * sigma) - 1 if points else -x) * smooth
    smooth = smooth / smooth.sum()
    positive = derivative[derivative > 0].sum()
    negative = -derivative[derivative < 0].sum()
    derivative = numpy.where(derivative > 0, derivative / positive, derivative / negative)
    return numpy.hypot(_convolve(plane, derivative, smooth), _convolve(plane, smooth, derivative))


def _flip(test: _Seen, reference: _Seen) -> float:
    green, blue = (_hunt_lab(numpy.array(c, dtype=float)) for c in ([0, 1, 0], [0, 0, 1]))
    most = _hyab(green, blue) ** _COLOR_EXPONENT
    error = _hyab(test.lab, reference.lab) ** _COLOR_EXPONENT
    knee = _KNEE * most
    color = numpy.where(error < knee, error / knee * _KNEE_ERROR,
                        _KNEE_ERROR + (error - knee) / (most - knee) * (1 - _KNEE_ERROR))
    feature = numpy.maximum(numpy.abs(test.edges - reference.edges),
                            numpy.abs(test.points - reference.points))
    return float((color ** (1 - (feature / numpy.sqrt(2)) ** _FEATURE_EXPONENT)).mean())
