#!/usr/bin/python3
"""Pictures of the views beside those of Blender's Cycles, as docs/images/beside_cycles/ shows them.

    bench/pictures_beside_peers.py --build build/release --scenes FOLDER --work WORK --out PICTURES
        [--cycles FOLDER] [--views kitchen,bunny,...] [--size 480x270] [--spp 512] [--threads 2]

For each view one JPEG: ours without a filter | Cycles | ours over Cycles, from blue (half) over white
(equal) to red (twice), both averaged over 3x3 pixels and given 1 % of the picture's mean first. Prints
a table: brightness over Cycles', and the middle half of the pixels' ratios. Renders lie in WORK and
are used again. --cycles: a folder with cycles-VIEW.exr of the same size, taken instead of rendering.
Needs python3-numpy, python3-openimageio and blender (Debian packages).
"""

import argparse
import pathlib
import sys

sys.dont_write_bytecode = True  # the source folder stays clean

import numpy
import OpenImageIO as oiio

from peers import accuracy, renderers, views

SEED = 7
PANEL_WIDTH = 320
JPEG_QUALITY = 88
WHITE_PERCENTILE = 98  # of Cycles' luminance: what becomes 0.9 in the picture, for both renderers
LUMINANCE = numpy.array([0.2126, 0.7152, 0.0722])


def parse_arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    views.add_arguments(parser, size="480x270")
    parser.add_argument("--work", type=pathlib.Path, required=True)
    parser.add_argument("--cycles", type=pathlib.Path)
    parser.add_argument("--spp", type=int, default=512)
    parser.add_argument("--max-depth", type=int, default=8)
    parser.add_argument("--threads", type=int, default=2)
    return parser.parse_args()


def box_blur(picture: numpy.ndarray) -> numpy.ndarray:
    """Mean of 3x3 pixels, the border repeated."""
    padded = numpy.pad(picture, ((1, 1), (1, 1), (0, 0)), mode="edge")
    height, width = picture.shape[:2]
    return sum(padded[y:y + height, x:x + width] for y in range(3) for x in range(3)) / 9


def ratio_of(ours: numpy.ndarray, theirs: numpy.ndarray) -> numpy.ndarray:
    """By pixel: luminance of ours over theirs."""
    floor = 0.01 * float((theirs @ LUMINANCE).mean())
    a, b = ((box_blur(p) @ LUMINANCE) + floor for p in (ours, theirs))
    return a / b


def ratio_colours(ratio: numpy.ndarray) -> numpy.ndarray:
    """Blue at 1/2 and below, white at 1, red at 2 and above; display values."""
    stops = numpy.clip(numpy.log2(ratio), -1, 1)[:, :, None]
    blue, white, red = (numpy.array(c) for c in ((0.1, 0.3, 0.8), (1, 1, 1), (0.85, 0.15, 0.1)))
    return numpy.where(stops < 0, white + (white - blue) * stops, white + (red - white) * stops)


def display(picture: numpy.ndarray, white: float) -> numpy.ndarray:
    """sRGB of the picture with `white` at 0.9."""
    linear = numpy.clip(picture * (0.9 / white), 0, 1)
    return numpy.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)


def resized(picture: numpy.ndarray, width: int) -> numpy.ndarray:
    height = round(picture.shape[0] * width / picture.shape[1])
    buffer = oiio.ImageBuf(numpy.ascontiguousarray(picture, dtype=numpy.float32))
    small = oiio.ImageBufAlgo.resize(buffer, roi=oiio.ROI(0, width, 0, height, 0, 1, 0, 3))
    return small.get_pixels(oiio.FLOAT)


def write_jpeg(path: pathlib.Path, picture: numpy.ndarray) -> None:
    buffer = oiio.ImageBuf(numpy.ascontiguousarray(picture, dtype=numpy.float32))
    buffer.specmod().attribute("Compression", f"jpeg:{JPEG_QUALITY}")
    if not buffer.write(str(path), oiio.UINT8):
        raise RuntimeError(f"{path}: {buffer.geterror()}")


def rendered(renderer, view, scene, args) -> numpy.ndarray:
    """The view by one renderer, from WORK where it is there already."""
    width, height = map(int, args.size.split("x"))
    out = args.work / f"{view.name}_{renderer.name}_{args.size}_{args.spp}.exr"
    if not out.is_file():
        frame = renderers.Frame(width, height, args.max_depth, args.threads)
        renderer.render(view, scene, frame, args.spp, SEED, out)
    return accuracy.read_rgb(out)


def pair_of(view, args) -> tuple:
    """Ours and Cycles'; None for what cannot be made here."""
    scene = views.scene_path(view, args.scenes, args.build / "scenes")
    given = args.cycles / f"cycles-{view.name}.exr" if args.cycles else None
    if given and given.is_file():
        theirs = accuracy.read_rgb(given)
    elif renderers.Cycles.available() and not views.is_compressed(scene):
        theirs = rendered(renderers.Cycles(), view, scene, args)
    else:
        return None, None
    ours = rendered(renderers.Tessera(args.build / "bin" / "tessera"), view, scene, args)
    if ours.shape != theirs.shape:
        raise RuntimeError(f"{view.name}: Cycles' picture is of another size than {args.size}")
    return ours, theirs


def main() -> int:
    args = parse_arguments()
    for folder in (args.work, args.out):
        folder.mkdir(parents=True, exist_ok=True)
    print("| view | brightness over Cycles' | R | G | B | ratio of pixels, quartiles |")
    print("|---|---|---|---|---|---|", flush=True)
    for view in views.chosen(args.views, args.scenes, views.VIEWS + views.PROBES):
        ours, theirs = pair_of(view, args)
        if ours is None:
            print(f"{view.name}: left out, no picture by Cycles", file=sys.stderr)
            continue
        ratio = ratio_of(ours, theirs)
        white = max(1e-6, float(numpy.percentile(theirs @ LUMINANCE, WHITE_PERCENTILE)))
        panels = [display(ours, white), display(theirs, white), ratio_colours(ratio)]
        write_jpeg(args.out / f"{view.name}.jpg",
                   numpy.concatenate([resized(p, PANEL_WIDTH) for p in panels], axis=1))
        bands = " | ".join(f"{ours[:, :, c].mean() / theirs[:, :, c].mean():.3f}" for c in range(3))
        low, high = numpy.percentile(ratio, (25, 75))
        print(f"| {view.name} | {ours.mean() / theirs.mean():.3f} | {bands} "
              f"| {low:.3f} to {high:.3f} |", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
