#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Every exit code that is not 0 comes with its reason, also under --quiet, which hides warnings.
quiet_test.py BIN, the build's folder apps/."""

import pathlib
import sys
import tempfile
import unittest

from programs import SOURCE, Programs, write_capture

MISSED = 1


class Quiet(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.programs = Programs(BIN)
        cls.place = tempfile.TemporaryDirectory(prefix="haarlight-quiet.")
        cls.folder = pathlib.Path(cls.place.name)
        write_capture(cls.folder / "capture", n_lights=9, size=16, scale=3.0)
        for line in ("import capture --lights capture/dirs.lp --places positions -o session",
                     "compress session -o basis.hlb --basis direct --max-error 0.02"):
            cls.check(line + " -q")

    @classmethod
    def tearDownClass(cls):
        cls.place.cleanup()

    @classmethod
    def check(cls, line, expected=0):
        done = cls.programs.run(*line.split(), cwd=cls.folder)
        assert done.returncode == expected, f"{line}: {done.returncode}\n{done.stdout}{done.stderr}"
        return done

    def test_a_missed_target_says_why(self):
        box = SOURCE / "configs/scenes/cornell.toml"
        for line, why in (
                ("shape session --width-mm 100 --rounds 1 -o shape", "the heights still move by"),
                ("relight basis.hlb --light 0 --max-error 1e-9 -o error.exr", "cannot be promised"),
                ("relight basis.hlb --light 0 --seconds 1e-6 -o time.exr", "s are too short"),
                ("publish basis.hlb --max-error 1e-9 -o site", "cannot be promised"),
                (f"render surface {box} --crop 16x16+100+100 --spp 16 --max-error 1e-6 -o box.exr",
                 "a standard error of 1e-06 was requested and is not reached")):
            with self.subTest(line.split()[0]):
                self.assertRegex(self.check(line, MISSED).stderr, f" error .*{why}")
                quiet = self.check(line + " --force -q", MISSED)
                self.assertRegex(quiet.stderr, f" error .*{why}")
                self.assertNotIn(" warning ", quiet.stderr)


if __name__ == "__main__":
    BIN = pathlib.Path(sys.argv.pop(1))
    unittest.main(verbosity=2)
