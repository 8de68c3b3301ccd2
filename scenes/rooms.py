"""Interiors: the Cornell box, and a living room lit by nothing but the sky in its windows."""

import numpy as np

import shapes
import textures
from glb_writer import GlbWriter


def _cuboid_on_floor(width, height, depth):
    return shapes.box((-width / 2, 0, -depth / 2), (width / 2, height, depth / 2))


def cornell():
    """After Goral et al. 1984 and the box at Cornell: 5.5 m, red left, green right."""
    scene = GlbWriter("cornell")
    white = scene.material("white", (0.73, 0.71, 0.68), roughness=1.0)
    red = scene.material("red", (0.63, 0.06, 0.05), roughness=1.0)
    green = scene.material("green", (0.12, 0.45, 0.09), roughness=1.0)
    light = scene.material("light", (0, 0, 0), emission=(18.0, 13.0, 6.5))
    s, x0, x1, z0, z1 = 5.5, 2.1, 3.4, -3.3, -2.2  # the room, and the light in its ceiling
    scene.add("floor", shapes.quad((0, 0, 0), (s, 0, 0), (0, 0, -s)), white)
    scene.add("ceiling", shapes.merge([
        shapes.quad((xa, s, za), (xb - xa, 0, 0), (0, 0, zb - za))
        for xa, xb, za, zb in ((0, s, -s, z0), (0, s, z1, 0), (0, x0, z0, z1), (x1, s, z0, z1))]),
              white)
    scene.add("back wall", shapes.quad((0, 0, -s), (s, 0, 0), (0, s, 0)), white)
    scene.add("left wall", shapes.quad((0, 0, 0), (0, 0, -s), (0, s, 0)), red)
    scene.add("right wall", shapes.quad((s, 0, -s), (0, 0, s), (0, s, 0)), green)
    scene.add("light", shapes.quad((x0, s, z0), (x1 - x0, 0, 0), (0, 0, z1 - z0)), light)
    scene.add("short block", _cuboid_on_floor(1.65, 1.65, 1.65), white, at=(3.7, 0, -1.7),
              turn_y=-17)
    scene.add("tall block", _cuboid_on_floor(1.65, 3.3, 1.65), white, at=(1.85, 0, -3.5), turn_y=17)
    scene.camera("camera", (2.75, 2.75, 7.95), (2.75, 2.75, 0), 38.0, aspect=1)
    return scene


def _wall_with_windows(x, thickness, z_range, height, windows):
    """A wall in the plane of x whose windows are (z0, z1, y0, y1), ascending in z."""
    boxes, z = [], z_range[0]
    for z0, z1, y0, y1 in windows:
        boxes += [((z, z0), (0, height)), ((z0, z1), (0, y0)), ((z0, z1), (y1, height))]
        z = z1
    boxes.append(((z, z_range[1]), (0, height)))
    return shapes.merge([shapes.box((x - thickness, y[0], z[0]), (x, y[1], z[1]))
                         for z, y in boxes])


def _window_frame(x, window):
    z0, z1, y0, y1 = window
    bar, zm, ym = 0.03, (window[0] + window[1]) / 2, (window[2] + window[3]) / 2 + 0.15
    spans = [((z0, z1), (y0, y0 + 2 * bar)), ((z0, z1), (y1 - 2 * bar, y1)),
             ((z0, z0 + 2 * bar), (y0, y1)), ((z1 - 2 * bar, z1), (y0, y1)),
             ((zm - bar, zm + bar), (y0, y1)), ((z0, z1), (ym - bar, ym + bar))]
    return shapes.merge([shapes.box((x - 0.05, y[0], z[0]), (x, y[1], z[1])) for z, y in spans])


def _furnish(scene):
    oak = scene.material("oak", (0.40, 0.26, 0.15), roughness=0.45)
    fabric = scene.material("fabric", (0.20, 0.27, 0.30), roughness=0.95)
    cushion = scene.material("cushion", (0.72, 0.46, 0.15), roughness=0.95)
    porcelain = scene.material("porcelain", (0.85, 0.84, 0.80), roughness=0.12)
    leaf = scene.material("leaf", (0.10, 0.26, 0.07), roughness=0.5, double_sided=True)
    brass = scene.material("brass", (0.86, 0.62, 0.28), metallic=1.0, roughness=0.25)
    rug = scene.material("rug", (1, 1, 1), roughness=1.0,
                         color_texture=scene.texture("rug", textures.rug()))
    scene.add("rug", shapes.quad((-1.1, 0.012, 0.9), (2.4, 0, 0), (0, 0, -2.0)), rug)

    sofa = [((1.05, 0.12, -1.3), (0.9, 0.32, 2.2)), ((1.75, 0.12, -1.3), (0.25, 0.75, 2.2)),
            ((1.05, 0.12, -1.5), (0.95, 0.52, 0.22)), ((1.05, 0.12, 0.88), (0.95, 0.52, 0.22))]
    parts = [shapes.move(shapes.rounded_box(size, 0.05), np.add(low, np.divide(size, 2)))
             for low, size in sofa]
    scene.add("sofa", shapes.merge(parts), fabric)
    pillow = scene.mesh("pillow", shapes.rounded_box((0.14, 0.42, 0.42), 0.068), cushion)
    scene.node("pillow 0", pillow, at=(1.66, 0.64, -1.0), rotation=(0, 0, -0.17, 0.985))
    scene.node("pillow 1", pillow, at=(1.66, 0.64, 0.55), rotation=(0.05, 0.1, -0.2, 0.973))

    top = shapes.move(shapes.lathe([(0, 0), (0.42, 0), (0.45, 0.01), (0.45, 0.03), (0.43, 0.04),
                                    (0, 0.04)]), (0, 0.38, 0))
    legs = [shapes.tube([(0.30 * np.cos(a), 0.39, 0.30 * np.sin(a)),
                         (0.36 * np.cos(a), 0.0, 0.36 * np.sin(a))], 0.018, 12)
            for a in (0.5, 0.5 + 2.0944, 0.5 + 4.18879)]
    scene.add("table", shapes.merge([top] + legs), oak, at=(0.15, 0, -0.15))
    vase = [(0, 0), (0.05, 0), (0.05, 0), (0.085, 0.08), (0.075, 0.16), (0.035, 0.22), (0.045, 0.26),
            (0.041, 0.26), (0.031, 0.22), (0.071, 0.16), (0.080, 0.08), (0.045, 0.006), (0, 0.006)]
    scene.add("vase", shapes.lathe(vase, steps=5), porcelain, at=(0.05, 0.42, -0.2))
    blade = shapes.grid(lambda u, v: ((u - 0.5) * 0.09 * np.sin(np.pi * np.sqrt(0.01 + 0.97 * v)), 0.42 * v,
                                      0.25 * v * v + 0.02 * np.cos(2 * np.pi * u) * v), 6, 16)
    blade = scene.mesh("leaf", blade, leaf)
    for i in range(11):
        scene.node(f"leaf {i}", blade, at=(0.05, 0.60, -0.2), turn_y=round(i * 137.5 % 360, 6),
                   scale=round(0.8 + 0.35 * np.sin(1.7 * i) ** 2, 6))
    scene.add("lamp foot", shapes.lathe([(0, 0), (0.15, 0), (0.15, 0.015), (0.016, 0.03),
                                         (0.012, 1.45), (0, 1.45)]), brass, at=(1.5, 0, -2.15))
    shade = shapes.lathe([(0.22, 1.32), (0.14, 1.66), (0.135, 1.66), (0.215, 1.32)])
    scene.add("lamp shade", shade, porcelain, at=(1.5, 0, -2.15))
    for i, (x, w, h, color) in enumerate(((-0.75, 0.7, 0.9, (0.55, 0.35, 0.2)),
                                          (0.25, 0.9, 0.65, (0.2, 0.3, 0.42)))):
        frame = shapes.box((x - w / 2, 1.55 - h / 2, -2.98), (x + w / 2, 1.55 + h / 2, -2.94))
        scene.add(f"picture frame {i}", frame, oak)
        canvas = shapes.quad((x - w / 2 + 0.05, 1.6 - h / 2, -2.935), (w - 0.1, 0, 0),
                             (0, h - 0.1, 0))
        picture = textures.plaster(128, np.multiply(color, 0.5), np.multiply(color, 1.6), seed=40 + i)
        scene.add(f"picture {i}", canvas, scene.material(
            f"canvas {i}", (1, 1, 1), roughness=0.8,
            color_texture=scene.texture(f"canvas {i}", picture)))


def window_room():
    scene = GlbWriter("window room")
    plaster = scene.material("plaster", (0.80, 0.77, 0.71), roughness=1.0)
    paint = scene.material("paint", (0.86, 0.86, 0.84), roughness=0.4)
    wood, wood_roughness = textures.wood(512, seed=3)
    floor = scene.material("floor", (1, 1, 1), roughness=1.0,
                           color_texture=scene.texture("floor", wood),
                           roughness_texture=scene.texture("floor roughness", wood_roughness))
    x, y, z, t = 2.4, 2.7, 3.0, 0.25
    scene.add("floor", shapes.quad((-x, 0, z), (2 * x, 0, 0), (0, 0, -2 * z), (4, 6)), floor)
    solids = [((-x - t, y, -z - t), (x + t, y + t, z + t)), ((-x - t, -t, -z - t), (x + t, y, -z)),
              ((-x - t, -t, z), (x + t, y, z + t)), ((x, -t, -z), (x + t, y, z)),
              ((-x - t, -t, -z), (x + t, -0.01, z))]
    scene.add("walls", shapes.merge([shapes.box(*s) for s in solids]), plaster)
    windows = [(-2.6, -0.5, 0.45, 2.4), (0.0, 2.1, 0.45, 2.4)]
    scene.add("window wall", _wall_with_windows(-x, t, (-z, z), y, windows), plaster)
    for i, window in enumerate(windows):
        scene.add(f"window {i}", _window_frame(-x - 0.1, window), paint)
        z0, z1, y0, _ = window
        scene.add(f"sill {i}", shapes.box((-x - 0.1, y0 - 0.04, z0 - 0.06),
                                          (-x + 0.10, y0, z1 + 0.06)), paint)
    _furnish(scene)
    scene.camera("camera", (-1.35, 1.45, 2.75), (0.45, 0.82, -1.2), 52.0)
    return scene
