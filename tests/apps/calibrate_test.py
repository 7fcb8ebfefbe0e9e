#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""`haarlight rig calibrate`: a sheet of paper captured on a virtual rig whose lights are not where the
rig file has them; a chessboard drawn in closed form for the lens and the plane. calibrate_test.py
BIN, the build's folder apps/."""

import math
import pathlib
import re
import signal
import subprocess
import sys
import tempfile
import tomllib
import unittest

from chessboards import BOARD, LENS, draw_flat_board, draw_lens_boards, write_lab
from programs import SOURCE, Programs, free_port, report_problems, wait_for

# Truth: the face lower, aside and tilted by 1 degree about x.
TILT = math.radians(1.0)
TRUTH = [("centre", "[7.0, -4.0, 620.0]"),
         ("v", f"[0.0, {math.cos(TILT)!r}, {math.sin(TILT)!r}]"),
         ("emits", f"[0.0, {math.sin(TILT)!r}, {-math.cos(TILT)!r}]")]


class Calibrate(unittest.TestCase):
    def setUp(self):
        self.programs = Programs(BIN)
        place = tempfile.TemporaryDirectory(prefix="haarlight-calibrate.")
        self.addCleanup(place.cleanup)
        self.folder = pathlib.Path(place.name)
        self.port = free_port()
        self.url = f"http://127.0.0.1:{self.port}"

    def write_rigs(self):
        # Large LEDs: taken as points they stand off by about 0.6 w^2 / h, 3.5 mm.
        rig = self.folder / "lab.toml"
        write_lab(rig, self.folder, self.port, [("emitter", "[60.0, 60.0]")])
        text = rig.read_text()
        rig.write_text(re.sub(r"(?m)^centre = .*", "centre = [0.0, 0.0, 600.0]", text))
        truth = text
        for key, value in TRUTH:
            head, tail = truth.split("[[plane]]", 1)
            head, n = re.subn(rf"(?m)^{key} = .*", f"{key} = {value}", head)
            self.assertEqual(n, 1, key)
            truth = head + "[[plane]]" + tail
        (self.folder / "truth.toml").write_text(truth)
        return rig

    def start(self, log, *words):
        process = subprocess.Popen(list(map(str, words)), stdout=log, stderr=log)

        def end():
            if process.poll() is None:
                process.send_signal(signal.SIGTERM)
            process.wait(timeout=30)

        self.addCleanup(end)
        return process

    def test_finds_the_lens_and_the_plane(self):
        rig = self.write_rigs()
        boards = [self.folder / f"board{i}.png" for i in range(5)]
        draw_lens_boards(boards)
        pictures = [word for board in boards for word in ("--picture", board)]
        done = self.programs.run("rig", "calibrate", "camera", rig, *pictures, *BOARD, "--report",
                                 self.folder / "report.json")
        print(done.stdout)
        self.assertEqual(done.returncode, 0, done.stdout + done.stderr)
        self.assertEqual(report_problems(self.folder / "report.json", "rig"), [])
        measured = self.folder / "lab.measured.toml"
        camera = tomllib.loads(measured.read_text())["measured"]["camera"][0]
        for found, sigma, true in zip(camera["lens_k"], camera["lens_k_sigma"], LENS):
            self.assertLess(abs(found - true), 5.0 * sigma + 0.05, camera)
        self.assertIn("board4.png", (self.folder / "lab.camera.html").read_text())

        # The plane 3 mm up and tilted by half a degree about x, from the rig file's camera.
        tilt = math.radians(0.5)
        draw_flat_board(self.folder / "flat.png", tilt)
        done = self.programs.run("rig", "calibrate", "plane", rig, "--picture",
                                 self.folder / "flat.png", *BOARD)
        print(done.stdout)
        self.assertEqual(done.returncode, 0, done.stdout + done.stderr)
        plane = tomllib.loads(measured.read_text())["measured"]["plane"][0]
        n = [0.0, -math.sin(tilt), math.cos(tilt)]
        wrong = math.degrees(math.acos(min(1.0, sum(a * b for a, b in zip(plane["n"], n)))))
        self.assertLess(wrong, 5.0 * plane["tilt_sigma_deg"] + 0.2, plane)
        height = -plane["d"] - (plane["n"][1] * 5.0)
        self.assertLess(abs(height / plane["n"][2] - 3.0), 5.0 * plane["distance_sigma"] + 2.0, plane)
        # Both stay, and win.
        camera = tomllib.loads(measured.read_text())["measured"]["camera"][0]
        self.assertEqual(len(camera["lens_k"]), 4)
        self.assertEqual(self.programs.run("check", rig).returncode, 0)
        done = self.programs.run("rig", "calibrate", "plane", rig, "--picture",
                                 self.folder / "flat.png", "--board", "7,5", "--force")
        self.assertEqual(done.returncode, 65, done.stdout)
        self.assertIn("no picture shows the whole board", done.stderr)

    def test_finds_the_face_that_the_rig_file_has_elsewhere(self):
        rig = self.write_rigs()
        ready = self.folder / "ready"
        log = open(self.folder / "log", "wb")
        self.addCleanup(log.close)
        self.start(log, self.programs.sim, self.folder / "truth.toml", "--scene",
                   SOURCE / "configs/scenes/empty.toml", "--ready-file", ready)
        wait_for(ready.exists, 300, "the simulator")
        self.start(log, self.programs.daemon, rig)
        wait_for(lambda: self.programs.run("status", "--daemon", self.url).returncode == 0, 30,
                 "the daemon")
        done = self.programs.run("capture", SOURCE / "configs/plans/quick.toml", "--daemon",
                                 self.url, "--quiet", timeout=300)
        self.assertEqual(done.returncode, 0, done.stderr)
        session = done.stdout.strip()

        done = self.programs.run("rig", "calibrate", "lights", rig, "--session", session, "--report",
                                 self.folder / "report.json", timeout=300)
        print(done.stdout)
        self.assertEqual(done.returncode, 0, done.stdout + done.stderr)
        self.assertEqual(report_problems(self.folder / "report.json", "rig"), [])
        page = (self.folder / "lab.lights.html").read_text()
        self.assertIn("Power of each light", page)
        face = tomllib.loads((self.folder / "lab.measured.toml").read_text())["measured"]["face"][0]
        truth = [7.0, -4.0, 620.0]
        for c in range(3):
            self.assertLess(abs(face["centre"][c] - truth[c]),
                            max(5.0 * face["centre_sigma"][c], 0.5), face)
        wrong = math.degrees(math.acos(min(1.0, face["emits"][1] * math.sin(TILT) -
                                           face["emits"][2] * math.cos(TILT))))
        self.assertLess(wrong, 0.1)
        self.assertLess(abs(face["lobe_mu"]["value"] - 1.0), 0.05)
        self.assertEqual(len(face["power"]), 64)

        # What was measured wins in every program, and a second calibration stands where it is.
        done = self.programs.run("check", rig)
        self.assertEqual(done.returncode, 0, done.stderr)
        other = self.folder / "other.toml"
        other.write_text(rig.read_text().replace('name = "small8"', 'name = "another"'))
        done = self.programs.run("rig", "calibrate", "lights", other, "--session", session)
        self.assertEqual(done.returncode, 65)
        self.assertIn("another rig file", done.stderr)
        done = self.programs.run("rig", "calibrate", "lights", rig)
        self.assertEqual(done.returncode, 2)


if __name__ == "__main__":
    BIN = sys.argv.pop(1)
    unittest.main()
