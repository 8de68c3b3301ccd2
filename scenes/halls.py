"""A hall with hundreds of lights: what light selection is tested with."""

import math

import numpy as np

import shapes
import textures
from glb_writer import GlbWriter


def _warmth(t):
    """From candle (t = 0) to daylight (t = 1)."""
    return np.array([1.0, 0.45 + 0.45 * t, 0.12 + 0.80 * t])


def many_lights():
    scene = GlbWriter("many lights")
    stone = scene.material("stone", (0.62, 0.58, 0.52), roughness=0.8)
    vault = scene.material("vault", (0.45, 0.42, 0.40), roughness=0.9)
    tiles = scene.material("tiles", (1, 1, 1), roughness=0.12,
                           color_texture=scene.texture("tiles", textures.checker()))
    bronze = scene.material("bronze", (0.72, 0.48, 0.28), metallic=1.0, roughness=0.35)
    width, height, length = 16.0, 9.0, 44.0
    w = width / 2
    scene.add("floor", shapes.quad((-w, 0, 2), (width, 0, 0), (0, 0, -length), (2, 5.5)), tiles)
    arch = shapes.grid(lambda u, v: (-w * np.cos(np.pi * u), 6.0 + 3.0 * np.sin(np.pi * u),
                                     2 - length * v), 48, 1)
    scene.add("vault", arch, vault)
    scene.add("walls", shapes.merge([
        shapes.quad((-w, 0, 2), (0, 0, -length), (0, 6, 0)),
        shapes.quad((w, 0, 2 - length), (0, 0, length), (0, 6, 0)),
        shapes.quad((-w, 0, 2 - length), (width, 0, 0), (0, height, 0)),
        shapes.quad((w, 0, 2), (-width, 0, 0), (0, height, 0))]), stone)
    column = scene.mesh("column", shapes.lathe(
        [(0, 0), (0.62, 0), (0.62, 0.25), (0.50, 0.35), (0.42, 0.50), (0.36, 5.2), (0.46, 5.4),
         (0.60, 5.6), (0.60, 6.3), (0, 6.3)], segments=48), stone)
    for side in (-1, 1):
        for i in range(8):
            scene.node(f"column {'left' if side < 0 else 'right'} {i}", column,
                       at=(side * 5.0, 0, -1.5 - 5.0 * i))

    # Lanterns: eight colours, one mesh each, many nodes; 6 x 60 = 360 in five sagging rows.
    half = 0.07
    lantern = shapes.lathe([(0, -half * 1.5), (half, 0), (0, half * 1.5)], segments=4,
                           crease_degrees=10)
    meshes = []
    for k in range(8):
        color = _warmth(k / 7)
        glow = scene.material(f"lantern {k}", (0, 0, 0),
                              emission=tuple(round(float(c), 6) for c in color * (9 + 2 * (k % 3))))
        meshes.append(scene.mesh(f"lantern {k}", lantern, glow))
    for row in range(6):
        x = -6.5 + 2.6 * row
        for i in range(60):
            sag = 0.45 * math.cos(2 * math.pi * (i / 10.0))
            y = 4.3 + 0.5 * math.sin(1.3 * row) + sag
            scene.node(f"lantern {row} {i}", meshes[(3 * row + 5 * i) % 8],
                       at=(round(x + 0.12 * math.sin(2.1 * i), 6), round(y, 6), 0.6 - 0.7 * i),
                       turn_y=(37 * i) % 90)
        path = [(x + 0.12 * math.sin(2.1 * i),
                 4.3 + half * 1.5 + 0.5 * math.sin(1.3 * row) + 0.45 * math.cos(2 * math.pi * i / 10),
                 0.6 - 0.7 * i) for i in range(60)]
        scene.add(f"cord {row}", shapes.tube(path, 0.006, 6), bronze)

    # Floor lamps of point lights and spots on the walls.
    for i in range(16):
        side = -1 if i % 2 else 1
        z = -1.5 - 5.0 * (i // 2)
        scene.spot_light(f"wall spot {i}", (side * 7.6, 0.4, z), (side * 7.2, 6.0, z),
                         tuple(_warmth(0.25)), 90.0, 12.0, 35.0)
    for i in range(24):
        angle = 2.39996 * i
        at = (round(3.2 * math.cos(angle), 6), 0.25, round(-4.0 - 1.5 * i, 6))
        scene.point_light(f"floor light {i}", at, tuple(_warmth((i % 5) / 4)), 1.5)
    pot = scene.mesh("pot", shapes.lathe([(0, 0), (0.16, 0), (0.3, 0.3), (0.32, 0.55), (0.28, 0.55),
                                          (0.26, 0.32), (0.12, 0.04), (0, 0.04)]), bronze)
    for i in range(8):
        scene.node(f"pot {i}", pot, at=((-1) ** i * 2.6, 0, -3.5 - 4.4 * i))
    scene.camera("camera", (1.2, 2.1, 1.0), (-0.6, 2.5, -14.0), 55.0)
    return scene
