#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Scenes of glTF through the programs: gltf_test.py BIN"""

import json
import pathlib
import shutil
import struct
import subprocess
import sys
import tempfile
import unittest

from programs import SOURCE, Programs, png_bytes, report_problems

BALLS = SOURCE / "configs/scenes/balls.glb"


def write_scene(folder, colour=(1.0, 1.0, 1.0)):
    """A textured floor under a point, seen from above: scene.gltf, floor.bin, tiles.png."""
    numbers = struct.pack("<12f", -1, 0, 1, 1, 0, 1, 1, 0, -1, -1, 0, -1) + struct.pack("<8f", 0, 1, 1, 1, 1, 0, 0, 0)
    (folder / "floor.bin").write_bytes(numbers + struct.pack("<6H", 0, 1, 2, 0, 2, 3))
    (folder / "tiles.png").write_bytes(png_bytes(2, 2, [bytes((200, 90)), bytes((30, 120))]))
    views = [{"buffer": 0, "byteOffset": at, "byteLength": size} for at, size in ((0, 48), (48, 32), (80, 12))]
    kinds = ((5126, 4, "VEC3"), (5126, 4, "VEC2"), (5123, 6, "SCALAR"))
    (folder / "scene.gltf").write_text(json.dumps({
        "asset": {"version": "2.0"}, "scenes": [{"nodes": [0, 1, 2]}],
        "nodes": [{"mesh": 0}, {"camera": 0, "translation": [0, 3, 0], "rotation": [-(0.5**0.5), 0, 0, 0.5**0.5]},
                  {"translation": [0, 1, 0], "extensions": {"KHR_lights_punctual": {"light": 0}}}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0, "TEXCOORD_0": 1}, "indices": 2, "material": 0}]}],
        "materials": [{"normalTexture": {"index": 0}, "pbrMetallicRoughness": {
            "baseColorFactor": [*colour, 1.0], "baseColorTexture": {"index": 0}, "metallicFactor": 0.0}}],
        "textures": [{"source": 0}], "images": [{"uri": "tiles.png"}],
        "cameras": [{"type": "perspective", "perspective": {"yfov": 0.7, "aspectRatio": 2.0, "znear": 0.1}}],
        "extensions": {"KHR_lights_punctual": {"lights": [{"type": "point", "intensity": 683.0}]}},
        "buffers": [{"byteLength": 92, "uri": "floor.bin"}], "bufferViews": views,
        "accessors": [{"bufferView": i, "componentType": kind, "count": n, "type": words}
                      for i, (kind, n, words) in enumerate(kinds)]}))


def json_of(glb):
    """Without lengths, which depend on how well the picture is compressed."""
    text = glb.read_bytes()
    document = json.loads(text[20:20 + struct.unpack_from("<I", text, 12)[0]])
    return {key: value for key, value in document.items() if key not in ("buffers", "bufferViews")}


class Gltf(unittest.TestCase):
    def setUp(self):
        self.place = tempfile.TemporaryDirectory()
        self.addCleanup(self.place.cleanup)
        self.folder = pathlib.Path(self.place.name)
        self.programs = Programs(BIN)

    def run_line(self, *words, expected=0):
        done = self.programs.run(*words, cwd=self.folder)
        self.assertEqual(done.returncode, expected, done.stdout + done.stderr)
        return done

    def test_the_example_is_what_its_script_writes(self):
        made = self.folder / "balls.glb"
        subprocess.run([sys.executable, SOURCE / "scripts/make_gltf_scene.py", made], check=True)
        self.assertEqual(json_of(made), json_of(BALLS))
        shown = self.run_line("check", BALLS).stdout
        # The lamp is open and shines from both sides: a surface for each.
        for words in ("7 meshes", "6 materials", "1 texture", "2 lights", "a camera"):
            self.assertIn(words, shown)
        self.assertLessEqual(BALLS.stat().st_size, 200_000)

    def test_a_report_lists_all_files(self):
        write_scene(self.folder)
        done = self.run_line("render", "surface", "scene.gltf", "-o", "s.exr", "--spp", "1", "--size", "8x4", "--report",
                             "r.json")
        self.assertEqual(report_problems(self.folder / "r.json", "render"), [])
        inputs = [pathlib.Path(name).name for name in json.loads((self.folder / "r.json").read_text())["inputs"]]
        self.assertEqual(inputs, ["scene.gltf", "floor.bin", "tiles.png"])
        self.assertIn("a normal map is left out (materials[0])", done.stderr)

    def test_a_film_of_another_scene_is_refused(self):
        line = ("render", "surface", "scene.gltf", "--film", "s.film", "--size", "8x4", "--spp")
        write_scene(self.folder)
        self.run_line(*line, 1)
        self.run_line(*line, 2)
        write_scene(self.folder, colour=(1.0, 0.5, 1.0))
        self.run_line(*line, 4, expected=65)

    def test_a_scene_file_takes_its_meshes(self):
        write_scene(self.folder)
        (self.folder / "s.toml").write_text('[[mesh]]\nfile = "scene.gltf"\n')
        self.assertIn("1 mesh, 2 triangles, 1 material, 1 texture", self.run_line("check", "s.toml").stdout)

    def test_what_is_wrong_is_told(self):
        shutil.copy(BALLS, self.folder / "balls.glb")
        (self.folder / "cut.glb").write_bytes(BALLS.read_bytes()[:5000])
        for line, words in ((("check", "cut.glb"), "cut.glb: byte 8"),
                            (("render", "volume", "balls.glb", "-o", "v.exr"), "a glTF scene")):
            done = self.run_line(*line, expected=65)
            self.assertIn(words, done.stderr)
            self.assertEqual(sorted(path.name for path in self.folder.iterdir()), ["balls.glb", "cut.glb"])


if __name__ == "__main__":
    BIN = sys.argv.pop(1)
    unittest.main()
