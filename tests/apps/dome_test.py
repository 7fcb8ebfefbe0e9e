#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""`haarlight calibrate`: chrome ball photographs, mirror balls and sheets under a dome that made_lights.py
draws, a rig's array without its rig file, bad input. dome_test.py BIN, the build's folder apps/."""

import json
import pathlib
import shutil
import sys
import tempfile
import unittest

import numpy as np

from made_lights import Balls, Sheet, unit, write_png16
from programs import SOURCE, Programs, report_problems, write_capture

BALLS = SOURCE.parent / "shared/data/balls"
SHEET = ["--target", "sheet", "--width-mm", "250", "--camera-mm", "740", "--tilt-deg", "0", "--transfer",
         "linear"]


class Dome(unittest.TestCase):
    def setUp(self):
        self.programs = Programs(BIN)
        place = tempfile.TemporaryDirectory(prefix="haarlight-dome.")
        self.addCleanup(place.cleanup)
        self.folder = pathlib.Path(place.name)

    def calibrate(self, *words, expected=0):
        report = self.folder / "report.json"
        report.unlink(missing_ok=True)
        done = self.programs.run("calibrate", *words, "--report", report, "--quiet", timeout=300,
                                 cwd=self.folder)
        self.assertEqual(done.returncode, expected, done.stdout + done.stderr)
        if report.exists():
            self.assertEqual(report_problems(report, "calibrate"), [])
            self.reached = json.loads(report.read_text())["reached"]
        return done

    def lights_of(self, folder):
        return json.loads((self.folder / folder / "lights.json").read_text())["lights"]

    def places(self, folder):
        return np.array([light["position_mm"] for light in self.lights_of(folder)])

    def sigmas(self, folder):
        return np.array([light["sigma_mm"] for light in self.lights_of(folder)])

    # ---- mirror balls ----

    def known_directions(self):
        rows = (BALLS / "lights.txt").read_text().split("\n")[1:13]
        return unit(np.array([[float(word) for word in row.split()] for row in rows]))

    def angle_to_known(self, folder):
        found = np.array([light["direction"] for light in self.lights_of(folder)])
        cosine = np.clip((found * self.known_directions()).sum(1), -1.0, 1.0)
        return np.degrees(np.arccos(cosine)).mean()

    def test_chrome_ball_photographs(self):
        if not BALLS.exists():
            self.skipTest(f"{BALLS} is absent")
        chrome = BALLS / "chrome"
        self.calibrate(chrome, "--ball", chrome / "chrome.mask.tga", "-o", "masked")
        masked = self.angle_to_known("masked")
        self.calibrate(chrome, "--target", "ball", "--exclude", "mask", "-o", "found")
        found = self.angle_to_known("found")
        print(f"to the published directions: {masked:.3f} degrees by the mask, {found:.3f} without")
        self.assertLess(masked, 3.1)
        self.assertLess(found, 2.8)
        self.assertTrue((self.folder / "found/balls.png").stat().st_size > 1000)
        # The same lights, whichever way the ball was told: within both stated errors.
        apart = self.sigma_apart("masked", "found")
        self.assertLess(apart, 2.5)
        # What was found goes straight back in.
        done = self.programs.run("import", chrome, "--lights", self.folder / "found/lights.json", "-o",
                                 self.folder / "chrome.session")
        self.assertEqual(done.returncode, 0, done.stderr)
        self.assertIn("12 lights", done.stdout)

    def sigma_apart(self, a, b):
        one, other = self.lights_of(a), self.lights_of(b)
        apart = [np.degrees(np.linalg.norm(np.subtract(p["direction"], q["direction"]))) /
                 np.hypot(p["sigma_deg"], q["sigma_deg"]) for p, q in zip(one, other)]
        return np.sqrt(np.mean(np.square(apart)) / 2)

    def test_several_mirror_balls(self):
        middles = [(-90, -60), (90, -50), (70, 60), (-80, 55)]
        pulls, errors = [], []
        for seed in range(3):
            made = Balls(seed, middles)
            name = f"balls{seed}"
            made.write(self.folder / name)
            self.calibrate(name, "--target", "ball", "--balls", "4", "--radius-mm", "12", "--focal-px",
                           "1600", "--transfer", "linear", "--edge-px", "0.2", "-o", f"{name}.lights")
            e = self.places(f"{name}.lights") - made.lamps
            errors.append(np.linalg.norm(e, axis=1))
            pulls.append(e / self.sigmas(f"{name}.lights"))
            self.assertAlmostEqual(self.reached["camera_mm"], 700.0, delta=3.0)
        pull = np.sqrt(np.mean(np.square(pulls)))
        print(f"four balls: {np.sqrt(np.mean(np.square(errors))):.1f} mm at 500, normalised {pull:.2f}")
        self.assertGreater(pull, 0.5)
        self.assertLess(pull, 1.5)
        self.assertLess(np.sqrt(np.mean(np.square(errors))), 40.0)
        # Another number of balls than is there; masks instead of it; one ball of another size.
        done = self.calibrate("balls0", "--target", "ball", "--transfer", "linear", "-o", "new",
                              expected=65)
        self.assertIn("4 mirror balls are seen, not 1", done.stderr)
        masks = []
        for i in range(3):
            masks += ["--ball", self.folder / f"mask{i}.png"]
            write_png16(masks[-1], made.mask_of(i))
        self.calibrate("balls2", *masks, "--radius-mm", "12", "--focal-px", "1600", "--transfer",
                       "linear", "-o", "masked")
        e = np.linalg.norm(self.places("masked") - made.lamps, axis=1)
        self.assertLess(np.sqrt(np.mean(e ** 2)), 60.0)
        done = self.calibrate("balls2", *masks, "--radius-mm", "12,15,12", "--focal-px", "1600",
                              "--transfer", "linear", "--edge-px", "0.2", "-o", "wrong", expected=1)
        self.assertIn("no +- is given", done.stderr)
        self.assertNotIn("sigma_mm", self.lights_of("wrong")[0])

    def test_no_ball_is_refused(self):
        Sheet(1, n=6, size=(96, 72)).write(self.folder / "sheet")
        done = self.calibrate("sheet", "--target", "ball", "-o", "new", expected=65)
        self.assertIn("no mirror ball is seen", done.stderr)
        self.assertIn("--ball MASK.png", done.stderr)
        self.assertFalse((self.folder / "new").exists())

    # ---- a sheet ----

    def calibrate_sheet(self, made, name, *words, expected=0):
        made.write(self.folder / name)
        return self.calibrate(name, *SHEET, *words, "-o", f"{name}.lights", expected=expected)

    def test_a_dome_of_40_lights_over_a_flat_sheet(self):
        # Bow, sheen and lens are what all lights' errors have in common: few independent numbers
        # per sheet, so that eight are drawn.
        for aim, n, words in ((0.0, 8, ["--aim-deg", "0"]), (3.0, 3, [])):
            pulls, errors, powers = [], [], []
            for seed in range(n):
                made = Sheet(seed, aim_deg=aim, is_drawn=aim == 0.0)
                name = f"sheet{seed}_{aim:.0f}"
                self.calibrate_sheet(made, name, *words)
                e = self.places(f"{name}.lights") - made.places
                errors.append(np.linalg.norm(e, axis=1))
                pulls.append(e / self.sigmas(f"{name}.lights"))
                found = [light["relative_power"] for light in self.lights_of(f"{name}.lights")]
                powers.append(found / made.powers - 1.0)
                self.assertTrue(self.reached["is_model_right"])
                self.assertAlmostEqual(self.reached["reduced_chi2"], 1.0, delta=0.1)
            pull = np.sqrt(np.mean(np.square(pulls)))
            error = np.sqrt(np.mean(np.square(errors)))
            print(f"dome of 500 mm, aim off by {aim} degrees: {error:.2f} mm, normalised {pull:.2f}, "
                  f"power {100 * np.std(powers):.2f} %")
            self.assertGreater(pull, 0.7)
            self.assertLess(pull, 1.5)
            self.assertLess(error, 25.0)
        # Straight back into import and shape.
        done = self.programs.run("import", self.folder / "sheet0_0", "--lights",
                                 self.folder / "sheet0_0.lights/lights.json", "--transfer", "linear",
                                 "-o", self.folder / "sheet.session")
        self.assertEqual(done.returncode, 0, done.stderr)
        done = self.programs.run("shape", self.folder / "sheet.session", "-o", self.folder / "flat",
                                 "--width-mm", "250", "--mesh", "none")
        self.assertEqual(done.returncode, 0, done.stderr)
        self.lobes_are_the_sessions(made)
        # A session with lights is calibrated as its folder is.
        self.calibrate("sheet.session", *SHEET[:8], "--aim-deg", "0", "-o", "again")
        apart = np.linalg.norm(self.places("again") - self.places("sheet0_0.lights"), axis=1)
        self.assertLess(apart.max(), 0.5)

    def lobes_are_the_sessions(self, made):
        """What `correct` takes off a picture is the found lights' whole stencil."""
        lights = json.loads((self.folder / "sheet.session/session.json").read_text())["lights"]
        place = np.array([light["position_mm"] for light in lights])
        axis = np.array([light["axis"] for light in lights])
        mu = np.array([light["lobe_mu"] for light in lights])
        self.assertTrue((np.abs(mu - 1.0) < 0.3).all(), mu)
        off = np.arccos(np.clip((axis * unit(-place)).sum(1), -1.0, 1.0))
        self.assertLess(np.degrees(off.max()), 1.0)
        width, height = made.size
        pixel_mm = made.width_mm / width
        x, y = np.meshgrid((np.arange(width) + 0.5 - 0.5 * width) * pixel_mm,
                           (0.5 * height - np.arange(height) - 0.5) * pixel_mm)

        def stencil(k, point):
            way = place[k] - point
            r = np.linalg.norm(way, axis=-1)
            return (-(way @ axis[k]) / r) ** mu[k] * way[..., 2] / r ** 3

        point = np.stack([x, y, np.zeros_like(x)], 2)
        least = min((stencil(k, point) / stencil(k, np.zeros(3))).min() for k in range(len(lights)))
        report = self.folder / "even.json"
        done = self.programs.run("correct", self.folder / "sheet.session", "--width-mm", "250", "-o",
                                 self.folder / "even", "--report", report)
        self.assertEqual(done.returncode, 0, done.stderr)
        told = json.loads(report.read_text())["reached"]["least_fall_off"]
        self.assertAlmostEqual(told, least, delta=1e-4 * least)

    def test_a_wrong_model_gets_no_standard_error(self):
        for name, made in (("arch", Sheet(1, arch_mm=3.0)), ("gauss", Sheet(1, gauss_deg=15.0))):
            with self.subTest(name):
                done = self.calibrate_sheet(made, name, "--aim-deg", "0", expected=1)
                self.assertIn("no +- is given", done.stderr)
                self.assertFalse(self.reached["is_model_right"])
                for light in self.lights_of(f"{name}.lights"):
                    self.assertNotIn("sigma_mm", light)
                    self.assertNotIn("sigma_deg", light)
                    self.assertNotIn("relative_power_sigma", light)
                self.assertNotIn("position_sigma_mm_median", self.reached)

    def test_a_camera_aslant_is_in_the_standard_error(self):
        pulls, without = [], []
        for seed in range(3):
            made = Sheet(seed, tilt_deg=3.0)
            name = f"aslant{seed}"
            self.calibrate_sheet(made, name, "--aim-deg", "0")
            e = self.places(f"{name}.lights") - made.places
            without.append(e / self.sigmas(f"{name}.lights"))
            self.calibrate(name, *SHEET[:6], *SHEET[8:], "--tilt-deg", "3", "--aim-deg", "0", "-o",
                           f"{name}.told")
            pulls.append((self.places(f"{name}.told") - made.places) / self.sigmas(f"{name}.told"))
        self.assertGreater(np.sqrt(np.mean(np.square(without))), 2.0)
        self.assertLess(np.sqrt(np.mean(np.square(pulls))), 1.5)

    def test_rough_paper_is_found_to_be_rough(self):
        made = Sheet(2, slope=0.3)
        self.calibrate_sheet(made, "rough", "--aim-deg", "0")
        pull = (self.places("rough.lights") - made.places) / self.sigmas("rough.lights")
        self.assertLess(np.sqrt(np.mean(pull ** 2)), 1.6)

    def test_an_array_without_a_rig_file(self):
        grid = [(80.0 * (k % 6 - 2.5), 80.0 * (2.5 - k // 6), 0.0) for k in range(36)]
        turn = np.radians(8.0)
        pose = np.array([[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1]])
        self.make_array(np.array(grid) @ pose.T + [15.0, -10.0, 420.0], "array")
        self.calibrate("array", *SHEET, "--grid", "6,6", "--pitch-mm", "80", "-o", "array.lights")
        e = np.linalg.norm(self.places("array.lights") - self.array, axis=1)
        print(f"array of 6 x 6 at 420 mm: {np.sqrt(np.mean(e ** 2)):.2f} mm, stated "
              f"{np.linalg.norm(self.sigmas('array.lights'), axis=1).mean():.2f}")
        self.assertLess(np.sqrt(np.mean(e ** 2)),
                        3.0 * np.linalg.norm(self.sigmas("array.lights"), axis=1).mean())
        done = self.calibrate("array", *SHEET, "--grid", "5,6", "--pitch-mm", "80", "-o", "new",
                              expected=2)
        self.assertIn("5 x 6 lights for 36 pictures", done.stderr)

    def make_array(self, places, name):
        """LEDs that shine straight down."""
        self.array = places
        made = Sheet.__new__(Sheet)
        rng = np.random.default_rng(5)
        width, height = 192, 144
        x, y = np.meshgrid(250.0 / width * (np.arange(width) + 0.5 - 96),
                           250.0 / width * (72 - np.arange(height) - 0.5))
        point = np.stack([x, y, np.zeros_like(x)], 2)
        made.pictures = []
        for place in places:
            way = place - point
            made.pictures.append(way[..., 2] ** 2 / (way ** 2).sum(2) ** 2)
        most = max(p.max() for p in made.pictures)
        made.pictures = [0.9 / most * p * (1 + 0.01 * rng.normal(size=p.shape)) for p in made.pictures]
        made.write(self.folder / name)

    def test_a_bent_sheet(self):
        made = Sheet(4, n=24, radius=300.0, arch_mm=6.0, noise=0.005)
        self.calibrate_sheet(made, "bent", "--bent", "--mu", "1")
        self.reached_bent = self.reached
        flat = self.calibrate("bent", *SHEET, "--bow", "0", "--lobe", "given", "--aim-deg", "0", "-o",
                              "flat", expected=1)
        self.assertIn("no +- is given", flat.stderr)
        bent = np.linalg.norm(self.places("bent.lights") - made.places, axis=1)
        as_flat = np.linalg.norm(self.places("flat") - made.places, axis=1)
        print(f"a sheet bent by 6 mm: {np.median(bent):.1f} mm, taken as flat {np.median(as_flat):.1f}")
        self.assertLess(np.median(bent), 0.35 * np.median(as_flat))
        self.assertLess(self.reached_bent["reduced_chi2"], 1.2)
        self.assertGreater(self.reached_bent["chi2_flat"], 20.0)
        self.assertNotIn("sigma_mm", self.lights_of("bent.lights")[0])

    # ---- bad input ----

    def test_missing_and_odd_pictures(self):
        made = Sheet(1, n=10, size=(96, 72))
        made.write(self.folder / "good")
        odd = self.folder / "odd"

        def refused(change, *messages, expected=65):
            shutil.rmtree(odd, ignore_errors=True)
            shutil.copytree(self.folder / "good", odd)
            change()
            done = self.calibrate("odd", *SHEET, "-o", "new", expected=expected)
            for message in messages:
                self.assertIn(message, done.stderr)
            self.assertIn("hint: ", done.stderr)

        refused(lambda: write_png16(odd / "light3.png", np.zeros((72, 90))), "light3.png", "90 x 72")
        refused(lambda: shutil.copy(odd / "light2.png", odd / "light5.png"), "light5.png",
                "same bytes as light2.png")
        refused(lambda: (odd / "light4.png").write_bytes(b"no picture"), "light4.png")
        refused(lambda: [p.unlink() for p in odd.glob("*.png")], "no pictures")
        self.assertFalse((self.folder / "new").exists())
        # A black picture: its light is unseen, the others are found, and the exit code says so.
        refused(lambda: write_png16(odd / "light3.png", np.zeros((72, 96))), "left out of the lists",
                expected=1)
        names = [light["name"] for light in self.lights_of("new")]
        self.assertEqual(names, [f"light{k}.png" for k in range(10) if k != 3])
        table = (self.folder / "new/lights.csv").read_text()
        self.assertIn('"light3.png","unseen', table)

    def test_bad_options(self):
        write_capture(self.folder / "photos")
        for words, code, message in (
                (["photos", "-o", "new"], 2, "--target ball or --target sheet"),
                (["photos", "--target", "sheet", "-o", "new"], 2, "--width-mm"),
                (["photos", *SHEET, "--ball", "mask.png", "-o", "new"], 2, "a ball's option"),
                (["photos", *SHEET, "--rig", "rig.toml", "-o", "new"], 65, "a capture of the rig"),
                (["photos", *SHEET, "--bent", "--grid", "2,2", "-o", "new"], 2, "--bent"),
                (["photos", *SHEET, "--grid", "2,2", "-o", "new"], 2, "--pitch-mm"),
                (["photos", "--target", "ball", "--radius-mm", "12", "-o", "new"], 2, "one ball tells"),
                (["photos", "--target", "ball", "--balls", "3", "-o", "new"], 2, "--radius-mm"),
                (["photos", "--target", "ball", "--balls", "3", "--radius-mm", "12", "-o", "new"], 2,
                 "--focal-px"),
                (["photos", "--ball", "photos/light0.png", "--ball", "photos/light1.png", "-o", "new"],
                 2, "--radius-mm"),
                (["photos", *SHEET, "-o", "photos"], 2, "--force"),
                (["absent", *SHEET, "-o", "new"], 65, "absent")):
            with self.subTest(words=words):
                done = self.calibrate(*words, expected=code)
                self.assertIn(message, done.stderr)
                self.assertFalse((self.folder / "new").exists())


if __name__ == "__main__":
    BIN = sys.argv.pop(1)
    unittest.main(verbosity=2)
