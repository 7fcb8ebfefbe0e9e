#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""What every verb of `haarlight` promises on the command line: help, exit codes, named causes, no
overwriting, reports, quiet. command_line_test.py BIN, the build's folder apps/. No rig is needed."""

import json
import math
import os
import pathlib
import pty
import re
import signal
import struct
import subprocess
import sys
import tempfile
import unittest
import urllib.request

from programs import (SOURCE, Programs, footer_examples, free_port, report_problems,
                      schema_problems, write_ball, write_capture, write_png, write_relightable)

DONE, MISSED, USAGE, BAD_INPUT, UNAVAILABLE = 0, 1, 2, 65, 69
RIG = SOURCE / "configs/rigs/small8.toml"
PLAN = SOURCE / "configs/plans/quick.toml"
SCENE = SOURCE / "configs/scenes/stairs.toml"
CORNELL = SOURCE / "configs/scenes/cornell.toml"
VOLUME = SOURCE / "configs/volumes/four_cells.vtu"
ROOM = SOURCE / "configs/environments/room.hdr"
DEVICES = {"rig"}  # verbs that need a rig: examples_test.py and rig_commission_test.py run them
CLIENTS = {"status", "pause", "resume", "abort", "all-off", "reshoot", "sessions"}
WRITING_CLIENTS = {"capture", "shot", "preview"}
SERVERS = {"view", "serve"}  # end when they are asked to

# For each verb: command lines whose only fault is that the input named "absent..." is not there.
ABSENT = {
    "check": ["absent.toml"],
    "plan": ["absent.toml {plan}", "{rig} absent.toml"],
    "capture": ["absent.toml", "{plan} --token-file absent"],
    "status": ["--token-file absent"],
    "pause": ["--token-file absent"],
    "resume": ["--token-file absent"],
    "abort": ["--token-file absent"],
    "all-off": ["--token-file absent"],
    "reshoot": ["1 --token-file absent"],
    "cameras": [],
    "advise": ["absent.toml --signal 800", "{rig} --signal 800 --cubemap absent.hdr"],
    "rig": ["doctor absent.toml", "commission absent.toml --flash-ok",
            "predict absent.toml --object-height 10,20",
            "calibrate lights absent.toml --session session"],
    "preview": ["1 --token-file absent"],
    "shot": ["1 --token-file absent"],
    "sessions": ["--token-file absent"],
    "import": ["absent --lights photos/dirs.lp -o new", "photos --lights absent.lp -o new",
               "photos --lights photos/dirs.lp --dark absent.png -o new"],
    "calibrate": ["absent --target ball -o new", "ball --ball absent.png -o new",
                  "absent --target sheet --width-mm 100 --camera-mm 500 -o new"],
    "verify": ["absent", "session --signers absent.txt"],
    "rebuild": ["absent"],
    "develop": ["absent"],
    "export": ["absent --lp -o new"],
    "convert": ["absent.ptm new.rti", "absent.ptm new.png --light 0,0,1", "absent.lp new.dome"],
    "fit": ["absent -o new", "photos --lights absent.lp -o new"],
    "plate": ["absent.toml -o new"],
    "compress": ["absent -o new", "session -o new --plate absent.hlb --basis direct"],
    "relight": ["absent.hlb --light 0 -o new.png", "object.hlb --cubemap absent.hdr -o new.png",
                "object.hlb --weights absent.json -o new.png",
                "object.hlb --light 0 --against absent -o new.png"],
    "view": ["absent.hlb"], "serve": ["absent.hlb", "object.hlb --skies absent", "object.hlb --token-file absent"],
    "publish": ["absent.hlb -o new", "object.hlb -o new --environment absent.hdr", "absent -o new"],
    "correct": ["absent -o new"],
    "shape": ["absent -o new", "session -o new --mask absent.png", "absent.ptm -o new",
              "session -o new --method ptm --mask absent.png"],
    "bases": ["absent -o new", "object.hlb -o new --plate absent.hlb",
              "object.hlb -o new --lightings absent.json", "object.hlb -o new --regions absent.png"],
    "mesh": ["info absent.vtu", "info absent.vtk --json", "info absent.msh", "info absent.xyz --solution absent.q"],
    "render": ["surface absent.toml -o new.png", "join absent.film -o new.exr",
               "soft-shadow absent.toml -o new.png", "volume absent.toml -o new.png"],
    "hull": ["absent.hlb -o new.ply", "plate.hlb --also absent.hlb -o new.ply",
             "plate.hlb --plate absent.hlb -o new.ply", "plate.hlb --mask absent.png -o new.ply"],
    "shadow": ["absent.hlb --scene {scene} --light 0 -o new.png",
               "plate.hlb --scene absent.toml --light 0 -o new.png",
               "plate.hlb --scene {scene} --cubemap absent.hdr -o new.png",
               "plate.hlb --scene {scene} --light 0 --plate absent.hlb -o new.png",
               "plate.hlb --also absent.hlb --scene {scene} --light 0 -o new.png",
               "plate.hlb --scene {scene} --light 0 --mask absent.png -o new.png",
               "plate.hlb --scene {scene} --light 0 --truth-object absent.toml --truth t.png -o new.png"],
}

# Command lines that succeed and write to "taken...": the test puts a file (a folder for "taken/")
# there first, and leaves it out for the reports. None: a verb that writes no output.
WRITES = {
    "check": None, "status": None, "pause": None, "resume": None, "abort": None, "all-off": None,
    "reshoot": None, "sessions": None, "verify": None, "rebuild": None, "rig": None,
    "cameras": None, "view": None, "serve": None, "mesh": None,
    "plan": ["{rig} {plan} -o taken.json"],
    "advise": ["{rig} --signal 800 --cubemap {room} -o taken.json"],
    "capture": ["{plan} -o taken/"],
    "preview": ["3 -o taken.png"],
    "shot": ["3 -o taken.png"],
    "import": ["photos --lights photos/dirs.lp -o taken/"],
    "calibrate": ["ball --target ball -o taken/", "ball --target ball -o taken.json",
                  "ball --target ball --focal-px 500 -o taken.lp"],
    "develop": ["session --exr taken/"],
    "export": ["session --lp -o taken.lp", "session --dome -o taken.dome",
               "session --lp -o new.lp --png taken/"],
    "convert": ["object.ptm taken.rti", "object.ptm taken/ --basis hsh",
                "object.ptm taken.ptm --jpeg", "object.ptm taken.png --light 0.5,0,0.8",
                "photos/dirs.lp taken.dome"],
    "fit": ["session -o taken.rti --basis hsh4", "session -o taken.ptm --basis lptm",
            "session -o taken/ --basis bilinear"],
    "plate": ["{rig} -o taken.hlb"],
    "compress": ["session -o taken.hlb --basis direct --plate none"],
    "relight": ["object.hlb --light 0 -o taken.png"],
    "publish": ["object.hlb -o taken/", "object.ptm -o taken/ --quality 80"],
    "correct": ["near.session -o taken/ --width-mm 300"],
    "shape": ["session -o taken/", "near.session -o taken/ --width-mm 300 --mesh none",
              "object.ptm -o taken/ --mesh none", "session -o taken/ --method hsh --mesh none"],
    "bases": ["object.hlb -o taken/ --error 0.1 --size 2", "session -o taken/ --basis pca --error 0.1"],
    "render": ["surface {cornell} --spp 1 -o taken.exr",
               "surface {cornell} --spp 2 --integrator direct -o new.exr --error taken.exr",
               "join cornell.film -o taken.exr",
               "soft-shadow {cornell} --size 16x16 -o taken.exr",
               "soft-shadow {cornell} --size 16x16 -o new.png --map taken.png"],
    "hull": [f"plate.hlb --mask middle.png --voxel 16 -o taken.{kind}" for kind in ("ply", "vtu", "png")],
    "shadow": ["plate.hlb --scene {scene} --light 3 --size 16x12 -o taken.png",
               "plate.hlb --scene {scene} --light 3 --size 16x12 --max-error 0.01 -o taken.png",
               "plate.hlb --scene {scene} --light 3 --size 16x12 -o new.png --spread taken.png",
               "plate.hlb --scene {scene} --light 3 --size 16x12 -o new.png "
               "--truth-object {scene} --truth taken.png",
               "plate.hlb --scene {scene} --light 3 --size 16x12 -o new.png "
               "--truth-object {scene} --truth new2.png --difference taken.png"],
}
READS = {"check": "{rig} {plan} {scene} {room} object.hlb", "verify": "session", "rebuild": "session",
         "cameras": "", "mesh": "info {volume}"}


def write_surface(folder, size, normal, widths=None):
    """A matte surface under 36 lights, sRGB; x right, y up, z to the camera. normal(x, y) of a
    position in pixels from the middle, None: black. `widths`: how far the lights stand, in picture
    widths, aimed at the middle (None: far); the list holds their directions either way."""
    folder.mkdir()
    lines = ["36"]
    for k in range(36):
        up = math.radians(25.0 + 60.0 * k / 35)
        light = (math.cos(up) * math.cos(2.399963 * k), math.cos(up) * math.sin(2.399963 * k),
                 math.sin(up))

        def value(col, row, light=light):
            x, y = col + 0.5 - size / 2, size / 2 - row - 0.5
            n = normal(x, y)
            if n is None:
                return 0
            way = light if widths is None else tuple(
                c - p / (widths * size) for c, p in zip(light, (x, y, 0.0)))
            lit = 0.6 * max(0.0, sum(a * b for a, b in zip(n, way))) / math.hypot(*way) ** 3
            coded = 12.92 * lit if lit <= 0.0031308 else 1.055 * lit ** (1 / 2.4) - 0.055
            return min(255, round(255 * coded))

        write_png(folder / f"light{k}.png", size, size, value)
        lines.append(f"light{k}.png " + " ".join(f"{c:.6f}" for c in light))
    (folder / "dirs.lp").write_text("\n".join(lines) + "\n")


def ball(x, y, radius):
    """The normal of a ball that is seen from far; nothing beside it."""
    u, v = x / radius, y / radius
    return (u, v, math.sqrt(1.0 - u * u - v * v)) if u * u + v * v < 1.0 else None


def write_sphere(folder, size, radius):
    write_surface(folder, size, lambda x, y: ball(x, y, radius))


def sphere_normals(ply, radius):
    """Of a mesh of write_sphere()'s picture: ((x, y) in radii, normal) a vertex."""
    head, body = ply.read_bytes().split(b"end_header\n", 1)
    n = int(re.search(rb"element vertex (\d+)", head)[1])
    vertex = struct.Struct("<8f3B")
    found = [vertex.unpack_from(body, i * vertex.size) for i in range(n)]
    return [((v[0] / radius, v[1] / radius), v[3:6]) for v in found]


class CommandLine(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.programs = Programs(BIN)
        cls.verbs = cls.programs.verbs()
        cls.whole_verbs = cls.programs.whole_verbs()
        cls.place = tempfile.TemporaryDirectory(prefix="haarlight-cli.")
        cls.folder = pathlib.Path(cls.place.name)
        write_capture(cls.folder / "photos")
        write_relightable(cls.folder / "object.ptm")
        write_ball(cls.folder / "ball")
        write_capture(cls.folder / "near", scale=800.0)
        # The rig's camera, and an object where nothing but its shadow can be missing.
        write_png(cls.folder / "middle.png", 64, 48,
                  lambda x, y: 0 if abs(x - 32) < 6 and abs(y - 24) < 6 else 255)
        for line in ("import photos --lights photos/dirs.lp -o session",
                     "import near --lights near/dirs.lp --places positions -o near.session",
                     "compress session -o object.hlb --basis direct --plate none",
                     "plate {rig} -o plate.hlb",
                     "render surface {cornell} --spp 1 --film cornell.film"):
            done = cls.run_line(line)
            assert done.returncode == DONE, done.stderr

    @classmethod
    def tearDownClass(cls):
        cls.place.cleanup()

    @classmethod
    def run_line(cls, line, *more):
        words = line.format(rig=RIG, plan=PLAN, scene=SCENE, room=ROOM, cornell=CORNELL, volume=VOLUME).split()
        if words[0] in CLIENTS | WRITING_CLIENTS:
            more = ("--daemon", f"http://127.0.0.1:{cls.closed_port}", *more)
        return cls.programs.run(*words, *more, cwd=cls.folder)

    closed_port = free_port()

    def lines(self, table):
        self.assertEqual(sorted(table), sorted(self.verbs), "the table must name every verb")
        return [(verb, f"{verb} {ending}") for verb, endings in table.items()
                for ending in endings or []]

    def test_help_shows_usage_and_an_example_of_the_verb(self):
        for verb in self.whole_verbs:
            with self.subTest(verb=verb):
                shown = self.programs.run(*verb.split(), "--help")
                self.assertEqual(shown.returncode, DONE)
                self.assertEqual(shown.stderr, "")
                self.assertIn(f"Usage: haarlight {verb} ", shown.stdout)
                examples = footer_examples(shown.stdout)
                self.assertTrue(examples, "no example")
                for example in examples:
                    self.assertTrue(example.startswith(f"haarlight {verb}"), example)
                # What a terminal of 80 columns shows whole; only commands to copy are longer.
                prose = re.split(r"^Examples?:$", shown.stdout, flags=re.M)[0]
                self.assertEqual([line for line in prose.splitlines() if len(line) > 80], [])
                for option in ("--report FILE", "--quiet", "--memory", "--threads", "--force"):
                    self.assertIn(option, shown.stdout)

    def test_a_verb_of_verbs_lists_them_and_takes_the_options_of_none(self):
        groups = {" ".join(words[:i]) for whole in self.whole_verbs
                  for words in [whole.split()] for i in range(1, len(words))}
        self.assertEqual(groups, {"rig", "rig calibrate", "mesh", "render"})
        for group in groups:
            with self.subTest(group=group):
                shown = self.programs.run(*group.split(), "--help")
                self.assertEqual((shown.returncode, shown.stderr), (DONE, ""))
                self.assertIn(f"Usage: haarlight {group} ", shown.stdout)
                self.assertEqual([line for line in shown.stdout.splitlines() if len(line) > 80], [])
                alone = self.programs.run(*group.split())
                self.assertEqual(alone.returncode, USAGE)
                self.assertIn(f"hint: haarlight {group} --help", alone.stderr)
        for line, option in (("rig doctor {rig} --lobe free", "--lobe"),
                             ("rig doctor {rig} --flash-ok", "--flash-ok"),
                             ("rig predict {rig} --object-height 5,10 --session x", "--session"),
                             ("rig calibrate lights {rig} --picture a.png", "--picture"),
                             ("rig calibrate camera {rig} --region 0,1,0,1", "--region")):
            with self.subTest(line=line):
                shown = self.run_line(line)
                self.assertEqual((shown.returncode, shown.stdout), (USAGE, ""))
                self.assertIn(f"there is no option {option}", shown.stderr)
        for line, words in (("rig docter x", "docter is not a verb of haarlight rig: did you mean doctor?"),
                            ("rig calibrate light x", "light is not a verb of haarlight rig calibrate: "
                                                      "did you mean lights?")):
            with self.subTest(line=line):
                shown = self.run_line(line)
                self.assertEqual(shown.returncode, USAGE)
                self.assertIn(words, shown.stderr)

    def test_an_unknown_option_or_verb_is_a_usage_error_that_names_it(self):
        for verb in self.whole_verbs:
            with self.subTest(verb=verb):
                shown = self.programs.run(*verb.split(), "--no-such-option", cwd=self.folder)
                self.assertEqual(shown.returncode, USAGE)
                self.assertEqual(shown.stdout, "")
                self.assertRegex(shown.stderr, "no-such-option|is required")
        shown = self.programs.run("status", "--no-such-option")
        self.assertIn("--no-such-option", shown.stderr)
        shown = self.programs.run("relihgt", "x.hlb")
        self.assertEqual(shown.returncode, USAGE)
        self.assertIn("did you mean relight?", shown.stderr)
        self.assertEqual(self.programs.run().returncode, USAGE)

    def test_a_wrong_line_is_said_with_its_verb_the_option_meant_and_a_hint(self):
        for line, problem in (
                ("relight object.hlb --exposur 2 -o new.png", "there is no option --exposur: did you mean --exposure?"),
                ("fit photos -o new --lights", "--lights is without its value"),
                ("rig doctor", "RIG is required"),
                ("relight object.hlb other.hlb --light 0 -o new.png", "what is other.hlb?")):
            with self.subTest(line=line):
                shown = self.run_line(line)
                verb = "rig doctor" if line.startswith("rig") else line.split()[0]
                self.assertEqual(shown.returncode, USAGE)
                self.assertEqual(shown.stderr, f"haarlight {verb}: {problem}\n  hint: haarlight {verb} "
                                               "--help tells what it takes\n")

    def test_an_environment_is_named_alike_by_every_verb(self):
        """publish calls it --environment, relight --cubemap: each takes both words."""
        for word in ("--environment", "--cubemap"):
            with self.subTest(word=word):
                for line in (f"relight object.hlb {word} {{room}} -o {word[2:]}.png",
                             f"publish object.hlb {word} {{room}} -o {word[2:]}-site"):
                    done = self.run_line(line)
                    self.assertEqual(done.returncode, DONE, done.stderr)
        self.assertEqual((self.folder / "cubemap.png").read_bytes(),
                         (self.folder / "environment.png").read_bytes())

    def test_a_folder_given_for_a_basis_file_is_told_the_step_that_lacks(self):
        self.assertEqual(self.run_line("convert object.ptm fitted").returncode, DONE)
        for folder, problem, hint in (
                ("session", "a session, not a basis file", "haarlight compress session -o NAME.hlb, then haarlight {} NAME.hlb"),
                ("fitted", "one direction at a time, not a basis file", "haarlight convert fitted OUT.png --light X,Y,Z"),
                ("photos", "a folder of pictures, not a basis file", "haarlight import photos --lights LIST.lp")):
            for line in (f"relight {folder} --light 0 -o new.png",
                         f"shadow {folder} --scene {{scene}} --light 0 -o new.png"):
                with self.subTest(line=line):
                    shown = self.run_line(line)
                    self.assertEqual(shown.returncode, BAD_INPUT, shown.stderr)
                    self.assertIn(problem, shown.stderr)
                    self.assertIn("hint: ", shown.stderr)
                    self.assertIn(hint.format(line.split()[0]), shown.stderr)

    def test_a_scene_that_would_render_black_is_refused(self):
        dark = CORNELL.read_text().replace("emits = ", "# ")
        unused = dark + '\n[[material]]\nname = "spare"\nemits = [1, 1, 1]\n'
        for name, text, problem in (("dark", dark, "nothing in the scene emits light"),
                                    ("unused", unused, "nothing in the scene emits light"),
                                    ("blind", CORNELL.read_text().split("[camera]")[0], "the scene has no camera"),
                                    ("negative", CORNELL.read_text().replace("emits = [17", "emits = [-17"), "emits")):
            with self.subTest(name=name):
                (self.folder / f"{name}.toml").write_text(text)
                shown = self.run_line(f"render surface {name}.toml -o never.png")
                self.assertEqual(shown.returncode, BAD_INPUT, shown.stderr)
                self.assertIn(problem, shown.stderr)
                self.assertIn(f"{name}.toml", shown.stderr)
                self.assertRegex(shown.stderr, r"\n  hint: \S")
                self.assertFalse((self.folder / "never.png").exists())

    def test_an_error_picture_that_cannot_be_is_refused_before_any_work(self):
        for ending, problem in (("--spp 1 --error never2.exr", "one sample has no standard error"),
                                ("--error never.exr", "would be one file")):
            with self.subTest(ending=ending):
                shown = self.run_line(f"render surface {{cornell}} -o never.exr {ending}")
                self.assertEqual(shown.returncode, USAGE, shown.stderr)
                self.assertIn(problem, shown.stderr)
                self.assertFalse((self.folder / "never.exr").exists())

    def test_a_picture_that_misses_its_error_is_written_and_said(self):
        line = "render surface {cornell} --spp 16 --max-error 0.001 --report missed.json -o missed.exr"
        shown = self.run_line(line)
        self.assertEqual(shown.returncode, MISSED, shown.stderr)
        self.assertGreater(json.loads((self.folder / "missed.json").read_text())["reached"]["relative_l2"], 0.001)
        self.assertTrue((self.folder / "missed.exr").exists())

    def test_pictures_of_other_names_than_the_lists_are_told_the_hint(self):
        lines = (self.folder / "photos/dirs.lp").read_text().splitlines()
        named = [f"scan-{i}-of-march.tif {line.split(maxsplit=1)[1]}" for i, line in enumerate(lines[1:])]
        (self.folder / "other.lp").write_text("\n".join([lines[0], *named]) + "\n")
        shown = self.run_line("import photos --lights other.lp -o new.session")
        self.assertEqual(shown.returncode, BAD_INPUT)
        self.assertIn("take all names out of the list", shown.stderr)
        nameless = [line.split(maxsplit=1)[1] for line in named]
        (self.folder / "other.lp").write_text("\n".join([lines[0], *nameless]) + "\n")
        done = self.run_line("import photos --lights other.lp -o nameless.session")
        self.assertEqual(done.returncode, DONE, done.stderr)

    def test_a_ball_of_which_little_is_seen_is_doubted(self):
        """Its wall is as dark as itself, but for 140 degrees; what is no ball at all looks like this too."""
        (self.folder / "arc").mkdir()
        for k in range(6):
            def value(x, y, k=k):
                right, down = x + 0.5 - 58.2, y + 0.5 - 35.7
                if math.hypot(right + 8.2 - 3 * k, down + 5.7 - 4 * (k % 3)) < 1.7:
                    return 250
                is_dark = math.hypot(right, down) < 24.4 or abs(math.atan2(down, right)) > math.radians(70)
                return 20 if is_dark else 120 + (x + 2 * k) % 7

            write_png(self.folder / f"arc/light{k}.png", 120, 80, value)
        done = self.run_line("calibrate arc --target ball -o arc.lights")
        self.assertEqual(done.returncode, DONE, done.stderr)
        self.assertRegex(done.stdout, "(3[0-9]|4[0-9]) % of its outline seen")
        self.assertIn("is it a ball? Look at balls.png", done.stderr)
        self.assertIn("--ball MASK", done.stderr)
        whole = self.run_line("calibrate ball --target ball -o whole.lights")
        self.assertEqual(whole.returncode, DONE, whole.stderr)
        self.assertNotIn("is it a ball", whole.stderr)

    def test_develop_says_where_its_pictures_are(self):
        done = self.run_line("develop session")
        self.assertEqual(done.returncode, DONE, done.stderr)
        place = re.search(r"kept in (\S+)", done.stdout)[1]
        self.assertTrue(any((self.folder / place).iterdir()), place)

    def test_check_reads_a_light_stack_whole(self):
        self.assertEqual(self.run_line("develop session").returncode, DONE)
        stack = next((self.folder / "session/cache").glob("*.hls"))
        self.assertIn(": a good stack: ", self.run_line(f"check {stack}").stdout)
        damaged = bytearray(stack.read_bytes())
        damaged[-1] ^= 1
        (self.folder / "damaged.hls").write_bytes(damaged)
        shown = self.run_line("check damaged.hls")
        self.assertEqual(shown.returncode, BAD_INPUT)
        self.assertIn("damaged.hls", shown.stderr)

    def test_mesh_info_tells_what_is_there_and_names_the_cell_that_is_refused(self):
        told = json.loads(self.run_line("mesh info {volume} --json").stdout)
        self.assertEqual((told["format"], told["points"], told["cells"]), ("vtu", 12, 4))
        self.assertEqual({name: n for name, n in told["types"].items() if n > 0},
                         {"tetrahedron": 1, "hexahedron": 1, "wedge": 1, "pyramid": 1})
        self.assertAlmostEqual(told["volume"], 1 + 1 / 6 + 1 / 2 + 1 / 6, places=14)
        self.assertEqual((told["low"], told["high"]), ([0, -1, 0], [2, 1, 1.5]))
        self.assertEqual([(field["name"], field["components"], field["range"])
                          for field in told["point_fields"] + told["cell_fields"]],
                         [("height", 1, [0, 1.5]), ("velocity", 3, [-1, 2]), ("material", 1, [1, 3])])
        shown = self.run_line("mesh info {volume}").stdout
        self.assertIn("cells: 4: 1 tetrahedron, 1 hexahedron, 1 wedge, 1 pyramid\n", shown)
        self.assertIn("cell field 'material': 1 component, 1 to 3\n", shown)
        inverted = VOLUME.read_text().replace("1 9 5 11", "1 5 9 11")
        (self.folder / "inverted.vtu").write_text(inverted)
        for line in ("mesh info inverted.vtu", "mesh info inverted.vtu --json"):
            shown = self.run_line(line)
            self.assertEqual((shown.returncode, shown.stdout), (BAD_INPUT, ""))
            self.assertIn("inverted.vtu: cell 3, a tetrahedron, is inverted", shown.stderr)
            self.assertRegex(shown.stderr, r"\n  hint: \S")
        self.assertEqual(self.run_line("mesh info {scene}").returncode, BAD_INPUT)

    def test_numbers_out_of_range_nan_and_infinity_are_usage_errors(self):
        for line in ("plate {rig} -o new.hlb --max-error nan", "plate {rig} -o new.hlb --max-error 2",
                     "relight object.hlb --light 0 -o new.png --rotate inf",
                     "relight object.hlb --light 0 -o new.png --exposure nan",
                     "relight object.hlb --light 0 -o new.png --terms -1",
                     "relight object.hlb --light 0 -o new.png --frames 0",
                     "relight object.hlb --light 0 -o new.png --frames 2",
                     "convert object.ptm new.rti --terms 5", "convert object.ptm new.ptm --terms 9",
                     "convert object.ptm new.png", "convert object.ptm new.png --light 0,0,0",
                     "convert object.ptm new.ptm --basis hsh", "convert object.ptm new.rti --jpeg",
                     "publish object.hlb -o new --terms 0", "publish object.hlb -o new --quality 80",
                     "publish object.ptm -o new --quality 101", "publish object.ptm -o new --terms 3",
                     "publish object.ptm -o new --mm-per-pixel 0",
                     "check {rig} --threads 0", "check {rig} --memory 3Q"):
            with self.subTest(line=line):
                self.assertEqual(self.run_line(line).returncode, USAGE)
        self.assertFalse((self.folder / "new.hlb").exists())

    def test_a_repeated_option_takes_one_value_each_time(self):
        done = self.run_line("relight --light 1 --light 0=0.5 object.hlb -o pair.png")
        self.assertEqual(done.returncode, DONE, done.stderr)

    def test_a_missing_input_is_named_with_a_hint_and_leaves_nothing(self):
        before = sorted(self.folder.iterdir())
        for verb, line in self.lines(ABSENT):
            with self.subTest(line=line):
                shown = self.run_line(line)
                self.assertEqual(shown.returncode, BAD_INPUT, shown.stderr)
                self.assertIn(f"haarlight {verb}: ", shown.stderr)
                self.assertRegex(shown.stderr, r"absent")
                self.assertRegex(shown.stderr, r"\n  hint: \S")
                self.assertEqual(sorted(self.folder.iterdir()), before)

    def test_without_a_daemon_its_clients_say_so(self):
        for verb in sorted(CLIENTS | WRITING_CLIENTS - {"capture"}):
            with self.subTest(verb=verb):
                needs_number = verb in ("reshoot", "shot", "preview")
                shown = self.run_line(verb + (" 1" if needs_number else ""))
                self.assertEqual(shown.returncode, UNAVAILABLE, shown.stderr)
                self.assertIn(f"127.0.0.1:{self.closed_port}", shown.stderr)
                self.assertRegex(shown.stderr, r"\n  hint: \S")
        self.assertEqual(self.run_line("capture {plan}").returncode, UNAVAILABLE)

    def test_an_existing_output_is_refused_and_left_as_it_was(self):
        for verb, line in self.lines(WRITES):
            with self.subTest(line=line):
                name = re.search(r"taken[./]\S*", line)[0]
                taken = self.folder / name
                kept = taken / "mine.txt" if name.endswith("/") else taken
                kept.parent.mkdir(exist_ok=True)
                kept.write_text("mine")
                before = sorted(self.folder.rglob("*"))
                shown = self.run_line(line)
                self.assertEqual(shown.returncode, USAGE, shown.stderr)
                self.assertIn(name.rstrip("/"), shown.stderr)
                self.assertRegex(shown.stderr, "new folder" if verb == "capture" else "--force")
                self.assertEqual(kept.read_text(), "mine")
                after = [p for p in sorted(self.folder.rglob("*")) if "cache" not in p.parts]
                self.assertEqual(after, [p for p in before if "cache" not in p.parts])
                kept.unlink()
                if name.endswith("/"):
                    taken.rmdir()

    def test_reports_follow_the_schema_and_quiet_verbs_say_nothing_but_results(self):
        lines = [(verb, line) for verb, line in self.lines(WRITES) if verb not in WRITING_CLIENTS]
        lines += [(verb, f"{verb} {ending}") for verb, ending in READS.items()]
        self.assertEqual({verb for verb, _ in lines} | CLIENTS | DEVICES | WRITING_CLIENTS | SERVERS,
                         set(self.verbs))
        for number, (verb, line) in enumerate(lines):
            line = line.replace("taken", f"out{number}").replace("new", f"beside{number}_")
            report = self.folder / f"report{number}.json"
            with self.subTest(line=line):
                done = self.run_line(line, "--quiet", "--report", report)
                self.assertEqual(done.returncode, DONE, done.stderr)
                self.assertEqual(done.stderr, "")
                self.assertEqual(report_problems(report, verb), [])
                again = self.run_line(line, "--report", report)
                self.assertEqual(again.returncode, USAGE, "the report itself is not overwritten")
                forced = self.run_line(line, "--force", "--report", report)
                self.assertEqual(forced.returncode, DONE, forced.stderr)

    def test_the_viewer_serves_its_page_until_it_is_asked_to_end(self):
        report = self.folder / "view.json"
        for end in (signal.SIGINT, signal.SIGTERM):
            report.unlink(missing_ok=True)
            served = subprocess.Popen([self.programs.haarlight, "view", "object.hlb", "--report", report],
                                      cwd=self.folder, stdout=subprocess.PIPE, text=True)
            try:
                url = re.search(r"http://127\.0\.0\.1:\d+", served.stdout.readline())[0]
                page = urllib.request.urlopen(url, timeout=30)
                self.assertIn("viewer/index.html", page.url)
                about = json.load(urllib.request.urlopen(f"{url}/v1/basis", timeout=30))
                self.assertEqual((about["file"], about["lights"]["count"]), ("object.hlb", 4))
                again = self.run_line(f"view object.hlb --port {url.rsplit(':', 1)[1]}")
                self.assertEqual(again.returncode, UNAVAILABLE, again.stderr)
            finally:
                served.send_signal(end)
                code = served.wait(timeout=30)
                served.stdout.close()
            self.assertEqual(code, DONE)
            self.assertEqual(report_problems(report, "view"), [])
        self.assertEqual(self.run_line("view object.hlb --port 70000").returncode, USAGE)
        self.assertEqual(self.run_line("view object.hlb --web absent").returncode, BAD_INPUT)

    def test_the_simulator_ends_in_order_right_after_it_rendered(self):
        """The ray caster's threads live on for a while: a signal may reach one of them."""
        for i in range(5):
            words = [self.programs.sim, SOURCE / "configs/rigs/small8.toml", "--scene",
                     SOURCE / "configs/scenes/stairs.toml", "--cache", self.folder / f"cache{i}"]
            with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
                                  text=True, cwd=self.folder) as served:
                for line in served.stdout:
                    if line == "ready\n":
                        break
                served.terminate()
                told = served.communicate(timeout=30)[1]
            self.assertEqual(served.returncode, 0, told)
            self.assertIn("frames delivered", told)

    def test_bases_leaves_records_of_the_shared_schema(self):
        done = self.run_line("bases object.hlb -o compared --error 0.05 --size 2")
        self.assertEqual(done.returncode, DONE, done.stderr)
        self.assertIn("left out: Haar: the lights form no grid", done.stdout)
        place = self.folder / "compared"
        records = json.loads((place / "records.json").read_text())
        schema = json.loads((SOURCE / "docs/reference/tradeoff.schema.json").read_text())
        self.assertGreater(len(records), 10)
        self.assertEqual(schema_problems(records, schema), [])
        for name in ("bases.txt", "bases.json", "sizes.svg", "lightings.svg", "regions.svg",
                     "regions.png"):
            self.assertGreater((place / name).stat().st_size, 100, name)

    def test_progress_is_a_bar_on_a_terminal_unless_quiet(self):
        for line in ("develop session --force", "verify session"):
            with self.subTest(line=line):
                self.assertIn("100 %", self.on_a_terminal(line))
                self.assertEqual(self.on_a_terminal(line + " --quiet"), "")

    def on_a_terminal(self, line):
        """What the verb writes to its standard error when that is a terminal."""
        ours, theirs = pty.openpty()
        done = subprocess.run([self.programs.haarlight, *line.split()], cwd=self.folder,
                              stdout=subprocess.DEVNULL, stderr=theirs, timeout=60)
        os.close(theirs)
        self.assertEqual(done.returncode, DONE)
        text = b""
        try:
            while piece := os.read(ours, 65536):
                text += piece
        except OSError:  # Linux: the other end is closed
            pass
        os.close(ours)
        return text.decode()

    def test_check_tells_files_apart_and_lists_every_problem(self):
        good = self.run_line("check {rig} {plan} {scene} {room} plate.hlb " +
                             " ".join(str(SOURCE / "configs" / name) for name in ("faults/bad_day.toml", "scenes/two_cameras.toml")))
        self.assertEqual(good.returncode, DONE, good.stderr)
        for kind in ("rig", "plan", "scene", "environment", "basis", "faults", "cameras"):
            self.assertIn(f": a good {kind}: ", good.stdout)
        self.assertIn('64 shots, fits the rig "small8"', good.stdout)
        bad = {
            "rig.toml": (RIG.read_text().replace("rows = 8", "rows = 0").replace("fps =", "fbs ="),
                         ["rows = 0 is out of range", "fps is missing", "did you mean fps?"]),
            "plan.toml": ('schema = 1\nname = "p"\npatterns = "binns"\nrepeats = 0\n',
                          [r"plan.toml:3: patterns", r"plan.toml:4: repeats", "hint"]),
            "scene.toml": ('[[box]]\nlow = [0, 0, 0]\nhigh = [0, 0, 0]\nmaterial = "m"\n'
                           '[[sphere]]\ncentre = [0, 0]\nradius = -1\nmaterial = "m"\n',
                           [r"scene.toml:3: a box without volume", r"scene.toml:4: no \[\[material",
                            r"scene.toml:6: ", r"scene.toml:7: ", r"scene.toml:8: "]),
            "faults.toml": ('[frames]\nlate_share = 2\n[[bus]]\nat_s = 1\nfor_s = 1\nkind = "off"\n',
                            [r"faults.toml:2: ", r"faults.toml:6: "]),
            "broken.toml": ("[[face]\n", [r"broken.toml:1:"]),
            "other.toml": ("shade = 3\n", ["of no kind of file"]),
            "plan.json": ('{"schema": 1}', ['has no "name"']),
            "sky.hdr": ("#?RADIANCE\nnot a picture", ["sky.hdr"]),
            "cut.hlb": ("", []),
        }
        (self.folder / "bad").mkdir()
        for name, (text, _) in bad.items():
            (self.folder / "bad" / name).write_text(text)
        whole = (self.folder / "plate.hlb").read_bytes()
        (self.folder / "bad/cut.hlb").write_bytes(whole[:200])
        for name, (_, expected) in bad.items():
            with self.subTest(file=name):
                shown = self.run_line(f"check bad/{name}")
                self.assertEqual(shown.returncode, BAD_INPUT)
                self.assertIn(name, shown.stderr)
                self.assertIn("\n  hint: ", shown.stderr)
                for pattern in expected:
                    self.assertRegex(shown.stderr, pattern)
        both = self.run_line("check bad/rig.toml {plan}")
        self.assertEqual(both.returncode, BAD_INPUT)
        self.assertIn(": a good plan: ", both.stdout, "a bad file does not hide a good one")
        (self.folder / "far.toml").write_text(
            'schema = 1\nname = "far"\npatterns = "one_at_a_time"\nlights = [64]\n')
        self.assertEqual(self.run_line("check far.toml").returncode, DONE)
        far = self.run_line("check {rig} far.toml")
        self.assertEqual(far.returncode, BAD_INPUT)
        self.assertIn("light 64 does not exist", far.stderr)
        self.assertEqual(self.run_line("check session").returncode, BAD_INPUT)
        self.assertEqual(self.run_line("check {rig} --as car").returncode, USAGE)

    def test_lights_that_do_not_reach_the_plane_are_said(self):
        text = RIG.read_text()
        down = "emits = [0.0, 0.0, -1.0]"
        self.assertIn(down, text)
        dark = self.folder / "dark.toml"
        dark.write_text(text.replace(down, "emits = [0, 0, 1]"))
        for line in ("check dark.toml", "plate dark.toml -o dark.hlb"):
            with self.subTest(line=line):
                shown = self.run_line(line)
                self.assertEqual(shown.returncode, BAD_INPUT, shown.stderr)
                self.assertIn("no light reaches the plane", shown.stderr)
                self.assertIn("dark.toml", shown.stderr)
        self.assertFalse((self.folder / "dark.hlb").exists())
        begin, end = text.index("[[face]]"), text.index("[[plane]]")
        second = text[begin:end].replace('id = "top"', 'id = "back"').replace(down, "emits = [0, 0, 1]")
        (self.folder / "half.toml").write_text(text[:end] + second + text[end:])
        half = self.run_line("check half.toml")
        self.assertEqual(half.returncode, DONE, half.stderr)
        self.assertIn("warning: 64 of 128 lights (the first: 64) do not reach the plane", half.stdout)

    def test_check_warns_of_a_measured_file_with_the_mean_latch_alone(self):
        text = ('[measured]\ndate = "2026-11-21T10:20:46Z"\ntool = "haarlight"\n'
                'rig_hash = "0"\n\n[measured.controller]\nwith = "x"\nidentity = "y"\n'
                'latch_us = { value = 812, sigma = 3.5, n = 120 }\n')
        most = "latch_most_us = { value = 912, sigma = 20, n = 120 }\n"
        for name, body, is_warned in (("old", text, True), ("new", text + most, False)):
            with self.subTest(file=name):
                (self.folder / f"{name}.measured.toml").write_text(body)
                done = self.run_line(f"check {name}.measured.toml")
                self.assertEqual(done.returncode, DONE, done.stderr)
                shown = done.stdout + done.stderr
                self.assertEqual("warning: it has no latch_most_us" in shown, is_warned, shown)
                self.assertEqual("hint: measure again (haarlight rig commission)" in shown,
                                 is_warned, shown)

    def test_rig_predict_tells_the_numbers_of_the_rig(self):
        cube = str(SOURCE / "configs/rigs/cube32.toml")
        shown = self.run_line(f"rig predict {cube} --object-height 150,150 --receiver=-100 --json")
        self.assertEqual((shown.returncode, shown.stderr), (DONE, ""))
        plane = json.loads(shown.stdout)["planes"][0]
        edge = plane["edges"][0]
        self.assertAlmostEqual(edge["spacing_mm"]["middle"], 6.0)
        self.assertAlmostEqual(edge["penumbra_mm"]["middle"], 5.6)
        self.assertAlmostEqual(edge["largest_pixel_mm"], 2.8)
        self.assertAlmostEqual(edge["receivers"][0]["penumbra_mm"], 28 * 250 / 750)
        text = self.run_line(f"rig predict {cube} --object-height 76,128")
        for words in ("shadow spacing", "penumbra", "ripple", "hard sun", "largest camera pixel"):
            self.assertIn(words, text.stdout)
        for line, words in (("", "--object-height"), ("--object-height 20,10", "above its lowest"),
                            ("--object-height=-5,10", "under the plane"),
                            ("--object-height 5,10 --strip 0", "--strip"),
                            ("--object-height 5,10 --sun 95", "--sun"),
                            ("--object-height 5,10 --receiver 900", "--receiver")):
            with self.subTest(line=line):
                wrong = self.run_line(f"rig predict {cube} {line}")
                self.assertEqual(wrong.returncode, USAGE, wrong.stderr)
                self.assertIn(words, wrong.stderr)
                self.assertIn("\n  hint: ", wrong.stderr)
        high = self.run_line(f"rig predict {cube} --object-height 5,950")
        self.assertEqual(high.returncode, BAD_INPUT)
        self.assertIn("no face is above", high.stderr)

    def test_shadow_keeps_an_error_and_joins_captures(self):
        start = "shadow plate.hlb --scene {scene} --cubemap {room} --no-own-shadows --size 80x60"
        exact = self.run_line(f"{start} -o exact.exr --report exact.json")
        self.assertEqual(exact.returncode, DONE, exact.stderr)
        fast = self.run_line(f"{start} --method plane --max-error 0.01 -o fast.exr --report fast.json")
        self.assertEqual(fast.returncode, DONE, fast.stderr)
        self.assertIn("look-ups each instead of 64", fast.stdout)
        # Blocks of lights ask the hull so often that every light is faster.
        hull = self.run_line(f"{start} --max-error 0.01 -o hull.exr --report hull.json")
        self.assertEqual(hull.returncode, DONE, hull.stderr)
        self.assertIn("every light was looked up", hull.stdout)
        read = lambda name: json.loads((self.folder / name).read_text())
        self.assertTrue(read("hull.json")["details"]["is_exact"])
        self.assertTrue(read("exact.json")["details"]["is_exact"])
        self.assertFalse(read("fast.json")["details"]["is_exact"])
        self.assertLessEqual(read("fast.json")["reached"]["irradiance_relative_l2_limit"], 0.01)
        both = self.run_line(f"{start} --also plate.hlb -o both.exr --report both.json")
        self.assertEqual(both.returncode, DONE, both.stderr)
        # The same plane twice is one plane, seen by two cameras.
        self.assertEqual(read("both.json")["details"]["planes"], 1)
        self.assertGreater(read("both.json")["reached"]["joined_plane_known_share"], 0.9)
        together = self.run_line("shadow plate.hlb --scene {scene} --light 3 --with-object "
                                 "--plane-albedo 0.8 --truth-object {scene} --truth truth.exr "
                                 "-o together.exr --report together.json")
        self.assertEqual(together.returncode, DONE, together.stderr)
        self.assertIn("the object covers", together.stdout)
        self.assertIn("against scene and object ray-traced", together.stdout)
        # The plate shows no object: what is drawn is the scene alone, and that is the truth.
        self.assertLess(read("together.json")["reached"]["relative_l2"], 0.02)
        for line, words in (("--max-error 2", "--max-error"), ("--plane wall", 'no plane "wall"'),
                            ("--with-object", "--plane-albedo"),
                            ("--with-object --plane-albedo 0.8 --size 8x8", "--size"),
                            ("--with-object --plane-albedo 0", "--plane-albedo")):
            with self.subTest(line=line):
                wrong = self.run_line("shadow plate.hlb --scene {scene} --light 3 -o no.exr " + line)
                self.assertEqual(wrong.returncode, USAGE, wrong.stderr)
                self.assertIn(words, wrong.stderr)
        self.assertFalse((self.folder / "no.exr").exists())

    def test_fit_tells_the_size_and_the_worth_of_what_it_wrote(self):
        write_sphere(self.folder / "coded", 48, 22.0)
        done = self.run_line("import coded --lights coded/dirs.lp -o coded.session")
        self.assertEqual(done.returncode, DONE, done.stderr)
        start = "fit coded.session --force"

        def fit(words):
            done = self.run_line(f"{start} --basis hsh4 {words} --report fit.json")
            self.assertEqual(done.returncode, DONE, done.stderr)
            report = json.loads((self.folder / "fit.json").read_text())
            row = done.stdout.splitlines()[-1].split()
            return row, report

        row, report = fit("-o coded-web")
        web = self.folder / "coded-web"  # beside the page, index.html and viewer/
        on_disk = sum(path.stat().st_size for path in (web / "info.json", *web.glob("plane_*.jpg")))
        self.assertEqual(int(row[2]), on_disk)
        self.assertEqual(report["bytes"], on_disk)
        self.assertAlmostEqual(float(row[5]), report["reached"]["file dB"], delta=0.006)
        self.assertEqual(report["reached"]["quality"], 97)
        row, report = fit("-o coded-web --quality 40")
        self.assertEqual(report["reached"]["quality"], 40)
        low = report["reached"]["file dB"]
        self.assertLess(int(row[2]), on_disk)
        asked = (int(row[2]) + on_disk) // 2
        row, report = fit(f"-o coded-web --bytes {asked}")
        self.assertLessEqual(report["bytes"], asked)
        row, report = fit(f"-o coded-web --psnr {low + 0.5:.3f}")
        self.assertGreaterEqual(report["reached"]["file dB"], low + 0.5)
        # The same pictures straight from their folder, PNGs, and whatever else is in it.
        done = self.run_line("fit coded --lights coded/dirs.lp --basis hsh4 -o coded-pictures")
        self.assertEqual(done.returncode, DONE, done.stderr)
        fit("-o coded-web")
        for name in ("info.json", "plane_0.jpg", "plane_3.jpg"):
            self.assertEqual((self.folder / "coded-pictures" / name).read_bytes(),
                             (self.folder / "coded-web" / name).read_bytes(), name)
        for words, code, said in (("-o none --bytes 100", BAD_INPUT, "100 bytes do not hold"),
                                  ("-o none --psnr 90", BAD_INPUT, "cannot be achieved"),
                                  ("-o none --psnr 30 --bytes 1M", USAGE, "each decide the others"),
                                  ("-o none.rti --quality 90", USAGE, "write a folder"),
                                  ("-o none --bytes many", USAGE, "--bytes 800k"),
                                  ("-o none --basis rbf", USAGE, "--basis bilinear")):
            with self.subTest(words=words):
                wrong = self.run_line(f"{start} {words}")
                self.assertEqual(wrong.returncode, code, wrong.stderr)
                self.assertIn(said, wrong.stderr)
                self.assertEqual(list(self.folder.glob("none*")), [])

    def test_shape_takes_normals_as_rti_viewers_do(self):
        size, radius = 48, 22.0
        write_sphere(self.folder / "sphere", size, radius)
        for line in ("import sphere --lights sphere/dirs.lp -o sphere.session",
                     "fit sphere.session --basis ptm --ridge 0 -o sphere.ptm"):
            done = self.run_line(line)
            self.assertEqual(done.returncode, DONE, done.stderr)

        def mean_error(line):
            done = self.run_line(f"shape {line} --mesh ply --force -o sphere.shape --report sphere.json")
            self.assertEqual(done.returncode, DONE, done.stderr)
            self.assertEqual(report_problems(self.folder / "sphere.json", "shape"), [])
            errors = [math.degrees(math.acos(max(-1.0, min(
                          1.0, n[0] * x + n[1] * y + n[2] * math.sqrt(1.0 - x * x - y * y)))))
                      for (x, y), n in sphere_normals(self.folder / "sphere.shape/mesh.ply", radius)
                      if math.hypot(x, y) < 0.8]
            self.assertGreater(len(errors), 800)
            return sum(errors) / len(errors)

        # Matte grey without shadows but its own: 8 bits leave 0.09 degrees. The peaks of exact
        # biquadratics lie 10.77 degrees off (a fit in doubles, written apart), bytes add 0.01.
        # hsh: 2.22 measured.
        for line, expected, within in (("sphere.session", 0.0, 0.2),
                                       ("sphere.session --method ptm", 10.77, 0.1),
                                       ("sphere.session --method hsh", 2.2, 0.5),
                                       ("sphere.ptm", 10.77, 0.1)):
            with self.subTest(line=line):
                self.assertAlmostEqual(mean_error(line), expected, delta=within)
        shown = {path.name for path in (self.folder / "sphere.shape").iterdir()}
        self.assertIn("front.png", shown)
        self.assertIn("pixels_without_a_peak",
                      json.loads((self.folder / "sphere.json").read_text())["details"])
        for line, words in (("sphere.ptm --method hsh", "holds ptm"),
                            ("sphere.session --method ptm --light near", "--light near")):
            with self.subTest(line=line):
                wrong = self.run_line(f"shape {line} -o no.shape")
                self.assertEqual(wrong.returncode, USAGE, wrong.stderr)
                self.assertIn(words, wrong.stderr)
        self.assertFalse((self.folder / "no.shape").exists())

    def shape(self, line, name):
        """Runs shape on a session; its words, its warnings, its report."""
        done = self.run_line(f"shape {line} --force -o {name}.shape --report {name}.json")
        self.assertEqual(done.returncode, DONE, done.stderr)
        self.assertEqual(report_problems(self.folder / f"{name}.json", "shape"), [])
        return done.stdout, done.stderr, json.loads((self.folder / f"{name}.json").read_text())

    def import_surface(self, name, size, normal, widths=None):
        write_surface(self.folder / name, size, normal, widths)
        done = self.run_line(f"import {name} --lights {name}/dirs.lp -o {name}.session")
        self.assertEqual(done.returncode, DONE, done.stderr)

    def test_shape_finds_the_mask_and_states_its_errors(self):
        size, radius = 48, 20.0
        self.import_surface("matte", size, lambda x, y: ball(x, y, radius))
        n_ball = sum(ball(i % size + 0.5 - size / 2, i // size + 0.5 - size / 2, radius) is not None
                     for i in range(size * size))
        words, warnings, report = self.shape("matte.session --mesh ply", "matte")
        found = report["details"]["mask_pixels"]
        self.assertIn(f"mask: found by darkness, {found} of {size * size} pixels", words)
        self.assertTrue((self.folder / "matte.shape/mask.png").is_file())
        self.assertTrue((self.folder / "matte.shape/sigma.exr").is_file())
        # The horizon, lit by few lights, may be missed: a ring of a pixel.
        self.assertLessEqual(found, n_ball)
        self.assertGreater(found, n_ball - 2 * math.pi * radius)
        self.assertEqual(report["details"]["part_pixels"], [report["reached"]["good_pixels"]])
        self.assertNotIn("do not touch", warnings)
        # What it states of its normals holds: the printed numbers, and two of them cover.
        median = report["reached"]["sigma_deg_median"]
        most = report["reached"]["sigma_deg_nine_tenths"]
        stated = re.search(r"\+- (\S+) degrees in the median, nine tenths within (\S+) ", words)
        self.assertAlmostEqual(float(stated[1]), median, delta=0.06 * median)
        self.assertAlmostEqual(float(stated[2]), most, delta=0.06 * most)
        errors = sorted(math.degrees(math.acos(max(-1.0, min(1.0, sum(
                            a * b for a, b in zip(n, ball(x * radius, y * radius, radius)))))))
                        for (x, y), n in sphere_normals(self.folder / "matte.shape/mesh.ply", radius)
                        if math.hypot(x, y) < 0.99)
        self.assertGreater(len(errors), 800)
        self.assertLessEqual(errors[len(errors) // 2], 2 * median)
        self.assertLessEqual(errors[9 * len(errors) // 10], 2 * most)
        self.assertLess(median, 2.0)  # and they are no excuse: 8 bits leave 0.1

        words, _, report = self.shape("matte.session --mask none --mesh none", "whole")
        self.assertIn(f"mask: every pixel, {size * size} of", words)
        write_png(self.folder / "half.png", size, size, lambda x, y: 255 if x < size // 2 else 0)
        words, _, report = self.shape("matte.session --mask half.png --mesh none", "half")
        self.assertIn(f"mask: given, {size * size // 2} of", words)
        self.assertLessEqual(report["reached"]["good_pixels"], n_ball // 2)

    def test_shape_says_what_it_cannot_know(self):
        size = 48
        self.import_surface("pair", size, lambda x, y: ball(x + 12, y, 10.0) or ball(x - 12, y, 7.0))
        _, warnings, report = self.shape("pair.session --mesh none", "pair")
        large, small = report["details"]["part_pixels"]
        self.assertGreater(large, small)
        self.assertIn(f"2 parts do not touch ({large:.0f}, {small:.0f} pixels)", warnings)
        self.assertEqual(report["details"]["part_heights"], [None, None])
        # A flat sheet under lights three widths away, of which only directions are listed.
        self.import_surface("door", size, lambda x, y: (0.0, 0.0, 1.0), widths=3.0)
        words, warnings, report = self.shape("door.session --mesh none", "door")
        self.assertIn("every pixel", words)
        self.assertIn("heights have no standard error", words)
        self.assertRegex(warnings, r"look about [2-5](\.\d)? picture widths away")
        self.assertIn("are one slow bow", warnings)
        self.assertIn("--places positions", warnings)
        self.assertGreater(report["details"]["heights_bow"], report["details"]["heights_without_bow"])
        # The truth is flat: at the border two standard errors hold what the lights turn there.
        self.assertGreater(report["reached"]["sigma_deg_nine_tenths"], 3.0)

    def test_the_validator_refuses_broken_reports(self):
        schema = {"type": "object", "required": ["a"], "additionalProperties": False,
                  "properties": {"a": {"type": "integer"}, "b": {"type": "array",
                                                                "items": {"type": "string"}}}}
        self.assertEqual(schema_problems({"a": 1, "b": ["x"]}, schema), [])
        for broken in ([], {}, {"a": 1.5}, {"a": True}, {"a": 1, "c": 0}, {"a": 1, "b": [1]}):
            self.assertTrue(schema_problems(broken, schema), broken)


if __name__ == "__main__":
    BIN = sys.argv.pop(1)
    unittest.main(verbosity=2)
