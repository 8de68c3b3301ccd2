"""Writes glTF 2.0 binary files: a thin, deterministic layer over their JSON and one buffer."""

import json
import math
import struct

import numpy as np

FLOAT, UINT32, UINT16 = 5126, 5125, 5123
ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER = 34962, 34963


def _plain(values):
    """Floats short enough to read and to be the same from every libm."""
    return [round(float(v), 9) for v in values]


class GlbWriter:
    def __init__(self, name):
        self._json = {
            "asset": {"version": "2.0", "generator": "scenes/make_scenes.py"},
            "scene": 0,
            "scenes": [{"name": name, "nodes": []}],
        }
        self._bytes = bytearray()
        self._extensions = set()

    def _append(self, table, entry):
        entries = self._json.setdefault(table, [])
        entries.append(entry)
        return len(entries) - 1

    def _view(self, data, target=None):
        while len(self._bytes) % 4:
            self._bytes.append(0)
        view = {"buffer": 0, "byteOffset": len(self._bytes), "byteLength": len(data)}
        if target:
            view["target"] = target
        self._bytes += data
        return self._append("bufferViews", view)

    def _accessor(self, array, component, kind, target, with_bounds=False):
        accessor = {
            "bufferView": self._view(array.tobytes(), target),
            "componentType": component,
            "count": len(array),
            "type": kind,
        }
        if with_bounds:
            accessor["min"] = [float(v) for v in array.min(axis=0)]
            accessor["max"] = [float(v) for v in array.max(axis=0)]
        return self._append("accessors", accessor)

    def texture(self, name, png):
        """A texture of PNG bytes with repeating wrap."""
        image = self._append(
            "images", {"name": name, "mimeType": "image/png", "bufferView": self._view(png)})
        return self._append("textures", {"source": image})

    def material(self, name, color=(0.8, 0.8, 0.8), alpha=1.0, metallic=0.0, roughness=0.5,
                 color_texture=None, roughness_texture=None, normal_texture=None, normal_scale=1.0,
                 emission=None, transmission=0.0, ior=None, thickness=0.0, attenuation=None,
                 alpha_mode=None, double_sided=False):
        """`emission` is a radiance, `attenuation` a (colour, distance in metres) pair."""
        pbr = {
            "baseColorFactor": _plain((*color, alpha)),
            "metallicFactor": metallic,
            "roughnessFactor": roughness,
        }
        if color_texture is not None:
            pbr["baseColorTexture"] = {"index": color_texture}
        if roughness_texture is not None:
            pbr["metallicRoughnessTexture"] = {"index": roughness_texture}
        entry = {"name": name, "pbrMetallicRoughness": pbr}
        if normal_texture is not None:
            entry["normalTexture"] = {"index": normal_texture, "scale": normal_scale}
        if alpha_mode:
            entry["alphaMode"] = alpha_mode
        if double_sided:
            entry["doubleSided"] = True
        extensions = {}
        if emission is not None:
            strength = max(emission)
            entry["emissiveFactor"] = _plain(e / strength for e in emission)
            extensions["KHR_materials_emissive_strength"] = {"emissiveStrength": strength}
        if transmission:
            extensions["KHR_materials_transmission"] = {"transmissionFactor": transmission}
        if ior is not None:
            extensions["KHR_materials_ior"] = {"ior": ior}
        if thickness:
            volume = {"thicknessFactor": thickness}
            if attenuation:
                volume["attenuationColor"] = _plain(attenuation[0])
                volume["attenuationDistance"] = attenuation[1]
            extensions["KHR_materials_volume"] = volume
        if extensions:
            entry["extensions"] = extensions
            self._extensions |= set(extensions)
        return self._append("materials", entry)

    def mesh(self, name, shape, material):
        attributes = {
            "POSITION": self._accessor(shape.positions.astype("<f4"), FLOAT, "VEC3", ARRAY_BUFFER,
                                       with_bounds=True)}
        if shape.normals is not None:
            attributes["NORMAL"] = self._accessor(
                shape.normals.astype("<f4"), FLOAT, "VEC3", ARRAY_BUFFER)
        if shape.uvs is not None:
            attributes["TEXCOORD_0"] = self._accessor(
                shape.uvs.astype("<f4"), FLOAT, "VEC2", ARRAY_BUFFER)
        is_short = len(shape.positions) <= 65535
        indices = self._accessor(shape.triangles.astype("<u2" if is_short else "<u4").reshape(-1),
                                 UINT16 if is_short else UINT32, "SCALAR", ELEMENT_ARRAY_BUFFER)
        return self._append("meshes", {"name": name, "primitives": [
            {"attributes": attributes, "indices": indices, "material": material}]})

    def node(self, name, mesh=None, at=(0, 0, 0), turn_y=0.0, rotation=None, scale=None, **fields):
        """`turn_y` in degrees about +y, unless `rotation` gives a quaternion (x, y, z, w)."""
        entry = {"name": name, **fields}
        if mesh is not None:
            entry["mesh"] = mesh
        if any(at):
            entry["translation"] = _plain(at)
        if rotation is None and turn_y:
            half = math.radians(turn_y) / 2
            rotation = (0, math.sin(half), 0, math.cos(half))
        if rotation is not None:
            entry["rotation"] = _plain(rotation)
        if scale is not None:
            entry["scale"] = _plain((scale,) * 3 if np.isscalar(scale) else scale)
        index = self._append("nodes", entry)
        self._json["scenes"][0]["nodes"].append(index)
        return index

    def add(self, name, shape, material, **placing):
        """A mesh and one node that shows it."""
        return self.node(name, self.mesh(name, shape, material), **placing)

    def camera(self, name, eye, target, fov_y_degrees, aspect=16 / 9):
        camera = self._append("cameras", {"name": name, "type": "perspective", "perspective": {
            "yfov": round(math.radians(fov_y_degrees), 9), "aspectRatio": round(aspect, 9),
            "znear": 0.01}})
        self.node(name, at=eye, rotation=look_rotation(eye, target), camera=camera)

    def point_light(self, name, at, color, intensity_cd):
        self._punctual(name, {"type": "point"}, at, None, color, intensity_cd)

    def spot_light(self, name, at, target, color, intensity_cd, inner_degrees, outer_degrees):
        spot = {"innerConeAngle": round(math.radians(inner_degrees), 9),
                "outerConeAngle": round(math.radians(outer_degrees), 9)}
        self._punctual(name, {"type": "spot", "spot": spot}, at, look_rotation(at, target), color,
                       intensity_cd)

    def _punctual(self, name, light, at, rotation, color, intensity):
        lights = self._json.setdefault("extensions", {}).setdefault(
            "KHR_lights_punctual", {"lights": []})["lights"]
        lights.append({"name": name, **light, "color": _plain(color), "intensity": intensity})
        self._extensions.add("KHR_lights_punctual")
        self.node(name, at=at, rotation=rotation,
                  extensions={"KHR_lights_punctual": {"light": len(lights) - 1}})

    def encode(self):
        document = dict(self._json)
        if self._extensions:
            document["extensionsUsed"] = sorted(self._extensions)
        document["buffers"] = [{"byteLength": len(self._bytes)}]
        text = json.dumps(document, separators=(",", ":")).encode()
        text += b" " * (-len(text) % 4)
        binary = bytes(self._bytes) + b"\0" * (-len(self._bytes) % 4)
        total = 12 + 8 + len(text) + 8 + len(binary)
        return (struct.pack("<4sII", b"glTF", 2, total) + struct.pack("<I4s", len(text), b"JSON") +
                text + struct.pack("<I4s", len(binary), b"BIN\0") + binary)


def look_rotation(eye, target):
    """The quaternion that turns -z from `eye` towards `target`, +y staying up."""
    back = np.subtract(eye, target).astype(float)
    back /= np.linalg.norm(back)
    up = (0.0, 0.0, -1.0) if abs(back[1]) > 0.999 else (0.0, 1.0, 0.0)
    right = np.cross(up, back)
    right /= np.linalg.norm(right)
    m = np.stack([right, np.cross(back, right), back], axis=1)
    # The largest component first: no cancellation.
    squares = np.array([1 + m[0, 0] - m[1, 1] - m[2, 2], 1 - m[0, 0] + m[1, 1] - m[2, 2],
                        1 - m[0, 0] - m[1, 1] + m[2, 2], 1 + m[0, 0] + m[1, 1] + m[2, 2]])
    k = int(np.argmax(squares))
    s = 2 * math.sqrt(squares[k])
    rows = [
        (s / 4, (m[0, 1] + m[1, 0]) / s, (m[0, 2] + m[2, 0]) / s, (m[2, 1] - m[1, 2]) / s),
        ((m[0, 1] + m[1, 0]) / s, s / 4, (m[1, 2] + m[2, 1]) / s, (m[0, 2] - m[2, 0]) / s),
        ((m[0, 2] + m[2, 0]) / s, (m[1, 2] + m[2, 1]) / s, s / 4, (m[1, 0] - m[0, 1]) / s),
        ((m[2, 1] - m[1, 2]) / s, (m[0, 2] - m[2, 0]) / s, (m[1, 0] - m[0, 1]) / s, s / 4),
    ]
    return rows[k]
