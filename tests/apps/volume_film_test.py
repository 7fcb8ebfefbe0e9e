#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""`haarlight render volume` interrupted, killed, in parts, out of time and on a full disk: the same
bytes, or a named cause. volume_film_test.py BIN, the build's folder apps/. No rig is needed."""

import json
import math
import pathlib
import random
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import unittest

from picture_files import read_exr, read_npy, with_overlap
from programs import SOURCE, Programs

DONE, MISSED, USAGE, BAD_INPUT, IO, INTERRUPTED = 0, 1, 2, 65, 74, 75
VOLUMES = SOURCE / "configs/volumes"
SIZE = (600, 500)  # 19 x 16 tiles
OUTPUTS = ("exr", "png", "npy")


class Films(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.temporary = tempfile.TemporaryDirectory()
        cls.folder = pathlib.Path(cls.temporary.name)
        shutil.copy(VOLUMES / "cube.vtu", cls.folder)
        cls.scene = cls.folder / "scene.toml"
        cls.scene.write_text((VOLUMES / "cube.toml").read_text())
        begun = time.monotonic()
        cls.whole = cls.rendered("whole")
        cls.seconds = time.monotonic() - begun

    @classmethod
    def tearDownClass(cls):
        cls.temporary.cleanup()

    @classmethod
    def words(cls, *words, scene="scene.toml", size=SIZE, threads=1):
        # One thread: long enough to be interrupted.
        return ["render", "volume", scene, "--size", "%dx%d" % size, "--threads", str(threads), *map(str, words)]

    @classmethod
    def volume(cls, *words, returns=None, **options):
        done = PROGRAMS.run(*cls.words(*words, **options), cwd=cls.folder)
        if returns is not None and done.returncode != returns:
            raise AssertionError(f"{done.returncode}: {done.stdout}{done.stderr}")
        return done

    @classmethod
    def outputs(cls, name):
        return ["-o", f"{name}.exr", "--float64", f"{name}.npy"]

    @classmethod
    def bytes_of(cls, name):
        return {ending: (cls.folder / f"{name}.{ending}").read_bytes() for ending in ("film", *OUTPUTS)}

    @classmethod
    def rendered(cls, name, **options):
        """@return the bytes of the film and of all outputs"""
        cls.volume("--film", f"{name}.film", *cls.outputs(name), returns=DONE, **options)
        return cls.bytes_of(name)

    def start(self, *words, size=SIZE, **options):
        return subprocess.Popen([PROGRAMS.haarlight, *self.words(*words, size=size)], cwd=self.folder, text=True, **options)

    def interrupt(self, name, sign, *words):
        """Ends a render that has begun. @return  what it told"""
        process = self.start("--film", f"{name}.film", *self.outputs(name), *words, stdout=subprocess.PIPE,
                             stderr=subprocess.PIPE)
        while not (self.folder / f"{name}.film").exists():
            self.assertIsNone(process.poll())
            time.sleep(0.001)
        process.send_signal(sign)
        out, _ = process.communicate(timeout=60)
        self.assertEqual(process.returncode, INTERRUPTED, out)
        return out

    def test_a_film_changes_no_byte_of_the_picture(self):
        self.volume(*self.outputs("bare"), returns=DONE)
        for ending in OUTPUTS:
            self.assertEqual((self.folder / f"bare.{ending}").read_bytes(), self.whole[ending])
        for threads in (2, 7):
            self.assertEqual(self.rendered(f"threads{threads}", threads=threads), self.whole)

    def test_killed_at_20_moments_and_resumed(self):
        """While it renders, keeps its film and writes its outputs: each is whole or absent."""
        chance = random.Random(5)
        n_killed = n_begun = n_resumed = 0
        while n_killed < 20:
            process = self.start("--film", "killed.film", "--keep-every", "0.01", *self.outputs("killed"), "--quiet",
                                 stdout=subprocess.DEVNULL)
            time.sleep(chance.uniform(0.05, 1.0) * self.seconds)
            process.kill()
            is_done = process.wait() == DONE
            n_killed += not is_done
            film = self.folder / "killed.film"
            n_begun += film.exists()
            for ending in OUTPUTS:
                output = self.folder / f"killed.{ending}"
                if output.exists():
                    self.assertEqual(output.read_bytes(), self.whole[ending])
                    output.unlink()
            if is_done or chance.random() < 0.3:  # from what it left, with outputs of its own
                done = self.volume("--film", "killed.film", *self.outputs("resumed"), "--force", returns=DONE)
                n_resumed += "had been in killed.film" in done.stdout
                for ending in OUTPUTS:
                    self.assertEqual((self.folder / f"resumed.{ending}").read_bytes(), self.whole[ending])
                self.assertEqual(film.read_bytes(), self.whole["film"])
                film.unlink()
        self.assertGreater(n_begun, 10, "it is killed while it works")
        self.assertGreater(n_resumed, 2)
        self.assertEqual(self.rendered("killed"), self.whole)

    def test_killed_while_it_writes_its_outputs(self):
        """At the first, second ... file under its temporary name, and some time into it: what was there before, or what is to
        be there."""
        names = [f"over.{ending}" for ending in OUTPUTS]
        self.volume(*self.outputs("over"), size=(16, 16), returns=DONE)
        old = {name: (self.folder / name).read_bytes() for name in names}
        new = {f"over.{ending}": self.whole[ending] for ending in OUTPUTS}
        shutil.copy(self.folder / "whole.film", self.folder / "over.film")
        chance = random.Random(7)
        n_caught = 0
        for trial in range(40):
            for name in names:
                (self.folder / name).write_bytes(old[name])
            process = self.start("--film", "over.film", *self.outputs("over"), "--force", "--quiet", stdout=subprocess.DEVNULL)
            wanted = ("over.exr.tmp", "over.png.tmp", "over.npy.tmp", "over.film.tmp")[trial % 4] + str(process.pid)
            while not (self.folder / wanted).exists() and process.poll() is None:
                pass
            time.sleep(chance.choice((0.0, 0.0, 0.0005, 0.002)))
            process.kill()
            process.wait()
            n_caught += (self.folder / wanted).exists()
            for name in names:
                found = (self.folder / name).read_bytes()
                self.assertIn(found, (old[name], new[name]), name)
            self.assertEqual((self.folder / "over.film").read_bytes(), self.whole["film"])
            for left in self.folder.glob("over.*.tmp*"):
                left.unlink()
            if n_caught >= 10:
                break
        self.assertGreaterEqual(n_caught, 3, "it is killed while it writes")
        self.volume("--film", "over.film", *self.outputs("over"), "--force", returns=DONE)
        self.assertEqual(self.bytes_of("over"), self.whole)

    def test_a_mesh_that_changes_is_refused_or_harmless(self):
        mesh, scene = self.folder / "moved.vtu", self.folder / "moved.toml"
        cells = (self.folder / "cube.vtu").read_text()
        scene.write_text(self.scene.read_text().replace("cube.vtu", "moved.vtu"))
        for later in ("", "no mesh at all", cells[:len(cells) // 2]):
            mesh.write_text(cells)
            process = subprocess.Popen(
                [PROGRAMS.haarlight, *self.words("--film", "moved.film", *self.outputs("moved"), scene="moved.toml")],
                cwd=self.folder, stdout=subprocess.DEVNULL)
            while not (self.folder / "moved.film").exists():
                self.assertIsNone(process.poll())
                time.sleep(0.001)
            mesh.write_text(later)  # in its own file, not another one of its name
            self.assertEqual(process.wait(timeout=60), DONE)
            self.assertEqual(self.bytes_of("moved"), self.whole)
            for ending in ("film", *OUTPUTS):
                (self.folder / f"moved.{ending}").unlink()
        mesh.write_text(cells)
        process = subprocess.Popen([PROGRAMS.haarlight, *self.words("--film", "moved.film", scene="moved.toml")],
                                   cwd=self.folder, stdout=subprocess.DEVNULL)
        while not (self.folder / "moved.film").exists():
            self.assertIsNone(process.poll())
            time.sleep(0.001)
        process.kill()
        process.wait()
        film = (self.folder / "moved.film").read_bytes()
        field = re.search(r'Name="linear"[^>]*>\s*([-+.e\d]+)', cells)
        mesh.write_text(cells[:field.start(1)] + "0.0625" + cells[field.end(1):])
        refused = self.volume("--film", "moved.film", scene="moved.toml", returns=BAD_INPUT)
        self.assertRegex(refused.stderr, r"moved.film: the film is of another render: mesh is ")
        self.assertEqual((self.folder / "moved.film").read_bytes(), film)
        mesh.write_text(cells)
        self.volume("--film", "moved.film", *self.outputs("moved"), scene="moved.toml", returns=DONE)
        self.assertEqual(self.bytes_of("moved"), self.whole)

    def test_a_film_that_outgrows_its_disk_keeps_what_it_had(self):
        limited = subprocess.run(
            ["sh", "-c", 'ulimit -f 400; trap "" XFSZ; exec "$@"', "sh", PROGRAMS.haarlight,
             *self.words("--film", "outgrown.film", "--keep-every", "0.01", *self.outputs("outgrown"))], cwd=self.folder,
            capture_output=True, text=True, check=False)
        self.assertEqual(limited.returncode, IO, limited.stderr)
        self.assertIn("outgrown.film", limited.stderr)
        self.assertFalse((self.folder / "outgrown.exr").exists())
        self.assertLessEqual((self.folder / "outgrown.film").stat().st_size, 512 * 400)
        self.assertEqual(list(self.folder.glob("outgrown.film?*")), [])
        self.assertEqual(self.rendered("outgrown"), self.whole)

    def test_interrupted_it_says_so_and_goes_on(self):
        for name, sign in (("int", signal.SIGINT), ("term", signal.SIGTERM)):
            told = self.interrupt(name, sign)
            self.assertRegex(told, rf"^{name}.film: interrupted, \d+ of 304 tiles rendered; the same command goes on\n")
            self.assertFalse((self.folder / f"{name}.exr").exists())
            self.assertEqual(self.rendered(name), self.whole)

    def test_three_parts_are_the_picture(self):
        for part in (3, 1, 2):
            self.volume("--part", f"{part}/3", "--film", f"part{part}.film", returns=DONE)

        def join(*films, output="joined", returns=DONE):
            done = PROGRAMS.run("render", "join", *films, *self.outputs(output), cwd=self.folder)
            self.assertEqual(done.returncode, returns, done.stderr)
            return done

        missing = join("part1.film", "part3.film", returns=BAD_INPUT)
        self.assertIn("parts of the picture are missing: 101 of 304 tiles", missing.stderr)
        self.assertFalse((self.folder / "joined.exr").exists())
        self.assertIn("part1.film", join("part1.film", "part1.film", returns=BAD_INPUT).stderr)
        join("part2.film", "part3.film", "part1.film")
        join("whole.film", output="alone")
        for name in ("joined", "alone"):
            for ending in OUTPUTS:
                self.assertEqual((self.folder / f"{name}.{ending}").read_bytes(), self.whole[ending])
        other = self.volume("--part", "2/3", "--film", "part1.film", returns=BAD_INPUT)
        self.assertIn("part 1/3", other.stderr)
        refused = PROGRAMS.run("render", "join", "whole.film", "-o", "no.exr", "--error", "no.tif", cwd=self.folder)
        self.assertEqual(refused.returncode, USAGE, refused.stderr)
        self.assertIn("no standard error", refused.stderr)

    def test_films_of_surfaces_and_volumes_are_kept_apart(self):
        box = SOURCE / "configs/scenes/cornell.toml"
        words = ("render", "surface", box, "--size", "40x40", "--spp", 2)
        self.assertEqual(PROGRAMS.run(*words, "--film", "box.film", cwd=self.folder).returncode, DONE)
        refused = self.volume("--film", "box.film", returns=BAD_INPUT)
        self.assertIn("of another render", refused.stderr)
        refused = PROGRAMS.run("render", "join", "box.film", "whole.film", "-o", "no.exr", cwd=self.folder)
        self.assertEqual(refused.returncode, BAD_INPUT)
        refused = PROGRAMS.run("render", "join", "box.film", "-o", "no.exr", "--float64", "no.npy", cwd=self.folder)
        self.assertEqual(refused.returncode, USAGE)
        self.assertIn("--float64", refused.stderr)
        refused = PROGRAMS.run(*words, "--film", "whole.film", cwd=self.folder)
        self.assertEqual(refused.returncode, BAD_INPUT)
        self.assertEqual((self.folder / "whole.film").read_bytes(), self.whole["film"])

    def test_a_film_of_another_picture_is_refused_and_kept(self):
        text = self.scene.read_text()
        other, mesh = self.folder / "other.toml", self.folder / "other.vtu"
        cells = (self.folder / "cube.vtu").read_text()
        field = re.search(r'Name="linear"[^>]*>\s*([-+.e\d]+)', cells)
        mesh.write_text(cells[:field.start(1)] + "0.0625" + cells[field.end(1):])
        for old, new, cause in (("4.5]", "4.6]", "looks is "), ("0.9, 0.1, 0.2", "0.9, 0.1, 0.3", "looks is "),
                                ("fov_y_deg = 32", "fov_y_deg = 33", "camera is "), ("cube.vtu", "other.vtu", "mesh is ")):
            self.assertIn(old, text)
            other.write_text(text.replace(old, new, 1))
            refused = self.volume("--film", "whole.film", scene="other.toml", returns=BAD_INPUT)
            self.assertRegex(refused.stderr, rf"whole.film: the film is of another render: {cause}\S+ there, \S+ here")
        refused = self.volume("--film", "whole.film", "--max-error", 0.5, returns=BAD_INPUT)
        self.assertIn("max_error is 0 there, 0.5 here", refused.stderr)
        refused = self.volume("--film", "whole.film", size=(300, 250), returns=BAD_INPUT)
        self.assertIn("camera is ", refused.stderr)
        self.assertEqual((self.folder / "whole.film").read_bytes(), self.whole["film"])
        # What changes no pixel is no other picture.
        other.write_text("# Seen again\n" + text)
        self.volume("--film", "whole.film", scene="other.toml", returns=DONE)

    def test_out_of_time_what_is_missing_is_told_and_seen(self):
        large = (1000, 900)
        words = ("--film", "late.film")
        seconds, rendered = 0.03, 0
        while rendered == 0:  # it may have been late before its first tile
            done = self.volume(*words, *self.outputs("late"), "--seconds", seconds, "--report", "late.json", "--force", size=large,
                               returns=MISSED)
            told = re.search(r"the time ended it: (\d+) of (\d+) tiles rendered, the others are NaN in the picture, "
                             r"hatched in a .png; with --force the same command goes on\n", done.stdout)
            self.assertTrue(told, done.stdout)
            rendered, tiles = map(int, told.groups())
            seconds *= 1.5
        self.assertEqual(tiles, 32 * 29)
        self.assertLess(rendered, tiles)
        report = json.loads((self.folder / "late.json").read_text())["reached"]
        self.assertEqual((report["missing_tiles"], report["ended_by"]), (tiles - rendered, "time"))
        width, height, channels = read_exr(self.folder / "late.exr")
        self.assertEqual((width, height), large)
        missing = [math.isnan(value) for value in channels["A"]]
        for name in "RGB":
            self.assertEqual([math.isnan(value) for value in channels[name]], missing, name)
        n_missing = sum(missing)
        self.assertTrue((tiles - rendered - 61) * 1024 < n_missing <= (tiles - rendered) * 1024)
        _, values = read_npy(self.folder / "late.npy")
        self.assertEqual([math.isnan(value) for value in values[::4]], missing)
        png = (self.folder / "late.png").read_bytes()
        again = self.volume(*words, "--seconds", "100", *self.outputs("late"), "--force", size=large, returns=DONE)
        self.assertRegex(again.stdout, rf"{rendered} of {tiles} tiles had been in late.film")
        self.volume(*self.outputs("timely"), size=large, returns=DONE)
        for ending in OUTPUTS:
            self.assertEqual((self.folder / f"late.{ending}").read_bytes(), (self.folder / f"timely.{ending}").read_bytes())
        self.assertNotEqual((self.folder / "late.png").read_bytes(), png)

    def test_rays_that_ended_are_told_of_all_runs(self):
        dense = self.scene.read_text().replace('field = "linear"\n', 'field = "linear"\nscale = 30\n', 1)
        (self.folder / "dense.toml").write_text(dense)
        words = ("--max-error", 1e-3, "--film", "ended.film")
        first = self.volume(*words, "-o", "ended.tif", scene="dense.toml", returns=DONE)
        line = re.search(r"\d+ rays ended where no more than \S+ could come from behind\n", first.stdout)[0]
        again = self.volume(*words, "-o", "again.tif", "--report", "again.json", scene="dense.toml", returns=DONE)
        self.assertIn(line, again.stdout)
        left_out = json.loads((self.folder / "again.json").read_text())["reached"]["left_out"]
        self.assertTrue(0 < left_out <= 1e-3)
        joined = PROGRAMS.run("render", "join", "ended.film", "-o", "joined.tif", cwd=self.folder)
        self.assertIn(line.split(" could")[0].rsplit(" ", 1)[0], joined.stdout)

    def test_an_overlap_that_a_killed_run_has_met_is_not_lost(self):
        mesh = with_overlap((self.folder / "cube.vtu").read_text())
        (self.folder / "overlap.vtu").write_text(mesh)
        (self.folder / "overlap.toml").write_text(self.scene.read_text().replace("cube.vtu", "overlap.vtu"))
        told = set()
        for _ in range(2):  # the second finds all tiles rendered
            refused = self.volume("--film", "overlap.film", "-o", "no.exr", scene="overlap.toml", returns=BAD_INPUT)
            told.add(re.search(r"overlap.vtu: cells \d+ and \d+ overlap, in pixel .*", refused.stderr)[0])
        self.assertEqual(len(told), 1)
        joined = PROGRAMS.run("render", "join", "overlap.film", "-o", "no.exr", cwd=self.folder)
        self.assertEqual(joined.returncode, BAD_INPUT)
        self.assertIn("cells overlap, in pixel ", joined.stderr)
        self.assertFalse((self.folder / "no.exr").exists())

    def test_words_that_do_not_fit(self):
        for words, cause in ((["--part", "1/3", "-o", "a.exr"], "--film"), (["--part", "0/3", "--film", "a"], "--part"),
                             ([], "-o"), (["-o", "a.png", "--keep-every", "5"], "--film"),
                             (["--film", "a", "--float64", "a.npy"], "-o")):
            self.assertIn(cause, self.volume(*words, returns=USAGE).stderr)
        self.assertFalse((self.folder / "a").exists())
        refused = self.volume("--film", "absent/a.film", returns=IO)
        self.assertIn("absent", refused.stderr)

    def test_a_full_disk_costs_no_tiles(self):
        """The film's folder takes no more while it renders, then again does."""
        held = self.folder / "held"
        held.mkdir()
        process = self.start("--film", "held/a.film", "--keep-every", "0.01", stdout=subprocess.PIPE, stderr=subprocess.PIPE)
        while not (held / "a.film").exists():
            self.assertIsNone(process.poll())
            time.sleep(0.001)
        held.rename(self.folder / "away")
        told = any("the film is not kept yet" in line for line in process.stderr)
        (self.folder / "away").rename(held)
        _, problems = process.communicate(timeout=120)
        self.assertTrue(told)
        self.assertIn(process.returncode, (DONE, IO), problems)
        self.volume("--film", "held/a.film", returns=DONE)
        self.assertEqual((held / "a.film").read_bytes(), self.whole["film"])

    def test_outputs_on_a_full_disk(self):
        """The old picture stays, whole, and the film goes on."""
        self.volume("-o", "old.exr", size=(16, 16), returns=DONE)
        old = (self.folder / "old.exr").read_bytes()
        limited = subprocess.run(
            ["sh", "-c", 'ulimit -f 8; trap "" XFSZ; exec "$@"', "sh", PROGRAMS.haarlight,
             *self.words("-o", "old.exr", "--force")], cwd=self.folder, capture_output=True, text=True, check=False)
        self.assertEqual(limited.returncode, IO, limited.stderr)
        self.assertEqual((self.folder / "old.exr").read_bytes(), old)
        self.assertEqual([path.name for path in self.folder.glob("old.exr?*")], [])

    def test_one_process_at_a_film(self):
        first = self.start("--film", "busy.film", "--quiet", size=(4000, 4000), stdout=subprocess.DEVNULL)
        try:
            while not (self.folder / "busy.film").exists():
                self.assertIsNone(first.poll())
                time.sleep(0.001)
            second = self.volume("--film", "busy.film", returns=INTERRUPTED)
            self.assertIn("another haarlight render is at work on this film", second.stderr)
        finally:
            first.kill()
            first.wait()


if __name__ == "__main__":
    PROGRAMS = Programs(sys.argv.pop(1))
    unittest.main()
