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

DONE, TARGET_MISSED, USAGE, BAD_INPUT = 0, 1, 2, 65
CORNELL = (SOURCE / "configs/scenes/cornell.toml").read_text()
KINDS = ("whole", "edge", "outline", "assumed", "unsure", "traced")
TWO = (SOURCE / "configs/scenes/soft_shadow_two.toml").read_text()


class SoftShadows(unittest.TestCase):
    def setUp(self):
        temporary = tempfile.TemporaryDirectory()
        self.addCleanup(temporary.cleanup)
        self.folder = pathlib.Path(temporary.name)

    def render(self, text, name, *words, returns=DONE, size="80x80"):
        (self.folder / "scene.toml").write_text(text)
        done = PROGRAMS.run("render", "soft-shadow", "scene.toml", "--size", size, "-o", f"{name}.exr",
                            "--report", f"{name}.json", *words, cwd=self.folder)
        self.assertEqual(done.returncode, returns, done.stderr)
        return done

    def details(self, name):
        return json.loads((self.folder / f"{name}.json").read_text())["details"]

    def reached(self, name):
        return json.loads((self.folder / f"{name}.json").read_text())["reached"]

    def test_methods_beside_the_exact_values(self):
        self.render(TWO, "exact")
        self.assertEqual(self.details("exact")["points_assumed"], 0)
        errors = {}
        for method in ("d-buffer", "paper", "point-silhouette", "rays"):
            done = self.render(TWO, method, "--method", method, "--compare", f"{method}-error.png")
            self.assertIn("beside the exact values", done.stdout)
            self.assertNotIn("% of the values exact", done.stdout)
            errors[method] = self.reached(method)
            self.assertGreater(errors[method]["mean_error"], 0.0)
            self.assertGreaterEqual(errors[method]["worst_error"], errors[method]["error_at_99_percent"])
            self.assertGreater(self.details(method)["points_traced" if method == "rays" else "points_assumed"], 100)
            self.assertEqual((self.folder / f"{method}-error.png").read_bytes()[:4], b"\x89PNG")
            self.assertIn(b"error\0", (self.folder / f"{method}.exr").read_bytes()[:2000])
        self.assertLess(errors["rays"]["error_at_99_percent"], 0.015)
        self.assertGreater(errors["paper"]["mean_error"], errors["d-buffer"]["mean_error"])
        self.assertGreater(errors["paper"]["umbra_border_pixels"], 1)  # the boards' common umbra
        # Of a square light's disk.
        self.render(CORNELL, "disk", "--light-shape", "disk", "--compare", "disk-error.png")
        self.assertGreater(self.reached("disk")["mean_error"], 1e-3)

    def test_what_a_method_cannot_is_refused(self):
        ball = '\n[[sphere]]\ncentre = [0, 0, 90]\nradius = 9\nmaterial = "object"\nexact = true\n'
        same = '[[quad]]\ncorners = [[0, 0, 90], [9, 0, 90], [9, 9, 90], [0, 9, 90]]\nmaterial = "object"\n'
        for text, words, code, said in (
                (TWO, ("--visibility", "cubic"), USAGE, "a form of the D-buffer's"),
                (TWO, ("--compare", "x.png"), USAGE, "this is the exact way"),
                (TWO, ("--method", "paper", "--compare", "x.png", "--map", "x.png"), USAGE, "same file"),
                (TWO + ball, ("--method", "paper"), BAD_INPUT, "1 sphere and 0 disks"),
                (CORNELL, ("--method", "d-buffer"), BAD_INPUT, "--light-shape disk"),
                (TWO + same, ("--method", "paper"), DONE, "")):
            with self.subTest(words=words):
                done = self.render(text, "refused", *words, returns=code)
                self.assertIn(said, done.stderr)
                if code != DONE:
                    self.assertFalse((self.folder / "refused.exr").exists())
                    self.assertFalse((self.folder / "x.png").exists())

    def test_instances_under_a_disk(self):
        box = '\n[[mesh]]\nname = "box"\nfile = "box.obj"\n'
        (self.folder / "box.obj").write_text("v 0 0 0\nv 60 0 0\nv 0 60 30\nf 1 2 3\n")
        turned = '\n[[instance]]\nmesh = "box"\ntranslate = [100, 100, 60]\n'
        self.render(TWO + box + turned, "instance")
        (self.folder / "moved.obj").write_text("v 100 100 60\nv 160 100 60\nv 100 160 90\nf 1 2 3\n")
        self.render(TWO + box + box.replace('"box"', '"moved"').replace("box.obj", "moved.obj"), "mesh")
        self.assertEqual((self.folder / "instance.exr").read_bytes(), (self.folder / "mesh.exr").read_bytes())
        self.assertEqual(self.details("instance")["points_traced"], 0)

    def test_an_objects_mesh_under_a_rig(self):
        ply = ("ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
               "element face 1\nproperty list uchar int vertex_indices\nend_header\n"
               "-40 -30 50\n40 -30 50\n0 45 50\n3 0 1 2\n")
        (self.folder / "object.ply").write_text(ply)
        rig = SOURCE / "configs/rigs/small8.toml"
        PROGRAMS.run("render", "soft-shadow", "object.ply", "--rig", rig, "--light", "3", "-o", "ply.exr", "--size", "80x80",
                     "--report", "ply.json", cwd=self.folder)
        details = self.details("ply")
        self.assertGreater(details["points_whole"], 1000)  # the plane is seen
        self.assertGreater(details["points_penumbra"], 20)
        alone = PROGRAMS.run("render", "soft-shadow", "object.ply", "-o", "alone.exr", cwd=self.folder)
        self.assertNotEqual(alone.returncode, DONE)

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
        strata = []
        for asked in ("0.1", "0.02"):
            done = self.render(ball, f"ball{asked}", "--max-error", asked)
            details = self.details(f"ball{asked}")
            self.assertGreater(details["points_traced"], 100)
            self.assertRegex(done.stdout, r" [1-9]\d* traced")
            self.assertIn("rays per value", done.stdout)
            reached = self.reached(f"ball{asked}")
            self.assertLessEqual(reached["traced_error_at_99_percent"], float(asked))
            self.assertLess(reached["traced_mean_error"], reached["traced_error_at_99_percent"])
            strata.append(details["traced_strata"])
        self.assertGreater(strata[1], strata[0])
        self.render(ball, "fixed", "--strata", "5")
        self.assertEqual(self.details("fixed")["traced_strata"], 5)
        # A tessellated one has edges.
        self.render(ball.replace("exact = true", "subdivisions = 2"), "facets")
        self.assertEqual(self.details("facets")["points_traced"], 0)

    def test_an_error_that_the_most_rays_do_not_reach(self):
        # A blind of 60 slats: each has two borders before the light.
        slats = "".join(f'[[quad]]\ncorners = [[{x}, -420, 470], [{x + 2}, -420, 470], [{x + 2}, -90, 470], [{x}, -90, 470]]\n'
                        'material = "white"\n' for x in range(158, 398, 4))
        scene = (f'{CORNELL}\n[[sphere]]\ncentre = [278, -280, 420]\nradius = 40\nmaterial = "white"\nexact = true\n'
                 f'{slats}')
        for words, missed in (("0.0005", True), ("0.1", False)):
            done = self.render(scene, f"blind{words}", "--max-error", words, size="10x10",
                               returns=TARGET_MISSED if missed else DONE)
            self.assertEqual("is not reached" in done.stdout, missed, done.stdout)
            reached = self.reached(f"blind{words}")
            self.assertIs(reached["max_error_reached"], not missed)
            self.assertEqual(reached["traced_error_at_99_percent"] > float(words), missed)
            self.assertEqual(self.details(f"blind{words}")["traced_strata"] == 256, missed)
            self.assertTrue((self.folder / f"blind{words}.exr").exists())
        # A fixed number of rays has no target.
        done = self.render(scene, "fixed", "--strata", "4", "--max-error", "0.0005", size="10x10")
        self.assertNotIn("max_error_reached", self.reached("fixed"))

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

    def test_several_cameras_are_as_each_alone(self):
        cameras = [f"[camera]\nsize = [80, 60]\neye = [{x}, {y}, {z}]\ntarget = [{at}, 0, 30]\nfov_y_deg = {angle}\n"
                   for x, y, z, at, angle in ((0, -520, 330, 0, 20), (400, -300, 250, 90, 42), (-300, -9, 500, -90, 60))]
        turned = [camera.replace("[camera]", "[[camera]]") for camera in cameras]
        (self.folder / "views.toml").write_text("".join(turned))
        body = TWO[:TWO.index("[camera]")]
        ball = '\n[[sphere]]\ncentre = [90, 0, 90]\nradius = 9\nmaterial = "object"\nexact = true\n'
        lamp = '\n[[disk]]\ncentre = [90, 0, 300]\nnormal = [0, 0, -1]\nradius = 9\nmaterial = "lamp"\n'
        for name, scene, words in (("flat", body, ("--map", "flat-map.png")), ("ball", body + ball, ()), ("two", body + lamp, ()),
                                   ("buffer", body, ("--method", "d-buffer", "--d-buffer", "64"))):
            with self.subTest(name):
                done = self.render(scene + cameras[0], name, "--cameras", "views.toml", *words)
                self.assertEqual(done.stdout.count("80 x 80 pixels"), len(cameras))
                for phase in ("camera", "grid", "shadow", "picture"):
                    self.assertEqual(len(self.details(name)[f"{phase}_seconds_each"]), len(cameras))
                points = 0
                for number, camera in enumerate(cameras):
                    self.render(scene + camera, "alone", "--force", *(word.replace("flat", "alone") for word in words))
                    for ending in (".exr", ".png"):
                        self.assertEqual((self.folder / f"{name}-{number:04}{ending}").read_bytes(),
                                         (self.folder / f"alone{ending}").read_bytes(), (number, ending))
                    if "--map" in words:
                        self.assertEqual((self.folder / f"flat-map-{number:04}.png").read_bytes(),
                                         (self.folder / "alone-map.png").read_bytes())
                    points += self.details("alone")["points_penumbra"]
                self.assertEqual(self.details(name)["points_penumbra"], points)
                self.assertGreater(points, 100)

    def test_cameras_that_cannot_be_are_refused_with_their_line(self):
        good = "[[camera]]\nsize = [80, 60]\neye = [0, -520, 330]\ntarget = [0, 0, 30]\nfov_y_deg = 20\n"
        for text, words, code, said in (
                (good + good.replace("fov_y_deg", "fov_deg"), (), BAD_INPUT, "views.toml:10"),
                (good.replace("330", "nan"), (), BAD_INPUT, "views.toml:3"),
                (good + good.replace("80, 60", "0, 60"), (), BAD_INPUT, "views.toml:7"),
                ("schema = 1\n", (), BAD_INPUT, "0 cameras; a file has from 1 to 9999"),
                (good + "[film]\n", (), BAD_INPUT, "film"),
                (good, ("--method", "rays", "--compare", "x.png"), USAGE, "--cameras")):
            with self.subTest(said):
                (self.folder / "views.toml").write_text(text)
                refused = self.render(TWO, "refused", "--cameras", "views.toml", *words, returns=code)
                self.assertIn(said, refused.stderr)
                self.assertEqual(list(self.folder.glob("refused*.exr")), [])
        (self.folder / "views.toml").write_text(good + good)
        (self.folder / "taken-0001.exr").write_text("mine")
        self.assertIn("taken-0001.exr", self.render(TWO, "taken", "--cameras", "views.toml", returns=USAGE).stderr)
        self.assertEqual(list(self.folder.glob("taken-0000*")), [])

    def test_more_than_the_memory_is_refused(self):
        refused = self.render(CORNELL, "large", "--memory", "1M", returns=USAGE)
        self.assertIn("--memory allows", refused.stderr)


if __name__ == "__main__":
    PROGRAMS = Programs(sys.argv.pop(1))
    unittest.main()
