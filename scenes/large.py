"""Scenes of measured size: many triangles, many emitters. Too large for the default build."""

import numpy as np

import shapes
from glb_writer import GlbWriter

_HALL = np.array([16.0, 9.0, 40.0])  # width, height, length in metres
_GLOWING_AREA = 4.0  # square metres of all emitters together, whatever their number


def triangles_10m():
    """Exactly 10^7: hills of 8,000,000 and forty boulders, each its own mesh, of 50,000."""
    scene = GlbWriter("ten million triangles")
    earth = scene.material("earth", (0.46, 0.40, 0.30), roughness=0.9)
    rocks = [scene.material(f"rock {k}", color, roughness=0.6) for k, color in enumerate(
        [(0.55, 0.52, 0.50), (0.42, 0.30, 0.24), (0.30, 0.33, 0.38), (0.62, 0.58, 0.46)])]

    def height(x, z):
        return (1.8 * np.sin(0.21 * x + 0.4) * np.cos(0.17 * z) + 0.35 * np.sin(1.1 * x + 0.6 * z) +
                0.06 * np.sin(5.3 * x) * np.sin(4.7 * z) + 0.012 * np.sin(31 * x + 9 * z))

    def hills(u, v):
        x, z = 60 * (u - 0.5), -60 * v
        return x, height(x, z), z

    scene.add("hills", shapes.grid(hills, 2000, 2000), earth)
    for i in range(40):
        phase = 2.39996 * i
        size = 0.5 + 0.9 * ((i * 0.618034) % 1)

        def boulder(u, v):
            phi, theta = 2 * np.pi * u, np.pi * (0.0005 + 0.999 * (1 - v))
            n = np.stack([np.sin(theta) * np.sin(phi), np.cos(theta), np.sin(theta) * np.cos(phi)])
            bumps = (0.16 * np.sin(3 * n[0] + phase) * np.sin(2.5 * n[1] + 2 * phase) +
                     0.05 * np.sin(9 * n[2] + 5 * n[0] + phase) + 0.01 * np.sin(40 * n[1] + 23 * n[0]))
            return size * (1 + bumps) * n

        x, z = 11 * np.cos(phase) * ((i % 7 + 2) / 8), -6.0 - 1.1 * i
        scene.add(f"boulder {i}", shapes.grid(boulder, 250, 100), rocks[i % 4],
                  at=(float(x), float(height(x, z)) + 0.3 * size, z))
    scene.camera("camera", (0, 5.0, 2.0), (0, -0.6, -18.0), 50.0)
    return scene


def _emitters(number):
    """`number` quads below the ceiling, turned every way, as positions [number * 4, 3]."""
    i = np.arange(number)[:, None] + 0.5
    # Evenly spread by the generalised golden ratio (Roberts 2018), three axes and two of the turn.
    root = 1.1347241384015194  # of x^6 = x + 1
    u = (i * root ** -np.arange(1, 6)) % 1
    centres = np.stack([_HALL[0] * (0.94 * u[:, 0] - 0.47), 5.2 + 3.6 * u[:, 1],
                        -_HALL[2] * (0.02 + 0.96 * u[:, 2])], axis=1)
    y, phi = 2 * u[:, 3] - 1, 2 * np.pi * u[:, 4]
    r = np.sqrt(1 - y * y)
    front = np.stack([r * np.cos(phi), y, r * np.sin(phi)], axis=1)
    side = np.stack([-np.sin(phi), np.zeros(number), np.cos(phi)], axis=1)
    up = np.cross(front, side)
    # Areas differ by up to 16; together they are what they are in every hall.
    weights = 4.0 ** (2 * ((np.arange(number) * 0.7548776662) % 1))
    half = 0.5 * np.sqrt(_GLOWING_AREA * weights / weights.sum())[:, None]
    a, b = side * half, up * half
    return np.stack([centres - a - b, centres - a + b, centres + a + b, centres + a - b], axis=1)


def hall(number):
    """A hall lit by `number` emissive quads above the picture: 100, 10,000 or 100,000.

    Area, radiance and spread are the same for each number, and so the power; what is seen is lit
    by the quads and shows none of them, so that only the choice among them differs.
    """
    def build():
        scene = GlbWriter(f"hall of {number} emitters")
        stone = scene.material("stone", (0.62, 0.58, 0.52), roughness=0.8)
        floor = scene.material("floor", (0.45, 0.42, 0.40), roughness=0.4)
        bronze = scene.material("bronze", (0.72, 0.48, 0.28), metallic=1.0, roughness=0.35)
        w, h, d = _HALL
        scene.add("floor", shapes.quad((-w / 2, 0, 0), (w, 0, 0), (0, 0, -d)), floor)
        scene.add("walls", shapes.merge([
            shapes.quad((-w / 2, h, 0), (0, 0, -d), (w, 0, 0)),
            shapes.quad((-w / 2, 0, 0), (0, 0, -d), (0, h, 0)),
            shapes.quad((w / 2, 0, -d), (0, 0, d), (0, h, 0)),
            shapes.quad((-w / 2, 0, -d), (w, 0, 0), (0, h, 0)),
            shapes.quad((w / 2, 0, 0), (-w, 0, 0), (0, h, 0))]), stone)
        column = scene.mesh("column", shapes.lathe(
            [(0, 0), (0.62, 0), (0.62, 0.25), (0.42, 0.5), (0.36, 4.0), (0.6, 4.2), (0, 4.2)],
            segments=48), stone)
        ball = scene.mesh("ball", shapes.sphere(0.7), bronze)
        for side in (-1, 1):
            for i in range(7):
                scene.node(f"column {side} {i}", column, at=(side * 4.6, 0, -4.0 - 5.0 * i))
                scene.node(f"ball {side} {i}", ball, at=(side * 1.9, 0.7, -6.0 - 5.0 * i))
        corners = _emitters(number)
        for k in range(8):  # eight colours
            warmth = k / 7
            glow = scene.material(f"glow {k}", (0, 0, 0),
                                  emission=(180.0, 90 + 80 * warmth, 40 + 120 * warmth))
            quads = corners[k::8]
            first = 4 * np.arange(len(quads))[:, None, None]
            triangles = (first + np.array([(0, 1, 2), (0, 2, 3)])).reshape(-1, 3)
            scene.add(f"emitters {k}", shapes.Shape(quads.reshape(-1, 3), None, None, triangles),
                      glow)
        scene.camera("camera", (0.6, 4.6, -1.0), (-0.4, 0.0, -11.0), 38.0)
        return scene
    return build
