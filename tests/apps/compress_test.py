#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""haarlight compress, killed at random moments and shared by the processes of mpirun: the bytes are
always those of one undisturbed process. compress_test.py BIN, the build's folder apps/.
HAARLIGHT_SEED repeats a run."""

import hashlib
import json
import os
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

import numpy as np

from programs import Programs, png_bytes, wait_for

KERNELS = ["portable", "avx2", "avx2-gather", "avx512", "avx512-gather"]
LIGHTS = 36
SIZE = 512
SKY = pathlib.Path(__file__).resolve().parents[2] / "configs/environments/room.hdr"


def write_captures(folder):
    """A bump under lights on a spiral, with grain: one picture per light and dirs.lp."""
    folder.mkdir()
    y, x = np.mgrid[0:SIZE, 0:SIZE] / SIZE - 0.5
    bump = np.dstack((-8 * x, -8 * y, np.ones_like(x) * 0.7))
    bump /= np.linalg.norm(bump, axis=2, keepdims=True)
    grain = np.random.default_rng(7)
    lines = [str(LIGHTS)]
    for k in range(LIGHTS):
        angle, z = 2.4 * k, 0.3 + 0.6 * k / LIGHTS
        to = np.array((np.sqrt(1 - z * z) * np.cos(angle), np.sqrt(1 - z * z) * np.sin(angle), z))
        value = 200 * np.clip(bump @ to, 0, None) + 20 + grain.normal(0, 2, (SIZE, SIZE))
        rows = [bytes(row) for row in np.clip(value, 0, 255).astype(np.uint8)]
        (folder / f"light{k}.png").write_bytes(png_bytes(SIZE, SIZE, rows))
        lines.append(f"light{k}.png " + " ".join(f"{c:.9f}" for c in to))
    (folder / "dirs.lp").write_text("\n".join(lines) + "\n")


def can_stop_programs():
    """Whether gdb is there and allowed: containers may forbid it."""
    if not (shutil.which("gdb") and shutil.which("nm")):
        return False
    done = subprocess.run(["gdb", "-batch", "-nx", "-ex", "run", "--args", "true"], capture_output=True, text=True, timeout=60, check=False)
    return "exited normally" in done.stdout


class Compress(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.programs = Programs(BIN)
        cls.place = tempfile.TemporaryDirectory(prefix="haarlight-compress.")
        cls.folder = pathlib.Path(cls.place.name)
        write_captures(cls.folder / "capture")
        done = cls.programs.run("import", cls.folder / "capture", "--lights",
                                cls.folder / "capture/dirs.lp", "-o", cls.folder / "session")
        assert done.returncode == 0, done.stderr
        begin = time.monotonic()
        done = cls.programs.run(*cls.words("alone.hlb"))
        assert done.returncode == 0, done.stderr
        cls.seconds = time.monotonic() - begin
        cls.expected = cls.hash("alone.hlb")

    @classmethod
    def tearDownClass(cls):
        cls.place.cleanup()

    @classmethod
    def words(cls, name):
        return ["compress", cls.folder / "session", "-o", cls.folder / name, "--basis", "direct",
                "--max-error", "0.02", "--quiet"]

    @classmethod
    def hash(cls, name):
        return hashlib.sha256((cls.folder / name).read_bytes()).hexdigest()

    def start(self, name, processes=1, extra=()):
        words = [self.programs.haarlight, *self.words(name), *extra]
        if processes > 1:
            words = ["mpirun", "--oversubscribe", "-n", processes, *words]
        # A container has no other user; sockets between the processes stay on the machine.
        environment = dict(os.environ, OMPI_ALLOW_RUN_AS_ROOT="1",
                           OMPI_ALLOW_RUN_AS_ROOT_CONFIRM="1", OMPI_MCA_btl="self,vader")
        return subprocess.Popen(list(map(str, words)), stdout=subprocess.PIPE,
                                stderr=subprocess.PIPE, text=True, env=environment)

    def finish(self, process):
        out, err = process.communicate(timeout=120)
        self.assertEqual(process.returncode, 0, out + err)

    def test_every_kernel_gives_the_same_bytes(self):
        bytes_of = {}
        for word in [None, *KERNELS]:
            chosen = {"HAARLIGHT_KERNELS": word} if word else {}
            for verb, line in (("relight", self.turn(f"{word}.exr")),
                               ("compress", [*self.words(f"{word}.hlb"), "--threads", "2"])):
                report = self.folder / f"{verb}-{word}.json"
                done = self.programs.run(*line, "--report", report, **chosen)
                if word and done.returncode == 2 and "this processor has no" in done.stderr:
                    continue
                self.assertEqual(done.returncode, 0, done.stderr)
                told = json.loads(report.read_text())["details"]["kernels"]
                self.assertIn(told, [word] if word else KERNELS)
                made = f"{word}-0001.exr" if verb == "relight" else f"{word}.hlb"
                bytes_of[verb, told] = self.hash(made)
        for verb in ("relight", "compress"):
            found = [value for (of, _), value in bytes_of.items() if of == verb]
            self.assertGreater(len(found), 0)
            self.assertEqual(len(set(found)), 1, bytes_of)
        self.assertEqual(bytes_of["compress", "portable"], self.expected)

    def turn(self, name):
        return ["relight", self.folder / "alone.hlb", "--cubemap", SKY, "--frames", "11", "-o", self.folder / name]  # 33 sums: four batches and one alone

    @unittest.skipUnless(can_stop_programs(), "gdb or nm is not installed, or may not trace programs here")
    def test_the_kernels_that_run_are_those_named(self):
        turn, compress = self.turn("gdb.exr"), self.words("gdb.hlb")
        for word, line, others, own in (("portable", compress, ["avx2", "avx512", "vnni"], None),
                                        ("avx2", compress, ["avx512", "vnni"], "avx2"),
                                        ("avx512", compress, [], "avx512"),
                                        ("avx2", turn, ["gather", "avx512", "vnni"], "avx2"),
                                        ("avx2-gather", turn, ["avx512", "vnni"], "gather")):
            with self.subTest(f"{line[0]} by {word}"):
                out = self.calls_one_of(others or [own], word, [*line, "--force"])
                if "this processor has no" in out:
                    continue
                if others:
                    self.assertIn("exited normally", out)
                    self.assertNotIn("hit Breakpoint", out)
                if own:
                    self.assertIn("hit Breakpoint", self.calls_one_of([own], word, [*line, "--force"]))

    def calls_one_of(self, kinds, word, line):
        """What gdb says of a command that it stops at the first call of a kernel of these kinds."""
        names = subprocess.run(["nm", self.programs.haarlight], capture_output=True, text=True, check=True).stdout
        kernels = re.findall(rf" [tTW] (_Z\w*7relight\w*(?<!has)_(?:{'|'.join(kinds)})(?![a-z])[\w.]*)$", names, re.M)
        stops = [word for name in kernels if not name.endswith(".cold") for word in ("-ex", f"break *'{name}'")]
        self.assertGreater(len(stops), 0)
        done = subprocess.run(["gdb", "-batch", "-nx", *stops, "-ex", "run", "--args", self.programs.haarlight, *line],
                              capture_output=True, text=True, timeout=120, check=False,
                              env={**os.environ, "HAARLIGHT_KERNELS": word})
        self.assertEqual(done.stdout.count(" at 0x"), len(stops) // 2, done.stdout + done.stderr)
        return done.stdout + done.stderr

    def relit(self, name, *options, expected=0):
        """The program's words and the report of one picture."""
        out, report = self.folder / name, self.folder / f"{name}.json"
        done = self.programs.run("relight", self.folder / "alone.hlb", "--cubemap", SKY, *options, "-o", out,
                                 "--report", report)
        self.assertEqual(done.returncode, expected, done.stderr)
        return done, json.loads(report.read_text()) if report.exists() else None

    def test_seconds_allow_an_error(self):
        done, few = self.relit("few.exr", "--seconds", "0.000001", expected=1)
        self.assertIn("too short: the cheapest way takes", done.stderr)
        self.assertRegex(done.stdout, r"terms?: [0-9.]+ ms predicted, of 0.0 ms allowed; all would take [0-9.]+ ms")
        self.assertFalse(few["reached"]["is_time_enough"])
        self.assertEqual(few["details"]["form"], "file")
        self.assertGreater(few["details"]["predicted_seconds"], 0)
        self.assertGreater(few["details"]["relight_seconds"], 0)
        self.assertEqual(few["reached"]["seconds_a_picture"], few["details"]["relight_seconds"])
        # The terms make the same picture on any machine.
        self.relit("again.exr", "--terms", str(few["reached"]["terms"]))
        self.assertEqual((self.folder / "few.exr").read_bytes(), (self.folder / "again.exr").read_bytes())
        _, enough = self.relit("enough.exr", "--seconds", "100")
        self.assertEqual(enough["reached"]["terms"], enough["details"]["terms_all"])
        self.assertTrue(enough["details"]["has_all_terms"])
        self.relit("all.exr")
        self.assertEqual((self.folder / "enough.exr").read_bytes(), (self.folder / "all.exr").read_bytes())

    def test_an_error_takes_the_way_of_least_seconds(self):
        done, told = self.relit("within.exr", "--max-error", "0.3")
        self.assertRegex(done.stdout, r"  .*terms: [0-9.]+ ms predicted, ")
        self.assertLessEqual(told["reached"]["relative_l2_bound"], 0.3)
        self.assertLessEqual(told["details"]["predicted_seconds"], told["details"]["predicted_seconds_of_all"])
        done, _ = self.relit("never.exr", "--max-error", "0.000001", expected=1)
        self.assertIn("fewer would not keep 1e-06", done.stdout)

    def test_one_of_error_terms_and_seconds(self):
        for other in (["--max-error", "0.1"], ["--terms", "3"]):
            done, _ = self.relit("two.exr", "--seconds", "1", *other, expected=2)
            self.assertIn("--seconds", done.stderr)
            self.assertEqual(list(self.folder.glob("two*")), [])

    def test_one_thing_is_no_plural(self):
        one = re.compile(r"(?<![\d.])1 [a-z]+s\b")
        done = self.programs.run(*self.words("loud.hlb")[:-1])
        self.assertIn("1 channel, 36 lights", done.stdout)
        self.assertNotRegex(done.stdout, one)
        done, _ = self.relit("one.exr", "--terms", "1")
        self.assertIn("1 of 36 terms", done.stdout)
        done, _ = self.relit("first.exr", "--seconds", "0.000001", expected=1)
        self.assertIn("  1 term: ", done.stdout)
        self.assertNotRegex(done.stdout, one)

    def test_an_unknown_kernel_is_refused(self):
        os.environ["HAARLIGHT_KERNELS"] = "fastest"
        try:
            done = self.programs.run("relight", self.folder / "alone.hlb", "--cubemap", SKY, "--frames", "2", "-o",
                                     self.folder / "refused.exr")
        finally:
            del os.environ["HAARLIGHT_KERNELS"]
        self.assertEqual(done.returncode, 2)
        self.assertIn("HAARLIGHT_KERNELS", done.stderr)
        self.assertIn("avx2-gather", done.stderr)
        self.assertEqual(list(self.folder.glob("refused*")), [])

    def test_killed_at_twenty_random_moments(self):
        seed = int(os.environ.get("HAARLIGHT_SEED", time.time_ns() % 2**32))
        print(f"seed {seed}, {self.seconds:.2f} s undisturbed", flush=True)
        draw = random.Random(seed)
        reruns_that_found = 0
        for i in range(20):
            name = f"killed{i}.hlb"
            process = self.start(name)
            time.sleep(draw.uniform(0, self.seconds))
            process.send_signal(signal.SIGKILL)
            process.communicate(timeout=60)
            pieces = list((self.folder / f"{name}.part").glob("sums-" + 5 * "[0-9]"))
            if (self.folder / name).exists():  # it was faster
                self.assertEqual(self.hash(name), self.expected, "half a file under its name")
                continue
            report = self.folder / f"killed{i}.json"
            self.finish(self.start(name, extra=["--report", report]))
            self.assertEqual(self.hash(name), self.expected, f"kill {i}, seed {seed}")
            self.assertFalse((self.folder / f"{name}.part").exists())
            found = self.detail(report, "tile_rows_found")
            self.assertEqual(found, len(pieces), f"kill {i}, seed {seed}")
            reruns_that_found += found > 0
        print(f"{reruns_that_found} of 20 reruns went on with what they found", flush=True)

    def detail(self, report, key):
        return json.loads(report.read_text())["details"][key]

    def test_two_and_three_processes_give_the_bytes_of_one(self):
        for n in (2, 3):
            name = f"ranks{n}.hlb"
            report = self.folder / f"ranks{n}.json"
            self.finish(self.start(name, n, ["--report", report]))
            self.assertEqual(self.hash(name), self.expected)
            self.assertEqual(self.detail(report, "processes"), n)

    def test_a_lost_process_ends_the_job_and_a_rerun_goes_on(self):
        name = "lost.hlb"
        part = self.folder / f"{name}.part"
        job = self.start(name, 2)
        try:
            wait_for(lambda: list(part.glob("sums-*")) or job.poll() is not None, 60,
                     "the first tile row")
            victims = self.ranks_of(job.pid)
            if victims:
                os.kill(victims[-1], signal.SIGKILL)
            out, err = job.communicate(timeout=60)
        finally:
            job.kill()
        if job.returncode != 0:
            self.assertFalse((self.folder / name).exists(), "half a file under its name")
            report = self.folder / "lost.json"
            self.finish(self.start(name, 2, ["--report", report]))
            self.assertFalse(part.exists())
        self.assertEqual(self.hash(name), self.expected, out + err)
        print("a process was lost" if job.returncode != 0 else "the job was faster", flush=True)

    @staticmethod
    def ranks_of(mpirun):
        found = subprocess.run(["pgrep", "-P", str(mpirun), "haarlight"], capture_output=True,
                               text=True)
        return sorted(map(int, found.stdout.split()))

    def test_an_error_in_every_process_ends_the_job(self):
        job = self.start("small.hlb", 2, ["--memory", "100000"])
        out, err = job.communicate(timeout=60)
        self.assertNotEqual(job.returncode, 0)
        self.assertIn("hint: give more --memory", err + out)
        self.assertFalse((self.folder / "small.hlb").exists())


if __name__ == "__main__":
    BIN = pathlib.Path(sys.argv.pop(1))
    unittest.main(verbosity=2)
