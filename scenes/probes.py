"""Scenes that test one thing each: light sampling strategies, thin geometry, energy."""

import math

import numpy as np

import shapes
import textures
from glb_writer import GlbWriter


def veach_mis():
    """After Veach & Guibas 1995, "Optimally combining sampling techniques for Monte Carlo
    rendering", fig. 2: four plates from near-mirror to rough under four lights of equal power
    and growing size."""
    scene = GlbWriter("veach mis")
    gray = scene.material("gray", (0.40, 0.40, 0.40), roughness=1.0)
    eye = np.array([0.0, 2.0, 15.0])
    for i, radius in enumerate((0.035, 0.11, 0.33, 0.95)):
        tint = ((1.0, 0.75, 0.55), (1.0, 0.95, 0.65), (0.65, 1.0, 0.75), (0.6, 0.75, 1.0))[i]
        power = 1.1 / radius**2
        glow = scene.material(f"light {i}", (0, 0, 0),
                              emission=tuple(round(c * power, 6) for c in tint))
        segments = (16, 24, 40, 64)[i]
        scene.add(f"light {i}", shapes.sphere(radius, segments, segments // 2), glow,
                  at=(-3.75 + 2.5 * i, 0, 0))
    # Each plate mirrors the row of lights at the origin into the camera.
    for i, alpha in enumerate((0.006, 0.022, 0.06, 0.12)):
        plate = scene.material(f"plate {i}", (0.62, 0.62, 0.64), metallic=1.0,
                               roughness=round(math.sqrt(alpha), 6))
        centre = np.array([0.0, -2.35 - 0.52 * i, -0.25 + 1.22 * i])
        to_eye, to_light = eye - centre, -centre
        normal = to_eye / np.linalg.norm(to_eye) + to_light / np.linalg.norm(to_light)
        scene.add(f"plate {i}", shapes.panel(centre, centre + normal, 8.0, 1.0), plate)
    scene.add("floor", shapes.quad((-12, -4.6, 12), (24, 0, 0), (0, 0, -14)), gray)
    scene.add("back wall", shapes.quad((-12, -4.6, -2), (24, 0, 0), (0, 14, 0)), gray)
    lamp = scene.material("lamp", (0, 0, 0), emission=(260.0, 260.0, 260.0))
    scene.add("lamp", shapes.sphere(0.5, 24, 12), lamp, at=(9, 10, 5))
    scene.camera("camera", tuple(eye), (0, -1.9, 2.2), 26.0, aspect=1.5)
    return scene


def _chain_link(width, height, pitch):
    """Zigzag wires of a fence in the plane z = 0."""
    wires = []
    for k in range(int(width / pitch)):
        rows = np.arange(int(height / pitch) * 2 + 1)
        side = np.where((rows + k) % 2 == 0, 0.0, 1.0)
        path = np.stack([(k + side) * pitch - width / 2, rows * pitch / 2,
                         0.002 * np.where(rows % 2 == 0, 1, -1)], -1)
        wires.append(path)
    return wires


def wires():
    """A fence, bars and power lines: geometry at and below the width of a pixel."""
    scene = GlbWriter("wires")
    steel = scene.material("steel", (0.60, 0.61, 0.63), metallic=1.0, roughness=0.4)
    black = scene.material("black wire", (0.03, 0.03, 0.03), roughness=0.6)
    timber = scene.material("timber", (0.32, 0.22, 0.14), roughness=0.9)
    ground = scene.material("ground", (1, 1, 1), roughness=0.9, color_texture=scene.texture(
        "ground", textures.checker(256, 8, (0.30, 0.33, 0.25), (0.48, 0.47, 0.40))))
    red = scene.material("red ball", (0.60, 0.06, 0.05), roughness=0.2)
    scene.add("ground", shapes.quad((-40, 0, 10), (80, 0, 0), (0, 0, -90), (10, 11)), ground)

    fence = [shapes.tube(path, 0.0022, 6) for path in _chain_link(5.0, 1.8, 0.08)]
    scene.add("chain link", shapes.merge(fence), steel, at=(-1.6, 0.05, -3.0), turn_y=12)
    posts = [shapes.tube([(x, 0, 0), (x, 1.95, 0)], 0.025, 16) for x in (-2.5, 0.0, 2.5)]
    posts += [shapes.tube([(-2.5, y, 0), (2.5, y, 0)], 0.012, 12) for y in (0.05, 1.87)]
    scene.add("posts", shapes.merge(posts), steel, at=(-1.6, 0, -3.0), turn_y=12)

    bars = [shapes.tube([(0.09 * i, 0, 0), (0.09 * i, 1.5, 0)], 0.0015 + 0.0004 * (i % 6), 6)
            for i in range(40)]
    bars += [shapes.tube([(-0.05, y, 0), (3.6, y, 0)], 0.01, 8) for y in (0.12, 1.45)]
    scene.add("bars", shapes.merge(bars), black, at=(1.25, 0, -3.6), turn_y=-14)

    for i, x in enumerate((-9.0, 1.5, 12.0)):
        scene.add(f"pole {i}", shapes.merge([
            shapes.tube([(x, 0, 0), (x, 7.2, 0)], 0.10, 16),
            shapes.box((x - 0.9, 6.7, -0.05), (x + 0.9, 6.85, 0.05))]), timber, at=(0, 0, -16))
    lines = []
    for start in (-9.0, 1.5):
        for offset in (-0.8, -0.3, 0.3, 0.8):
            t = np.linspace(0, 1, 49)
            sag = 0.9 + 0.1 * offset
            lines.append(shapes.tube(np.stack(
                [start + offset + 10.5 * t, 6.9 - 4 * sag * t * (1 - t), 0 * t], -1), 0.008, 6))
    scene.add("power lines", shapes.merge(lines), black, at=(0, 0, -16))
    scene.add("ball", shapes.sphere(0.55, 64, 32), red, at=(-0.6, 0.55, -5.2))
    scene.camera("camera", (0.2, 1.5, 3.2), (0.0, 1.55, -6.0), 42.0)
    return scene


def furnace():
    """A white diffuse sphere; under a uniform sky of 1 it vanishes if no energy is lost."""
    scene = GlbWriter("furnace")
    white = scene.material("white", (1, 1, 1), roughness=1.0)
    scene.add("sphere", shapes.sphere(1.0, 96, 48), white)
    scene.camera("camera", (0, 0, 5), (0, 0, 0), 30.0, aspect=1)
    return scene


def furnace_closed():
    """Inside a closed sphere that emits 1 and reflects half: radiance 2 everywhere (diffuse)."""
    scene = GlbWriter("closed furnace")
    wall = scene.material("wall", (0.5, 0.5, 0.5), roughness=1.0, emission=(1.0, 1.0, 1.0),
                          double_sided=True)
    scene.add("sphere", shapes.sphere(1.0, 48, 24), wall)
    scene.camera("camera", (0, 0, 0.5), (0, 0, -1), 60.0, aspect=1)
    return scene
