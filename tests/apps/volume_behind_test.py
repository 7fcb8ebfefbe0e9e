#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""`haarlight render volume` with surfaces behind the medium and with backgrounds: from the picture of
`haarlight render surface` to the volume's, against closed forms. volume_behind_test.py BIN, the
build's folder apps/. No rig is needed."""

import json
import math
import pathlib
import re
import shutil
import sys
import tempfile
import unittest

from picture_files import read_exr, read_npy
from programs import SOURCE, Programs, write_png

DONE, USAGE, BAD_INPUT = 0, 2, 65
VOLUMES = SOURCE / "configs/volumes"
SIZE = (96, 72)
NO_DEPTH = 1e10
EXTINCTION, COLOUR = 1.5, (0.25, 0.5, 1.0)
EYE, TARGET, FOV = (1.9, 2.2, 3.1), (0.5, 0.5, 0.5), 32.0
CAMERA = f"""
[camera]
size = {list(SIZE)}
eye = {list(EYE)}
target = {list(TARGET)}
fov_y_deg = {FOV}
"""
MIST = f"""
[mesh]
file = "cube.vtu"
[density]
field = "linear"
points = [[0, {EXTINCTION}]]
[colour]
field = "linear"
points = [[0, {", ".join(map(str, COLOUR))}]]
""" + CAMERA


def cross(a, b):
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


def unit(a):
    return [x / math.sqrt(sum(y * y for y in a)) for x in a]


def ray_of(x, y):
    """Direction through a pixel's centre, of length 1 along the camera's axis."""
    width, height = SIZE
    forward = unit([t - e for t, e in zip(TARGET, EYE)])
    right = unit(cross(forward, (0, 0, 1)))
    down = cross(forward, right)
    f = height / 2 / math.tan(math.radians(FOV) / 2)
    return [a + (x + 0.5 - width / 2) / f * b + (y + 0.5 - height / 2) / f * c for a, b, c in zip(forward, right, down)]


def medium_before(x, y, depth):
    """Length in the unit cube up to a depth, and the depth at which it begins."""
    direction = ray_of(x, y)
    near, far = 0.0, depth
    for e, d in zip(EYE, direction):
        ends = sorted((-e / d, (1 - e) / d))
        near, far = max(near, ends[0]), min(far, ends[1])
    return max(far - near, 0.0) * math.sqrt(sum(d * d for d in direction)), near


class Behind(unittest.TestCase):
    def setUp(self):
        temporary = tempfile.TemporaryDirectory()
        self.addCleanup(temporary.cleanup)
        self.folder = pathlib.Path(temporary.name)
        shutil.copy(VOLUMES / "cube.vtu", self.folder)

    def run_verb(self, *words, returns=DONE):
        done = PROGRAMS.run(*words, cwd=self.folder)
        self.assertEqual(done.returncode, returns, done.stdout + done.stderr)
        return done

    def render(self, text, *words, returns=DONE):
        (self.folder / "mist.toml").write_text(text)
        return self.run_verb("render", "volume", "mist.toml", "-o", "mist.exr", "--float64", "mist.npy", "--force", *words,
                             returns=returns)

    def surfaces(self, *words, output="ball.exr"):
        ball = (VOLUMES / "ball.toml").read_text()
        (self.folder / "ball.toml").write_text(re.sub(r"(?s)\[camera\].*", CAMERA, ball))
        self.run_verb("render", "surface", "ball.toml", "-o", output, "--spp", 4, "--force", *words)

    def refused(self, text, *said):
        """By the render and by the check alike."""
        before = sorted(path.name for path in self.folder.iterdir())
        told = self.render(text, returns=BAD_INPUT).stderr
        checked = self.run_verb("check", "mist.toml", returns=BAD_INPUT).stderr
        for words in said:
            self.assertRegex(told, words)
            self.assertRegex(checked, words)
        self.assertIn("\n  hint: ", told)
        self.assertEqual(sorted({*before, "mist.toml"}), sorted(path.name for path in self.folder.iterdir()))
        return told

    def test_from_surfaces_to_the_volume(self):
        self.surfaces()
        _, _, surfaces = read_exr(self.folder / "ball.exr")
        self.render(MIST + '[behind]\npicture = "ball.exr"\n', "--report", "report.json")
        inputs = json.loads((self.folder / "report.json").read_text())["inputs"]
        self.assertTrue(any(name.endswith("ball.exr") for name in inputs))
        _, _, picture = read_exr(self.folder / "mist.exr")
        _, values = read_npy(self.folder / "mist.npy")
        width, height = SIZE
        n_within = n_behind = n_none = 0
        for y in range(height):
            for x in range(width):
                i = y * width + x
                depth = surfaces["Z"][i]
                length, near = medium_before(x, y, depth)
                whole, _ = medium_before(x, y, NO_DEPTH)
                n_within += 0 < length < whole
                n_behind += 0 < length == whole and depth < NO_DEPTH
                n_none += depth >= NO_DEPTH
                through = math.exp(-EXTINCTION * length)
                for value, colour, name in zip(values[4 * i:4 * i + 3], COLOUR, "RGB"):
                    self.assertAlmostEqual(value, (1 - through) * colour + through * surfaces[name][i], delta=1e-12)
                self.assertAlmostEqual(values[4 * i + 3], 1 - through, delta=1e-12)
                if abs(through - 0.5) > 1e-9:
                    stretch = math.sqrt(sum(d * d for d in ray_of(x, y)))
                    half = near + math.log(2) / EXTINCTION / stretch if through < 0.5 else depth
                    self.assertAlmostEqual(picture["Z"][i] / half, 1, delta=1e-7)
        for n in (n_within, n_behind, n_none):
            self.assertGreater(n, 100)

    def test_the_example_has_one_camera(self):
        cameras = {re.search(r"(?s)\[camera\].*", (VOLUMES / name).read_text())[0] for name in ("ball.toml", "ball_in_mist.toml")}
        self.assertEqual(len(cameras), 1)

    def test_pictures_that_are_no_surfaces(self):
        behind = MIST + '[behind]\npicture = "%s"\n'
        line = behind.count("\n")
        absent = self.refused(behind % "absent.exr", rf"mist.toml:{line}: the picture of \[behind\]: cannot open", "absent.exr")
        self.assertIn("check the name", absent)
        write_png(self.folder / "grey.png", *SIZE, lambda x, y: 60)
        self.refused(behind % "grey.png", "not an OpenEXR file", "grey.png", "haarlight render surface")
        self.run_verb("render", "soft-shadow", SOURCE / "configs/scenes/cornell.toml", "-o", "soft.exr", "--size", "%dx%d" % SIZE)
        self.refused(behind % "soft.exr", "has no channel [RZ]", "soft.exr", "haarlight render surface")
        (self.folder / "cut.exr").write_bytes((self.folder / "soft.exr").read_bytes()[:600])
        self.refused(behind % "cut.exr", "cut.exr")
        self.surfaces("--size", "48x36", output="small.exr")
        told = self.refused(behind % "small.exr", f"mist.toml:{line}: small.exr has 48 x 36 pixels, the picture of the volume 96 x 72")
        self.assertIn("make it again with 96 x 72 pixels, or render the volume with --size 48x36", told)
        self.render(behind % "small.exr", "--size", "48x36")
        self.surfaces("--size", "192x144", "--crop", "96x72+8+8", output="part.exr")
        self.refused(behind % "part.exr", "part.exr", "is a part of a larger picture", "without --crop")
        self.refused(behind % "small.exr" + "[background]\ncolour = [0, 0, 1]\n", r"a background behind the picture of \[behind\]")

    def test_a_film_knows_what_is_behind(self):
        self.surfaces()
        text = MIST + '[behind]\npicture = "ball.exr"\n'
        self.render(text, "--film", "mist.film")
        film = (self.folder / "mist.film").read_bytes()
        self.surfaces("--seed", 3)
        refused = self.render(text, "--film", "mist.film", returns=BAD_INPUT)
        self.assertRegex(refused.stderr, r"mist.film: the film is of another render: behind is \S+ there, \S+ here")
        self.assertEqual((self.folder / "mist.film").read_bytes(), film)

    def test_backgrounds(self):
        empty = MIST.replace(f"[[0, {EXTINCTION}]]", "[[0, 0]]")
        self.render(MIST)
        _, black = read_npy(self.folder / "mist.npy")
        width, height = SIZE
        top, bottom = (0.125, 0.25, 0.5), (1.0, 0.5, 2.0)
        write_png(self.folder / "sky.png", width, height, lambda x, y: (x + 2 * y) % 256)

        def linear(code):
            s = code / 255
            return s / 12.92 if s <= 0.04045 else ((s + 0.055) / 1.055) ** 2.4

        def mixed(x, y):
            part = (y + 0.5) / height
            return [(1 - part) * a + part * b for a, b in zip(top, bottom)]

        for table, truth, delta in (
                (f"colour = {list(top)}", lambda x, y: top, 0.0),
                (f"top = {list(top)}\nbottom = {list(bottom)}", mixed, 1e-15),
                (f"checker = [{list(top)}, {list(bottom)}]\nsquare = 10",
                 lambda x, y: bottom if (x // 10 + y // 10) % 2 else top, 0.0),
                ('picture = "sky.png"', lambda x, y: [linear((x + 2 * y) % 256)] * 3, 1e-6)):
            with self.subTest(table):
                self.render(empty + f"[background]\n{table}\n")
                _, alone = read_npy(self.folder / "mist.npy")
                self.render(MIST + f"[background]\n{table}\n")
                _, seen = read_npy(self.folder / "mist.npy")
                self.assertEqual(seen[3::4], black[3::4])
                self.assertEqual(max(alone[3::4]), 0.0)
                for y in range(height):
                    for x in range(width):
                        i = 4 * (y * width + x)
                        for c, value in enumerate(truth(x, y)):
                            self.assertAlmostEqual(alone[i + c], value, delta=delta)
                            through = 1 - black[i + 3]
                            self.assertAlmostEqual(seen[i + c], black[i + c] + through * value, delta=1e-6)

    def test_backgrounds_that_are_none(self):
        for table, said in (("", "background.colour is missing"), ("top = [1, 1, 1]", "background.bottom is missing"),
                            ("checker = [[1, 1, 1], [0, 0, 0]]", "background.square is missing"),
                            ("checker = [[1, 1, 1]]\nsquare = 4", "background.checker"),
                            ("checker = [[1, 1, 1], [0, 0, 0]]\nsquare = 0", "background.square"),
                            ("colour = [1, 1, 1]\ntop = [0, 0, 0]\nbottom = [1, 1, 1]", "more than one background"),
                            ("color = [1, 1, 1]", "did you mean colour?"), ('picture = "absent.png"', "absent.png")):
            with self.subTest(table):
                self.refused(MIST + f"[background]\n{table}\n", re.escape(said), r"mist.toml:\d+")
        write_png(self.folder / "sky.png", 30, 20, lambda x, y: 60)
        told = self.refused(MIST + '[background]\npicture = "sky.png"\n', "sky.png has 30 x 20 pixels")
        self.assertIn("--size 30x20", told)


if __name__ == "__main__":
    PROGRAMS = Programs(sys.argv.pop(1))
    unittest.main()
