#!/usr/bin/env python3
"""Writes the project's own glTF scenes: make_scenes.py --out DIR [NAME ...]; all without names.

Needs numpy. The bytes depend on nothing but this folder and the versions of numpy and zlib.
"""

import argparse
import os
import sys

sys.dont_write_bytecode = True  # the source folder stays clean

import halls
import probes
import rooms
import still_life

SCENES = {
    "cornell": rooms.cornell,
    "window_room": rooms.window_room,
    "many_lights": halls.many_lights,
    "veach_mis": probes.veach_mis,
    "wires": probes.wires,
    "furnace": probes.furnace,
    "furnace_closed": probes.furnace_closed,
    "still_life": still_life.build,
}


def main(description, scenes):
    """Reads the command line and writes what it names of `scenes`, by name."""
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("--out", required=True, help="folder for the .glb files")
    parser.add_argument("names", nargs="*", help=f"of {', '.join(scenes)}")
    arguments = parser.parse_args()
    unknown = [name for name in arguments.names if name not in scenes]
    if unknown:
        parser.error(f"no scene named {', '.join(unknown)}; there are {', '.join(scenes)}")
    os.makedirs(arguments.out, exist_ok=True)
    for name in arguments.names or scenes:
        path = os.path.join(arguments.out, name + ".glb")
        # Beside, then renamed: whoever reads the file sees all of it.
        with open(path + ".part", "wb") as file:
            file.write(scenes[name]().encode())
        os.replace(path + ".part", path)
        print(path)
    return 0


if __name__ == "__main__":
    sys.exit(main(__doc__, SCENES))
