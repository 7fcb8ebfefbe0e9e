#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""`haarlight render` interrupted, in parts and on a full disk: the same bytes, or a named cause.
render_test.py BIN, the build's folder apps/. No rig is needed."""

import json
import pathlib
import random
import re
import signal
import struct
import subprocess
import sys
import tempfile
import time
import tomllib
import unittest

from picture_files import read_exr
from programs import SOURCE, Programs, write_png

DONE, USAGE, BAD_INPUT, IO, INTERRUPTED = 0, 2, 65, 74, 75
SAMPLES = 160


def write_float_tif(path, width, height, values):
    """Three colours of floats, in one strip."""
    tags = [(256, 4, width), (257, 4, height), (258, 3, 32), (259, 3, 1), (262, 3, 2), (273, 4, 0), (277, 3, 3),
            (278, 4, height), (279, 4, 4 * len(values)), (339, 3, 3)]
    end = 8 + 2 + 12 * len(tags) + 4
    data = struct.pack("<2sHIH", b"II", 42, 8, len(tags))
    for tag, kind, value in tags:
        if tag in (258, 339):  # one of each colour, after the tags
            data += struct.pack("<HHII", tag, kind, 3, end + (0 if tag == 258 else 6))
        else:
            data += struct.pack("<HHII", tag, kind, 1, end + 12 if tag == 273 else value)
    path.write_bytes(data + struct.pack("<I3H3H", 0, 32, 32, 32, 3, 3, 3) + struct.pack(f"<{len(values)}f", *values))


class Films(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.temporary = tempfile.TemporaryDirectory()
        cls.folder = pathlib.Path(cls.temporary.name)
        text = (SOURCE / "configs/scenes/cornell.toml").read_text()
        cls.scene = cls.folder / "box.toml"
        cls.scene.write_text(text.replace("size = [256, 256]", "size = [150, 100]"))
        begun = time.monotonic()
        cls.whole = cls.rendered("whole")
        cls.seconds = time.monotonic() - begun

    @classmethod
    def tearDownClass(cls):
        cls.temporary.cleanup()

    @classmethod
    def surface(cls, *words, **options):
        return PROGRAMS.run("render", "surface", cls.scene, "--spp", SAMPLES, *words, cwd=cls.folder, **options)

    @classmethod
    def rendered(cls, name, *words):
        """@return the bytes of the film and of the picture"""
        done = cls.surface("--film", f"{name}.film", "-o", f"{name}.exr", *words)
        if done.returncode != DONE:
            raise AssertionError(done.stderr)
        return (cls.folder / f"{name}.film").read_bytes(), (cls.folder / f"{name}.exr").read_bytes()

    def test_the_same_bytes_for_any_number_of_threads(self):
        for threads in (1, 2, 7):
            self.assertEqual(self.rendered(f"threads{threads}", "--threads", threads), self.whole)

    def test_killed_at_20_moments_and_resumed(self):
        chance = random.Random(5)
        film, picture = self.folder / "killed.film", self.folder / "killed.exr"
        n_killed = n_begun = 0
        while n_killed < 20:
            process = subprocess.Popen(
                [PROGRAMS.haarlight, "render", "surface", self.scene, "--spp", str(SAMPLES), "--film", film,
                 "--keep-every", "0.01", "-o", picture, "--quiet"], cwd=self.folder, stdout=subprocess.DEVNULL)
            time.sleep(chance.uniform(0.02, 0.2) * self.seconds)
            process.kill()
            if process.wait() == DONE:  # it was sooner; from the beginning
                self.assertEqual((film.read_bytes(), picture.read_bytes()), self.whole)
                film.unlink()
                picture.unlink()
                picture.with_suffix(".png").unlink()
                continue
            n_killed += 1
            n_begun += film.exists()
            if picture.exists():  # whole, if at all
                self.assertEqual(picture.read_bytes(), self.whole[1])
                picture.unlink()
                picture.with_suffix(".png").unlink(missing_ok=True)
        self.assertGreater(n_begun, 10, "it is killed while it works")
        self.assertEqual(self.rendered("killed"), self.whole)

    def test_an_interrupted_render_says_so_and_goes_on(self):
        process = subprocess.Popen(
            [PROGRAMS.haarlight, "render", "surface", self.scene, "--spp", str(SAMPLES), "--film", "ended.film",
             "-o", "ended.exr"], cwd=self.folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        while not (self.folder / "ended.film").exists():
            self.assertIsNone(process.poll())
            time.sleep(0.01)
        time.sleep(0.05)
        process.send_signal(signal.SIGINT)
        out, _ = process.communicate(timeout=60)
        self.assertEqual(process.returncode, INTERRUPTED)
        self.assertRegex(out, r"interrupted, .* samples each; the same command goes on")
        self.assertFalse((self.folder / "ended.exr").exists())
        self.assertEqual(self.rendered("ended"), self.whole)

    def test_three_parts_are_the_picture(self):
        for part in (3, 1, 2):
            done = self.surface("--part", f"{part}/3", "--film", f"part{part}.film")
            self.assertEqual(done.returncode, DONE, done.stderr)
        missing = PROGRAMS.run("render", "join", "part1.film", "part3.film", "-o", "joined.exr", cwd=self.folder)
        self.assertEqual(missing.returncode, BAD_INPUT)
        self.assertIn("parts of the picture are missing", missing.stderr)
        twice = PROGRAMS.run("render", "join", "part1.film", "part1.film", "-o", "joined.exr", cwd=self.folder)
        self.assertEqual(twice.returncode, BAD_INPUT)
        self.assertIn("part1.film", twice.stderr)
        joined = PROGRAMS.run("render", "join", "part2.film", "part3.film", "part1.film", "-o", "joined.exr",
                              cwd=self.folder)
        self.assertEqual(joined.returncode, DONE, joined.stderr)
        self.assertEqual((self.folder / "joined.exr").read_bytes(), self.whole[1])
        other = self.surface("--part", "2/3", "--film", "part1.film")
        self.assertEqual(other.returncode, BAD_INPUT)
        self.assertIn("part 1/3", other.stderr)

    def test_more_samples_later(self):
        for samples in (10, SAMPLES):
            done = PROGRAMS.run("render", "surface", self.scene, "--spp", samples, "--film", "more.film",
                                cwd=self.folder)
            self.assertEqual(done.returncode, DONE, done.stderr)
        self.assertEqual((self.folder / "more.film").read_bytes(), self.whole[0])

    def test_a_film_of_another_render_is_refused_and_kept(self):
        for words, cause in ((["--seed", 5], "seed is 0 there, 5 here"),
                             (["--integrator", "direct"], "integrator is path there, direct here"),
                             (["--part", "1/2"], "parts is 1 there, 2 here")):
            shown = self.surface("--film", "whole.film", *words)
            self.assertEqual(shown.returncode, BAD_INPUT)
            self.assertIn(cause, shown.stderr)
            self.assertIn("whole.film", shown.stderr)
        changed = self.folder / "changed.toml"
        changed.write_text(self.scene.read_text().replace("17", "18", 1))
        self.assertNotEqual(changed.read_text(), self.scene.read_text())
        shown = PROGRAMS.run("render", "surface", changed, "--film", "whole.film", cwd=self.folder)
        self.assertEqual(shown.returncode, BAD_INPUT)
        self.assertIn("scene is ", shown.stderr)
        (self.folder / "text.film").write_text("my notes, which are not a film, and long enough to look like one")
        shown = self.surface("--film", "text.film")
        self.assertEqual(shown.returncode, BAD_INPUT)
        self.assertIn("not a film", shown.stderr)
        self.assertEqual((self.folder / "whole.film").read_bytes(), self.whole[0])

    def test_integrators_by_rays_do_not_depend_on_threads_or_interruptions(self):
        for integrator in ("ray-casting", "whitted"):
            films = []
            for name, threads, counts in (("a", 1, (6,)), ("b", 2, (2, 6))):
                for samples in counts:
                    done = PROGRAMS.run("render", "surface", self.scene, "--integrator", integrator, "--spp", samples,
                                        "--threads", threads, "--film", f"{integrator}-{name}.film", cwd=self.folder)
                    self.assertEqual(done.returncode, DONE, done.stderr)
                films.append((self.folder / f"{integrator}-{name}.film").read_bytes())
            self.assertEqual(films[0], films[1])

    def bidirectional(self, name, samples, *words):
        done = PROGRAMS.run("render", "surface", self.scene, "--integrator", "bidirectional", "--spp", samples, "--film",
                            f"{name}.film", *words, cwd=self.folder)
        self.assertEqual(done.returncode, DONE, done.stderr)
        return (self.folder / f"{name}.film").read_bytes()

    def test_splats_do_not_depend_on_threads_parts_or_interruptions(self):
        whole = self.bidirectional("light1", 24, "--threads", 1, "-o", "light1.exr")
        for threads in (2, 7):
            self.assertEqual(self.bidirectional(f"light{threads}", 24, "--threads", threads), whole)
        for samples in (3, 7, 24):
            later = self.bidirectional("later", samples)
        self.assertEqual(later, whole)
        for part in (2, 3, 1):
            self.bidirectional(f"light-part{part}", 24, "--part", f"{part}/3")
        joined = PROGRAMS.run("render", "join", *[f"light-part{part}.film" for part in (3, 1, 2)], "-o", "light.exr",
                              cwd=self.folder)
        self.assertEqual(joined.returncode, DONE, joined.stderr)
        self.assertEqual((self.folder / "light.exr").read_bytes(), (self.folder / "light1.exr").read_bytes())

    def test_the_caustic_box_is_the_one_that_renderers_share(self):
        shared = SOURCE.parent / "shared/data/cornell/cornell_caustic.json"
        if not shared.exists():
            self.skipTest(f"{shared} is not there")
        box = json.loads(shared.read_text())
        ours = tomllib.loads((SOURCE / "configs/scenes/cornell_caustic.toml").read_text())
        materials = {one["name"]: one for one in ours["material"]}

        def turned(point):  # y up there, z up here
            return [point[0], -point[2], point[1]]
        quads = [(quad["corners"], materials[quad["material"]]["kd"], materials[quad["material"]].get("emits"))
                 for quad in ours["quad"]]
        self.assertEqual(quads, [([turned(corner) for corner in corners], albedo, emitted)
                                 for _, corners, albedo, emitted in box["quads"]])
        for ball, sphere in zip(box["spheres"], ours["sphere"], strict=True):
            its = materials[sphere["material"]]
            self.assertEqual((sphere["centre"], sphere["radius"], its["bsdf"], sphere["exact"]),
                             (turned(ball["centre"]), ball["radius"], ball["material"], True))
            for key in ("ior", "reflectance"):
                self.assertEqual(its.get(key), ball.get(key))
        camera = ours["camera"]
        self.assertEqual([camera["eye"], camera["target"], camera["up"], camera["fov_y_deg"]],
                         [turned(box["eye"]), turned(box["look"]), turned(box["up"]), box["fov_deg"]])

    def test_a_bidirectional_render_is_killed_and_goes_on(self):
        whole = self.bidirectional("unharmed", 60)
        film = self.folder / "harmed.film"
        for part in range(6):
            process = subprocess.Popen(
                [PROGRAMS.haarlight, "render", "surface", self.scene, "--integrator", "bidirectional", "--spp", "60",
                 "--film", film, "--keep-every", "0.01", "--quiet"], cwd=self.folder, stdout=subprocess.DEVNULL)
            while not film.exists():
                time.sleep(0.01)
            time.sleep(0.05 * part)
            process.kill()
            process.wait()
        self.assertEqual(self.bidirectional("harmed", 60), whole)

    def test_an_irradiance_cache_does_not_depend_on_threads_interruptions_or_parts(self):
        words = ("--integrator", "irradiance-cache", "--accuracy", "0.5", "--gather-rays", "32")
        films = []

        def cached(samples, *more):
            done = PROGRAMS.run("render", "surface", self.scene, *words, "--spp", samples, *more, cwd=self.folder)
            self.assertEqual(done.returncode, DONE, done.stderr)
            self.assertRegex(done.stdout, r"irradiance cache: \d+ records, .* biased: ")

        for name, threads, counts in (("a", 1, (6,)), ("b", 2, (2, 6))):
            for samples in counts:
                cached(samples, "--threads", threads, "--film", f"cache-{name}.film")
            films.append((self.folder / f"cache-{name}.film").read_bytes())
        self.assertEqual(films[0], films[1])
        for part in ("1/2", "2/2"):
            cached(6, "--part", part, "--film", f"cache-{part[0]}.film")
        for picture, parts in (("cache.tif", ("cache-a.film",)), ("cache-parts.tif", ("cache-1.film", "cache-2.film"))):
            done = PROGRAMS.run("render", "join", *parts, "-o", picture, cwd=self.folder)
            self.assertEqual(done.returncode, DONE, done.stderr)
        self.assertEqual((self.folder / "cache.tif").read_bytes(), (self.folder / "cache-parts.tif").read_bytes())
        shown = self.surface("--integrator", "irradiance-cache", "--accuracy", "0.4", "--film", "cache-a.film")
        self.assertEqual(shown.returncode, BAD_INPUT)
        self.assertIn("accuracy is 0.5 there, 0.4 here", shown.stderr)

    def test_photon_maps_are_the_same_on_all_ways(self):
        for words in ([], ["--final-gather", "--gather-rays", 2]):
            def photon_map(name, samples, *more):
                done = PROGRAMS.run("render", "surface", self.scene, "--integrator", "photon-map", "--photons", 3000, "--nearest", 20,
                                    "--spp", samples, "--film", f"{name}.film", *words, *more, cwd=self.folder)
                self.assertEqual(done.returncode, DONE, done.stderr)
                return (self.folder / f"{name}.film").read_bytes()
            kind = f"photons{len(words)}"
            whole = photon_map(f"{kind}-whole", 3, "--threads", 1, "-o", f"{kind}-whole.tif")
            for threads in (2, 7):
                self.assertEqual(photon_map(f"{kind}-{threads}", 3, "--threads", threads), whole)
            photon_map(f"{kind}-later", 1)
            self.assertEqual(photon_map(f"{kind}-later", 3), whole)
            for part in (3, 1, 2):
                photon_map(f"{kind}-part{part}", 3, "--part", f"{part}/3")
            done = PROGRAMS.run("render", "join", *(f"{kind}-part{part}.film" for part in (1, 2, 3)), "-o", f"{kind}-joined.tif",
                                cwd=self.folder)
            self.assertEqual(done.returncode, DONE, done.stderr)
            self.assertEqual((self.folder / f"{kind}-joined.tif").read_bytes(), (self.folder / f"{kind}-whole.tif").read_bytes())
            other = PROGRAMS.run("render", "surface", self.scene, "--integrator", "photon-map", "--photons", 4000, "--nearest", 20,
                                 "--spp", 3, "--film", f"{kind}-whole.film", *words, cwd=self.folder)
            self.assertEqual(other.returncode, BAD_INPUT)
            self.assertIn("photons is 3000 there, 4000 here", other.stderr)

    def test_photons_that_the_memory_has_no_room_for(self):
        shown = PROGRAMS.run("render", "surface", self.scene, "--integrator", "photon-map", "--photons", 1 << 20, "--memory", "50M",
                             "-o", "never.tif", cwd=self.folder)
        self.assertEqual(shown.returncode, USAGE, shown.stderr)
        self.assertIn("give fewer --photons or more --memory", shown.stderr)
        self.assertFalse((self.folder / "never.tif").exists())

    def test_words_that_do_not_fit(self):
        for words, cause in ((["--part", "1/3", "-o", "a.exr"], "--film"), (["--part", "0/3", "--film", "a"], "--part"),
                             (["--part", "4/3", "--film", "a"], "--part"), (["--part", "2", "--film", "a"], "--part"),
                             (["--part", "1/3x", "--film", "a"], "--part"), ([], "-o"),
                             (["--part", "1/3", "--film", "a", "--max-error", "0.1"], "the same --spp"),
                             (["--film", "a", "--error", "e.png"], "-o"),
                             (["-o", "a.png", "--keep-every", "5"], "--film"),
                             (["-o", "a.png", "--integrator", "direct", "--bounces", "3"], "--bounces"),
                             (["-o", "a.png", "--integrator", "ray-casting", "--bounces", "3"], "--bounces"),
                             (["-o", "a.png", "--integrator", "whitted", "--lights", "power"], "--lights"),
                             (["-o", "a.png", "--integrator", "whitted", "--sampling", "bsdf"], "--sampling"),
                             (["--integrator", "whitted", "--explain"], "--explain"),
                             (["-o", "a.png", "--integrator", "bidirectional", "--lights", "all"], "--lights"),
                             (["-o", "a.png", "--integrator", "bidirectional", "--sampling", "bsdf"], "--sampling"),
                             (["--integrator", "bidirectional", "--explain"], "--explain"),
                             (["--integrator", "irradiance-cache", "--explain"], "--explain"),
                             (["-o", "a.png", "--accuracy", "0.2"], "--accuracy"),
                             (["-o", "a.png", "--gather-rays", "64"], "--gather-rays"),
                             (["-o", "a.png", "--photons", "1000"], "--photons"),
                             (["-o", "a.png", "--integrator", "whitted", "--final-gather"], "--final-gather"),
                             (["-o", "a.png", "--integrator", "photon-map", "--gather-rays", "2"], "--gather-rays"),
                             (["-o", "a.png", "--integrator", "photon-map", "--lights", "power"], "--lights"),
                             (["-o", "a.png", "--integrator", "photon-map", "--sampling", "light"], "--sampling"),
                             (["--integrator", "photon-map", "--explain"], "--explain")):
            shown = self.surface(*words)
            self.assertEqual(shown.returncode, USAGE, words)
            self.assertIn(cause, shown.stderr)
        self.assertFalse((self.folder / "a").exists())

    def test_textures_belong_to_the_scene(self):
        picture, scene = self.folder / "grey.png", self.folder / "textured.toml"
        write_png(picture, 2, 2, lambda x, y: 60 * (x + 2 * y))
        text = self.scene.read_text()
        scene.write_text(text.replace("kd = [0.73, 0.73, 0.73]", 'kd_texture = "grey.png"', 1))
        self.assertNotEqual(scene.read_text(), text)
        words = ("render", "surface", scene, "--spp", 2, "--film", "textured.film")
        done = PROGRAMS.run(*words, "--report", "textured.json", cwd=self.folder)
        self.assertEqual(done.returncode, DONE, done.stderr)
        self.assertIn("grey.png", (self.folder / "textured.json").read_text())
        checked = PROGRAMS.run("check", scene)
        self.assertEqual(checked.returncode, DONE, checked.stderr)
        self.assertIn("1 texture,", checked.stdout)
        simulated = subprocess.run(
            [PROGRAMS.sim, SOURCE / "configs/rigs/small8.toml", "--scene", scene, "--only-transport", "--quiet",
             "--cache", self.folder / "cache"], capture_output=True, text=True)
        self.assertEqual(simulated.returncode, BAD_INPUT)
        self.assertIn("material 'white' has a texture", simulated.stderr)
        write_png(picture, 2, 2, lambda x, y: 61 * (x + 2 * y))
        changed = PROGRAMS.run(*words, cwd=self.folder)
        self.assertEqual(changed.returncode, BAD_INPUT)
        self.assertIn("scene is ", changed.stderr)
        picture.unlink()
        for shown in (PROGRAMS.run(*words, cwd=self.folder), PROGRAMS.run("check", scene)):
            self.assertEqual(shown.returncode, BAD_INPUT)
            self.assertIn("grey.png", shown.stderr)
            self.assertRegex(shown.stderr, r"textured\.toml:\d+")

    def test_lights_of_every_kind(self):
        scene = SOURCE / "configs/scenes/lights.toml"
        for words in (("tree",), ("power",), ("uniform",), ("all",), ("tree", "--sampling", "light")):
            done = PROGRAMS.run("render", "surface", scene, "-o", "lights.exr", "--spp", 4, "--size", "60x40", "--force",
                                "--report", "lights.json", "--lights", *words, cwd=self.folder)
            self.assertEqual(done.returncode, DONE, done.stderr)
            requested = json.loads((self.folder / "lights.json").read_text())["asked"]
            self.assertEqual(requested["lights"], words[0])
        refused = PROGRAMS.run("render", "surface", scene, "-o", "no.exr", "--sampling", "bsdf", cwd=self.folder)
        self.assertEqual(refused.returncode, USAGE)
        self.assertIn("[[light]]", refused.stderr)
        self.assertFalse((self.folder / "no.exr").exists())

    def test_an_environment_belongs_to_the_scene(self):
        picture, scene = self.folder / "sky.png", self.folder / "sky.toml"
        write_png(picture, 4, 2, lambda x, y: 30 * (x + y))
        scene.write_text(self.scene.read_text() + '\n[environment]\nfile = "sky.png"\n')
        words = ("render", "surface", scene, "--spp", 2, "--film", "sky.film")
        self.assertEqual(PROGRAMS.run(*words, cwd=self.folder).returncode, DONE)
        self.assertIn("an environment", PROGRAMS.run("check", scene).stdout)
        write_png(picture, 4, 2, lambda x, y: 31 * (x + y))
        changed = PROGRAMS.run(*words, cwd=self.folder)
        self.assertEqual(changed.returncode, BAD_INPUT)
        self.assertIn("environment is ", changed.stderr)
        picture.unlink()
        for shown in (PROGRAMS.run(*words, cwd=self.folder), PROGRAMS.run("check", scene)):
            self.assertEqual(shown.returncode, BAD_INPUT)
            self.assertIn("sky.png", shown.stderr)

    def test_instances_are_counted_and_rendered_or_named(self):
        (self.folder / "leaf.obj").write_text("v 0 0 1\nv 9 0 1\nv 0 9 1\nusemtl kd0.7_ks0_n0\nf 1 2 3\n")
        scene, instance = self.folder / "leaves.toml", '[[instance]]\nmesh = "leaf"\ntranslate = [9, 9, 9]\nscale = 2\n'
        text = self.scene.read_text() + '\n[[mesh]]\nname = "leaf"\nfile = "leaf.obj"\n'
        scene.write_text(text + 2 * instance)
        self.assertIn(", 2 instances", PROGRAMS.run("check", scene).stdout)
        shown = PROGRAMS.run("render", "surface", scene, "-o", "leaves.exr", "--spp", 1, cwd=self.folder)
        self.assertEqual(shown.returncode, DONE, shown.stderr)
        scene.write_text(text + instance.replace('"leaf"', '"laef"'))
        refused = PROGRAMS.run("check", scene)
        self.assertEqual(refused.returncode, BAD_INPUT)
        line = text.count("\n") + 2
        self.assertRegex(refused.stderr, rf"leaves.toml:{line}\b[\s\S]*did you mean 'leaf'")

    def test_a_picture_larger_than_the_memory_is_refused_at_once(self):
        large = self.folder / "large.toml"
        large.write_text(self.scene.read_text().replace("size = [150, 100]", "size = [16000, 16000]"))
        shown = PROGRAMS.run("render", "surface", large, "-o", "large.exr", cwd=self.folder, timeout=10)
        self.assertEqual(shown.returncode, USAGE)
        self.assertIn("--memory", shown.stderr)

    def test_more_triangles_than_the_memory_are_refused(self):
        many = self.folder / "many.toml"
        ball = '[[sphere]]\ncentre = [0, 0, 0]\nradius = 1\nsubdivisions = 7\nmaterial = "white"\n'
        many.write_text(self.scene.read_text() + ball)
        for memory, code in (("10M", USAGE), ("100M", DONE)):
            shown = PROGRAMS.run("render", "surface", many, "-o", "many.exr", "--spp", 1, "--memory", memory,
                                 cwd=self.folder)
            self.assertEqual(shown.returncode, code, shown.stderr)
            self.assertEqual("surfaces, textures and the environment" in shown.stderr, code == USAGE)

    def test_a_folder_that_cannot_be_written_is_known_before_the_work(self):
        begun = time.monotonic()
        shown = PROGRAMS.run("render", "surface", self.scene, "--spp", 1 << 19, "--film", "absent/a.film",
                             cwd=self.folder, timeout=60)
        self.assertEqual(shown.returncode, IO, shown.stderr)
        self.assertIn("absent", shown.stderr)
        self.assertLess(time.monotonic() - begun, 30.0)

    def test_a_full_disk_costs_no_samples(self):
        """The film's folder takes no more while it renders, then again does."""
        held = self.folder / "held"
        held.mkdir()
        process = subprocess.Popen(
            [PROGRAMS.haarlight, "render", "surface", self.scene, "--spp", str(SAMPLES), "--film", "held/a.film",
             "--keep-every", "0.01"], cwd=self.folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        while not (held / "a.film").exists():
            self.assertIsNone(process.poll())
            time.sleep(0.01)
        held.rename(self.folder / "away")
        told = any("the film is not kept yet" in line for line in process.stderr)
        (self.folder / "away").rename(held)
        _, problems = process.communicate(timeout=120)
        self.assertTrue(told)
        self.assertEqual(process.returncode, DONE, problems)
        self.assertEqual((held / "a.film").read_bytes(), self.whole[0])

    def test_channels_of_an_exr_have_their_names(self):
        header = (self.folder / "whole.exr").read_bytes()[:2000]
        names = re.findall(rb"([A-Za-z.]+)\0\x02\0\0\0", header)
        self.assertEqual(names, [b"B", b"G", b"R", b"Z", b"albedo.B", b"albedo.G", b"albedo.R", b"error.B", b"error.G",
                                 b"error.R", b"normal.X", b"normal.Y", b"normal.Z"])

    def test_a_crop_is_that_part_of_the_picture(self):
        self.assertEqual(self.rendered("all", "--crop", "150x100+0+0"), self.whole)
        done = self.surface("--crop", "40x30+110+70", "-o", "crop.png")
        self.assertEqual(done.returncode, DONE, done.stderr)
        self.assertIn("40 x 30 pixels", done.stdout)
        for wrong in ("40x30", "40x30+111+0", "40x30+0+71", "0x3+0+0", "4x4-1+0", "99999999999x1+0+0", "4x4+1+1x"):
            refused = self.surface("--crop", wrong, "-o", "never.tif")
            self.assertEqual(refused.returncode, USAGE, refused.stderr)
            self.assertIn("WxH+X+Y", refused.stderr)

    def windows(self, name):
        """Data and display window of an .exr: x and y of the first and the last pixel of each."""
        header = (self.folder / name).read_bytes()[:4000]
        return [struct.unpack("<4i", header.split(window + b"\0box2i\0\x10\0\0\0", 1)[1][:16])
                for window in (b"dataWindow", b"displayWindow")]

    def test_a_film_section_is_the_same_as_the_options(self):
        scene = self.folder / "film.toml"
        scene.write_text(self.scene.read_text() +
                         '\n[film]\nsize = [90, 60]\ncrop = "70x40+20+10"\nfilter = "gaussian"\n')
        words = ("--size", "90x60", "--crop", "70x40+20+10", "--filter", "gaussian")

        def made(name, file, *options, samples=8):
            done = PROGRAMS.run("render", "surface", file, "--spp", samples, "--film", f"{name}.film", *options,
                                cwd=self.folder)
            self.assertEqual(done.returncode, DONE, done.stderr)
            return (self.folder / f"{name}.film").read_bytes()

        by_options = made("by_options", self.scene, *words, "-o", "by_options.exr")
        self.assertEqual(made("by_file", scene, "-o", "by_file.exr"), by_options)
        self.assertEqual((self.folder / "by_file.exr").read_bytes(), (self.folder / "by_options.exr").read_bytes())
        self.assertEqual(self.windows("by_file.exr"), [(20, 10, 89, 49), (0, 0, 89, 59)])
        self.assertEqual(self.windows("whole.exr"), [(0, 0, 149, 99)] * 2)
        made("by_file", self.scene, *words, samples=16)  # goes on from the other's
        for part in (1, 2):
            made(f"half{part}", scene, "--part", f"{part}/2")
        joined = PROGRAMS.run("render", "join", "half1.film", "half2.film", "-o", "halves.exr", cwd=self.folder)
        self.assertEqual(joined.returncode, DONE, joined.stderr)
        self.assertEqual((self.folder / "halves.exr").read_bytes(), (self.folder / "by_options.exr").read_bytes())
        # An option wins over the file.
        self.assertEqual(made("whole_view", scene, "--crop", "90x60+0+0", "--filter", "box"),
                         made("plain", self.scene, "--size", "90x60"))
        shown = PROGRAMS.run("render", "surface", scene, "--size", "80x60", "-o", "never.exr", cwd=self.folder)
        self.assertEqual(shown.returncode, USAGE, shown.stderr)
        self.assertRegex(shown.stderr, r"the crop 70x40\+20\+10 is outside of the picture of 80 x 60 pixels")
        self.assertRegex(shown.stderr, r"film\.toml:\d+")

    def test_one_process_at_a_film(self):
        first = subprocess.Popen(
            [PROGRAMS.haarlight, "render", "surface", self.scene, "--spp", str(1 << 20), "--film", "held.film", "--quiet"],
            cwd=self.folder, stdout=subprocess.DEVNULL)
        try:
            while not (self.folder / "held.film").exists():
                self.assertIsNone(first.poll())
                time.sleep(0.01)
            second = PROGRAMS.run("render", "surface", self.scene, "--spp", 1, "--film", "held.film", cwd=self.folder)
            self.assertEqual(second.returncode, INTERRUPTED, second.stderr)
            self.assertIn("another haarlight render is at work on this film", second.stderr)
            self.assertIn("held.film", second.stderr)
            self.assertIn("hint:", second.stderr)
        finally:
            first.kill()
            first.wait()
        (self.folder / "held.film").unlink()
        third = PROGRAMS.run("render", "surface", self.scene, "--spp", 1, "--film", "held.film", cwd=self.folder)
        self.assertEqual(third.returncode, DONE, third.stderr)
        self.assertFalse((self.folder / "held.film.lock").exists())

    def test_an_environment_counts_as_memory(self):
        picture, scene = self.folder / "wide.png", self.folder / "wide.toml"
        write_png(picture, 1000, 500, lambda x, y: 90)
        scene.write_text(self.scene.read_text() + '\n[environment]\nfile = "wide.png"\n')
        # The film takes 2 x 1.7 MB; 500 000 grey texels and their table 12 bytes each: 6 MB.
        for memory, code in (("8M", USAGE), ("12M", DONE)):
            shown = PROGRAMS.run("render", "surface", scene, "-o", f"wide{memory}.exr", "--spp", 1, "--memory", memory,
                                 cwd=self.folder)
            self.assertEqual(shown.returncode, code, shown.stderr)
            self.assertEqual("and the environment 6 MB" in shown.stderr, code == USAGE, shown.stderr)

    def test_near_and_far_belong_to_the_scene(self):
        scene = self.folder / "near.toml"
        scene.write_text(self.scene.read_text().replace("[camera]", "[camera]\nnear_mm = 10"))
        shown = PROGRAMS.run("render", "surface", scene, "--film", "whole.film", cwd=self.folder)
        self.assertEqual(shown.returncode, BAD_INPUT, shown.stderr)
        self.assertIn("scene is ", shown.stderr)

    def test_a_picture_to_look_at_is_beside_an_exr(self):
        self.assertEqual((self.folder / "whole.png").read_bytes()[:4], b"\x89PNG")
        (self.folder / "beside.png").write_bytes(b"mine")
        refused = self.surface("-o", "beside.exr")
        self.assertEqual(refused.returncode, USAGE, refused.stderr)
        self.assertIn("beside.png", refused.stderr)
        self.assertEqual((self.folder / "beside.png").read_bytes(), b"mine")

    def test_explain_tells_what_the_scene_requires(self):
        told = PROGRAMS.run("render", "surface", self.scene, "--explain", "--report", "told.json", cwd=self.folder)
        self.assertEqual(told.returncode, DONE, told.stderr)
        self.assertRegex(told.stdout, "rays between surfaces +needed")
        self.assertRegex(told.stdout, r"a choice among lights +left out +[+-]\d+ \+- \d+ % of the time: one light")
        costs = json.loads((self.folder / "told.json").read_text())["details"]
        self.assertIn("cost_of_light_choice", costs)
        self.assertNotIn("cost_of_self_rays", costs)

    def test_the_report_says_what_ended_it(self):
        for words, end in ((["--spp", "3"], "samples"), (["--max-error", "0.9"], "error"),
                           (["--seconds", "0.01"], "time")):
            report = self.folder / f"{end}.json"
            done = PROGRAMS.run("render", "surface", self.scene, *words, "-o", f"{end}.png", "--report", report,
                                cwd=self.folder)
            self.assertEqual(done.returncode, DONE, done.stderr)
            self.assertEqual(json.loads(report.read_text())["reached"]["ended_by"], end)


class Integrators(unittest.TestCase):
    """Radiosity, path tracing's baselines, and filters of what they have made."""

    @classmethod
    def setUpClass(cls):
        cls.temporary = tempfile.TemporaryDirectory()
        cls.folder = pathlib.Path(cls.temporary.name)
        cls.scene = SOURCE / "configs/scenes/cornell.toml"

    @classmethod
    def tearDownClass(cls):
        cls.temporary.cleanup()

    def surface(self, *words, scene=None):
        return PROGRAMS.run("render", "surface", scene or self.scene, "--size", "70x40", *words, cwd=self.folder)

    def refused(self, code, text, *words, scene=None):
        done = self.surface(*words, "-o", "never.exr", scene=scene)
        self.assertEqual(done.returncode, code, done.stderr)
        self.assertIn(text, done.stderr)
        self.assertFalse((self.folder / "never.exr").exists())

    def test_the_same_bytes_for_any_threads_and_parts(self):
        for name, *words in (("radiosity", "--patches", 300, "--form-factor-rays", 64),
                             ("path-naive", "--bounces", 4), ("path-by-area", "--bounces", 4)):
            made = []
            for threads in (1, 2, 7):
                done = self.surface("--integrator", name, *words, "--spp", 2, "--threads", threads, "-o", "threads.exr",
                                    "--force")
                self.assertEqual(done.returncode, DONE, done.stderr)
                made.append((self.folder / "threads.exr").read_bytes())
            films = [f"{name}{part}.film" for part in (1, 2, 3)]
            for part, film in enumerate(films):
                done = self.surface("--integrator", name, *words, "--spp", 2, "--part", f"{part + 1}/3", "--film", film)
                self.assertEqual(done.returncode, DONE, done.stderr)
            joined = PROGRAMS.run("render", "join", *films, "-o", f"{name}.exr", cwd=self.folder)
            self.assertEqual(joined.returncode, DONE, joined.stderr)
            made.append((self.folder / f"{name}.exr").read_bytes())
            self.assertEqual(made, [made[0]] * 4, name)

    def test_what_radiosity_cannot_render_is_refused(self):
        glass = SOURCE / "configs/scenes/cornell_glass.toml"
        self.refused(BAD_INPUT, "cornell_glass.toml: material ", "--integrator", "radiosity", scene=glass)
        self.refused(USAGE, "--patches", "--patches", 100)
        self.refused(USAGE, "--form-factor-rays", "--form-factor-rays", 100, "--integrator", "whitted")
        self.refused(USAGE, "--bounces", "--bounces", 3, "--integrator", "radiosity")
        self.refused(USAGE, "--bounces", "--bounces", 1001, "--integrator", "path-naive")
        self.refused(USAGE, "--memory", "--integrator", "radiosity", "--memory", "50M")

    def smooth(self, name, *words):
        return PROGRAMS.run("render", "smooth", name, "--force", *words, cwd=self.folder)

    def channels_of(self, name):
        return read_exr(self.folder / name)[2]

    def test_filters_keep_the_light(self):
        self.assertEqual(self.surface("--spp", 4, "-o", "noisy.exr").returncode, DONE)
        self.assertEqual(self.surface("--spp", 64, "--seed", 1, "-o", "long.exr").returncode, DONE)
        noisy = self.channels_of("noisy.exr")
        for kind in ("low-pass", "median", "features"):
            done = self.smooth("noisy.exr", "--by", kind, "-o", "smooth.exr", "--reference", "long.exr", "--report",
                               "smooth.json")
            self.assertEqual(done.returncode, DONE, done.stderr)
            smooth = self.channels_of("smooth.exr")
            for colour in "RGB":
                self.assertAlmostEqual(sum(smooth[colour]) / sum(noisy[colour]), 1.0, delta=1e-6)
            self.assertEqual("albedo.R" in smooth, kind == "features")
            self.assertNotIn("error.R", smooth)
            reached = json.loads((self.folder / "smooth.json").read_text())["reached"]
            if kind == "features":
                self.assertLess(reached["rmse_after"], reached["rmse_before"])

    def test_what_cannot_be_filtered_is_refused(self):
        self.assertEqual(self.surface("--spp", 1, "-o", "one.exr").returncode, DONE)
        for name, words, text in (("one.exr", [], "no channel error."), ("absent.exr", [], "absent.exr"),
                                  ("one.png", [], "not an OpenEXR file"),
                                  ("one.exr", ["--by", "median", "--reference", self.other_size()], "40 x 30")):
            done = self.smooth(name, *words, "-o", "never.exr")
            self.assertNotEqual(done.returncode, DONE)
            self.assertIn(text, done.stderr)
            self.assertFalse((self.folder / "never.exr").exists())

    def other_size(self):
        done = PROGRAMS.run("render", "surface", self.scene, "--size", "40x30", "--spp", 1, "-o", "other.exr",
                            cwd=self.folder)
        self.assertEqual(done.returncode, DONE, done.stderr)
        return "other.exr"

    def test_a_pixel_that_is_no_number_is_named(self):
        write_float_tif(self.folder / "nan.tif", 3, 2, [0.5] * 9 + [float("nan")] + [0.5] * 8)
        for kind in ("low-pass", "median"):
            done = self.smooth("nan.tif", "--by", kind, "-o", "never.exr")
            self.assertEqual(done.returncode, BAD_INPUT)
            self.assertIn("pixel (x 0, y 1)", done.stderr)


if __name__ == "__main__":
    PROGRAMS = Programs(sys.argv.pop(1))
    unittest.main()
