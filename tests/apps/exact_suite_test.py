#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""`haarlight render volume` against the true pictures of configs/exact. exact_suite_test.py BIN, the build's folder apps/. Prints
each scene's largest error. Python's own library only."""

import math
import os
import pathlib
import random
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
import unittest

from picture_files import read_npy
from programs import SOURCE, Programs

DEBIANS = "/usr/bin/python3"
SUITE = SOURCE / "configs/exact"
EXACT = 1e-12
RELATIVE = ("thin",)  # scenes whose errors count over the pixel's value


def with_cells_shuffled(text, seed):
    """A .vtu of the suite with its cells in another order."""
    def rows_of(name):
        return re.search(rf'Name="{name}" format="ascii">\n(.*?)\n</DataArray>', text, re.S)

    nodes = rows_of("connectivity")[1].split("\n")
    order = random.Random(seed).sample(range(len(nodes)), len(nodes))
    cells = text[text.index("<CellData>"):]
    fields = re.findall(r'Name="(\w+)" format="ascii">', cells)
    offsets, offset = [], 0
    for i in order:
        offset += len(nodes[i].split())
        offsets.append(str(offset))
    changed = {"connectivity": "\n".join(nodes[i] for i in order), "offsets": " ".join(offsets)}
    for name in ("types", *fields):
        values = rows_of(name)[1].split()
        changed[name] = " ".join(values[i] for i in order)
    for name, rows in changed.items():
        begin, end = rows_of(name).span(1)
        text = text[:begin] + rows + text[end:]
    return text


class ExactSuite(unittest.TestCase):
    def setUp(self):
        temporary = tempfile.TemporaryDirectory()
        self.addCleanup(temporary.cleanup)
        self.folder = pathlib.Path(temporary.name)

    def python(self, *words):
        """What Debian's Python prints, which may have NumPy and mpmath, without an X server."""
        environment = {name: value for name, value in os.environ.items() if name != "DISPLAY"}
        environment["PYTHONDONTWRITEBYTECODE"] = "1"
        return subprocess.run([DEBIANS, *words], capture_output=True, text=True, cwd=self.folder, check=True,
                              env=environment, timeout=300).stdout

    def require_module(self, name):
        if subprocess.run([DEBIANS, "-c", f"import {name}"], capture_output=True, check=False).returncode:
            self.skipTest(f"no {name} for {DEBIANS}")

    def largest_error(self, scene, folder):
        """Of the pixels that are known, of the scene in that folder."""
        done = PROGRAMS.run("render", "volume", folder / f"{scene}.toml", "-o", "picture.exr", "--float64", "picture.npy",
                            "--force", cwd=self.folder)
        self.assertEqual(done.returncode, 0, done.stderr)
        shape, truth = read_npy(SUITE / f"{scene}.npy")
        shape_of_picture, picture = read_npy(self.folder / "picture.npy")
        self.assertEqual(shape_of_picture, shape)
        known = [(value, true) for value, true in zip(picture, truth) if not math.isnan(true)]
        self.assertGreater(len(known), 0.5 * len(truth))
        self.assertTrue(all(math.isfinite(value) for value, _ in known))
        if scene in RELATIVE:
            return max(abs(value - true) / abs(true) if true else abs(value) for value, true in known)
        return max(abs(value - true) for value, true in known)

    def require_exact(self, folder):
        scenes = sorted(path.stem for path in SUITE.glob("*.toml"))
        self.assertGreaterEqual(len(scenes), 20)
        self.assertEqual(scenes, sorted(path.stem for path in SUITE.glob("*.npy")))
        for scene in scenes:
            with self.subTest(scene):
                error = self.largest_error(scene, folder)
                print(f"{scene:22} {error:.2g}{' of the value' if scene in RELATIVE else ''}", flush=True)
                self.assertLessEqual(error, EXACT)

    def test_every_scene(self):
        self.require_exact(SUITE)

    def test_cells_in_any_order(self):
        copy = self.folder / "suite"
        shutil.copytree(SUITE, copy)
        for seed, path in enumerate(sorted((copy / "meshes").glob("*.vtu"))):
            path.write_text(with_cells_shuffled(path.read_text(), seed))
        self.require_exact(copy)

    def test_commands_of_its_readme(self):
        """Those of haarlight as they stand there; the Python example with NumPy, where there is one."""
        shutil.copytree(SUITE, self.folder / "configs/exact")
        text = (SUITE / "README.md").read_text()
        lines = re.findall(r"^    (haarlight .*)$", text, re.M)
        self.assertGreaterEqual(len(lines), 1)
        for line in lines:
            done = PROGRAMS.run(*shlex.split(line.split(" #")[0])[1:], cwd=self.folder)
            self.assertEqual(done.returncode, 0, f"{line}\n{done.stderr}")
        self.require_module("numpy")
        for line in re.findall(r"^    (configs/exact/score\.py .*)$", text, re.M):
            self.assertLess(float(re.search(r"largest +(\S+)", self.python(*shlex.split(line)))[1]), EXACT)
        example = re.search(r"^```python\n(.*?)^```", text, re.M | re.S)[1]
        self.assertLess(float(self.python("-c", example).split()[-1]), EXACT)
        self.assertIn("VTK", self.python("configs/exact/score.py", "--vtk"))  # what it lacks here

    def test_the_truth_is_what_is_written(self):
        """One scene made once more."""
        self.require_module("mpmath")
        self.python(SUITE / "make_suite.py", "--folder", self.folder, "nearly_constant")
        for name in ("nearly_constant.toml", "nearly_constant.npy", "meshes/six.vtu"):
            self.assertEqual((self.folder / name).read_bytes(), (SUITE / name).read_bytes(), name)
        checked = self.python(SUITE / "make_suite.py", "--check", "nearly_constant")
        for difference in re.findall(r"(?:rule|form) ([^\s,]+)", checked):
            self.assertLess(float(difference), 1e-25)


if __name__ == "__main__":
    PROGRAMS = Programs(sys.argv.pop(1))
    unittest.main()
