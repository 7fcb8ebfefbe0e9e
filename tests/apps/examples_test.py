#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Runs every example that --help, README.md and docs/ show, as it stands there, on a virtual rig:
the cube of 1024 lights with small cameras. examples_test.py BIN, the build's folder apps/."""

import os
import pathlib
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
import time
import unittest

from chessboards import draw_flat_board, draw_lens_boards, write_lab
from programs import (SOURCE, Programs, VirtualRig, footer_examples, free_port, report_problems,
                      rig_on_free_ports, wait_for, write_capture,
                      write_relightable)


def shown_commands(document):
    """Commands of a Markdown file: lines of its indented or fenced code that begin with a program's
    name. Comments are left out."""
    text = (SOURCE / document).read_text()
    lines = re.findall(r"^(?:    )?(haarlight(?:-sim|d)? .*)$", text, re.M)
    code = [line for line in lines if f"    {line}" in text or f"```sh\n{line}" in text]
    return [line.split(" #")[0].strip() for line in code]


class Examples(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.programs = Programs(BIN)
        cls.place = tempfile.TemporaryDirectory(prefix="haarlight-examples.")
        cls.folder = pathlib.Path(cls.place.name)
        cls.port = free_port()
        cls.url = f"http://127.0.0.1:{cls.port}"
        for part in ("plans", "scenes", "environments", "faults", "volumes"):
            shutil.copytree(SOURCE / "configs" / part, cls.folder / "configs" / part)
        for scene in (cls.folder / "configs/scenes").glob("*.toml"):
            scene.write_text(re.sub(r"(?m)^size = .*", "size = [48, 36]", scene.read_text()))
        rigs = cls.folder / "configs/rigs"
        rigs.mkdir()
        small = (SOURCE / "configs/rigs/small8.toml").read_text()
        camera = re.search(r"\[\[camera\]\].*?(?=\[controller\])", small, re.S)[0]
        # Fewer pixels, as the embedded metadata rows need 48 columns, and nearer: shape needs some hundred of the object.
        for key, value in (("size", "[48, 44]"), ("active_area", "36"),
                           ("K", "[[160.0, 0.0, 24.0], [0.0, 160.0, 18.0], [0.0, 0.0, 1.0]]")):
            camera, n = re.subn(rf"(?m)^{key} = .*", f"{key} = {value}", camera)
            assert n == 1, key
        cube = (SOURCE / "configs/rigs/cube32.toml").read_text()
        source = cls.folder / "cube32_small_camera.toml"
        source.write_text(re.sub(r"\[\[camera\]\].*?(?=\[controller\])", camera, cube, flags=re.S))
        rig_on_free_ports(source, rigs / "cube32.toml", cls.folder, cls.port)
        (cls.folder / "small8").mkdir()
        rig_on_free_ports(SOURCE / "configs/rigs/small8.toml", rigs / "small8.toml",
                          cls.folder / "small8", free_port())
        for name in ("apartment.hdr", "sky.hdr"):
            shutil.copy(SOURCE / "configs/environments/room.hdr", cls.folder / name)

    @classmethod
    def tearDownClass(cls):
        cls.place.cleanup()

    def run_shown(self, command, folder=None, expected=0, url=None):
        """Runs a command as a user would type it; `url`: the daemon's, else the cube's."""
        words = shlex.split(command)
        self.assertEqual(words[0], "haarlight", command)
        start = time.monotonic()
        done = self.programs.run(*words[1:], cwd=folder or self.folder, timeout=300,
                                 HAARLIGHT_DAEMON=url or self.url)
        print(f"{time.monotonic() - start:6.1f} s  {command}", flush=True)
        self.assertEqual(done.returncode, expected, f"{command}\n{done.stdout}{done.stderr}")
        return done

    def begin_simulator(self, rig, scene="empty"):
        """haarlight-sim alone, until the end of the test. @return  its process"""
        ready = self.folder / "alone.ready"
        ready.unlink(missing_ok=True)
        with (self.folder / "alone.log").open("w") as log:
            served = subprocess.Popen(
                [self.programs.sim, rig, "--scene", f"configs/scenes/{scene}.toml", "--ready-file", ready,
                 "--cache", self.folder / "cache"], cwd=self.folder, stdout=log, stderr=log)
        self.addCleanup(served.wait, timeout=30)
        self.addCleanup(served.terminate)
        wait_for(ready.exists, 120, "the simulator")
        return served

    def capture_once(self, rig, session):
        """What the simulator shows, by a daemon that has ended afterwards."""
        with (self.folder / "capture.log").open("w") as log:
            daemon = subprocess.Popen([self.programs.daemon, rig], cwd=self.folder, stdout=log,
                                      stderr=log)
        url = re.search(r"(?m)^port = (\d+)", (self.folder / rig).read_text())[1]
        url = f"http://127.0.0.1:{url}"
        try:
            wait_for(lambda: self.programs.run("status", "--daemon", url).returncode == 0, 30,
                     "the daemon")
            done = self.programs.run("capture", "configs/plans/quick.toml", "--daemon", url,
                                     "--quiet", cwd=self.folder)
            self.assertEqual(done.returncode, 0, done.stderr)
            shutil.copytree(self.folder / done.stdout.strip(), self.folder / session)
        finally:
            daemon.terminate()
            self.assertEqual(daemon.wait(timeout=30), 0)

    def draw_calibrations(self, folder):
        """chrome/, balls/ and paper/: what `haarlight calibrate` is shown on. NumPy is Debian's."""
        subprocess.run(["/usr/bin/python3", SOURCE / "tests/apps/made_lights.py", folder], check=True)

    def phase(self):
        return self.programs.run("status", "--daemon", self.url).stdout.split()[0]

    def wait_for_phase(self, *phases):
        wait_for(lambda: self.phase() in phases, 60, f"phase {phases}")

    def begin_capture(self):
        """A capture in the background, until it runs."""
        capture = subprocess.Popen(
            [self.programs.haarlight, "capture", "configs/plans/one_at_a_time.toml", "--daemon",
             self.url], cwd=self.folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        self.wait_for_phase("running")
        return capture

    def examples_of(self, verb):
        return footer_examples(self.programs.run(*verb.split(), "--help").stdout)

    def test_examples_of_every_verb(self):
        left = self.programs.whole_verbs()

        def run_examples(*verbs):
            for verb in verbs:
                left.remove(verb)
                for example in self.examples_of(verb):
                    self.run_shown(example)

        run_examples("check", "plan", "advise", "cameras")
        self.begin_simulator("configs/rigs/small8.toml")
        self.capture_once("configs/rigs/small8.toml", "sheet.session")
        self.draw_calibrations(self.folder)
        write_lab(self.folder / "lab.toml", self.folder, free_port())
        draw_lens_boards([self.folder / f"{name}.png" for name in "abc"])
        draw_flat_board(self.folder / "flat.png", 0.0)
        run_examples("rig doctor", "rig commission", "rig calibrate camera", "rig calibrate plane",
                     "rig calibrate lights", "rig predict", "calibrate")
        rig = VirtualRig(self.programs, "configs/rigs/cube32.toml", "configs/scenes/airplane.toml",
                         self.folder, self.url, cwd=self.folder)
        try:
            run_examples("capture")
            with self.subTest("a capture reports its shots, and quiet is quiet"):
                done = self.programs.run("capture", "configs/plans/quick.toml", "--daemon", self.url,
                                         "--quiet", "--report", "capture.json", cwd=self.folder)
                self.assertEqual((done.returncode, done.stderr), (0, ""))
                self.assertEqual(report_problems(self.folder / "capture.json", "capture"), [])
            run_examples("status")
            capture = self.begin_capture()
            run_examples("pause")
            self.wait_for_phase("paused")
            run_examples("resume")
            self.wait_for_phase("running")
            run_examples("abort")
            self.assertEqual(capture.wait(timeout=60), 75, capture.stderr.read())
            capture.stdout.close()
            capture.stderr.close()
            run_examples("all-off")
            self.run_shown("haarlight resume")
            self.wait_for_phase("idle", "done")
            session = self.run_shown("haarlight capture configs/plans/quick.toml").stdout.strip()
            run_examples("reshoot")
            self.wait_for_phase("done")
            run_examples("shot", "sessions")
            self.run_shown(f"haarlight verify {session}")
            for line in ("reshoot 3", "status", "pause", "resume", "abort", "all-off"):
                with self.subTest("report", line=line):
                    verb = line.split()[0]
                    done = self.programs.run(*line.split(), "--daemon", self.url, "--quiet",
                                             "--report", f"{verb}.json", cwd=self.folder)
                    self.assertEqual((done.returncode, done.stderr), (0, ""))
                    self.assertEqual(report_problems(self.folder / f"{verb}.json", verb), [])
            self.run_shown("haarlight resume")
            self.wait_for_phase("idle", "done")
            run_examples("preview")
            self.run_shown("haarlight abort")
            self.wait_for_phase("idle")
        finally:
            self.assertEqual(rig.end(), [0, 0])

        shutil.copytree(self.folder / "vase", self.folder / "sessions/airplane")
        shutil.copytree(self.folder / "vase", self.folder / "cube.session")
        write_capture(self.folder / "door")
        write_capture(self.folder / "rig", n_lights=64, scale=800.0)
        shutil.copy(self.folder / "rig/dirs.lp", self.folder / "rig.lp")
        write_capture(self.folder / "ball")
        shutil.copy(self.folder / "ball/dirs.lp", self.folder / "lights.txt")
        shutil.copy(self.folder / "ball/light0.png", self.folder / "ball/mask.png")
        shutil.copytree(SOURCE / "tests/data/small_rti", self.folder / "card")
        self.run_shown("haarlight import door/ --lights door/dirs.lp -o dark.session")
        self.run_shown("haarlight export dark.session --lp -o lit.lp --exr lit")
        run_examples("import")
        shutil.copytree(self.folder / "door.session", self.folder / "sessions/coin")
        write_relightable(self.folder / "coin.ptm")
        shutil.copy(self.folder / "door/dirs.lp", self.folder / "dome.lp")
        for part, name in enumerate(("first", "second")):
            self.run_shown("haarlight render surface configs/scenes/cornell.toml --spp 4 "
                           f"--part {part + 1}/2 --film {name}.film")
        run_examples("verify", "rebuild", "develop", "export", "convert", "plate", "compress", "relight",
                     "bases", "fit", "shadow", "hull", "correct", "shape", "publish",
                     "render surface", "render join", "render smooth", "render soft-shadow", "render volume", "mesh info",
                     "mesh convert")
        for server in ("view", "serve"):
            left.remove(server)
            for example in self.examples_of(server):
                self.run_viewer(example, self.folder)
        self.assertEqual(left, [], "verbs whose examples were not run")

    def test_readme_in_use(self):
        """The demo, then every line of the README in order, as a new user types them."""
        place = self.folder / "readme"
        place.mkdir()
        shutil.copytree(self.folder / "configs", place / "configs")
        start = time.monotonic()
        demo = subprocess.run([SOURCE / "scripts/run_demo", self.programs.bin, place / "out/demo",
                               place / "configs/rigs/cube32.toml"], capture_output=True, text=True,
                              env={**os.environ, "XDG_CACHE_HOME": str(self.folder / "cache")},
                              timeout=400, check=False)
        print(f"{time.monotonic() - start:6.1f} s  scripts/run_demo", flush=True)
        self.assertEqual(demo.returncode, 0, demo.stdout + demo.stderr)
        page = (place / "out/demo/index.html").read_text()
        for name in re.findall(r'(?:src|href)="([^"#:]+)"', page):
            self.assertTrue((place / "out/demo" / name).exists(), f"the demo's page shows {name}")
        commands = shown_commands("README.md")
        self.assertGreaterEqual(len(commands), 17)
        self.type_in_order(commands, place)
        for picture in ("sky.png", "shadow.exr"):
            self.assertGreater((place / picture).stat().st_size, 1000)
        self.make_gallery(place)

    def make_gallery(self, place):
        """The commands of the gallery with fewer pixels, samples and photons, where README's were typed."""
        shown = shown_commands("docs/gallery.md")
        pictures = set(re.findall(r"\]\(images/(gallery-[a-z-]+\.png)\)", (SOURCE / "docs/gallery.md").read_text()))
        self.assertGreaterEqual(len(pictures), 8)
        commands = [re.sub(r"--(spp|photons) (\d+)", lambda found: f"--{found[1]} {max(2, int(found[2]) // 128)}",
                           re.sub(r"--size \S+", "--size 48x36", re.sub(r"--crop \S+", "--crop 48x30+0+6", command)))
                    for command in shown]
        self.type_in_order(commands, place)
        for picture in pictures:
            self.assertGreater((place / picture).stat().st_size, 500, "a picture of the gallery that its commands do not make")

    def test_the_readmes_outputs_are_nothing_that_the_checkout_has(self):
        """The README is typed beside README.md, not in an empty folder as above."""
        commands = shown_commands("README.md")
        names = [name for command in commands
                 for name in re.findall(r" (?:-o|--png) (\S+)", command)]
        self.assertGreaterEqual(len(names), 12)
        found = subprocess.run(["git", "-C", SOURCE, "ls-files", "--", *names], capture_output=True,
                               text=True, check=False)
        if found.returncode != 0:
            self.skipTest("not a git checkout")
        self.assertEqual(found.stdout, "", "the command would find something there already")

    def type_in_order(self, commands, folder, url=None):
        """As a user types them into one shell; what ends in & runs until the last."""
        served = []
        try:
            for command in commands:
                with self.subTest(command=command):
                    if command.endswith(" &"):
                        served.append(self.start_shown(command, folder))
                    elif command.startswith(("haarlight view ", "haarlight serve ")):
                        self.run_viewer(command, folder)
                    else:
                        self.run_shown(command, folder, url=url)
        finally:
            for process in reversed(served):
                process.terminate()
                self.assertEqual(process.wait(timeout=30), 0, process.args)

    def test_guides(self):
        """Each guide in a folder of its own, with what it says that its reader has."""
        guides = sorted((SOURCE / "docs/guides").glob("*.md"))
        self.assertGreaterEqual(len(guides), 5)
        for guide in guides:
            place = self.folder / "guides" / guide.stem
            shutil.copytree(self.folder / "configs", place / "configs")
            shutil.copy(self.folder / "sky.hdr", place)
            write_capture(place / "photos", n_lights=24)
            port = free_port()
            rig_on_free_ports(SOURCE / "configs/rigs/small8.toml", place / "rig.toml", place, port)
            self.draw_calibrations(place)
            for command in ("import photos --lights photos/dirs.lp -o door.session",
                            "plate rig.toml -o object.hlb"):
                self.assertEqual(self.programs.run(*command.split(), cwd=place).returncode, 0)
            commands = shown_commands(guide)
            if any("-o door.session" in command for command in commands):
                shutil.rmtree(place / "door.session")
            with self.subTest(guide=guide.name):
                self.assertGreaterEqual(len(commands), 3)
                self.type_in_order(commands, place, f"http://127.0.0.1:{port}")

    def start_shown(self, command, folder):
        """A program in the background, as a shell starts it; the simulator until it says that it
        is ready. @return  its process"""
        words = shlex.split(command)[:-1]
        program = {"haarlight-sim": self.programs.sim, "haarlightd": self.programs.daemon}[words[0]]
        log = folder / f"{words[0]}.log"
        with log.open("w") as out:
            process = subprocess.Popen([program, *words[1:]], cwd=folder, stdout=out, stderr=out,
                                       env={**os.environ, "XDG_CACHE_HOME": str(self.folder / "cache")})
        if words[0] == "haarlight-sim":
            wait_for(lambda: "\nready\n" in log.read_text() or process.poll() is not None, 120, command)
        return process

    def test_commands_of_the_documents(self):
        place = self.folder / "documents"
        place.mkdir()
        shutil.copytree(self.folder / "configs", place / "configs")
        shutil.copy(self.folder / "configs/rigs/small8.toml", place / "rig.toml")
        shutil.copy(self.folder / "configs/plans/one_at_a_time.toml", place / "plan.toml")
        write_relightable(place / "coin.ptm")
        self.run_shown("haarlight plate rig.toml -o object.hlb", place)
        write_capture(place / "door")
        shutil.copytree(SOURCE / "tests/data/small_rti", place / "card")
        self.run_shown("haarlight import door/ --lights door/dirs.lp -o door.session", place)
        self.sign(place / "door.session", place / "lab_signers")
        self.draw_calibrations(place)
        for scene, session in (("empty", "sheet.session"), ("airplane", "airplane.session")):
            served = self.begin_simulator("configs/rigs/small8.toml", scene)
            self.capture_once("configs/rigs/small8.toml", session)
            served.terminate()  # documents start simulators of this rig themselves
            served.wait(timeout=30)
            shutil.move(self.folder / session, place / session)
        self.run_shown("haarlight compress airplane.session -o airplane.hlb", place)
        for document in sorted((SOURCE / "docs/reference").glob("*.md")):
            for command in shown_commands(document):
                with self.subTest(document=document.name, command=command):
                    if command.startswith("haarlight-sim "):
                        self.run_simulator(command, place)
                    elif command.startswith(("haarlight view ", "haarlight serve ")):
                        self.run_viewer(command, place)
                    else:
                        self.run_shown(command, place)

    def test_examples_of_the_simulator_and_the_daemon(self):
        for program in (self.programs.sim, self.programs.daemon):
            text = subprocess.run([program, "--help"], capture_output=True, text=True,
                                  check=True).stdout
            examples = footer_examples(text)
            self.assertTrue(examples)
            for example in examples:
                with self.subTest(example=example):
                    if program == self.programs.sim:
                        self.run_simulator(example, self.folder)
                    else:
                        self.run_program(program, example, self.folder, "haarlightd 0")

    def sign(self, session, signers):
        """As docs/reference/session-format.md says, with a key made here."""
        key = self.folder / "lab_key"
        for words in (["-q", "-t", "ed25519", "-N", "", "-f", key],
                      ["-q", "-Y", "sign", "-f", key, "-n", "haarlight", session / "session.json"]):
            subprocess.run(["ssh-keygen", *words], stdin=subprocess.DEVNULL, check=True,
                           capture_output=True)
        signers.write_text("name@lab.org " + key.with_suffix(".pub").read_text())

    def run_viewer(self, command, folder):
        self.run_program(self.programs.haarlight, re.sub(r"--port \d+", f"--port {free_port()}", command),
                         folder, "on http://")

    def run_simulator(self, command, folder):
        self.run_program(self.programs.sim, command.replace("/tmp/", f"{folder}/"), folder, "ready\n")

    def run_program(self, program, command, folder, sign):
        """Starts a program that serves, waits until it says `sign`, asks it to end."""
        log = folder / "served.log"
        with log.open("w") as out:
            served = subprocess.Popen([program, *shlex.split(command)[1:]], cwd=folder, stdout=out,
                                      stderr=out, env={**os.environ, "XDG_CACHE_HOME": str(folder)})
            try:
                wait_for(lambda: sign in log.read_text() or served.poll() is not None, 120, command)
            finally:
                served.terminate()
                code = served.wait(timeout=30)
        self.assertIn(sign, log.read_text())
        self.assertEqual(code, 0, log.read_text())


if __name__ == "__main__":
    BIN = sys.argv.pop(1)
    unittest.main(verbosity=2)
