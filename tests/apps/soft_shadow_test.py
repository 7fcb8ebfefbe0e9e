#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""`haarlight render soft-shadow`: what it writes, tells and refuses. soft_shadow_test.py BIN, the
build's folder apps/. No rig is needed."""

import json
import pathlib
import sys
import tempfile
import unittest

from programs import SOURCE, Programs

DONE, USAGE, BAD_INPUT = 0, 2, 65
CORNELL = (SOURCE / "configs/scenes/cornell.toml").read_text()
KINDS = ("whole", "edge", "outline", "unsure", "traced")


class SoftShadows(unittest.TestCase):
    def setUp(self):
        temporary = tempfile.TemporaryDirectory()
        self.addCleanup(temporary.cleanup)
        self.folder = pathlib.Path(temporary.name)

    def render(self, text, name, *words, returns=DONE):
        (self.folder / "scene.toml").write_text(text)
        done = PROGRAMS.run("render", "soft-shadow", "scene.toml", "--size", "80x80", "-o", f"{name}.exr",
                            "--report", f"{name}.json", *words, cwd=self.folder)
        self.assertEqual(done.returncode, returns, done.stderr)
        return done

    def details(self, name):
        return json.loads((self.folder / f"{name}.json").read_text())["details"]

    def test_the_same_bytes_for_any_grid_and_number_of_threads(self):
        self.render(CORNELL, "whole")
        for words in (("--grid", "1"), ("--grid", "1000"), ("--threads", "1"), ("--threads", "7")):
            name = "".join(words).strip("-")
            self.render(CORNELL, name, *words)
            self.assertEqual((self.folder / f"{name}.exr").read_bytes(),
                             (self.folder / "whole.exr").read_bytes(), words)

    def test_every_point_is_of_one_kind(self):
        done = self.render(CORNELL, "kinds", "--map", "map.png")
        details = self.details("kinds")
        points = [details[f"points_{kind}"] for kind in KINDS]
        self.assertLessEqual(sum(points), 80 * 80)
        self.assertGreater(sum(points), 0.9 * 80 * 80)  # the box fills the picture but for its rim
        self.assertEqual(details["points_traced"], 0)
        self.assertGreater(details["points_outline"], 500)
        self.assertLess(details["rays"], sum(points))  # one for each point at most
        self.assertIn("% of the values exact", done.stdout)
        for picture in ("kinds.png", "map.png"):
            self.assertEqual((self.folder / picture).read_bytes()[:4], b"\x89PNG")

    def test_a_sphere_in_the_way_is_traced(self):
        ball = CORNELL + '\n[[sphere]]\ncentre = [278, -280, 420]\nradius = 40\nmaterial = "white"\nexact = true\n'
        done = self.render(ball, "ball", "--max-error", "0.1")
        self.assertGreater(self.details("ball")["points_traced"], 100)
        self.assertRegex(done.stdout, r" [1-9]\d* traced")
        # A tessellated one has edges.
        self.render(ball.replace("exact = true", "subdivisions = 2"), "facets")
        self.assertEqual(self.details("facets")["points_traced"], 0)

    def test_lights_that_are_not_flat_are_refused_by_name(self):
        for added, named in (
                ('[[sphere]]\ncentre = [0, 0, 0]\nradius = 9\nmaterial = "light"\nexact = true', "sphere 0"),
                ('[[box]]\nlow = [0, 0, 0]\nhigh = [9, 9, 9]\nmaterial = "light"', "mesh"),
                ('[[light]]\nkind = "point"\nposition = [0, 0, 9]\nintensity = [1, 1, 1]', "point or spot light")):
            with self.subTest(named):
                refused = self.render(f"{CORNELL}\n{added}\n", "refused", returns=BAD_INPUT)
                self.assertIn(named, refused.stderr)
                self.assertIn("is no flat light", refused.stderr)
                self.assertFalse((self.folder / "refused.exr").exists())

    def test_several_lights(self):
        lamp = '\n[[disk]]\ncentre = [100, -100, 548.5]\nnormal = [0, 0, -1]\nradius = 30\nmaterial = "light"\n'
        done = self.render(CORNELL + lamp, "two")
        self.assertIn("2 lights", done.stdout)
        self.assertEqual(self.details("two")["points_traced"], 0)  # they lie in one plane
        self.render(CORNELL + lamp.replace("548.5", "400"), "before", "--max-error", "0.25")
        self.assertGreater(self.details("before")["points_traced"], 0)  # one is before the other

    def test_a_rigs_lights(self):
        scene = (SOURCE / "configs/scenes/airplane.toml").read_text()
        scene = scene.replace('"airplane.obj"', f'"{SOURCE}/configs/scenes/airplane.obj"')
        rig = SOURCE / "configs/rigs/small8.toml"
        done = self.render(scene, "rig", "--rig", rig)
        self.assertIn("64 lights", done.stdout)
        self.render(scene, "one", "--rig", rig, "--light", "3")
        self.assertGreater(self.details("one")["points_penumbra"], 50)
        refused = self.render(scene, "none", "--rig", rig, "--light", "64", returns=USAGE)
        self.assertIn("the rig has 64", refused.stderr)
        self.render(scene, "alone", "--light", "3", returns=USAGE)

    def test_more_than_the_memory_is_refused(self):
        refused = self.render(CORNELL, "large", "--memory", "1M", returns=USAGE)
        self.assertIn("--memory allows", refused.stderr)


if __name__ == "__main__":
    PROGRAMS = Programs(sys.argv.pop(1))
    unittest.main()
