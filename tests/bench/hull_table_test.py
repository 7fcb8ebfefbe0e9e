#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""The rigs of bench/relight/hull_table.py are good rigs, and their rows' lights lie in the directions of
cube32's. hull_table_test.py BIN, the build's folder apps/."""

import pathlib
import sys
import tempfile
import unittest

import numpy as np

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[2] / "bench/relight"))
import hull_table  # noqa: E402
from programs import Programs  # noqa: E402


class Rigs(unittest.TestCase):
    def test_every_rig_is_good_and_has_its_lights(self):
        programs = Programs(BIN)
        with tempfile.TemporaryDirectory(prefix="haarlight-table.") as folder:
            file = pathlib.Path(folder) / "rig.toml"
            for name, n in (("cube32", 1024), ("grid16", 256), ("grid8", 64), ("dome60", 60)):
                for is_ideal, finer in ((False, 1), (True, 1), (False, 2)):
                    file.write_text(hull_table.rig_text(name, is_ideal, finer))
                    done = programs.run("check", file)
                    self.assertEqual(done.returncode, 0, done.stderr)
                    self.assertIn(f"{n} lights", done.stdout)
                self.assertEqual(len(hull_table.positions(hull_table.RIGS[name])), n)

    def test_lights_lie_in_the_directions_of_cube32(self):
        def towards(rig, lights):
            p = hull_table.positions(hull_table.RIGS[rig])[lights] - hull_table.OBJECT_CENTRE
            return p / np.linalg.norm(p, axis=1, keepdims=True)

        self.assertEqual(hull_table.nearest_lights("cube32", [528, 0, 1023]), [528, 0, 1023])
        # Half a diagonal of the pitch, 120 mm at 855 mm; the dome's gaps.
        for rig, most_degrees in (("grid16", 3.0), ("grid8", 6.0), ("dome60", 16.0)):
            for light in ("1", "4"):
                lights = hull_table.LIGHTS[light]
                found = hull_table.nearest_lights(rig, lights)
                self.assertEqual(len(set(found)), len(lights))
                cosine = (towards(rig, found) * towards("cube32", lights)).sum(1)
                self.assertLess(np.degrees(np.arccos(cosine.min())), most_degrees, f"{rig} {light}")
        with self.assertRaises(SystemExit):  # two of the nine would be one
            hull_table.nearest_lights("dome60", hull_table.LIGHTS["9"])


if __name__ == "__main__":
    BIN = sys.argv.pop(1)
    unittest.main()
