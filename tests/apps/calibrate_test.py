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

from programs import (SOURCE, Programs, free_port, png_bytes, report_problems, rig_on_free_ports,
                      wait_for)

# Truth: the face lower, aside and tilted by 1 degree about x.
TILT = math.radians(1.0)
TRUTH = [("centre", "[7.0, -4.0, 620.0]"),
         ("v", f"[0.0, {math.cos(TILT)!r}, {math.sin(TILT)!r}]"),
         ("emits", f"[0.0, {math.sin(TILT)!r}, {-math.cos(TILT)!r}]")]


WIDTH, HEIGHT = 192, 144
COLS, ROWS, SQUARE = 9, 6, 40.0


def turned(axis, angle):
    """A rotation matrix about the x, y or z axis."""
    c, s = math.cos(angle), math.sin(angle)
    i, j = [(1, 2), (2, 0), (0, 1)][axis]
    m = [[float(a == b) for b in range(3)] for a in range(3)]
    m[i][i] = m[j][j] = c
    m[i][j], m[j][i] = -s, s
    return m


def times(a, b):
    return [[sum(a[i][k] * b[k][j] for k in range(3)) for j in range(3)] for i in range(3)]


def draw_board(path, k, turn, middle):
    """A chessboard seen by a pinhole camera: each of 3 x 3 samples of a pixel meets the board's plane.
    turn: the board's axes in the camera's frame, as columns; middle: of the board there, mm."""
    fx, fy, cx, cy = k
    n = [turn[i][2] for i in range(3)]
    d = sum(n[i] * middle[i] for i in range(3))
    offsets = [(i + 0.5) / 3 for i in range(3)]
    rows = []
    for y in range(HEIGHT):
        row = bytearray()
        for x in range(WIDTH):
            white = 0
            for oy in offsets:
                for ox in offsets:
                    way = ((x + ox - cx) / fx, (y + oy - cy) / fy, 1.0)
                    t = d / (n[0] * way[0] + n[1] * way[1] + n[2])
                    at = [t * way[i] - middle[i] for i in range(3)]
                    u = sum(turn[i][0] * at[i] for i in range(3)) / SQUARE + 0.5 * (COLS + 1)
                    v = sum(turn[i][1] * at[i] for i in range(3)) / SQUARE + 0.5 * (ROWS + 1)
                    on = 0 <= u < COLS + 1 and 0 <= v < ROWS + 1
                    white += 0 if on and (int(u) + int(v)) % 2 else 1
            row.append(15 + 25 * white)
        rows.append(bytes(row))
    path.write_bytes(png_bytes(WIDTH, HEIGHT, rows))


class Calibrate(unittest.TestCase):
    def setUp(self):
        self.programs = Programs(BIN)
        place = tempfile.TemporaryDirectory(prefix="haarlight-calibrate.")
        self.addCleanup(place.cleanup)
        self.folder = pathlib.Path(place.name)
        self.port = free_port()
        self.url = f"http://127.0.0.1:{self.port}"

    def write_rigs(self):
        # Large LEDs: taken as points they stand off by about 0.6 w^2 / h, 3.5 mm. A larger picture than the test rig's.
        rig = self.folder / "lab.toml"
        rig_on_free_ports(SOURCE / "configs/rigs/small8.toml", rig, self.folder, self.port,
                          [("emitter", "[60.0, 60.0]"), ("size", "[192, 152]"),
                           ("active_area", "144"), ("fps", "60.0"), ("exposure_us", "8000.0"),
                           ("K", "[[263.76, 0.0, 96.0], [0.0, 263.76, 72.0], [0.0, 0.0, 1.0]]")])
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
        truth = (270.0, 268.0, 97.5, 70.5)
        pictures = []
        for i, (ax, ay, az, x, y) in enumerate([(0.5, 0.0, 0.0, 0.0, 0.0), (-0.5, 0.1, 0.2, 30.0, 0.0),
                                                (0.1, 0.5, -0.2, -30.0, 10.0), (0.0, -0.5, 0.3, 20.0, -20.0),
                                                (0.35, 0.35, 0.1, -20.0, -15.0)]):
            turn = times(turned(2, az), times(turned(1, ay), turned(0, ax)))
            pictures += ["--picture", self.folder / f"board{i}.png"]
            draw_board(pictures[-1], truth, turn, [x, y, 680.0])
        board = ["--board", f"{COLS},{ROWS}", "--square", SQUARE]
        done = self.programs.run("rig", "calibrate", "camera", rig, *pictures, *board, "--report",
                                 self.folder / "report.json")
        print(done.stdout)
        self.assertEqual(done.returncode, 0, done.stdout + done.stderr)
        self.assertEqual(report_problems(self.folder / "report.json", "rig"), [])
        measured = self.folder / "lab.measured.toml"
        camera = tomllib.loads(measured.read_text())["measured"]["camera"][0]
        for found, sigma, true in zip(camera["lens_k"], camera["lens_k_sigma"], truth):
            self.assertLess(abs(found - true), 5.0 * sigma + 0.05, camera)
        self.assertIn("board4.png", (self.folder / "lab.camera.html").read_text())

        # The plane 3 mm up and tilted by half a degree about x, from the rig file's camera.
        cam = [[1, 0, 0, 0], [0, -0.643509750887, 0.765437914212, -560],
               [0, -0.765437914212, -0.643509750887, 520]]
        tilt = math.radians(0.5)
        world_from_board = times(turned(0, tilt), turned(0, math.pi))  # x right, y to the camera
        cam_from_world = [[cam[j][i] for j in range(3)] for i in range(3)]
        turn = times(cam_from_world, world_from_board)
        centre = [cam[i][3] for i in range(3)]
        middle = [sum(cam_from_world[i][j] * ([0.0, 5.0, 3.0][j] - centre[j]) for j in range(3))
                  for i in range(3)]
        draw_board(self.folder / "flat.png", truth, turn, middle)
        done = self.programs.run("rig", "calibrate", "plane", rig, "--picture",
                                 self.folder / "flat.png", *board)
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
