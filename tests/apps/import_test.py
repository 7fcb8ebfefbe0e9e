#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""A folder of pictures and a list of lights that disagree: `haarlight import` and `haarlight fit`
refuse or say so, and never give a light another's picture. import_test.py BIN, the build's folder
apps/."""

import json
import os
import pathlib
import shutil
import struct
import subprocess
import sys
import tempfile
import unittest

from programs import SOURCE, Programs, write_capture, write_png

USAGE = 2
BAD_INPUT = 65
SIZE = 8
NAMES = ["a.png", "b.png", "c.png", "d.png"]
PLACES = [".6 0 .8", "0 .6 .8", "-.6 0 .8", "0 -.6 .8"]


def value_of(name):
    """The grey of a picture: a.png 40, b.png 51 ... A light's frame shows whose picture it got."""
    return 40 + 11 * "abcdefghijklmnop".index(pathlib.PurePath(name).stem.lower())


def put(path, value=None):
    path.parent.mkdir(parents=True, exist_ok=True)
    write_png(path, SIZE, SIZE, lambda x, y: value_of(path.name) if value is None else value)


def lines(names, announced=None):
    return "\n".join([str(len(names) if announced is None else announced)] + [
        f"{name} {PLACES[k % 4]}" for k, name in enumerate(names)]) + "\n"


def link(path, target):
    path.unlink(missing_ok=True)
    path.symlink_to(target)


def cut(path):
    path.write_bytes(path.read_bytes()[:60])


# Name of the case: how the folder `in` and the list beside it come to disagree, the list, what is
# said. A case that ends well also names, light by light, whose picture each got.
REFUSED = {
    "the missing picture lies beside the list":
        (lambda f: (os.remove(f / "in/d.png"), put(f / "d.png")), lines(NAMES), "\"d.png\" is missing"),
    "a name leads above the folder":
        (lambda f: put(f / "e.png"), lines(NAMES[:3] + ["../e.png"]), "\"../e.png\" is missing"),
    "a name leads beside the folder":
        (lambda f: put(f / "other/e.png"), lines(NAMES[:3] + ["..\\other\\e.png"]), "is missing"),
    "the picture is a folder":
        (lambda f: (os.remove(f / "in/d.png"), (f / "in/d.png").mkdir()), lines(NAMES), "is missing"),
    "the picture is a link to nothing":
        (lambda f: link(f / "in/d.png", "nowhere.png"), lines(NAMES), "is missing"),
    "another ending": (lambda f: None, lines(["a.tif"] + NAMES[1:]), "is it \"a.png\""),
    "letters of two cases":
        (lambda f: put(f / "in/A.png"), lines(["a.PNG"] + NAMES[1:]), "may be"),
    "a picture listed twice": (lambda f: None, lines(["a.png", "a.png", "b.png"]), "listed twice"),
    "two names of one picture":
        (lambda f: link(f / "in/d.png", "a.png"), lines(NAMES), "are one picture"),
    "one picture saved twice":
        (lambda f: shutil.copy(f / "in/a.png", f / "in/d.png"), lines(NAMES), "the same bytes"),
    "no names, and a picture too many":
        (lambda f: None, "3\n.6 0 .8\n0 .6 .8\n-.6 0 .8\n", "4 pictures for 3 lights"),
    "no names, and a picture too few":
        (lambda f: os.remove(f / "in/b.png"), "4\n" + "\n".join(PLACES) + "\n", "3 pictures for 4"),
    "a list without its count":
        (lambda f: None, lines(NAMES).split("\n", 1)[1], "not a number of lights"),
    "positions or directions": (lambda f: None, lines(NAMES).replace(".8", "8"), "--places"),
    "a direction of nothing": (lambda f: None, lines(NAMES).replace("0 -.6 .8", "0 0 0"), "zero"),
    "an empty list": (lambda f: None, "4\n", "no lights"),
    "counted, but without a picture":
        (lambda f: None, lines(NAMES + ["e.png"]), "\"e.png\" is missing"),
}
# What only a reader of the pictures finds.
DAMAGED = {
    "a picture of another size":
        (lambda f: write_png(f / "in/d.png", 9, SIZE, lambda x, y: 7), lines(NAMES), "d.png"),
    "a picture cut off": (lambda f: cut(f / "in/d.png"), lines(NAMES), "d.png"),
    "an empty picture": (lambda f: (f / "in/d.png").write_bytes(b""), lines(NAMES), "d.png"),
    "a text with a picture's name":
        (lambda f: (f / "in/d.png").write_text("hello"), lines(NAMES), "d.png"),
}
SAID = {
    "another machine's folders":
        (lambda f: None, lines(["C:\\set\\" + name for name in NAMES]), "by the last part", NAMES),
    "a folder of exports":
        (lambda f: None, lines(["png-exports/" + name for name in NAMES]), "by the last part", NAMES),
    "letters of another case":
        (lambda f: None, lines([name.upper() for name in NAMES]), "another case", NAMES),
    "a picture that no light has":
        (lambda f: put(f / "in/e.png"), lines(NAMES), "e.png (--exclude", NAMES),
    "more lights announced": (lambda f: None, lines(NAMES, 7), "7 lights announced", NAMES),
    "fewer lights announced": (lambda f: None, lines(NAMES, 2), "2 lights announced", NAMES),
    "an uncounted line without a picture":
        (lambda f: None, lines(NAMES + ["e.png"], 4), "e.png: left out", NAMES),
    "the picture wanted lies in both folders":
        (lambda f: put(f / "sets/in/a.png", 9), lines(["sets/in/a.png"] + NAMES[1:]),
         "by the last part", NAMES),
    "one direction of another length":
        (lambda f: [put(f / f"in/{c}.png") for c in "efghij"],
         lines([f"{c}.png" for c in "abcdefghij"]).replace("\nc.png -.6 0 .8", "\nc.png -.3 0 .4"),
         "mistyped?", [f"{c}.png" for c in "abcdefghij"]),
}


class FolderAndList(unittest.TestCase):
    def setUp(self):
        self.programs = Programs(BIN)
        place = tempfile.TemporaryDirectory(prefix="haarlight-import.")
        self.addCleanup(place.cleanup)
        self.folder = pathlib.Path(place.name)

    def renew(self, change, text):
        for entry in self.folder.iterdir():
            shutil.rmtree(entry) if entry.is_dir() and not entry.is_symlink() else entry.unlink()
        for name in NAMES:
            put(self.folder / "in" / name)
        change(self.folder)
        (self.folder / "lights.lp").write_text(text)

    def run_verb(self, verb, *more):
        form = ["--basis", "bilinear"] if verb == "fit" else []
        return self.programs.run(verb, "in", "--lights", "lights.lp", "-o", "new", *form, *more,
                                 cwd=self.folder)

    def check_pictures(self, wanted):
        for k, name in enumerate(wanted):
            frame = (self.folder / f"new/frames/{k:06}_a0.tif").read_bytes()
            self.assertIn(bytes([value_of(name)]) * SIZE * SIZE, frame, name)
        self.assertEqual(len(list((self.folder / "new/frames").iterdir())), len(wanted))
        done = self.programs.run("verify", self.folder / "new")
        self.assertEqual(done.returncode, 0, done.stdout + done.stderr)

    def test_refused(self):
        for verb in ("import", "fit"):
            for name, (change, text, word) in {**REFUSED, **DAMAGED}.items():
                with self.subTest(verb=verb, case=name):
                    self.renew(change, text)
                    done = self.run_verb(verb)
                    self.assertEqual(done.returncode, BAD_INPUT, done.stderr)
                    self.assertIn("hint: ", done.stderr)
                    self.assertIn(word, done.stderr)
                    self.assertFalse((self.folder / "new").exists())

    def test_said(self):
        for name, (change, text, word, wanted) in SAID.items():
            with self.subTest(case=name):
                self.renew(change, text)
                done = self.run_verb("import")
                self.assertEqual(done.returncode, 0, done.stderr)
                self.assertIn(word, done.stderr)
                self.check_pictures(wanted)
                shutil.rmtree(self.folder / "new")
                done = self.run_verb("fit")
                self.assertEqual(done.returncode, 0, done.stderr)
                self.assertIn(word, done.stderr)
                shutil.rmtree(self.folder / "new")
                done = self.run_verb("import", "--strict")
                self.assertEqual(done.returncode, BAD_INPUT, done.stderr)
                self.assertFalse((self.folder / "new").exists())
                done = self.run_verb("fit", "--strict")
                self.assertEqual(done.returncode, BAD_INPUT, done.stderr)

    def test_pictures_from_another_folder_only_when_told(self):
        self.renew(lambda f: (os.remove(f / "in/d.png"), put(f / "other/d.png")), lines(NAMES))
        self.assertEqual(self.run_verb("import").returncode, BAD_INPUT)
        done = self.run_verb("import", "--pictures-from", "other")
        self.assertEqual(done.returncode, 0, done.stderr)
        self.assertIn("taken from other", done.stderr)
        self.check_pictures(NAMES)

    def test_a_verb_that_makes_something_says_what_opens_it(self):
        self.renew(lambda f: None, lines(NAMES))
        self.assertIn("next: haarlight fit new", self.run_verb("import").stderr)
        # What cannot be shown yet is met with the step that is missing.
        done = self.programs.run("view", "new", cwd=self.folder)
        self.assertEqual(done.returncode, BAD_INPUT)
        self.assertIn("haarlight compress new", done.stderr)
        done = self.programs.run("view", "in", cwd=self.folder)
        self.assertEqual(done.returncode, BAD_INPUT)
        self.assertIn("haarlight fit in --lights", done.stderr)
        # No grid of lights: the basis is chosen, and that is said with the folder's name.
        done = self.programs.run("compress", "new", "-o", "new.hlb", cwd=self.folder)
        self.assertEqual(done.returncode, 0, done.stderr)
        self.assertIn("new: its lights form no grids of rows and columns", done.stderr)
        self.assertIn("next: haarlight view new.hlb", done.stderr)
        done = self.programs.run("compress", "new", "-o", "haar.hlb", "--basis", "haar", cwd=self.folder)
        self.assertEqual(done.returncode, BAD_INPUT)
        self.assertIn(": new: ", done.stderr)  # the folder, not the session's hash
        done = self.programs.run("compress", "new", "-o", "whole.hlb", "--whole-steps", cwd=self.folder)
        self.assertEqual(done.returncode, BAD_INPUT)
        self.assertIn(": new: the values are no whole steps", done.stderr)
        done = self.programs.run("fit", "new", "-o", "web", "--basis", "bilinear", cwd=self.folder)
        self.assertIn("next: haarlight view web", done.stderr)
        # Quiet: results and errors alone.
        done = self.programs.run("compress", "new", "-o", "two.hlb", "--quiet", cwd=self.folder)
        self.assertNotIn("next:", done.stderr)

    def test_lights_in_a_grid_of_any_sides_become_wavelets(self):
        names = [f"{c}.png" for c in "abcdefghijklmno"]
        self.renew(lambda f: [put(f / "in" / name) for name in names[4:]], lines(names))
        self.assertEqual(self.run_verb("import", "--grid", "3x5").returncode, 0)
        done = self.programs.run("compress", "new", "-o", "wide.hlb", cwd=self.folder)
        self.assertEqual(done.returncode, 0, done.stderr)
        self.assertIn("15 lights; haar basis", done.stdout)
        self.assertNotIn("direct", done.stderr)
        done = self.programs.run("compress", "new", "-o", "all.hlb", "--max-error", "0", cwd=self.folder)
        self.assertEqual(done.returncode, 0, done.stderr)
        self.assertIn(b'"basis":"unbalanced haar"', (self.folder / "all.hlb").read_bytes())
        # Each light's picture, whole: grey and nothing else.
        for light, name in ((0, "a.png"), (7, "h.png"), (14, "o.png")):
            done = self.programs.run("relight", "all.hlb", "--light", str(light), "--against", "new",
                                     "-o", "one.exr", "--force", cwd=self.folder)
            self.assertEqual(done.returncode, 0, name + done.stderr)
            self.assertRegex(done.stdout, "against the session: relative error 0,|relative error [0-9.]*e-0[789]")
        done = self.programs.run("relight", "wide.hlb", "--lights", "0,7,14", "--max-error", "0.2",
                                 "-o", "three.exr", cwd=self.folder)
        self.assertEqual(done.returncode, 0, done.stderr)
        done = self.programs.run("bases", "wide.hlb", "-o", "bases", "--basis", "haar", "--basis", "direct", cwd=self.folder)
        self.assertEqual(done.returncode, 0, done.stderr)
        self.assertIn("Haar ", done.stdout)
        # What it recommends can be written, by the command that it prints.
        done = self.programs.run("bases", "new", "-o", "again", "--error", "0.02", "--size", "2", "--basis", "haar",
                                 "--basis", "dct", "--basis", "cdf53", "--basis", "direct", cwd=self.folder)
        self.assertEqual(done.returncode, 0, done.stderr)
        said = json.loads((self.folder / "again/bases.json").read_text())
        self.assertIn("CDF 5/3: no: it is not orthonormal", done.stdout)
        self.assertEqual({b["name"] for b in said["bases"] if b["compress_writes_it"]}, {"haar", "dct", "direct"})
        (found,) = said["recommended"]
        self.assertEqual(found["error"], 0.02)
        self.assertIn(found["command"], done.stdout)
        done = self.programs.run(*found["command"].split()[1:], cwd=self.folder)
        self.assertEqual(done.returncode, 0, done.stderr)
        self.assertIn(f"; {found['basis']} basis", done.stdout)
        done = self.programs.run("compress", "new", "-o", "dct.hlb", "--basis", "dct", cwd=self.folder)
        self.assertEqual(done.returncode, 0, done.stderr)
        self.assertIn("15 lights; dct basis", done.stdout)
        done = self.programs.run("relight", "dct.hlb", "--lights", "0,7,14", "--against", "new", "-o", "dct.exr",
                                 cwd=self.folder)
        self.assertEqual(done.returncode, 0, done.stderr)
        done = self.programs.run("compress", "new", "-o", "no.hlb", "--basis", "haar-standard", cwd=self.folder)
        self.assertEqual(done.returncode, BAD_INPUT)
        self.assertIn("--basis haar-standard: 3 x 5 lights: rows and columns must be powers of two", done.stderr)


def session_of(folder):
    return json.loads((folder / "session.json").read_text())


def floats_of(frame):
    """The samples of a session's frame of 32-bit floats."""
    data = frame.read_bytes()
    at = struct.unpack_from("<I", data, 4)[0]
    tags = {}
    for i in range(struct.unpack_from("<H", data, at)[0]):
        tag, kind, count, value = struct.unpack_from("<HHII", data, at + 2 + 12 * i)
        tags[tag] = (kind, count, value)
    strips = []
    for tag in (273, 279):  # offsets, bytes
        _, count, value = tags[tag]
        strips.append([value] if count == 1 else struct.unpack_from(f"<{count}I", data, value))
    return [v for begin, size in zip(*strips) for v in struct.unpack_from(f"<{size // 4}f", data, begin)]


class SmallRti(unittest.TestCase):
    """tests/data/small_rti: sixteen JPEGs with a grey card, whose truth its README tells."""

    CARD = "75,51,14,14"

    def setUp(self):
        self.programs = Programs(BIN)
        place = tempfile.TemporaryDirectory(prefix="haarlight-small-rti.")
        self.addCleanup(place.cleanup)
        self.folder = pathlib.Path(place.name)
        shutil.copytree(SOURCE / "tests/data/small_rti", self.folder / "set")

    def run_line(self, line, expected=0):
        done = self.programs.run(*line.split(), cwd=self.folder)
        self.assertEqual(done.returncode, expected, f"{line}\n{done.stdout}{done.stderr}")
        return done

    def check_session(self, name):
        self.run_line(f"verify {name}")
        done = subprocess.run([sys.executable, SOURCE / "docs/reference/verify_session.py", self.folder / name],
                              capture_output=True, text=True, check=False)
        self.assertEqual(done.returncode, 0, done.stdout + done.stderr)
        return session_of(self.folder / name)

    def test_it_is_small_and_complete(self):
        files = list((SOURCE / "tests/data/small_rti").iterdir())
        self.assertEqual(sum(f.suffix == ".jpg" for f in files), 16)
        self.assertLess(sum(f.stat().st_size for f in files), 60_000)

    def test_a_card_makes_the_warm_lamps_white(self):
        done = self.run_line(f"import set --lights set/relief.lp --white {self.CARD} -o s --report r.json")
        self.assertRegex(done.stderr, r"white: gains R 1\.0000, G 1\.2\d+, B 1\.8\d+, from 16 of 16 lights")
        info = self.check_session("s")
        # 8 bits, quality 88: flat blocks are coded by their mean, to half a step of the DC quantiser (2 of 8
        # x 8 means of 255 steps); 1 % of the value at blue's darkest, 0.12.
        for gain, truth in zip(info["form"]["gains"], (1.0, 1 / 0.8, 1 / 0.55)):
            self.assertAlmostEqual(gain, truth, delta=0.01 * truth)
        report = json.loads((self.folder / "r.json").read_text())
        self.assertEqual(report["reached"]["white lights used"], 16)
        self.assertLess(max(report["details"]["white scatter"]), 0.02)
        plan = json.loads((self.folder / "s/plan.json").read_text())
        self.assertEqual(plan["white"]["patch"], [75, 51, 14, 14])
        self.assertEqual(plan["white"]["gains"], info["form"]["gains"])

    def test_with_its_reflectance_shape_finds_the_cards_albedo(self):
        self.run_line(f"import set --lights set/relief.lp --white {self.CARD}=0.5 -o s")
        info = self.check_session("s")
        for gain, lamp in zip(info["form"]["gains"], (1.0, 0.8, 0.55)):
            self.assertAlmostEqual(gain * lamp, 1.0, delta=0.01)
        self.run_line("shape s -o shape")
        albedo = self.pixels_of("shape/albedo.exr")
        for place in ((77, 53), (82, 58), (87, 63)):
            for value in albedo(*place):
                self.assertAlmostEqual(value, 0.5, delta=0.01)

    def pixels_of(self, exr):
        """Its colour at (x, y), read through a session's plain frames."""
        folder = self.folder / "one"
        folder.mkdir()
        shutil.copy(self.folder / exr, folder / "one.exr")
        (self.folder / "one.lp").write_text("1\none.exr 0 0 1\n")
        self.run_line("import one --lights one.lp -o one.session")
        values = floats_of(self.folder / "one.session/frames/000000_a0.tif")
        return lambda x, y: values[(96 * y + x) * 3:(96 * y + x) * 3 + 3]

    def test_what_is_compressed_and_relit_has_the_gains(self):
        self.run_line(f"import set --lights set/relief.lp --white {self.CARD} -o s")
        self.run_line("compress s -o s.hlb --max-error 0.0001")
        self.run_line("relight s.hlb --light 3 --light 9=0.5 -o lit.exr")
        red, green, blue = self.pixels_of("lit.exr")(82, 58)
        self.assertGreater(red, 0.1)
        self.assertAlmostEqual(green / red, 1.0, delta=0.02)  # a code of 8 bits under each light
        self.assertAlmostEqual(blue / red, 1.0, delta=0.02)
        done = self.run_line("compress s -o whole.hlb --whole-steps", BAD_INPUT)
        self.assertIn("no whole steps", done.stderr)

    def test_a_patch_that_cannot_be_used_is_refused(self):
        for patch, code, word in (("90,50,14,14", USAGE, "96 x 72"), ("1,1,0,4", USAGE, "--white"),
                                  ("75,51,14,14=1.5", USAGE, "reflectance"), ("75,51,14,14=", USAGE, "reflectance"),
                                  ("75,51,14", USAGE, "X,Y,W,H")):
            done = self.run_line(f"import set --lights set/relief.lp --white {patch} -o s", code)
            self.assertIn(word, done.stderr)
        for level, word in ((255, "clipped under 2"), (1, "dark under 2")):
            rgb = self.folder / "flat"
            rgb.mkdir(exist_ok=True)
            for k in range(2):  # colour by TIFF, which the test can write: the card at one end of the range
                write_tiff(rgb / f"{k}.tif", 12, 9,
                           lambda x, y, k=k: [level] * 3 if x < 4 else [90 + k, 80 + x, 70 + y])
            (self.folder / "flat.lp").write_text("2\n0.tif 0 0 1\n1.tif .6 0 .8\n")
            done = self.run_line("import flat --lights flat.lp --white 0,0,4,9 -o s", BAD_INPUT)
            self.assertIn(word, done.stderr)
            self.assertIn("hint: ", done.stderr)
        self.assertFalse((self.folder / "s").exists())

    def test_a_lamp_of_another_colour_is_named(self):
        folder = self.folder / "lamps"
        folder.mkdir()
        for k in range(5):
            warm = 60 if k == 3 else 100
            write_tiff(folder / f"{k}.tif", 12, 9,
                       lambda x, y, k=k, warm=warm: [160 + k, 140 + k, warm] if x < 4 else [90 + k, x, y])
        (self.folder / "lamps.lp").write_text(
            "5\n" + "".join(f"{k}.tif {0.1 * k} 0 1\n" for k in range(5)))
        done = self.run_line("import lamps --lights lamps.lp --white 0,0,4,9 -o s")
        self.assertRegex(done.stderr, r"warning under light 3\.tif the white patch's colour is \d+ % off")

    def test_fit_states_what_it_is_worth(self):
        self.run_line(f"import set --lights set/relief.lp --white {self.CARD} -o s")
        for words, least in (("set --lights set/relief.lp", 40.5), ("s", 38.7)):
            done = self.run_line(f"fit {words} --basis hsh9 -o out.rti --report f.json")
            self.assertIn("file dB", done.stdout)
            found = json.loads((self.folder / "f.json").read_text())["reached"]["file dB"]
            self.assertGreater(found, least)  # measured: 40.8 and 39.0
            for name in ("f.json", "out.rti"):
                (self.folder / name).unlink()

    def test_fit_crops_as_import_does(self):
        crop = "10,6,48,60"
        self.run_line(f"import set --lights set/relief.lp --crop {crop} -o s")
        info = self.check_session("s")
        self.assertEqual(info["form"]["crop"], [10, 6, 96, 72])
        self.assertEqual((info["form"]["width"], info["form"]["height"]), (48, 60))
        self.run_line("fit s --basis ptm -o a.ptm")
        self.run_line(f"fit set --lights set/relief.lp --crop {crop} --basis ptm -o b.ptm")
        self.assertEqual((self.folder / "a.ptm").read_bytes(), (self.folder / "b.ptm").read_bytes())
        for verb in ("import", "fit"):
            for bad in ("0,0,97,72", "96,0,1,1", "0,0,0,5", "1,2,3"):
                done = self.run_line(f"{verb} set --lights set/relief.lp --crop {bad} -o none", USAGE)
                self.assertIn("--crop", done.stderr)
                self.assertIn("hint: ", done.stderr)
            self.assertIn("96 x 72", self.run_line(
                f"{verb} set --lights set/relief.lp --crop 0,0,97,72 -o none", USAGE).stderr)
        self.assertIn("haarlight import --crop", self.run_line("fit s --crop 0,0,4,4 -o none", USAGE).stderr)
        self.assertFalse((self.folder / "none").exists())

    def test_exrs_that_say_where_their_lights_are_need_no_list(self):
        """Directions and positions: export, import, export, import give the same."""
        write_capture(self.folder / "far", n_lights=9)
        write_capture(self.folder / "near", n_lights=9, scale=800.0)
        for name, places in (("far", "directions"), ("near", "positions")):
            self.run_line(f"import {name} --lights {name}/dirs.lp --places {places} -o {name}.0")
            for k in range(2):
                self.run_line(f"export {name}.{k} --lp -o {name}{k}.lp --exr {name}.exr{k}")
                done = self.run_line(f"import {name}.exr{k} -o {name}.{k + 1}")
                self.assertIn(f"each picture says where its light is ({places})", done.stderr)
            first, again = (self.check_session(f"{name}.{k}") for k in (1, 2))
            self.assertEqual([light["name"] for light in first["lights"]],
                             [f"light_{k:04}.exr" for k in range(9)])
            self.assertEqual(first["lights"], again["lights"])
            key = "direction" if name == "far" else "position_mm"
            for a, b in zip(session_of(self.folder / f"{name}.0")["lights"], first["lights"]):
                for x, y in zip(a[key], b[key]):
                    self.assertAlmostEqual(x, y, delta=1e-8 * max(1.0, abs(x)))  # nine digits
            self.assertEqual([f["evidence"]["pixel_hash"] for f in first["frames"]],
                             [f["evidence"]["pixel_hash"] for f in again["frames"]])
            grey = 40 / 255  # write_capture's first pixel
            self.assertAlmostEqual(floats_of(self.folder / f"{name}.1/frames/000000_a0.tif")[0],
                                   ((grey + 0.055) / 1.055) ** 2.4, delta=1e-6)
        # One that says nothing is named, and so is the way out.
        file = self.folder / "near.exr0/light_0004.exr"
        file.write_bytes(file.read_bytes().replace(b"haarlightLightFromObject", b"haarlightLightFromNowher"))
        done = self.run_line("import near.exr0 -o none", BAD_INPUT)
        self.assertIn("light_0004.exr", done.stderr)
        self.assertIn("--lights FILE", done.stderr)
        self.run_line("import near.exr0 --exclude 0004 -o eight")
        done = self.run_line("import set -o none", BAD_INPUT)
        self.assertIn("relief_00.jpg", done.stderr)
        self.assertIn("no list of lights", done.stderr)
        self.run_line("import near.exr0 --places positions -o none", USAGE)
        self.assertFalse((self.folder / "none").exists())

    def test_a_crop_survives_export_and_import(self):
        write_capture(self.folder / "near", n_lights=9, scale=800.0)
        self.run_line("import near --lights near/dirs.lp --places positions --crop 1,2,6,5 -o s")
        self.run_line("export s --lp -o s.lp --exr s.exr")
        self.run_line("import s.exr --crop 1,1,4,3 -o t")
        self.assertEqual(self.check_session("t")["form"]["crop"], [2, 3, 8, 8])
        done = self.run_line("calibrate t --target ball -o lights.json", BAD_INPUT)
        self.assertIn("without --crop", done.stderr)

    def test_frames_without_their_gains_are_not_passed_on_in_silence(self):
        self.run_line(f"import set --lights set/relief.lp --white {self.CARD} -o s")
        self.assertIn("gains", self.run_line("export s --lp -o raw.lp").stderr)
        self.assertNotIn("gains", self.run_line("export s --lp -o dev.lp --exr dev").stderr)


def write_tiff(path, width, height, value):
    """An 8-bit RGB picture; value(x, y) gives three codes."""
    pixels = bytes(c for y in range(height) for x in range(width) for c in value(x, y))
    tags = [(256, 4, 1, width), (257, 4, 1, height), (258, 3, 3, 8 + len(pixels)), (259, 3, 1, 1),
            (262, 3, 1, 2), (273, 4, 1, 8), (277, 3, 1, 3), (278, 4, 1, height), (279, 4, 1, len(pixels))]
    path.write_bytes(b"II*\0" + struct.pack("<I", 14 + len(pixels)) + pixels + struct.pack("<3H", 8, 8, 8) +
                     struct.pack("<H", len(tags)) + b"".join(struct.pack("<HHII", *tag) for tag in tags) +
                     struct.pack("<I", 0))


if __name__ == "__main__":
    BIN = sys.argv.pop(1)
    unittest.main()
