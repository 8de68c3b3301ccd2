"""Procedural pictures as PNG bytes: colours are sRGB, noise is hashed, so bytes are repeatable."""

import struct
import zlib

import numpy as np


def png(pixels):
    """Encodes height x width x 3 floats in [0, 1]."""
    bytes_ = np.clip(np.floor(np.round(pixels * 255, 4) + 0.5), 0, 255).astype(np.uint8)
    height, width, _ = bytes_.shape
    # Filter 1 (difference to the left pixel) suits smooth pictures.
    rows = bytes_.reshape(height, -1).astype(np.int16)
    rows[:, 3:] -= bytes_.reshape(height, -1)[:, :-3]
    data = np.concatenate([np.ones((height, 1), np.uint8), (rows & 255).astype(np.uint8)], axis=1)

    def chunk(kind, body):
        return struct.pack(">I", len(body)) + kind + body + struct.pack(
            ">I", zlib.crc32(kind + body))

    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    return (b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) +
            chunk(b"IDAT", zlib.compress(data.tobytes(), 9)) + chunk(b"IEND", b""))


def _hash(x, y, seed):
    """Integers to floats in [0, 1), by the finaliser of a 32-bit mixing function."""
    h = (x.astype(np.uint32) * np.uint32(0x9E3779B1)) ^ (y.astype(np.uint32) * np.uint32(0x85EBCA77))
    h ^= np.uint32((seed * 0xC2B2AE3D) & 0xFFFFFFFF)
    for shift, factor in ((15, 0x2C1B3C6D), (12, 0x297A2D39)):
        h = (h ^ (h >> np.uint32(shift))) * np.uint32(factor)
    return (h ^ (h >> np.uint32(15))) / 2.0**32


def noise(u, v, cells_u, cells_v, seed):
    """Smooth value noise in [0, 1] that tiles over the unit square."""
    x, y = u * cells_u, v * cells_v
    i, j = np.floor(x).astype(int), np.floor(y).astype(int)
    fx, fy = x - i, y - j
    fx, fy = fx * fx * (3 - 2 * fx), fy * fy * (3 - 2 * fy)
    at = lambda di, dj: _hash((i + di) % cells_u, (j + dj) % cells_v, seed)
    low = at(0, 0) * (1 - fx) + at(1, 0) * fx
    high = at(0, 1) * (1 - fx) + at(1, 1) * fx
    return low * (1 - fy) + high * fy


def fractal(u, v, cells_u, cells_v, octaves, seed):
    total, weight = np.zeros_like(u), 0.0
    for k in range(octaves):
        total += noise(u, v, cells_u << k, cells_v << k, seed + k) / 2**k
        weight += 1 / 2**k
    return total / weight


def _uv(width, height=None):
    height = height or width
    return np.meshgrid((np.arange(width) + 0.5) / width, (np.arange(height) + 0.5) / height)


def _mix(a, b, t):
    return np.asarray(a) * (1 - t[..., None]) + np.asarray(b) * t[..., None]


def wood(size=1024, planks=5, seed=1):
    """Planks along u; returns colour and metallic-roughness pictures."""
    u, v = _uv(size)
    plank = np.floor(v * planks)
    shade = _hash(plank.astype(int), np.zeros_like(plank, int), seed)
    # Rings: distance to the heart of the tree, bent by slow noise along the grain.
    bend = fractal(u, v, 2, planks * 2, 3, seed + 10) - 0.5
    across = (v * planks - plank - 0.5) + 0.9 * (shade - 0.5) + 0.55 * bend
    rings = 0.5 + 0.5 * np.sin(2 * np.pi * (9 * across * (1 + 0.4 * shade) + 3 * shade))
    fibre = fractal(u, v, 8, 256, 3, seed + 20)
    tone = np.clip(0.58 * rings**1.5 + 0.42 * fibre, 0, 1)
    color = _mix((0.33, 0.185, 0.10), (0.66, 0.45, 0.27), tone)
    color *= (0.82 + 0.3 * shade)[..., None]
    edge = np.abs(v * planks - plank - 0.5) * 2
    gap = np.clip((edge - 0.988) / 0.008, 0, 1)
    color *= (1 - 0.7 * gap)[..., None]
    roughness = np.clip(0.34 + 0.22 * (1 - tone) + 0.12 * (fractal(u, v, 6, 6, 4, seed + 30) - 0.5) +
                        0.3 * gap, 0, 1)
    return png(color), png(np.stack([np.zeros_like(u), roughness, np.zeros_like(u)], -1))


def plaster(size=512, low=(0.30, 0.36, 0.38), high=(0.47, 0.53, 0.53), seed=5):
    u, v = _uv(size)
    cloud = fractal(u, v, 3, 3, 6, seed)
    tone = np.clip((cloud - 0.3) * 2.2, 0, 1)
    return png(_mix(low, high, tone))


def gingham(size=256, stripe=(0.62, 0.10, 0.10), ground=(0.93, 0.90, 0.84)):
    """Woven checks: warp and weft each half coloured, with thread texture."""
    u, v = _uv(size)
    band = (np.floor(u * 2) % 2 + np.floor(v * 2) % 2) / 2
    thread = 0.5 + 0.25 * np.sin(2 * np.pi * u * 64) + 0.25 * np.sin(2 * np.pi * v * 64)
    return png(_mix(ground, stripe, band) * (0.90 + 0.10 * thread)[..., None])


def checker(size=256, cells=8, dark=(0.12, 0.12, 0.13), light=(0.80, 0.80, 0.78)):
    u, v = _uv(size)
    cell = (np.floor(u * cells) + np.floor(v * cells)) % 2
    return png(_mix(dark, light, cell))


def skin(color, spots, size=512, seed=8, cells=48):
    """Fruit skin: colour with mottling, and a normal map of its pores."""
    u, v = _uv(size, size // 2)
    mottle = fractal(u, v, 8, 4, 5, seed)
    picture = png(_mix(color, spots, np.clip((mottle - 0.35) * 2.0, 0, 1)))
    height = noise(u, v, cells * 2, cells, seed + 50) * 0.6 + noise(
        u, v, cells * 4, cells * 2, seed + 51) * 0.4
    du = (np.roll(height, -1, 1) - np.roll(height, 1, 1)) * size / 2 / (cells * 6)
    dv = (np.roll(height, -1, 0) - np.roll(height, 1, 0)) * size / 4 / (cells * 6)
    n = np.stack([-du, dv, np.ones_like(du)], -1)
    n /= np.linalg.norm(n, axis=-1, keepdims=True)
    return picture, png(n * 0.5 + 0.5)


def book_cover(ground, ink, size=256):
    """A cloth cover with a frame and three bars for a title."""
    u, v = _uv(size)
    cloth = 0.9 + 0.1 * noise(u, v, 128, 128, 77)
    inside = np.maximum(np.abs(u - 0.5), np.abs(v - 0.5))
    mark = (np.abs(inside - 0.42) < 0.008) | ((np.abs(u - 0.5) < 0.22) & (
        (np.abs(v - 0.30) < 0.025) | (np.abs(v - 0.38) < 0.012) | (np.abs(v - 0.72) < 0.010)))
    return png(_mix(ground, ink, mark.astype(float)) * cloth[..., None])


def rug(size=256):
    u, v = _uv(size)
    rim = np.maximum(np.abs(u - 0.5), np.abs(v - 0.5)) * 2
    diamond = (np.abs((u * 6) % 1 - 0.5) + np.abs((v * 6) % 1 - 0.5)) < 0.32
    color = _mix((0.50, 0.12, 0.10), (0.83, 0.72, 0.52), diamond.astype(float))
    color[rim > 0.86] = (0.12, 0.16, 0.28)
    color[rim > 0.95] = (0.83, 0.72, 0.52)
    return png(color * (0.85 + 0.15 * noise(u, v, 128, 128, 33))[..., None])
