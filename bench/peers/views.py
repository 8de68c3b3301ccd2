"""The views on which renderers are compared: one camera, one light, for every renderer alike."""

import argparse
import dataclasses
import json
import pathlib
import struct
import sys


@dataclasses.dataclass(frozen=True)
class View:
    """A scene file and how it is looked at. Lengths in metres, glTF's axes, radiance linear."""

    name: str
    file: str
    position: tuple | None = None  # None: the file's first camera
    target: tuple | None = None
    fov_y_degrees: float | None = None
    env: str | None = None  # environment map, beside the file
    sky: float | None = None  # grey radiance from everywhere
    own: bool = False  # one of the project's own scenes


VIEWS = (
    View("kitchen", "apartment.glb", (7, 1.7, -6.8), (10.8, 0.9, -4.2), 65, sky=2),
    View("apartment", "apartment.glb", (7, 12, 4), (6.6, 0, -5.5), 50, sky=1),
    View("bunny", "bunny.glb", (0, 1, 3), (0, 0.5, 0), 45, env="studio_small_05_1k.hdr"),
    View("ingenuity", "ingenuity.glb", (1.2, 0.8, 1.2), (0, 0.3, 0), 45,
         env="leadenhall_market_1k.hdr"),
    View("material-ball", "material-ball.glb", (300, 250, 420), (0, 30, 0), 40,
         env="leadenhall_market_1k.hdr"),
    View("cornell", "cornell.glb", own=True),
    View("window_room", "window_room.glb", sky=3, own=True),
    View("many_lights", "many_lights.glb", own=True),
    View("veach_mis", "veach_mis.glb", own=True),
    View("wires", "wires.glb", sky=1, own=True),
    View("still_life", "still_life.glb", own=True),
)

# White bodies in white light: pictures to look at, without noise to compare.
PROBES = (
    View("furnace", "furnace.glb", sky=1, own=True),
    View("furnace_closed", "furnace_closed.glb", own=True),
)


def add_arguments(parser: argparse.ArgumentParser, size: str) -> None:
    """What every comparison of views is told: --build, --out, --scenes, --views and --size."""
    parser.add_argument("--build", type=pathlib.Path, required=True)
    parser.add_argument("--out", type=pathlib.Path, required=True)
    parser.add_argument("--scenes", type=pathlib.Path, help="folder with apartment.glb, bunny.glb, ...")
    parser.add_argument("--views", help="comma-separated; all without")
    parser.add_argument("--size", default=size)


def chosen(names: str | None, folder: pathlib.Path | None,
           all_views: tuple[View, ...] = VIEWS) -> list[View]:
    """Those of `all_views` that are named, comma-separated; all without names.

    Those of other people's files are left out where `folder` is not given, which is said.
    """
    wanted = names.split(",") if names else [view.name for view in all_views]
    found = []
    for view in all_views:
        if view.name not in wanted:
            continue
        if not view.own and folder is None:
            print(f"{view.name}: left out, --scenes is not given", file=sys.stderr)
            continue
        found.append(view)
    return found


def scene_path(view: View, folder: pathlib.Path, own_folder: pathlib.Path) -> pathlib.Path:
    """The view's file; the copy in `plain/`, which Blender's importer can read, where there is one.

    Errors: FileNotFoundError.
    """
    home = own_folder if view.own else folder
    for path in (home / "plain" / view.file, home / view.file):
        if path.is_file():
            return path
    raise FileNotFoundError(f"{home / view.file}: no such scene")


def is_compressed(path: pathlib.Path) -> bool:
    """Whether a GLB needs mesh compression that Blender 3.4 does not import."""
    data = path.read_bytes()
    length = struct.unpack_from("<I", data, 12)[0]
    document = json.loads(data[20:20 + length])
    return "EXT_meshopt_compression" in document.get("extensionsRequired", [])
