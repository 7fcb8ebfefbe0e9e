#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Writes the example of a glTF scene, balls on a tiled table: make_gltf_scene.py OUT.glb

One mesh of a ball stands in it four times, as gold, lacquer, clay and glass would need four materials: so
four meshes share its vertices. Lit by a panel that emits and by a point and a spot in candela.
"""

import json
import math
import pathlib
import struct
import sys
import zlib

FLOAT, SHORT = 5126, 5123


def ball(subdivisions):
    """Vertices of the unit sphere and triangles, corners counter-clockwise from outside."""
    vertices = [(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)]
    triangles = [(4, 0, 2), (4, 2, 1), (4, 1, 3), (4, 3, 0), (5, 2, 0), (5, 1, 2), (5, 3, 1), (5, 0, 3)]
    for _ in range(subdivisions):
        between = {}

        def middle(a, b):
            key = (min(a, b), max(a, b))
            if key not in between:
                point = [(vertices[a][i] + vertices[b][i]) for i in range(3)]
                length = math.hypot(*point)
                between[key] = len(vertices)
                vertices.append(tuple(x / length for x in point))
            return between[key]

        finer = []
        for a, b, c in triangles:
            ab, bc, ca = middle(a, b), middle(b, c), middle(c, a)
            finer += [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
        triangles = finer
    return vertices, triangles


def tiles_png(side=64, tiles=2):
    """Two colours of tiles, sRGB, 8 bits."""
    def chunk(kind, body):
        return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))

    rows = b""
    for y in range(side):
        rows += b"\0"
        for x in range(side):
            is_dark = (x * tiles // side + y * tiles // side) % 2
            rows += bytes((96, 110, 128) if is_dark else (214, 205, 188))
    return (b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", struct.pack(">IIBBBBB", side, side, 8, 2, 0, 0, 0)) +
            chunk(b"IDAT", zlib.compress(rows, 9)) + chunk(b"IEND", b""))


class Writer:
    def __init__(self):
        self.bytes = b""
        self.views = []
        self.accessors = []

    def view(self, body):
        self.bytes += b"\0" * (-len(self.bytes) % 4)
        self.views.append({"buffer": 0, "byteOffset": len(self.bytes), "byteLength": len(body)})
        self.bytes += body
        return len(self.views) - 1

    def accessor(self, rows, kind):
        component = SHORT if kind == "SCALAR" else FLOAT
        flat = [number for row in rows for number in row] if kind != "SCALAR" else rows
        body = struct.pack(f"<{len(flat)}{'H' if component == SHORT else 'f'}", *flat)
        entry = {"bufferView": self.view(body), "componentType": component, "count": len(rows), "type": kind}
        if kind == "VEC3":
            entry["min"] = [min(row[i] for row in rows) for i in range(3)]
            entry["max"] = [max(row[i] for row in rows) for i in range(3)]
        self.accessors.append(entry)
        return len(self.accessors) - 1

    def glb(self, document):
        document |= {"buffers": [{"byteLength": len(self.bytes)}], "bufferViews": self.views,
                     "accessors": self.accessors}
        text = json.dumps(document, separators=(",", ":")).encode()
        text += b" " * (-len(text) % 4)
        body = self.bytes + b"\0" * (-len(self.bytes) % 4)
        chunks = (struct.pack("<I", len(text)) + b"JSON" + text + struct.pack("<I", len(body)) + b"BIN\0" + body)
        return b"glTF" + struct.pack("<II", 2, 12 + len(chunks)) + chunks


def turn(axis, degrees):
    half = math.radians(degrees) / 2
    return [math.sin(half) * a for a in axis] + [math.cos(half)]


def main():
    writer = Writer()
    vertices, triangles = ball(5)
    position = writer.accessor(vertices, "VEC3")
    indices = writer.accessor([corner for t in triangles for corner in t], "SCALAR")
    square = writer.accessor([(-1, 0, -1), (1, 0, -1), (1, 0, 1), (-1, 0, 1)], "VEC3")
    up = writer.accessor([(0, 1, 0)] * 4, "VEC3")
    uvs = writer.accessor([(0, 0), (4, 0), (4, 4), (0, 4)], "VEC2")
    corners = writer.accessor([0, 2, 1, 0, 3, 2], "SCALAR")
    picture = writer.view(tiles_png())
    names = ("gold", "lacquer", "clay", "glass")
    meshes = [{"name": name, "primitives": [{"attributes": {"POSITION": position, "NORMAL": position},
                                             "indices": indices, "material": i}]} for i, name in enumerate(names)]
    for name, material in (("table", 4), ("panel", 5)):
        attributes = {"POSITION": square, "NORMAL": up} | ({"TEXCOORD_0": uvs} if name == "table" else {})
        meshes.append({"name": name, "primitives": [{"attributes": attributes, "indices": corners,
                                                     "material": material}]})
    spots = ((-0.09, 0.0), (0.0, 0.05), (0.09, 0.0), (0.01, -0.075))
    nodes = [{"name": name, "mesh": i, "translation": [x, 0.04, -y], "scale": [0.04] * 3}
             for i, (name, (x, y)) in enumerate(zip(names, spots))]
    nodes += [
        {"name": "table", "mesh": 4, "scale": [0.4, 1, 0.4]},
        {"name": "panel", "mesh": 5, "translation": [0.1, 0.5, -0.1], "scale": [0.1, 1, 0.1]},
        {"name": "camera", "camera": 0, "translation": [0.0, 0.22, 0.42], "rotation": turn((1, 0, 0), -26.0)},
        {"name": "point", "translation": [-0.3, 0.35, 0.25], "extensions": {"KHR_lights_punctual": {"light": 0}}},
        {"name": "spot", "translation": [0.02, 0.45, 0.12], "rotation": turn((1, 0, 0), -80.0),
         "extensions": {"KHR_lights_punctual": {"light": 1}}},
    ]

    def glossy(name, colour, metallic, roughness):
        return {"name": name, "pbrMetallicRoughness": {"baseColorFactor": [*colour, 1.0], "metallicFactor": metallic,
                                                       "roughnessFactor": roughness}}

    materials = [
        glossy("gold", (1.0, 0.77, 0.34), 1.0, 0.3), glossy("lacquer", (0.45, 0.02, 0.02), 0.0, 0.2),
        glossy("clay", (0.30, 0.42, 0.35), 0.0, 0.9),
        glossy("glass", (1.0, 1.0, 1.0), 0.0, 0.0) | {"extensions": {
            "KHR_materials_transmission": {"transmissionFactor": 1.0}, "KHR_materials_ior": {"ior": 1.5}}},
        {"name": "tiles", "pbrMetallicRoughness": {"baseColorTexture": {"index": 0}, "metallicFactor": 0.0,
                                                   "roughnessFactor": 0.5}},
        {"name": "panel", "doubleSided": True, "emissiveFactor": [1.0, 0.95, 0.85], "extensions": {
            "KHR_materials_emissive_strength": {"emissiveStrength": 3000.0}},
         "pbrMetallicRoughness": {"baseColorFactor": [0.0, 0.0, 0.0, 1.0], "metallicFactor": 0.0}},
    ]
    used = ["KHR_lights_punctual", "KHR_materials_emissive_strength", "KHR_materials_ior",
            "KHR_materials_transmission"]
    document = {
        "asset": {"version": "2.0", "generator": "haarlight scripts/make_gltf_scene.py"}, "scene": 0,
        "scenes": [{"nodes": list(range(len(nodes)))}], "nodes": nodes, "meshes": meshes, "materials": materials,
        "textures": [{"source": 0}], "images": [{"bufferView": picture, "mimeType": "image/png"}],
        "cameras": [{"type": "perspective", "perspective": {"yfov": 0.62, "aspectRatio": 1.5, "znear": 0.01}}],
        "extensionsUsed": used,
        "extensions": {"KHR_lights_punctual": {"lights": [
            {"name": "point", "type": "point", "color": [0.7, 0.8, 1.0], "intensity": 60.0},
            {"name": "spot", "type": "spot", "color": [1.0, 0.85, 0.6], "intensity": 150.0,
             "spot": {"innerConeAngle": 0.2, "outerConeAngle": 0.3}}]}},
    }
    pathlib.Path(sys.argv[1]).write_bytes(writer.glb(document))


if __name__ == "__main__":
    main()
