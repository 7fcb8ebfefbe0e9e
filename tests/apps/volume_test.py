#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""`haarlight render volume` and `haarlight check` on volumes: what they write, tell and refuse.
volume_test.py BIN, the build's folder apps/. No rig is needed."""

import array
import json
import math
import os
import pathlib
import re
import shutil
import subprocess
import sys
import tempfile
import unittest

from picture_files import read_exr, read_npy, with_overlap
from programs import SOURCE, Programs, report_problems

DONE, TARGET_MISSED, USAGE, BAD_INPUT, IO = 0, 1, 2, 65, 74
VOLUMES = SOURCE / "configs/volumes"
CUBE = (VOLUMES / "cube.toml").read_text()


class Volumes(unittest.TestCase):
    def setUp(self):
        temporary = tempfile.TemporaryDirectory()
        self.addCleanup(temporary.cleanup)
        self.folder = pathlib.Path(temporary.name)
        shutil.copy(VOLUMES / "cube.vtu", self.folder)

    def render(self, output, *words, text=CUBE, returns=DONE):
        (self.folder / "scene.toml").write_text(text)
        done = PROGRAMS.run("render", "volume", "scene.toml", "-o", output, *words, cwd=self.folder)
        self.assertEqual(done.returncode, returns, done.stdout + done.stderr)
        return done

    def report(self, name="report.json"):
        self.assertEqual(report_problems(self.folder / name, "render"), [])
        return json.loads((self.folder / name).read_text())

    def files(self):
        return sorted(path.name for path in self.folder.iterdir())

    def test_the_picture_and_its_doubles(self):
        done = self.render("mist.exr", "--float64", "mist.npy", "--size", "70x50", "--report", "report.json")
        self.assertRegex(done.stdout, r"^mist.exr: 70 x 50 pixels, 384 cells; \d+ rays through \S+ million cells in ")
        self.assertEqual((self.folder / "mist.png").read_bytes()[:4], b"\x89PNG")
        width, height, channels = read_exr(self.folder / "mist.exr")
        self.assertEqual((width, height, sorted(channels)), (70, 50, ["A", "B", "G", "R", "Z"]))
        shape, values = read_npy(self.folder / "mist.npy")
        self.assertEqual(tuple(shape), (50, 70, 4))
        for k, name in enumerate("RGBA"):
            self.assertEqual(array.array("f", values[k::4]), channels[name], name)
        opacity = values[3::4]
        self.assertEqual(opacity[0], 0.0)  # beside the cube
        self.assertTrue(all(0.0 <= value <= 1.0 for value in values))
        self.assertGreater(max(opacity), 0.9)
        report = self.report()
        self.assertEqual(report["reached"], {"left_out": 0.0, "missing_tiles": 0, "ended_by": "samples"})
        details = report["details"]
        self.assertEqual(details["cells_of_mesh"], 384)
        self.assertEqual(details["rays"], sum(value > 0.0 for value in opacity))
        self.assertGreater(details["cells_passed"], details["rays"])
        self.assertEqual(details["opaque_rays"], 0)
        self.assertTrue(all(name.endswith(("scene.toml", "cube.vtu")) for name in report["inputs"]))

    def test_a_ray_is_what_the_formulas_say(self):
        """One pixel along z through the middle, where the extinction and the colour are constant."""
        text = re.sub(r"(?s)points = .*?\n\n", "points = [[0, 1.5]]\n\n", CUBE, count=1)
        text = re.sub(r"(?s)(\[colour\]\nfield = \"linear\"\n)points = .*?\n\]\n",
                      r"\1points = [[0, 0.25, 0.5, 1]]\n", text)
        text = re.sub(r"(?s)\[camera\].*", '[background]\ncolour = [1, 0, 0.5]\n[camera]\nsize = [1, 1]\n'
                      "eye = [0.4, 0.3, 9]\ntarget = [0.4, 0.3, 0]\nup = [0, 1, 0]\nwidth_mm = 0.01\n", text)
        through = math.exp(-1.5)
        for glow, scale in (("chromaticity", 1 - through), ("own", (1 - through) / 1.5)):
            self.render("ray.tif", "--float64", "ray.npy", "--force",
                        text=text.replace("[colour]\n", f'[colour]\nglow = "{glow}"\n'))
            _, values = read_npy(self.folder / "ray.npy")
            for value, colour, behind in zip(values, (0.25, 0.5, 1.0), (1.0, 0.0, 0.5)):
                self.assertAlmostEqual(value, scale * colour + through * behind, delta=1e-14)
            self.assertAlmostEqual(values[3], 1 - through, delta=1e-14)

    def test_the_same_bytes_on_any_number_of_threads(self):
        for threads in (1, 2, 7):
            self.render(f"{threads}.exr", "--float64", f"{threads}.npy", "--threads", threads)
        for name in ("exr", "npy", "png"):
            first, *others = [(self.folder / f"{threads}.{name}").read_bytes() for threads in (1, 2, 7)]
            for other in others:
                self.assertEqual(other, first, name)

    def test_previews_say_what_they_are(self):
        self.render("exact.exr", "--float64", "exact.npy")
        _, exact = read_npy(self.folder / "exact.npy")
        off = {}
        for words in (["m0"], ["m1"], ["m3"], ["m1", "--order", "exact"]):
            done = self.render("look.exr", "--float64", "look.npy", "--force", "--algorithm", "projected-tetrahedra", "--preview", *words,
                               "--report", "report.json")
            self.assertRegex(done.stdout, r"^look.exr: 256 x 256 pixels, 384 cells in ")
            order = "visibility" if "--order" in words else "their centroids, which may be wrong"
            self.assertIn(f"a preview, not the exact picture: 384 projected tetrahedra, {words[0]}, in the order of {order}\n", done.stdout)
            details = self.report()["details"]
            self.assertEqual([details[key] for key in ("cells_of_mesh", "tetrahedra", "tetrahedra_drawn", "tetrahedra_clipped")],
                             [384, 384, 384, 0])
            _, values = read_npy(self.folder / "look.npy")
            self.assertTrue(all(0.0 <= value <= 1.0 for value in values[3::4]))
            off[words[0]] = sum(abs(a - b) for a, b in zip(values, exact)) / len(exact)
        self.assertLess(off["m3"], 0.7 * off["m1"])
        self.assertLess(off["m1"], 0.9 * off["m0"])
        self.assertLess(off["m0"], 0.05)

    def test_a_preview_from_within_says_what_it_leaves_out(self):
        text = re.sub(r"eye = .*", "eye = [0.4, 0.45, 0.7]", CUBE)
        done = self.render("within.png", "--algorithm", "projected-tetrahedra", text=text)
        self.assertRegex(done.stdout, r"\d+ tetrahedra were cut along the axis; nothing nearer than \S+ mm is drawn\n")

    def test_previews_are_the_same_bytes_on_any_number_of_threads(self):
        for threads in (1, 2, 7):
            self.render(f"{threads}.exr", "--algorithm", "projected-tetrahedra", "--threads", threads)
        first, *others = [(self.folder / f"{threads}.exr").read_bytes() for threads in (1, 2, 7)]
        for other in others:
            self.assertEqual(other, first)

    def test_small_cells_are_spread(self):
        """Of a picture of 10 x 10 pixels most cells are splats; optical depths are those of many rays."""
        depths = {}
        text = CUBE.replace("[density]", "[density]\nscale = 0.01")
        for name, size, words in (("few", "10x10", ("--small-cells", "splatted")), ("many", "400x400", ())):
            done = self.render("mist.exr", "--float64", "mist.npy", "--size", size, "--force", "--algorithm", "cell-projection", *words,
                               "--report", "report.json", text=text)
            _, values = read_npy(self.folder / "mist.npy")
            side = int(size.split("x")[0])
            depths[name] = sum(-math.log1p(-value) for value in values[3::4]) / side**2
            n = self.report()["details"]["splats"]
            self.assertEqual("cells smaller than two pixels are splats: not exact\n" in done.stdout, n > 0)
            self.assertEqual(n > 300, name == "few")
        self.assertAlmostEqual(depths["few"], depths["many"], delta=0.02 * depths["many"])
        done = self.render("no.exr", "--small-cells", "splatted", returns=USAGE)
        self.assertIn("--algorithm ray-casting makes no splats", done.stderr)

    def test_what_is_not_exact_is_compared_with_it(self):
        errors = {}
        for name, words in (("cells", ("--algorithm", "cell-projection")), ("m0", ("--algorithm", "projected-tetrahedra", "--preview", "m0")),
                            ("m3", ("--algorithm", "projected-tetrahedra", "--preview", "m3")),
                            ("splats", ("--algorithm", "cell-projection", "--small-cells", "splatted"))):
            done = self.render("cells.exr", "--size", "48x48", "--compare", "off.png", "--report", "report.json", "--force", *words)
            reached = self.report()["reached"]
            errors[name] = max(reached[f"mean_error_{channel}"] for channel in ("red", "green", "blue", "opacity"))
            self.assertRegex(done.stdout, r"beside the exact picture, red: off by \S+ in the mean")
            self.assertEqual((self.folder / "off.png").read_bytes()[:4], b"\x89PNG")
        self.assertLess(errors["cells"], 1e-14)
        self.assertTrue(1e-3 < errors["m3"] < errors["m0"] < 0.2, errors)
        self.assertTrue(errors["splats"] < 0.1, errors)

    def test_what_does_not_go_with_a_preview_is_refused(self):
        for words, text, what in ((("--preview", "m1"), CUBE, "ray-casting is no preview"),
                                  (("--order", "exact", "--algorithm", "cell-projection"), CUBE, "cell-projection is no preview"),
                                  (("--algorithm", "projected-tetrahedra", "--max-error", "0.1"), CUBE, "--max-error: it goes with --algorithm ray-casting alone"),
                                  (("--algorithm", "projected-tetrahedra", "--seconds", "9"), CUBE, "--seconds: it goes with --algorithm ray-casting alone"),
                                  (("--algorithm", "projected-tetrahedra"), CUBE + '\n[[contour]]\nfield = "linear"\nvalue = 0.5\ncolour = [1, 1, 1]\nopacity = 0.5\n',
                                   "previews draw no contours")):
            done = self.render("no.exr", *words, text=text, returns=USAGE)
            self.assertIn(what, done.stderr)
            self.assertFalse((self.folder / "no.exr").exists())

    def test_the_flows_of_the_documents(self):
        data = SOURCE.parent / "shared/data/volume"
        if not data.is_dir():
            self.skipTest("needs ../shared/data/volume")
        scenes = re.findall(r"(?s)```toml\n(\[mesh\]\nfile = \"\w+xyz\.bin\".*?)```", (SOURCE / "docs/reference/volume-scene.md").read_text())
        self.assertEqual(len(scenes), 2)
        for scene in scenes:
            text = 'schema = 1\nname = "flow"\n\n' + re.sub(r'= "(\w+\.bin)"', rf'= "{data}/vtkdata_\1"', scene)
            self.render("flow.exr", "--float64", "flow.npy", "--size", "24x18", "--force", text=text)
            _, values = read_npy(self.folder / "flow.npy")
            self.assertGreater(max(values[3::4]), 0.5)
            self.assertTrue(all(math.isfinite(value) for value in values))

    def test_what_is_there_is_kept_without_force(self):
        for taken in ("mist.exr", "mist.png", "mist.npy"):
            with self.subTest(taken):
                (self.folder / taken).write_bytes(b"mine")
                before = self.files()
                refused = self.render("mist.exr", "--float64", "mist.npy", "--size", "8x8", returns=USAGE)
                self.assertIn(taken, refused.stderr)
                self.assertIn("--force", refused.stderr)
                self.assertEqual((self.folder / taken).read_bytes(), b"mine")
                self.assertEqual(sorted({*before, "scene.toml"}), self.files())
                self.render("mist.exr", "--float64", "mist.npy", "--size", "8x8", "--force")
                self.assertNotEqual((self.folder / taken).read_bytes(), b"mine")
                for name in ("mist.exr", "mist.png", "mist.npy"):
                    (self.folder / name).unlink()

    def test_names_that_are_no_outputs(self):
        for output, words in (("mist.jpx", ()), ("mist.exr", ("--float64", "mist.txt"))):
            self.render(output, *words, returns=USAGE)
        self.assertEqual(self.files(), ["cube.vtu", "scene.toml"])

    def test_an_error_that_is_allowed_is_told_and_held(self):
        dense = CUBE.replace('field = "linear"\n', 'field = "linear"\nscale = 30\n', 1)
        self.render("exact.tif", "--float64", "exact.npy", "--size", "40x40", text=dense)
        _, exact = read_npy(self.folder / "exact.npy")
        for allowed in (1e-2, 1e-6):
            done = self.render("ended.tif", "--float64", "ended.npy", "--size", "40x40", "--max-error", allowed, "--force",
                               "--report", "report.json", text=dense)
            self.assertRegex(done.stdout, r"\n\d+ rays ended where no more than \S+ could come from behind\n")
            report = self.report()
            self.assertEqual(report["asked"]["max_error"], allowed)
            self.assertLessEqual(report["reached"]["left_out"], allowed)
            self.assertGreater(report["details"]["opaque_rays"], 50)
            _, ended = read_npy(self.folder / "ended.npy")
            worst = max(abs(a - b) for i, (a, b) in enumerate(zip(exact, ended)) if i % 4 < 3)
            self.assertLessEqual(worst, report["reached"]["left_out"])
            self.assertGreater(worst, 0.0)

    MODES = ("gauss", "series", "paper", "approximate", "approximate-unsliced")

    def test_every_mode_tells_what_it_is_off_by(self):
        self.render("exact.tif", "--float64", "exact.npy", "--size", "40x40")
        _, exact = read_npy(self.folder / "exact.npy")
        seen = [i for i in range(0, len(exact), 4) if exact[i + 3] > 0.0]
        for mode in self.MODES:
            with self.subTest(mode):
                done = self.render(f"{mode}.tif", "--mode", mode, "--float64", f"{mode}.npy", "--size", "40x40", "--compare",
                                   f"{mode}-off.png", "--report", f"{mode}.json")
                report = self.report(f"{mode}.json")
                _, values = read_npy(self.folder / f"{mode}.npy")
                self.assertEqual(report["asked"]["mode"], mode)
                reached = report["reached"]
                self.assertEqual(report["details"]["pixels_compared"], len(seen))
                for k, name in enumerate(("red", "green", "blue", "opacity")):
                    off = sorted(abs(values[i + k] - exact[i + k]) for i in seen)
                    self.assertAlmostEqual(reached[f"mean_error_{name}"], sum(off) / len(off), delta=1e-12)
                    self.assertEqual(reached[f"error_at_99_percent_{name}"], off[math.ceil(0.99 * len(off)) - 1])
                    self.assertEqual(reached[f"worst_error_{name}"], off[-1])
                    self.assertRegex(done.stdout, rf"\nbeside the exact picture, {name}: off by \S+ in the mean, \S+ at 99 %, \S+ at worst\n")
                self.assertRegex(done.stdout, r"\nit took \S+ s, the exact one \S+ s\n")
                self.assertIn(f"\nby {mode}: ", done.stdout)
                worst = max(reached[f"worst_error_{name}"] for name in ("red", "green", "blue"))
                if mode in ("gauss", "series"):
                    self.assertLessEqual(worst, reached["error_bound"])
                    self.assertLess(reached["error_bound"], 1e-5)
                    self.assertRegex(done.stdout, r"red, green and blue are off by \S+ at most")
                else:
                    self.assertNotIn("error_bound", reached)
                    self.assertIn("no bound of its error is known: --compare measures it", done.stdout)
                    self.assertGreater(worst, 1e-9)
                self.assertEqual((self.folder / f"{mode}-off.png").read_bytes()[:4], b"\x89PNG")

    def test_more_points_and_smaller_pieces_are_nearer(self):
        worst = []
        for points, depth in ((1, 1), (2, 1), (2, 0.1), (5, 0.1)):
            self.render("gauss.tif", "--mode", "gauss", "--points", points, "--piece-depth", depth, "--size", "24x24", "--compare",
                        "off.exr", "--report", "report.json", "--force")
            report = self.report()
            self.assertEqual((report["asked"]["points"], report["asked"]["piece_depth"]), (points, depth))
            worst.append(report["reached"]["worst_error_red"])
        self.assertEqual(worst, sorted(worst, reverse=True))
        self.assertLess(worst[-1], 1e-3 * worst[0])

    def test_a_series_keeps_the_error_that_is_asked(self):
        terms = []
        for allowed in (1e-3, 1e-6, 1e-9):
            self.render("series.tif", "--mode", "series", "--max-error", allowed, "--size", "24x24", "--compare", "off.exr", "--report",
                        "report.json", "--force")
            report = self.report()
            self.assertLessEqual(report["reached"]["error_bound"], allowed)
            self.assertLessEqual(report["reached"]["worst_error_red"], report["reached"]["error_bound"])
            terms.append(report["details"]["terms"])
        self.assertEqual(terms, sorted(terms))

    def test_what_a_ray_that_ended_left_out_is_compared(self):
        dense = CUBE.replace('field = "linear"\n', 'field = "linear"\nscale = 30\n', 1)
        self.render("ended.tif", "--max-error", 1e-3, "--size", "24x24", "--compare", "off.tif", "--report", "report.json", text=dense)
        reached = self.report()["reached"]
        worst = max(reached[f"worst_error_{name}"] for name in ("red", "green", "blue"))
        self.assertLessEqual(worst, reached["left_out"])
        self.assertGreater(worst, 0.0)

    def test_failures_of_the_papers_formulas_are_told(self):
        clear = re.sub(r"(?s)points = .*?\n\n", "points = [[0.4, 0.0], [0.6, 2.0]]\n\n", CUBE, count=1)
        clear = clear.replace("[colour]\n", '[colour]\nglow = "own"\n')
        done = self.render("paper.tif", "--mode", "paper", "--float64", "paper.npy", "--size", "24x24", "--report", "report.json", text=clear)
        self.assertRegex(done.stdout, r"\nits formulas gave no number for [1-9]\d* segments \(written: their mean colour")
        self.assertGreater(self.report()["details"]["not_finite"], 0)
        _, values = read_npy(self.folder / "paper.npy")
        self.assertTrue(all(math.isfinite(value) for value in values))

    def test_modes_and_options_that_do_not_go_together(self):
        for words, named, cure in (
                (("--mode", "exact", "--compare", "off.png"), "--compare: ", "give --mode, --max-error or --algorithm"),
                (("--points", 3), "--points: ", "give --mode gauss"),
                (("--mode", "series", "--piece-depth", 1), "--piece-depth: ", "give --mode gauss"),
                (("--mode", "paper", "--max-error", 0.1), "--max-error: ", "give --mode exact or series"),
                (("--mode", "gauss", "--max-error", 0.1), "--max-error: ", "give --mode exact or series"),
                (("--mode", "gauss", "--points", 33), "--points", ""),
                (("--mode", "gauss", "--piece-depth", 0), "--piece-depth", ""),
                (("--mode", "simpson"), "--mode", "approximate-unsliced"),
                (("--mode", "paper", "--compare", "no.exr"), "no.exr", "file")):
            with self.subTest(words):
                refused = self.render("no.exr", *words, returns=USAGE)
                self.assertIn(named, refused.stderr)
                self.assertIn(cure, refused.stderr)
                self.assertEqual(self.files(), ["cube.vtu", "scene.toml"])

    def test_cells_projected_in_their_order_are_the_same_picture(self):
        self.render("rays.exr", "--float64", "rays.npy")
        done = self.render("cells.exr", "--float64", "cells.npy", "--algorithm", "cell-projection", "--report", "report.json")
        self.assertRegex(done.stdout, r"^cells.exr: 256 x 256 pixels, 384 cells; \S+ million stretches in \S+ s\n$")
        (_, rays), (_, cells) = read_npy(self.folder / "rays.npy"), read_npy(self.folder / "cells.npy")
        self.assertLessEqual(max(abs(a - b) for a, b in zip(rays, cells)), 1e-13)
        report = self.report()
        self.assertEqual(report["asked"]["algorithm"], "cell-projection")
        self.assertEqual(report["reached"], {"violations": 0.0})
        details = report["details"]
        self.assertEqual((details["cells_of_mesh"], details["cells_outside"], details["cells_transparent"]), (384, 0, 0))
        self.assertEqual((details["cyclic_components"], details["cyclic_cells"], details["pieces"]), (0, 0, 0))
        self.assertEqual(details["relations_by_boundary"], 0)  # the cube is convex
        self.assertEqual(details["relations_by_faces"], 672)  # (4 x 384 - 192)/2: all faces but the cube's own
        self.assertTrue(0 < details["tiles"] <= 64)
        self.render("again.exr", "--float64", "again.npy", "--algorithm", "cell-projection", "--threads", 3)
        self.assertEqual((self.folder / "again.npy").read_bytes(), (self.folder / "cells.npy").read_bytes())

    def test_rings_of_cells_are_named_and_split(self):
        points, n = [], 3
        for i in range(n):
            turn = 2 * math.pi * i / n
            for x, y, z in ((0.75, -2.5, -0.5), (0.875, -2.5, -0.52), (0.8125, 2.5, 0.5), (0.8, 2.5, 0.625)):
                points.append((x * math.cos(turn) - y * math.sin(turn), x * math.sin(turn) + y * math.cos(turn), z))
        (self.folder / "ring.vtk").write_text(
            "# vtk DataFile Version 2.0\nring\nASCII\nDATASET UNSTRUCTURED_GRID\nPOINTS 12 double\n"
            + "".join("%.17g %.17g %.17g\n" % point for point in points)
            + "CELLS 3 15\n" + "".join(f"4 {4 * i} {4 * i + 1} {4 * i + 2} {4 * i + 3}\n" for i in range(n))
            + "CELL_TYPES 3\n10\n10\n10\nPOINT_DATA 12\nSCALARS linear double 1\nLOOKUP_TABLE default\n"
            + "".join(f"{i / 11:g}\n" for i in range(12)))
        text = re.sub(r"(?s)\[camera\].*", "[camera]\nsize = [64, 64]\neye = [0, 0, 9]\ntarget = [0, 0, 0]\nup = [0, 1, 0]\n"
                      "width_mm = 6\n", CUBE.replace("cube.vtu", "ring.vtk"))
        self.render("rays.exr", "--float64", "rays.npy", text=text)
        done = self.render("cells.exr", "--float64", "cells.npy", "--algorithm", "cell-projection", "--report", "report.json",
                           text=text)
        self.assertRegex(done.stdout, r"\ncells 0, 1 and 2 hide parts of each other in a ring "
                                      r"\(\d > \d > \d > \d\): split into [45] pieces\n")
        details = self.report()["details"]
        self.assertEqual((details["cyclic_components"], details["cyclic_cells"]), (1, 3))
        self.assertGreater(details["pieces"], 3)
        (_, rays), (_, cells) = read_npy(self.folder / "rays.npy"), read_npy(self.folder / "cells.npy")
        self.assertGreater(max(rays[3::4]), 0.1)
        self.assertLessEqual(max(abs(a - b) for a, b in zip(rays, cells)), 1e-13)

    def test_a_picture_out_of_order_ends_with_1(self):
        """Two cells that overlap have no order: what rays refuse, the witness of the projection tells."""
        (self.folder / "two.vtk").write_text(
            "# vtk DataFile Version 2.0\ntwo\nASCII\nDATASET UNSTRUCTURED_GRID\nPOINTS 8 double\n"
            "0 0 0\n1 0 0\n0 1 0\n0 0 1\n0 0 0.1\n1 0 0.1\n0 1 0.1\n0 0 1.1\n"
            "CELLS 2 10\n4 0 1 2 3\n4 4 5 6 7\nCELL_TYPES 2\n10\n10\n"
            "POINT_DATA 8\nSCALARS linear double 1\nLOOKUP_TABLE default\n" + 8 * "0.5\n")
        text = re.sub(r"(?s)\[camera\].*", "[camera]\nsize = [16, 16]\neye = [0.2, 0.2, 9]\ntarget = [0.2, 0.2, 0]\nup = [0, 1, 0]\n"
                      "width_mm = 2\n", CUBE.replace("cube.vtu", "two.vtk"))
        told = self.render("two.exr", "--algorithm", "cell-projection", "--report", "report.json", text=text, returns=TARGET_MISSED)
        self.assertRegex(told.stderr, r"two.exr: \d+ stretches were drawn out of order, the picture is wrong: cell \d is nearer "
                                      r"than cell \d, which was drawn before it, in pixel \(\d+, \d+\)")
        self.assertGreater(self.report()["reached"]["violations"], 0)
        refused = self.render("no.exr", "--algorithm", "cell-projection", "--max-error", "0.1", text=text, returns=USAGE)
        self.assertIn("--max-error", refused.stderr)

    def test_broken_scenes_are_told_with_their_line(self):
        for old, new, where, said in (
                ('"linear"', '"linaer"', r"scene.toml:9: ", "its fields on points: 'linear'"),
                ("[0.3, 4.5]", "[0.3, -4.5]", r"scene.toml:10: ", "-4.5 is negative"),
                ("[0.3, 4.5], [0.55, 0.5]", "[0.55, 0.5], [0.3, 4.5]", r"scene.toml:10: ", "sort the rows"),
                ("fov_y_deg", "fov_deg", r"scene.toml:\d+: ", "did you mean fov_y_deg?"),
                ("cube.vtu", "absent.vtu", r"absent.vtu", ""),
                ("[density]", "[density", r"scene.toml:8:", "")):
            with self.subTest(new):
                text = CUBE.replace(old, new, 1)
                refused = self.render("no.exr", text=text, returns=BAD_INPUT)
                self.assertRegex(refused.stderr, where)
                self.assertIn(said, refused.stderr)
                self.assertIn("\n  hint: ", refused.stderr)
                self.assertEqual(self.files(), ["cube.vtu", "scene.toml"])
                checked = PROGRAMS.run("check", "scene.toml", cwd=self.folder)
                self.assertEqual(checked.returncode, BAD_INPUT)
                self.assertRegex(checked.stderr, where)
                self.assertIn(said, checked.stderr)

    def test_check_takes_volumes_for_what_they_are(self):
        good = PROGRAMS.run("check", VOLUMES / "cube.toml", SOURCE / "configs/scenes/stairs.toml",
                            "--report", "check.json", cwd=self.folder)
        self.assertEqual(good.returncode, DONE, good.stderr)
        self.assertIn(": a good volume: 384 cells, extinction of 'linear' on points, ", good.stdout)
        self.assertIn(": a good scene: ", good.stdout)
        report = json.loads((self.folder / "check.json").read_text())
        self.assertEqual(report["details"][str(VOLUMES / "cube.toml")], "volume")
        (self.folder / "bare.toml").write_text(CUBE.replace("[density]", "[densty]"))
        bare = PROGRAMS.run("check", "bare.toml", cwd=self.folder)
        self.assertEqual(bare.returncode, BAD_INPUT)
        self.assertIn("[density] is missing", bare.stderr)
        self.assertIn("did you mean density?", bare.stderr)
        forced = PROGRAMS.run("check", "--as", "volume", SOURCE / "configs/scenes/stairs.toml")
        self.assertEqual(forced.returncode, BAD_INPUT)
        self.assertIn("[density] is missing", forced.stderr)
        small = PROGRAMS.run("check", VOLUMES / "cube.toml", "--memory", "10K")
        self.assertEqual(small.returncode, BAD_INPUT)
        self.assertIn("--memory allows", small.stderr)

    def test_more_than_the_memory_is_refused(self):
        refused = self.render("no.exr", "--memory", "1M", returns=USAGE)
        self.assertIn("384 cells and 256 x 256 pixels need 6 MB; --memory allows 1", refused.stderr)
        self.assertEqual(self.files(), ["cube.vtu", "scene.toml"])
        self.render("small.exr", "--memory", "1M", "--size", "16x16")

    def test_faces_that_are_not_flat_are_told(self):
        corners = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1.125), (0, 1, 1)]
        (self.folder / "bent.vtk").write_text(
            "# vtk DataFile Version 2.0\nbent\nASCII\nDATASET UNSTRUCTURED_GRID\nPOINTS 8 double\n"
            + "".join("%g %g %g\n" % corner for corner in corners)
            + "CELLS 1 9\n8 0 1 2 3 4 5 6 7\nCELL_TYPES 1\n12\nPOINT_DATA 8\n"
            + "SCALARS linear double 1\nLOOKUP_TABLE default\n" + 8 * "0.5\n")
        done = self.render("bent.exr", "--report", "report.json", text=CUBE.replace("cube.vtu", "bent.vtk"))
        self.assertIn("1 face is not flat, by up to 0.03", done.stdout)
        self.assertEqual(self.report()["details"]["faces_not_flat"], 1)

    def test_a_plot3d_grid_with_its_solution(self):
        for name in ("duct.xyz", "duct.q"):
            shutil.copy(VOLUMES / name, self.folder)
        duct = """
[mesh]
file = "duct.xyz"
solution = "duct.q"
[density]
field = "density"
points = [[0.0, 1.0]]
[camera]
size = [16, 16]
eye = [5.0, 6.0, 7.0]
target = [0.0, 0.0, 0.0]
fov_y_deg = 60
"""
        self.render("duct.exr", "--report", "report.json", text=duct)
        self.assertTrue(any(name.endswith("duct.q") for name in self.report()["inputs"]))
        self.assertGreater(self.report()["details"]["cells_passed"], 0)
        refused = self.render("no.exr", text=duct.replace('"duct.xyz"', '"cube.vtu"'), returns=BAD_INPUT)
        self.assertIn("solution", refused.stderr)

    def test_cells_that_overlap_are_refused_without_a_picture(self):
        mesh = (self.folder / "cube.vtu").read_text()
        one = with_overlap(mesh)
        (self.folder / "cube.vtu").write_text(one)
        refused = self.render("no.exr", returns=BAD_INPUT)
        self.assertRegex(refused.stderr, r"cube.vtu: cells \d+ and \d+ overlap, in pixel ")
        self.assertEqual(self.files(), ["cube.vtu", "scene.toml"])

    def test_where_nothing_can_be_written(self):
        (self.folder / "file").write_text("")
        for output in ("absent/no.exr", "file/no.exr"):
            with self.subTest(output):
                refused = self.render(output, "--size", "8x8", returns=IO)
                self.assertIn(output, refused.stderr)
                self.assertIn("\n  hint: ", refused.stderr)

    def test_a_folder_that_may_only_be_read(self):
        (self.folder / "scene.toml").write_text(CUBE)
        before = self.files()
        self.folder.chmod(0o555)
        self.addCleanup(self.folder.chmod, 0o755)
        nobody = {"user": 65534} if os.geteuid() == 0 else {}  # root may write anywhere
        try:
            refused = subprocess.run(
                [PROGRAMS.haarlight, "render", "volume", "scene.toml", "-o", "no.exr", "--size", "8x8"],
                cwd=self.folder, capture_output=True, text=True, timeout=60, check=False, **nobody)
        except PermissionError:
            self.skipTest("only root may run the program")
        self.assertEqual(refused.returncode, IO, refused.stderr)
        self.assertIn("no.exr", refused.stderr)
        self.assertIn("\n  hint: ", refused.stderr)
        self.assertEqual(self.files(), before)

    def test_a_full_disk_leaves_no_part_of_a_picture(self):
        (self.folder / "scene.toml").write_text(CUBE)
        limited = subprocess.run(
            ["sh", "-c", 'ulimit -f 8; trap "" XFSZ; exec "$@"', "sh", PROGRAMS.haarlight, "render", "volume",
             "scene.toml", "-o", "mist.exr", "--float64", "mist.npy"],
            cwd=self.folder, capture_output=True, text=True, timeout=60, check=False)
        self.assertEqual(limited.returncode, IO, limited.stderr)
        self.assertEqual(self.files(), ["cube.vtu", "scene.toml"])


if __name__ == "__main__":
    PROGRAMS = Programs(sys.argv.pop(1))
    unittest.main()
