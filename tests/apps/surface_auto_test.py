#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""`haarlight render surface --integrator auto`: what it chooses, what it predicts, and that a film goes on with it.
surface_auto_test.py BIN, the build's folder apps/. No rig is needed."""

import json
import pathlib
import re
import subprocess
import sys
import tempfile
import unittest

from programs import SOURCE, Programs

DONE, MISSED, USAGE, BAD_INPUT = 0, 1, 2, 65
FLOOR = """schema = 1
name = "a floor under a small lamp"
[[material]]
name = "floor"
kd = [0.7]
[[material]]
name = "lamp"
kd = [0, 0, 0]
emits = [900, 900, 900]
[[quad]]
corners = [[-100, -100, 0], [100, -100, 0], [100, 100, 0], [-100, 100, 0]]
material = "floor"
[[disk]]
centre = [0, 0, 60]
normal = [0, 0, -1]
radius = 3
material = "lamp"
[camera]
size = [64, 64]
eye = [0, -150, 120]
target = [0, 0, 0]
fov_y_deg = 40
"""


def in_glass(lamp):
    """The same floor under a lamp in a ball of glass, which the camera does not see."""
    ball = """[[material]]
name = "glass"
bsdf = "dielectric"
ior = 1.5
[[sphere]]
centre = [0, 0, 160]
radius = 15
material = "glass"
"""
    return FLOOR[:FLOOR.index("[[disk]]")] + ball + lamp + FLOOR[FLOOR.index("[camera]"):]


class Auto(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.temporary = tempfile.TemporaryDirectory()
        cls.folder = pathlib.Path(cls.temporary.name)
        cls.floor = cls.folder / "floor.toml"
        cls.floor.write_text(FLOOR)

    @classmethod
    def tearDownClass(cls):
        cls.temporary.cleanup()

    def surface(self, scene, *words):
        return PROGRAMS.run("render", "surface", scene, *words, cwd=self.folder)

    def chosen(self, scene, *words, name="auto", code=DONE):
        """@return the report and what was printed"""
        done = self.surface(scene, "--integrator", "auto", "-o", f"{name}.exr", "--force", "--report", f"{name}.json", *words)
        self.assertEqual(done.returncode, code, done.stderr)
        return json.loads((self.folder / f"{name}.json").read_text()), done.stdout

    def test_ten_thousand_lights_take_the_tree(self):
        scene = self.folder / "lamps.toml"
        subprocess.run([sys.executable, SOURCE / "bench/render/many_lights.py", "10000", scene], check=True)
        report, told = self.chosen(scene, "--size", "64x64", "--max-error", 0.2)
        self.assertEqual(report["reached"]["lights"], "tree")
        names = report["details"]["pilot_candidates"].split("; ")
        self.assertNotIn("path --lights all --sampling mis", names, "10000 rays at each point")
        by_power = report["details"]["pilot_efficiencies"][names.index("path --lights power --sampling mis")]
        self.assertLess(by_power, 0.3, "45 times less in docs/numerics/surface.md, with other boxes and samples")
        self.assertRegex(told, r"auto: path --lights tree --sampling (mis|light): ")
        with_power = report["details"]["pilot_efficiencies"][names.index("bidirectional --lights power")]
        self.assertLess(with_power, 1.0, "it tells of paths that ask the same lights alone")

    def test_one_light_is_not_chosen(self):
        report, told = self.chosen(SOURCE / "configs/scenes/cornell.toml", "--size", "64x64", "--max-error", 0.05)
        self.assertEqual(report["details"]["pilot_candidates"], "path --sampling mis; path --sampling light; bidirectional")
        self.assertEqual(report["reached"]["integrator"], "path", "two to four times as efficient: docs/numerics/surface.md")
        self.assertNotIn("--lights", told)

    def test_light_that_is_all_direct_is_asked_for_alone(self):
        report, told = self.chosen(self.floor, "--max-error", 0.01, name="direct")
        self.assertEqual(report["reached"]["integrator"], "direct")
        # It is the same picture: nothing that a path could find was left out.
        done = self.surface(self.floor, "-o", "path.exr", "--spp", report["reached"]["samples_per_pixel"],
                            "--sampling", report["reached"]["sampling"])
        self.assertEqual(done.returncode, DONE, done.stderr)
        self.assertEqual((self.folder / "direct.exr").read_bytes(), (self.folder / "path.exr").read_bytes())
        for change in (("kd = [0, 0, 0]", "kd = [0, 0, 0.1]"), ("[camera]", '[[sphere]]\ncentre = [0, 0, 9]\nradius = 9\n'
                       'material = "floor"\n[camera]'), ("kd = [0.7]", 'bsdf = "dielectric"')):
            other = self.folder / "other.toml"
            other.write_text(FLOOR.replace(*change))
            self.assertNotEqual(other.read_text(), FLOOR)
            report, _ = self.chosen(other, "--max-error", 0.1)
            self.assertEqual(report["reached"]["integrator"], "path", change)

    def test_a_small_lamp_is_not_left_to_chance(self):
        """Directions alone find a lamp of 3 mm once in a thousand: given as a choice, auto takes points of the lamp."""
        report, told = self.chosen(self.floor, "--max-error", 0.05, "--sampling", "bsdf", "--spp", 64, code=MISSED)
        self.assertEqual(report["reached"]["sampling"], "bsdf", "what was given is kept")
        self.assertIn("the prediction is not to be trusted", told)
        self.assertGreater(report["details"].get("predicted_samples", 1e9), 1000, "nothing, or many")
        report, _ = self.chosen(self.floor, "--max-error", 0.05)
        self.assertIn(report["reached"]["sampling"], ("mis", "light"))
        self.assertLess(report["details"]["predicted_samples"], 100)

    def test_a_caustic_takes_paths_from_the_lights(self):
        """Path tracing meets it one time in thousands: its own samples do not tell."""
        scene = self.folder / "caustic.toml"
        scene.write_text(in_glass('[[sphere]]\ncentre = [0, 0, 160]\nradius = 0.5\nmaterial = "lamp"\n'))
        floor = ("--size", "48x48", "--film", "caustic.film", "--max-error")
        report, told = self.chosen(scene, *floor, 0.5)
        self.assertEqual(report["reached"]["integrator"], "bidirectional")
        names = report["details"]["pilot_candidates"].split("; ")
        by_path = report["details"]["pilot_efficiencies"][names.index("path --sampling mis")]
        self.assertLess(by_path, 0.2)
        self.assertIn("times the efficiency of path", told)
        # Its film goes on with it, as with one that was named.
        report, told = self.chosen(scene, *floor, 0.3)
        self.assertIn("auto: bidirectional, as caustic.film was begun", told)
        words = ("--integrator", "bidirectional", "--film", "by_name.film", "-o", "by_name.exr")
        named = self.surface(scene, *words, *floor[:2], "--max-error", 0.3)
        self.assertEqual(named.returncode, DONE, named.stderr)
        self.assertEqual((self.folder / "caustic.film").read_bytes(), (self.folder / "by_name.film").read_bytes())
        # What path tracing alone can do is not offered to it; nor what memory does not hold.
        for words in (("--sampling", "mis"), ("--lights", "all"), ("--memory", "30M")):
            size = ("--size", "300x300") if "--memory" in words else floor[:2]
            report, _ = self.chosen(scene, *size, "--max-error", 0.9, "--spp", 4, *words, code=MISSED)
            self.assertNotIn("bidirectional", report["details"]["pilot_candidates"], words)

    def test_light_that_paths_from_the_camera_never_meet(self):
        """A point lamp in a ball of glass."""
        scene = self.folder / "ball.toml"
        scene.write_text(in_glass('[[light]]\nkind = "point"\nposition = [0, 0, 162]\nintensity = [1e4, 1e4, 1e4]\n'))
        report, told = self.chosen(scene, "--max-error", 0.2)
        self.assertEqual(report["reached"]["integrator"], "bidirectional")
        self.assertIn("100.0 % of the light is not met by paths from the camera alone", told)

    def test_what_is_predicted_comes_true(self):
        """Samples within a factor of 2 of those that the error needed; the error is achieved; the pilot took a
        tenth of the CPU time, or less than a second."""
        for scene, error in (("cornell", 0.05), ("cornell_glass", 0.07), ("lights", 0.07)):
            report, told = self.chosen(SOURCE / f"configs/scenes/{scene}.toml", "--size", "160x120", "--max-error", error)
            predicted, needed = report["details"]["predicted_samples"], report["reached"]["needed_samples"]
            self.assertLessEqual(report["reached"]["relative_l2"], error)
            self.assertLess(max(predicted / needed, needed / predicted), 2.0, (scene, predicted, needed, told))
            self.assertLess(report["details"]["pilot_cpu_seconds"], 1.0, scene)
            self.assertRegex(told, r"auto: \S+ samples predicted, \S+ needed")
        report, told = self.chosen(SOURCE / "configs/scenes/cornell.toml", "--seconds", 2)
        ratio = report["details"]["predicted_error"] / report["reached"]["relative_l2"]
        self.assertLess(max(ratio, 1.0 / ratio), 3.0, told)  # seconds of a machine that others use, too
        self.assertLess(report["details"]["pilot_seconds"] + report["details"]["render_seconds"], 3.0)

    def test_a_film_goes_on_with_what_was_chosen_first(self):
        words = ("--film", "box.film", "--size", "60x40", "--seed", 4)
        scene = SOURCE / "configs/scenes/lights.toml"
        report, _ = self.chosen(scene, *words, "--max-error", 0.5)
        choice = [word for key in ("integrator", "lights", "sampling") for word in (f"--{key}", report["reached"][key])]
        report, told = self.chosen(scene, *words, "--max-error", 0.05)
        self.assertRegex(told, r"auto: path .*, as box\.film was begun")
        self.assertNotIn("pilot_seconds", report["details"])
        named = self.surface(scene, *choice, "--film", "named.film", "--size", "60x40", "--seed", 4, "--max-error", 0.05,
                             "-o", "named.exr", "--threads", 1)
        self.assertEqual(named.returncode, DONE, named.stderr)
        for ending in ("film", "exr"):
            name = "box.film" if ending == "film" else "auto.exr"
            self.assertEqual((self.folder / name).read_bytes(), (self.folder / f"named.{ending}").read_bytes())
        self.assertEqual(self.surface(scene, "--integrator", "whitted", "--film", "w.film", "--size", "60x40", "--spp",
                                      2).returncode, DONE)
        kept = (self.folder / "w.film").read_bytes()
        refused = self.surface(scene, "--integrator", "auto", "--film", "w.film", "--size", "60x40", "--max-error", 0.5)
        self.assertEqual(refused.returncode, BAD_INPUT, refused.stderr)
        self.assertIn("begun by --integrator whitted", refused.stderr)
        (self.folder / "text.film").write_text("my notes, which are not a film, and long enough to look like one")
        refused = self.surface(scene, "--integrator", "auto", "--film", "text.film", "--max-error", 0.5)
        self.assertEqual(refused.returncode, BAD_INPUT, refused.stderr)
        self.assertIn("not a film", refused.stderr)
        self.assertEqual((self.folder / "w.film").read_bytes(), kept)

    def test_words_that_leave_it_without_a_choice(self):
        for words, cause in (([], "--max-error E or --seconds T"), (["--spp", 16], "--max-error E or --seconds T"),
                             (["--seconds", 1, "--part", "1/2", "--film", "never.film"], "name what auto chose there"),
                             (["--max-error", 0.1, "--explain"], "--integrator path or direct")):
            output = [] if "--part" in words else ["-o", "never.exr"]
            refused = self.surface(self.floor, "--integrator", "auto", *output, *words)
            self.assertEqual(refused.returncode, USAGE, words)
            self.assertIn(cause, refused.stderr)
        self.assertEqual(list(self.folder.glob("never*")), [])

    def test_a_picture_without_light_is_told(self):
        dark = self.folder / "dark.toml"
        dark.write_text(re.sub(r"normal = .*", "normal = [0, 0, 1]", FLOOR).replace("eye = [0, -150, 120]", "eye = [0, -150, 20]"))
        _, told = self.chosen(dark, "--max-error", 0.1, "--spp", 16, code=MISSED)
        self.assertIn("the pilot found no light", told)


if __name__ == "__main__":
    PROGRAMS = Programs(sys.argv.pop(1))
    unittest.main()
