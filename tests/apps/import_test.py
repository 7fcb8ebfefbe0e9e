#!/usr/bin/env python3
"""A folder of pictures and a list of lights that disagree: `haarlight import` and `haarlight fit`
refuse or say so, and never give a light another's picture. import_test.py BIN, the build's folder
apps/."""

import os
import pathlib
import shutil
import sys
import tempfile
import unittest

from programs import Programs, write_png

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
    "places or directions": (lambda f: None, lines(NAMES).replace(".8", "8"), "--places"),
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
                    self.assertIn("cure: ", done.stderr)
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


if __name__ == "__main__":
    BIN = sys.argv.pop(1)
    unittest.main()
