"""Triangle meshes of simple solids. Lengths in metres, +y up, fronts counter-clockwise."""

import math
from collections import namedtuple

import numpy as np

Shape = namedtuple("Shape", "positions normals uvs triangles")


def _shape(positions, normals, uvs, triangles):
    """Rounds so that the bytes do not depend on the last bit of a machine's sine."""
    round_ = lambda a: None if a is None else np.round(np.asarray(a, float), 6) + 0.0
    return Shape(round_(positions), round_(normals), round_(uvs), np.asarray(triangles, int))


def merge(shapes):
    offsets = np.cumsum([0] + [len(s.positions) for s in shapes])
    return Shape(*(np.concatenate([s[k] for s in shapes]) for k in range(3)),
                 np.concatenate([s.triangles + o for s, o in zip(shapes, offsets)]))


def move(shape, offset):
    return shape._replace(positions=shape.positions + np.asarray(offset, float))


def quad(corner, edge_u, edge_v, uv_scale=(1, 1)):
    """A parallelogram whose front is edge_u x edge_v; v = 0 at the end of edge_v."""
    corner, edge_u, edge_v = (np.asarray(a, float) for a in (corner, edge_u, edge_v))
    normal = np.cross(edge_u, edge_v)
    normal /= np.linalg.norm(normal)
    points = [corner, corner + edge_u, corner + edge_u + edge_v, corner + edge_v]
    uvs = np.array([(0, 1), (1, 1), (1, 0), (0, 0)]) * uv_scale
    return _shape(points, [normal] * 4, uvs, [(0, 1, 2), (0, 2, 3)])


def panel(centre, target, width, height):
    """A rectangle at `centre` whose front looks at `target`."""
    centre = np.asarray(centre, float)
    front = np.asarray(target, float) - centre
    front /= np.linalg.norm(front)
    up = (0.0, 0.0, -1.0) if abs(front[1]) > 0.999 else (0.0, 1.0, 0.0)
    u = np.cross(up, front)
    u *= width / np.linalg.norm(u)
    v = np.cross(front, u)
    v *= height / np.linalg.norm(v)
    return quad(centre - u / 2 - v / 2, u, v)


def box(low, high, uv_scale=1.0):
    """Axis-aligned, uvs in metres times `uv_scale`."""
    (x0, y0, z0), (x1, y1, z1) = low, high
    w, h, d = x1 - x0, y1 - y0, z1 - z0
    faces = [
        ((x0, y0, z1), (w, 0, 0), (0, h, 0)), ((x1, y0, z0), (-w, 0, 0), (0, h, 0)),
        ((x1, y0, z1), (0, 0, -d), (0, h, 0)), ((x0, y0, z0), (0, 0, d), (0, h, 0)),
        ((x0, y1, z1), (w, 0, 0), (0, 0, -d)), ((x0, y0, z0), (w, 0, 0), (0, 0, d)),
    ]
    return merge([quad(c, u, v, (np.linalg.norm(u) * uv_scale, np.linalg.norm(v) * uv_scale))
                  for c, u, v in faces])


def grid(function, num_u, num_v):
    """A surface function(u, v) -> (x, y, z) over [0, 1]^2 arrays, smooth; front is d/du x d/dv."""
    u, v = np.meshgrid(np.linspace(0, 1, num_u + 1), np.linspace(0, 1, num_v + 1))
    p = np.stack(np.broadcast_arrays(*function(u, v)), axis=-1)
    du, dv = np.gradient(p, axis=1), np.gradient(p, axis=0)
    normals = np.cross(du, dv)
    lengths = np.linalg.norm(normals, axis=-1, keepdims=True)
    normals = normals / np.where(lengths > 0, lengths, 1)
    i = np.arange(num_v)[:, None] * (num_u + 1) + np.arange(num_u)
    a, b, c, d = i, i + 1, i + num_u + 2, i + num_u + 1
    triangles = np.stack([a, b, c, a, c, d], axis=-1).reshape(-1, 3)
    return _shape(p.reshape(-1, 3), normals.reshape(-1, 3),
                  np.stack([u, 1 - v], axis=-1).reshape(-1, 2), triangles)


def sphere(radius, num_u=64, num_v=32):
    """Smooth; one vertex ring a latitude, exact normals."""
    u, v = np.meshgrid(np.arange(num_u + 1) / num_u, np.arange(num_v + 1) / num_v)
    phi, theta = 2 * np.pi * u, np.pi * v
    n = np.stack([np.sin(theta) * np.cos(phi), np.cos(theta), -np.sin(theta) * np.sin(phi)], -1)
    n = n.reshape(-1, 3)
    triangles = []
    for j in range(num_v):
        for i in range(num_u):
            a = j * (num_u + 1) + i
            b, c, d = a + num_u + 1, a + num_u + 2, a + 1
            if j < num_v - 1:
                triangles.append((a, b, c))
            if j > 0:
                triangles.append((a, c, d))
    return _shape(n * radius, n, np.stack([u, v], -1).reshape(-1, 2), triangles)


def _refine(points, steps):
    """Catmull-Rom through the points; a repeated point makes a corner."""
    points = np.asarray(points, float)
    out = []
    for i in range(len(points) - 1):
        p1, p2 = points[i], points[i + 1]
        if np.allclose(p1, p2):
            continue
        p0 = points[i - 1] if i > 0 else p1
        p3 = points[i + 2] if i + 2 < len(points) else p2
        t = (np.arange(steps) / steps)[:, None]
        out.append(0.5 * (2 * p1 + (p2 - p0) * t + (2 * p0 - 5 * p1 + 4 * p2 - p3) * t**2 +
                          (3 * p1 - p0 - 3 * p2 + p3) * t**3))
    return np.concatenate(out + [points[-1:]])


def lathe(profile, segments=96, steps=1, crease_degrees=40.0):
    """Turns (radius, height) points, listed from bottom to top along the outside, about +y.

    Corners sharper than `crease_degrees` stay sharp. `steps` > 1 rounds the profile.
    """
    profile = _refine(profile, steps) if steps > 1 else np.asarray(profile, float)
    profile[:, 0] = np.maximum(profile[:, 0], 0)
    edges = np.diff(profile, axis=0)
    lengths = np.linalg.norm(edges, axis=1)
    keep = lengths > 1e-9
    starts, ends, edges = profile[:-1][keep], profile[1:][keep], edges[keep] / lengths[keep][:, None]
    face = np.stack([edges[:, 1], -edges[:, 0]], axis=1)  # outward: right of the direction
    turn = math.cos(math.radians(crease_degrees))

    def blend(i, j):
        if not 0 <= j < len(face) or face[i] @ face[j] < turn:
            return face[i]
        n = face[i] + face[j]
        return n / np.linalg.norm(n)

    angle = np.arange(segments + 1) / segments * 2 * np.pi
    cos, sin = np.cos(angle), -np.sin(angle)
    heights = np.concatenate([[0], np.cumsum(np.linalg.norm(ends - starts, axis=1))])
    heights /= heights[-1]
    shapes = []
    for i, (start, end) in enumerate(zip(starts, ends)):
        rings = []
        for (radius, y), n, v in ((start, blend(i, i - 1), heights[i]),
                                  (end, blend(i, i + 1), heights[i + 1])):
            rings.append((np.stack([radius * cos, np.full_like(cos, y), radius * sin], 1),
                          np.stack([n[0] * cos, np.full_like(cos, n[1]), n[0] * sin], 1),
                          np.stack([angle / (2 * np.pi), np.full_like(cos, 1 - v)], 1)))
        a = np.arange(segments)
        b, c, d = a + 1, a + segments + 2, a + segments + 1
        triangles = []
        if start[0] > 0:
            triangles.append(np.stack([a, b, c], 1))
        if end[0] > 0:
            triangles.append(np.stack([a, c, d], 1))
        if triangles:
            shapes.append(_shape(*(np.concatenate(pair) for pair in zip(*rings)),
                                 np.concatenate(triangles)))
    return merge(shapes)


def tube(path, radius, sides=8):
    """A round wire along the points of `path`, open at its ends."""
    path = np.asarray(path, float)
    tangents = np.gradient(path, axis=0)
    tangents /= np.linalg.norm(tangents, axis=1, keepdims=True)
    normal = np.cross(tangents[0], (0, 1, 0) if abs(tangents[0][1]) < 0.9 else (1, 0, 0))
    angles = np.arange(sides + 1) / sides * 2 * np.pi
    rows, normals = [], []
    for point, tangent in zip(path, tangents):
        normal = normal - tangent * (normal @ tangent)  # carried along without twist
        normal /= np.linalg.norm(normal)
        side = np.cross(tangent, normal)
        ring = np.cos(angles)[:, None] * normal + np.sin(angles)[:, None] * side
        rows.append(point + radius * ring)
        normals.append(ring)
    n = len(path)
    i = np.arange(n - 1)[:, None] * (sides + 1) + np.arange(sides)
    a, b, c, d = i, i + 1, i + sides + 2, i + sides + 1
    triangles = np.stack([a, b, c, a, c, d], -1).reshape(-1, 3)
    u = np.broadcast_to(angles / (2 * np.pi), (n, sides + 1))
    v = np.broadcast_to(np.linspace(0, 1, n)[:, None], (n, sides + 1))
    return _shape(np.concatenate(rows), np.concatenate(normals),
                  np.stack([u, v], -1).reshape(-1, 2), triangles)


def rounded_box(size, radius, steps=5):
    """Centred at the origin; uvs are metres of the face's plane."""
    half = np.asarray(size, float) / 2
    faces = []
    for axis in range(3):
        for sign in (1, -1):
            u_axis, v_axis = (axis + 1) % 3, (axis + 2) % 3
            if sign < 0:
                u_axis, v_axis = v_axis, u_axis
            rim = radius * np.tan(np.linspace(0, np.pi / 4, steps + 1))
            line = lambda h: np.concatenate([-(h - radius) - rim[::-1], (h - radius) + rim])
            s, t = np.meshgrid(line(half[u_axis]), line(half[v_axis]))
            p = np.zeros(s.shape + (3,))
            p[..., u_axis], p[..., v_axis], p[..., axis] = s, t, sign * half[axis]
            inner = np.clip(p, -(half - radius), half - radius)
            n = p - inner
            n /= np.linalg.norm(n, axis=-1, keepdims=True)
            num = s.shape[1]
            i = np.arange(s.shape[0] - 1)[:, None] * num + np.arange(num - 1)
            triangles = np.stack([i, i + 1, i + num + 1, i, i + num + 1, i + num], -1)
            uvs = np.stack([p[..., 0 if axis != 0 else 2], p[..., 2 if axis == 1 else 1]], -1)
            faces.append(_shape((inner + radius * n).reshape(-1, 3), n.reshape(-1, 3),
                                uvs.reshape(-1, 2), triangles.reshape(-1, 3)))
    return merge(faces)
