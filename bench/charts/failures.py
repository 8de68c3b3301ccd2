"""Small scenes with one hard thing each, whose severity is a number (docs/stability.md)."""

import math
import pathlib

import shapes
import textures
from glb_writer import GlbWriter


def _room(name: str, lamp_side: float = 0.6, lamp_power: float = 12.0, floor_cells: int = 0,
          wall_cells: int = 0) -> GlbWriter:
    """A box of 4x2.4x4 m, open to the camera, under a square lamp that the camera does not see, for
    its rim would outweigh all else: that has a scene of its own. Power in W per steradian."""
    scene = GlbWriter(name)

    def surface(what, color, cells):
        texture = scene.texture(what, textures.checker(512, cells)) if cells else None
        return scene.material(what, (1, 1, 1) if cells else color, roughness=1.0,
                              color_texture=texture)

    floor = surface("floor", (0.6, 0.55, 0.5), floor_cells)
    wall = surface("wall", (0.7, 0.7, 0.72), wall_cells)
    left = scene.material("left", (0.65, 0.25, 0.2), roughness=1.0)
    scene.add("floor", shapes.quad((-2, 0, 2), (4, 0, 0), (0, 0, -4)), floor)
    scene.add("ceiling", shapes.quad((-2, 2.4, -2), (4, 0, 0), (0, 0, 4)), wall)
    scene.add("back", shapes.quad((-2, 0, -2), (4, 0, 0), (0, 2.4, 0)), wall)
    scene.add("left", shapes.quad((-2, 0, 2), (0, 0, -4), (0, 2.4, 0)), left)
    scene.add("right", shapes.quad((2, 0, -2), (0, 0, 4), (0, 2.4, 0)), wall)
    radiance = lamp_power / lamp_side ** 2
    glow = scene.material("lamp", (0, 0, 0), emission=(radiance, radiance * 0.95, radiance * 0.85))
    half = lamp_side / 2
    scene.add("lamp", shapes.quad((-half, 2.39, 1.6 - half), (lamp_side, 0, 0), (0, 0, lamp_side)), glow)
    scene.camera("camera", (0, 1.2, 4.6), (0, 1.0, 0), 36.0)
    return scene


def _furnish(scene: GlbWriter) -> GlbWriter:
    """A box and a ball to cast shadows."""
    grey = scene.material("grey", (0.55, 0.55, 0.55), roughness=1.0)
    blue = scene.material("blue", (0.2, 0.3, 0.6), roughness=0.4)
    scene.add("box", shapes.box((-0.45, 0, -0.45), (0.45, 1.0, 0.45)), grey, at=(-0.8, 0, -0.5),
              turn_y=20)
    scene.add("ball", shapes.sphere(0.5, 48, 24), blue, at=(0.8, 0.5, 0.2))
    return scene


def plain() -> GlbWriter:
    return _furnish(_room("plain"))


def firefly(strength: float) -> GlbWriter:
    """A polished ball, and a lamp of radiance `strength` and constant power: its caustics are found
    by chance alone, the rarer the brighter."""
    scene = _room("firefly", lamp_side=math.sqrt(12.0 / strength))
    brass = scene.material("brass", (0.9, 0.75, 0.4), metallic=1.0, roughness=0.05)
    scene.add("ball", shapes.sphere(0.6, 64, 32), brass, at=(0, 0.6, 0.2))
    return scene


def rim_of_lamp(radiance: float) -> GlbWriter:
    """A ball that glows in the camera's view, of constant power, and no other light: pixels that it
    covers in part outshine those beside them, the more the smaller and brighter it is."""
    scene = _furnish(_room("rim of a lamp", lamp_side=0.02, lamp_power=1e-6))
    glow = scene.material("bulb", (0, 0, 0), emission=(radiance,) * 3)
    scene.add("bulb", shapes.sphere(math.sqrt(12.0 / (math.pi * radiance)), 64, 32), glow,
              at=(0, 1.6, -1.0))
    return scene


def rare_light(hole: float) -> GlbWriter:
    """The lamp in a black box with a square hole: most rays to the lamp end at the box, so most
    samples are black, the more the smaller the hole; power stays."""
    lamp = 0.6
    scene = _furnish(_room("rare light", lamp_side=lamp, lamp_power=12.0 * (lamp / hole) ** 2))
    black = scene.material("box", (0, 0, 0), roughness=1.0)
    out, inner, low, high, z = lamp / 2 + 0.02, hole / 2, 2.28, 2.395, 1.6
    rim, side = out - inner, high - low
    panels = [shapes.quad((-out, low, z - out), (2 * out, 0, 0), (0, 0, rim)),
              shapes.quad((-out, low, z + inner), (2 * out, 0, 0), (0, 0, rim)),
              shapes.quad((-out, low, z - inner), (rim, 0, 0), (0, 0, hole)),
              shapes.quad((inner, low, z - inner), (rim, 0, 0), (0, 0, hole))]
    for at in (-out, out):
        panels += [shapes.quad((at, low, z - out), (0, 0, 2 * out), (0, side, 0)),
                   shapes.quad((-out, low, z + at), (2 * out, 0, 0), (0, side, 0))]
    scene.add("shade", shapes.merge(panels), black)
    return scene


def caustic(side: float) -> GlbWriter:
    """Light that a polished ring gathers on the floor: the smaller the lamp, the sharper."""
    scene = _room("caustic", lamp_side=side)
    brass = scene.material("brass", (0.9, 0.75, 0.4), metallic=1.0, roughness=0.1)
    ring = shapes.lathe([(0.97, 0.0), (1.0, 0.0), (1.0, 0.35), (0.97, 0.35), (0.97, 0.0)])
    scene.add("ring", ring, brass, at=(0, 0.0, 0.3))
    return scene


def light_size(side: float) -> GlbWriter:
    """From a wide penumbra to a hard shadow."""
    return _furnish(_room("light size", lamp_side=side))


def wire_width(width_px: float) -> GlbWriter:
    """Vertical wires before the wall; widths in pixels of a frame 54 pixels high."""
    scene = _room("wires")
    black = scene.material("wire", (0.03, 0.03, 0.03), roughness=0.8)
    distance = 4.6 - 0.5
    pixel = 2 * distance * math.tan(math.radians(18)) / 54
    for i in range(15):
        x = -1.4 + 0.2 * i
        scene.add(f"wire {i}", shapes.tube([(x, 0, 0.5), (x + 0.05, 2.2, 0.5)],
                                           width_px * pixel / 2, 8), black)
    return scene


def aperture() -> GlbWriter:
    """Checkers behind and before the focus; the lens is a flag of the view."""
    return _furnish(_room("aperture", floor_cells=16, wall_cells=24))


def roughness(value: float) -> GlbWriter:
    """A metal plate that shows checkers, from mirror to matt."""
    scene = _room("roughness", floor_cells=16, wall_cells=24)
    steel = scene.material("steel", (0.85, 0.85, 0.85), metallic=1.0, roughness=value)
    scene.add("plate", shapes.panel((0, 1.0, -1.2), (0, 0.6, 4), 2.6, 1.5), steel)
    return scene


def texture(cells: float) -> GlbWriter:
    """Ever finer checkers on floor and wall."""
    return _furnish(_room("texture", floor_cells=int(cells), wall_cells=int(cells)))


def triangles(count: int) -> GlbWriter:
    """The plain room with a ball of about `count` triangles."""
    scene = _room("triangles")
    grey = scene.material("grey", (0.55, 0.55, 0.55), roughness=1.0)
    around = max(4, round(math.sqrt(count)))
    scene.add("ball", shapes.sphere(0.7, around, max(3, around // 2)), grey, at=(0, 0.7, 0))
    return scene


def lights(count: int) -> GlbWriter:
    """The plain room under `count` small lamps of constant power together."""
    scene = _furnish(_room("lights", lamp_side=0.02, lamp_power=1e-6))
    around = max(1, round(math.sqrt(count)))
    side = min(0.1, 1.5 / around)
    radiance = 12.0 / (count * side * side)
    glow = scene.material("lamps", (0, 0, 0), emission=(radiance,) * 3)
    panels = []
    for i in range(count):
        x, z = (i % around + 0.5) / around * 3.6 - 1.8, (i // around + 0.5) / around * 3.6 - 1.8
        panels.append(shapes.quad((x - side / 2, 2.38, z - side / 2), (side, 0, 0), (0, 0, side)))
    scene.add("lamps", shapes.merge(panels), glow)
    return scene


def write(scene: GlbWriter, path: pathlib.Path) -> pathlib.Path:
    """The file, written anew only if it differs."""
    data = scene.encode()
    if not path.is_file() or path.read_bytes() != data:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)
    return path
