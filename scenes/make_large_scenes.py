#!/usr/bin/env python3
"""Writes the scenes of measured size: make_large_scenes.py --out DIR [NAME ...]; all without names.

Needs numpy and 4 GB of memory. The default build does not make them.
"""

import sys

sys.dont_write_bytecode = True  # the source folder stays clean

import large
import make_scenes

SCENES = {
    "triangles_10m": large.triangles_10m,
    "hall_100": large.hall(100),
    "hall_10000": large.hall(10_000),
    "hall_100000": large.hall(100_000),
}

if __name__ == "__main__":
    sys.exit(make_scenes.main(__doc__, SCENES))
