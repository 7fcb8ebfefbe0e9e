#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""`haarlight mesh convert` from file to file: every format becomes a .vtu that holds the same, for us and for VTK. mesh_test.py
BIN, the build's folder apps/. Python's own library only; VTK where Debian's Python has it."""

import json
import os
import pathlib
import subprocess
import sys
import tempfile
import time
import unittest

from programs import SOURCE, Programs

DEBIANS = "/usr/bin/python3"
VOLUMES = SOURCE / "configs/volumes"
SHARED = SOURCE.parent / "shared/data/volume"
READ_BY_VTK = """
import sys, vtk
reader = vtk.vtkXMLUnstructuredGridReader()
reader.SetFileName(sys.argv[1])
reader.Update()
grid = reader.GetOutput()
sizes = vtk.vtkCellSizeFilter()
sizes.SetInputData(grid)
sizes.Update()
volumes = sizes.GetOutput().GetCellData().GetArray("Volume")
points, cells = grid.GetPointData(), grid.GetCellData()
print(grid.GetNumberOfPoints(), grid.GetNumberOfCells(), sum(volumes.GetValue(i) for i in range(volumes.GetNumberOfTuples())),
      *(data.GetArrayName(i) + ":" + repr(data.GetArray(i).GetRange(0)[1]) for data in (points, cells)
        for i in range(data.GetNumberOfArrays())))
"""


class Convert(unittest.TestCase):
    def setUp(self):
        temporary = tempfile.TemporaryDirectory()
        self.addCleanup(temporary.cleanup)
        self.folder = pathlib.Path(temporary.name)

    def run_mesh(self, *words):
        return PROGRAMS.run("mesh", *words, cwd=self.folder)

    def info(self, *words):
        done = self.run_mesh("info", *words, "--json")
        self.assertEqual(done.returncode, 0, done.stderr)
        return json.loads(done.stdout)

    def require_same(self, path, *words):
        done = self.run_mesh("convert", path, "-o", "out.vtu", "--force", *words)
        self.assertEqual(done.returncode, 0, done.stderr)
        before, after = self.info(path, *words), self.info("out.vtu")
        self.assertIn(f"out.vtu: {before['points']} points, cells: {before['cells']}", done.stdout)
        # What a file says of itself, and what readers leave out or mend, is not in the new one.
        for key in ("file", "format", "left_out", "blanked", "turned", "notes", "other_wedges"):
            before.pop(key), after.pop(key)
        self.assertEqual(before, after)
        again = self.folder / "again.vtu"
        self.assertEqual(self.run_mesh("convert", "out.vtu", "-o", again, "--force").returncode, 0)
        self.assertEqual(again.read_bytes(), (self.folder / "out.vtu").read_bytes())
        return after

    def test_every_format(self):
        self.require_same(VOLUMES / "four_cells.vtu")
        self.require_same(VOLUMES / "four_cells.msh")
        self.require_same(VOLUMES / "duct.xyz", "--solution", VOLUMES / "duct.q")

    def test_meshes_of_other_programs(self):
        if not SHARED.is_dir():
            self.skipTest("needs ../shared/data/volume")
        for name in ("zoo_mixed_8.vtu", "vtkdata_QuadraticTetra.vtu", "vtkdata_hexa.vtk", "gmsh/tet10.msh", "gmsh/prism6.msh"):
            with self.subTest(name):
                self.require_same(SHARED / name)
        with self.subTest("bluntfin"):
            self.require_same(SHARED / "vtkdata_bluntfinxyz.bin", "--format", "plot3d", "--solution",
                              SHARED / "vtkdata_bluntfinq.bin")

    def test_vtk_reads_it(self):
        if subprocess.run([DEBIANS, "-c", "import vtk"], capture_output=True, check=False).returncode:
            self.skipTest(f"no VTK for {DEBIANS} (Debian: python3-vtk9)")
        for name in ("four_cells.vtu", "four_cells.msh", "cube.vtu"):
            with self.subTest(name):
                ours = self.require_same(VOLUMES / name)
                points, cells, volume, *fields = subprocess.run(
                    [DEBIANS, "-c", READ_BY_VTK, "out.vtu"], capture_output=True, text=True, check=True, cwd=self.folder,
                    timeout=120).stdout.split()
                self.assertEqual((int(points), int(cells)), (ours["points"], ours["cells"]))
                self.assertAlmostEqual(float(volume), ours["volume"], delta=1e-9 * ours["volume"])
                highest = [f"{field['name']}:{float(field['range'][1])!r}" for field in ours["point_fields"] + ours["cell_fields"]
                           if field["components"] == 1]
                self.assertGreater(len(highest), 0)
                self.assertLessEqual(set(highest), set(fields))

    def test_what_is_refused(self):
        done = self.run_mesh("convert", VOLUMES / "four_cells.vtu", "-o", "out.vtk")
        self.assertEqual(done.returncode, 2, done.stderr)
        self.assertIn("end it in .vtu", done.stderr)
        out = self.folder / "out.vtu"
        out.write_text("mine")
        done = self.run_mesh("convert", VOLUMES / "four_cells.vtu", "-o", out)
        self.assertNotEqual(done.returncode, 0)
        self.assertIn("--force", done.stderr)
        self.assertEqual(out.read_text(), "mine")
        broken = self.folder / "broken.vtu"
        broken.write_text((VOLUMES / "four_cells.vtu").read_text().replace("</Cells>", "", 1))
        done = self.run_mesh("convert", broken, "-o", out, "--force")
        self.assertEqual(done.returncode, 65, done.stderr)
        self.assertIn("broken.vtu", done.stderr)
        self.assertEqual(out.read_text(), "mine")

    def test_a_file_that_is_cut_short_while_it_is_read(self):
        mesh = self.folder / "mesh.vtu"
        text = (VOLUMES / "cube.vtu").read_text()
        begin = text.index("<PointData")
        whole = (text[:begin] + "<!--" + 30_000_000 * " " + "-->" + text[begin:]).encode()
        for delay in (0.0, 0.005, 0.01, 0.02, 0.03, 0.05):
            with self.subTest(delay):
                mesh.write_bytes(whole)
                with subprocess.Popen([PROGRAMS.haarlight, "mesh", "convert", mesh, "-o", "out.vtu", "--force"], cwd=self.folder,
                                      stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as running:
                    time.sleep(delay)
                    os.truncate(mesh, begin)
                    _, told = running.communicate(timeout=120)
                if running.returncode:  # else it had been read
                    self.assertIn(running.returncode, (65, 74), told)
                    self.assertIn("mesh.vtu", told)
                    self.assertIn("hint: ", told)


if __name__ == "__main__":
    PROGRAMS = Programs(sys.argv.pop(1))
    unittest.main()
