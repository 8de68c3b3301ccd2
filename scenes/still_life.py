"""The showcase: fruit, glass, brass and books on a wooden table, a warm key light, a cool fill."""

import math

import numpy as np

import shapes
import textures
from glb_writer import GlbWriter


def _materials(scene):
    wood, wood_roughness = (scene.texture(n, p) for n, p in zip(
        ("wood", "wood roughness"), textures.wood()))
    orange, pores = textures.skin((0.90, 0.42, 0.06), (0.96, 0.55, 0.12))
    apple, _ = textures.skin((0.58, 0.07, 0.05), (0.72, 0.55, 0.18), seed=21)
    pores = scene.texture("orange pores", pores)
    wine_green = (0.30, 0.62, 0.36)
    make = scene.material
    return {
        "table": make("table", (1, 1, 1), roughness=1.0, color_texture=wood,
                      roughness_texture=wood_roughness),
        "wall": make("wall", (1, 1, 1), roughness=0.95,
                     color_texture=scene.texture("plaster", textures.plaster(
                         low=(0.40, 0.46, 0.47), high=(0.60, 0.64, 0.62)))),
        "cloth": make("cloth", (1, 1, 1), roughness=0.9, double_sided=True,
                      color_texture=scene.texture("gingham", textures.gingham())),
        "orange": make("orange", (1, 1, 1), roughness=0.42, normal_texture=pores,
                       color_texture=scene.texture("orange skin", orange)),
        "apple": make("apple", (1, 1, 1), roughness=0.22,
                      color_texture=scene.texture("apple skin", apple)),
        "lemon": make("lemon", (0.86, 0.66, 0.10), roughness=0.38, normal_texture=pores,
                      normal_scale=0.8),
        "grape": make("grape", (0.13, 0.035, 0.12), roughness=0.24),
        "stem": make("stem", (0.16, 0.10, 0.045), roughness=0.8),
        "glaze": make("glaze", (0.035, 0.15, 0.20), roughness=0.10),
        "brass": make("brass", (0.86, 0.62, 0.28), metallic=1.0, roughness=0.22),
        "copper": make("copper", (0.93, 0.52, 0.37), metallic=1.0, roughness=0.36),
        "steel": make("steel", (0.75, 0.75, 0.76), metallic=1.0, roughness=0.08),
        "glass": make("glass", (1, 1, 1), roughness=0.0, transmission=1.0, ior=1.5,
                      thickness=0.01),
        "bottle": make("bottle glass", (1, 1, 1), roughness=0.0, transmission=1.0, ior=1.52,
                       thickness=0.01, attenuation=(wine_green, 0.008)),
        "wax": make("wax", (0.88, 0.82, 0.68), roughness=0.5),
        "wick": make("wick", (0.02, 0.02, 0.02), roughness=1.0),
        "paper": make("paper", (0.85, 0.80, 0.68), roughness=0.9),
        "flame": make("flame", (0, 0, 0), emission=(10.0, 4.6, 1.2)),
        "key": make("key light", (0, 0, 0), emission=(52.0, 41.0, 27.5)),
        "fill": make("fill light", (0, 0, 0), emission=(1.35, 1.65, 2.2)),
    }


def _stage(scene, m):
    scene.add("table", _table_top(), m["table"])
    wall = shapes.grid(lambda u, v: (3.2 * (u - 0.5), 1.9 * v - 0.55, -0.62 + 0 * u), 1, 1)
    scene.add("wall", wall, m["wall"])
    scene.add("key light", shapes.panel((-1.35, 1.25, 0.75), (0, 0.05, 0), 0.62, 0.62), m["key"])
    scene.add("fill light", shapes.panel((1.25, 1.55, 0.9), (0, 0.1, 0), 1.7, 1.5), m["fill"])
    scene.camera("camera", (0.10, 0.42, 1.30), (0.022, 0.100, 0.0), 25.0)


def _table_top():
    top = shapes.move(shapes.rounded_box((2.2, 0.05, 1.06), 0.009), (0, -0.025, -0.09))
    # Planks run along x and are 12 cm wide.
    p = top.positions
    return top._replace(uvs=np.round(np.stack([p[:, 0] / 0.9, (p[:, 2] - p[:, 1]) / 0.6], -1), 6))


def _cloth(scene, m):
    """A napkin, turned a little, that hangs over the front edge of the table."""
    edge, side, radius = 0.425, 0.40, 0.016

    def surface(u, v):
        x, s = (u - 0.5) * side, (1 - v) * 0.52  # s runs forward along the cloth
        s0 = edge - 0.105  # the length that lies on the table
        bend = np.clip((s - s0) / radius, 0, np.pi / 2)
        hang = np.maximum(s - s0 - radius * np.pi / 2, 0)
        z = 0.105 + np.minimum(s, s0) + radius * np.sin(bend)
        y = -radius * (1 - np.cos(bend)) - hang
        fold = 0.5 + 0.5 * np.sin(2 * np.pi * (2.6 * u + 0.35 * np.sin(5 * s)))
        lift = 0.0035 + 0.006 * fold * (0.4 + 0.6 * np.sin(np.pi * np.clip(s / s0, 0, 1)))
        wave = hang / 0.2 * 0.022 * np.sin(2 * np.pi * (2.6 * u + 0.1))
        return (x + 0.09 * (s - 0.2) * (u - 0.5), y + lift * np.cos(bend),
                z + lift * np.sin(bend) + wave)

    cloth = shapes.grid(surface, 96, 120)
    cloth = cloth._replace(uvs=np.round(cloth.uvs * (5, 6.5), 6))
    scene.add("cloth", cloth, m["cloth"], at=(0.045, 0, 0), turn_y=0)


def _bowl(scene, m, at):
    outer = [(0, 0.0), (0.045, 0.0), (0.045, 0.0), (0.050, 0.006), (0.048, 0.012), (0.085, 0.030),
             (0.120, 0.062), (0.132, 0.088), (0.134, 0.092), (0.131, 0.093), (0.127, 0.088),
             (0.112, 0.060), (0.080, 0.036), (0.040, 0.022), (0.0, 0.020)]
    scene.add("bowl", shapes.lathe(outer, steps=6), m["glaze"], at=at)
    orange = scene.mesh("orange", shapes.sphere(0.042, 64, 40), m["orange"])
    for i, (x, y, z, turn) in enumerate(((-0.052, 0.078, -0.018, 20), (0.036, 0.076, -0.050, 140),
                                         (-0.004, 0.128, -0.020, 250))):
        tilt = math.radians(turn) / 2
        scene.node(f"orange {i}", orange, at=np.add(at, (x, y, z)),
                   rotation=(math.sin(tilt) * 0.8, 0, math.sin(tilt) * 0.6, math.cos(tilt)))
    _apple(scene, m, np.add(at, (0.052, 0.082, 0.030)), 0.037, (0.25, 0, -0.2))


def _apple(scene, m, at, radius, lean):
    profile = [(0.0, -0.78), (0.18, -0.84), (0.42, -0.86), (0.74, -0.62), (0.96, -0.1), (0.99, 0.25),
               (0.86, 0.62), (0.55, 0.83), (0.28, 0.78), (0.10, 0.62), (0.0, 0.55)]
    shape = shapes.lathe(np.array(profile) * radius, segments=72, steps=6, crease_degrees=70)
    half = math.hypot(*lean) / 2
    norm = math.hypot(*lean) or 1
    rotation = (*(math.sin(half) * c / norm for c in (lean[0], 0.0, lean[2])), math.cos(half))
    scene.add("apple", shape, m["apple"], at=at, rotation=rotation)
    path = [(0, 0.55, 0), (0.02, 0.85, 0), (0.10, 1.12, 0.03), (0.20, 1.30, 0.05)]
    scene.add("apple stem", shapes.tube(np.array(path) * radius, radius * 0.045, 10), m["stem"],
              at=at, rotation=rotation)


def _grapes(scene, m, at):
    """Berries packed in layers, the cluster tapering towards +x."""
    berry = scene.mesh("grape", shapes.sphere(0.0115, 40, 24), m["grape"])
    step, index = 0.0205, 0
    for layer in range(3):
        for row in range(7 - layer):
            half_width = (2.3 - 0.32 * row) * (1 - 0.22 * layer)
            for column in range(-3, 4):
                z = (column + 0.5 * ((row + layer) % 2)) * step
                if abs(z) > half_width * step:
                    continue
                wobble = 0.0022 * np.array([math.sin(7.1 * index), 0, math.cos(4.3 * index)])
                x = (row + 0.5 * layer) * step * 0.92
                y = 0.0115 + layer * 0.0158
                scale = 1.0 + 0.07 * math.sin(2.7 * index)
                scene.node(f"grape {index}", berry, at=np.add(at, (x, y, z)) + wobble,
                           scale=round(scale, 6))
                index += 1
    path = [(-0.052, 0.058, 0.004), (-0.03, 0.050, 0.0), (0.0, 0.044, 0.0), (0.05, 0.040, 0.004)]
    scene.add("grape stem", shapes.tube(np.add(path, at), 0.0019, 10), m["stem"])


def _bottle(scene, m, at):
    outer = [(0, 0.012), (0.012, 0.010), (0.034, 0.0), (0.0375, 0.004), (0.038, 0.02), (0.038, 0.165),
             (0.034, 0.190), (0.018, 0.222), (0.0145, 0.245), (0.014, 0.286), (0.014, 0.286),
             (0.0158, 0.287), (0.0158, 0.297), (0.0145, 0.299)]
    inner = [(0.0112, 0.299), (0.0105, 0.290), (0.0105, 0.245), (0.0145, 0.221), (0.0300, 0.189),
             (0.0345, 0.164), (0.0345, 0.02), (0.0320, 0.010), (0.012, 0.0145), (0, 0.017)]
    scene.add("bottle", shapes.lathe(outer + inner, steps=5), m["bottle"], at=at)


def _goblet(scene, m, at):
    outer = [(0, 0.0), (0.033, 0.0), (0.0345, 0.0012), (0.033, 0.0025), (0.012, 0.007),
             (0.0042, 0.018), (0.0038, 0.05), (0.0055, 0.066), (0.020, 0.078), (0.0335, 0.100),
             (0.0360, 0.125), (0.0325, 0.158), (0.0318, 0.1592)]
    inner = [(0.0308, 0.158), (0.0342, 0.125), (0.0318, 0.101), (0.0185, 0.081), (0.006, 0.0745),
             (0, 0.0735)]
    scene.add("goblet", shapes.lathe(outer + inner, steps=6), m["glass"], at=at)


def _candlestick(scene, m, at):
    profile = [(0, 0), (0.052, 0), (0.052, 0), (0.053, 0.005), (0.048, 0.011), (0.028, 0.017),
               (0.014, 0.028), (0.010, 0.045), (0.0165, 0.058), (0.0165, 0.063), (0.009, 0.074),
               (0.0075, 0.110), (0.0105, 0.128), (0.020, 0.138), (0.0205, 0.143), (0.012, 0.149),
               (0.0125, 0.170), (0.0160, 0.174), (0.0160, 0.178), (0.0115, 0.178), (0.0, 0.176)]
    scene.add("candlestick", shapes.lathe(profile, steps=5, crease_degrees=50), m["brass"], at=at)
    candle = [(0, 0), (0.0105, 0), (0.0105, 0), (0.0102, 0.100), (0.0098, 0.104), (0.0075, 0.1055),
              (0.004, 0.1035), (0, 0.103)]
    base = np.add(at, (0, 0.172, 0))
    scene.add("candle", shapes.lathe(candle, segments=64, steps=4), m["wax"], at=base)
    wick = [(0, 0.102, 0), (0.0004, 0.107, 0), (0.0014, 0.1115, 0.0004)]
    scene.add("wick", shapes.tube(wick, 0.0007, 8), m["wick"], at=base)
    flame = [(0, 0.108), (0.0030, 0.1105), (0.0046, 0.116), (0.0040, 0.124), (0.0018, 0.133),
             (0, 0.139)]
    scene.add("flame", shapes.lathe(flame, segments=24, steps=3), m["flame"], at=base)


def _books(scene, m, at):
    covers = (((0.13, 0.20, 0.33), (0.80, 0.66, 0.34), (0.215, 0.034, 0.150), 8),
              ((0.42, 0.10, 0.09), (0.85, 0.75, 0.50), (0.190, 0.028, 0.135), -7))
    height = 0.0
    for i, (ground, ink, (width, thick, depth), turn) in enumerate(covers):
        cover = scene.material(
            f"cover {i}", (1, 1, 1), roughness=0.6,
            color_texture=scene.texture(f"cover {i}", textures.book_cover(ground, ink)))
        boards = []
        for y in (0.0015, thick - 0.0015):
            board = shapes.move(shapes.rounded_box((width, 0.003, depth), 0.0012, 3), (0, y, 0))
            p = board.positions
            boards.append(board._replace(uvs=np.round(
                np.stack([p[:, 0] / width + 0.5, p[:, 2] / depth + 0.5], -1), 6)))
        spine = shapes.move(shapes.rounded_box((0.004, thick, depth), 0.0015, 3),
                            (-width / 2 + 0.002, thick / 2, 0))
        boards.append(spine._replace(uvs=np.full_like(spine.uvs, 0.02)))
        place = {"at": np.add(at, (0, height, 0)), "turn_y": turn}
        scene.add(f"book {i}", shapes.merge(boards), cover, **place)
        pages = shapes.box((-width / 2 + 0.004, 0.003, -depth / 2 + 0.004),
                           (width / 2 - 0.004, thick - 0.003, depth / 2 - 0.004))
        scene.add(f"pages {i}", pages, m["paper"], **place)
        height += thick
    return height


def _pitcher(scene, m, at):
    profile = [(0, 0), (0.040, 0), (0.040, 0), (0.043, 0.004), (0.056, 0.040), (0.0585, 0.070),
               (0.047, 0.110), (0.033, 0.135), (0.0315, 0.150), (0.037, 0.172), (0.041, 0.182),
               (0.0395, 0.1828), (0.0355, 0.172), (0.0298, 0.150), (0.0312, 0.135), (0.045, 0.109),
               (0.0565, 0.070), (0.054, 0.041), (0.040, 0.006), (0, 0.005)]
    scene.add("pitcher", shapes.lathe(profile, steps=6), m["copper"], at=at)
    t = np.linspace(0, 1, 40)
    angle = np.pi * (0.42 - 0.98 * t)
    handle = np.stack([0.040 + 0.046 * np.cos(angle), 0.110 + 0.056 * np.sin(angle), 0 * t], -1)
    scene.add("pitcher handle", shapes.tube(handle, 0.0042, 20), m["copper"], at=at, turn_y=-28)


def build():
    scene = GlbWriter("still life")
    m = _materials(scene)
    _stage(scene, m)
    _cloth(scene, m)
    _bowl(scene, m, (-0.005, 0.0, -0.035))
    _bottle(scene, m, (-0.205, 0.0, -0.165))
    _goblet(scene, m, (0.205, 0.0, 0.105))
    _candlestick(scene, m, (0.275, 0.0, -0.130))
    _grapes(scene, m, (-0.235, 0.0, 0.115))
    top = _books(scene, m, (-0.385, 0.0, -0.090))
    scene.add("glass ball", shapes.sphere(0.034, 96, 64), m["glass"],
              at=(-0.378, round(top + 0.034, 6), -0.075))
    _pitcher(scene, m, (0.435, 0.0, -0.060))
    lemon = [(0, -0.040), (0.006, -0.038), (0.011, -0.033), (0.024, -0.020), (0.0285, 0.0),
             (0.024, 0.020), (0.011, 0.033), (0.0065, 0.039), (0, 0.041)]
    lemon = shapes.lathe(lemon, segments=72, steps=6, crease_degrees=60)
    side = math.sqrt(0.5)
    scene.add("lemon", lemon, m["lemon"], at=(0.085, 0.0280, 0.185),
              rotation=(0.31, 0.23, side, round(math.sqrt(1 - 0.31**2 - 0.23**2 - 0.5), 9)))
    scene.add("steel ball", shapes.sphere(0.024, 96, 64), m["steel"], at=(0.335, 0.024, 0.120))
    return scene
