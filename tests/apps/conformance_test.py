# SPDX-License-Identifier: Apache-2.0
"""The conformance kit: haarlight agrees with its closed forms, and a renderer that is off does not.

    conformance_test.py PROGRAMS    the folder of the programs
"""

import contextlib
import io
import pathlib
import shutil
import subprocess
import sys
import tempfile
import unittest

try:
    import numpy as np
except ImportError:
    np = None

SOURCE = pathlib.Path(__file__).resolve().parents[2]
KIT = SOURCE / "configs/conformance/conformance.py"
PROGRAMS = pathlib.Path(sys.argv.pop(1)).resolve() if len(sys.argv) > 1 else None


def kit(*words):
    return subprocess.run([sys.executable, KIT, *map(str, words)], capture_output=True, text=True, timeout=300)


@unittest.skipIf(np is None, "NumPy is not there")
class Conformance(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.kept = tempfile.TemporaryDirectory()
        cls.folder = pathlib.Path(cls.kept.name)
        assert kit("write", cls.folder).returncode == 0
        made = kit("render", cls.folder, "--haarlight", PROGRAMS / "haarlight/haarlight", "--seeds", 6, "--spp", 64, "--bounces", 1024)
        assert made.returncode == 0, made.stderr

    @classmethod
    def tearDownClass(cls):
        cls.kept.cleanup()

    def copy(self):
        folder = pathlib.Path(self.enterContext(tempfile.TemporaryDirectory()))
        for path in self.folder.glob("*.npy"):
            shutil.copy(path, folder)
        return folder

    def rows(self, score):
        return {row.split("|")[1].strip(" `"): row for row in score.stdout.splitlines() if row.startswith("| `")}

    def test_haarlight_agrees(self):
        score = kit("score", self.folder)
        self.assertNotIn("differs**", score.stdout)
        self.assertEqual(score.returncode, 2, "64 samples are too few for some scenes, and that is said")
        rows = self.rows(score)
        self.assertEqual(len(rows), 13)
        for name in ("under_a_quad", "under_a_point", "under_a_sun", "under_an_even_sky", "glass_in_a_furnace"):
            self.assertIn("| ok |", rows[name])
        self.assertIn("cosine at the floor twice (6.8 %)", rows["under_a_quad"])
        self.assertIn("not: pixels shifted by half a pixel", rows["under_a_quad"])
        self.assertIn("| weak |", rows["ball_in_a_ball"])

    def test_who_shows_a_fault_differs(self):
        """Each fault that the table says would be seen, is."""
        sys.path.insert(0, str(KIT.parent))
        import conformance

        def rows():
            told = io.StringIO()
            with contextlib.redirect_stdout(told):
                code = conformance.score(folder)
            return code, {row.split("|")[1].strip(" `"): row for row in told.getvalue().splitlines() if row.startswith("| `")}
        folder = self.copy()
        before = rows()[1]
        n_seen = 0
        for name in conformance.scenes.SCENES:
            scene = conformance.scene_of(name)
            paths = sorted(folder.glob(f"{name}.*.npy"))
            kept = [np.load(path) for path in paths]
            for fault, value in scene["faults"].items():
                if f"{fault} (" not in before[name].split("not:")[0]:
                    continue
                n_seen += 1
                for path, picture in zip(paths, kept):
                    np.save(path, picture * (value / scene["truth"]))
                code, after = rows()
                self.assertEqual(code, 1, f"{name}: {fault}")
                self.assertIn("**differs**", after[name], f"{name}: {fault}")
            for path, picture in zip(paths, kept):
                np.save(path, picture)
        self.assertGreaterEqual(n_seen, 15)

    def test_a_thousandth_is_seen(self):
        folder = self.copy()
        for path in folder.glob("under_a_quad.*.npy"):
            np.save(path, np.load(path) * 1.001)
        self.assertIn("**differs**", self.rows(kit("score", folder))["under_a_quad"])

    def test_what_cannot_be_scored_is_said(self):
        empty = pathlib.Path(self.enterContext(tempfile.TemporaryDirectory()))
        self.assertIn("no pictures", kit("score", empty).stderr)
        for wrong, told in ((np.zeros((4, 4, 3)), "is of shape (4, 4, 3)"), (np.full((16, 16, 3), np.nan), "not finite")):
            folder = self.copy()
            np.save(folder / "furnace.0.npy", wrong)
            score = kit("score", folder)
            self.assertNotEqual(score.returncode, 0)
            self.assertIn(told, score.stderr)
        few = self.copy()
        for seed in (3, 4, 5):
            (few / f"furnace.{seed}.npy").unlink()
        self.assertIn("3 pictures of furnace; 4 seeds at least", kit("score", few).stderr)
        for path in few.glob("furnace.*.npy"):
            path.unlink()
        self.assertIn("not rendered", self.rows(kit("score", few))["furnace"])

    def test_pictures_as_pfm(self):
        folder = self.copy()
        before = self.rows(kit("score", folder))["under_a_quad"]
        for path in folder.glob("under_a_quad.*.npy"):
            picture = np.load(path)[::-1].astype("<f4")
            path.with_suffix(".pfm").write_bytes(b"PF\n16 16\n-1.0\n" + picture.tobytes())
            path.unlink()
        self.assertEqual(self.rows(kit("score", folder))["under_a_quad"], before)


if __name__ == "__main__":
    unittest.main()
