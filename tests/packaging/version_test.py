#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""--version names the commit that was built: version_test.py BIN, the build's folder apps/."""

import pathlib
import re
import shutil
import subprocess
import sys
import tempfile
import unittest

SOURCE = pathlib.Path(__file__).resolve().parent.parent.parent
PROGRAMS = ("haarlight", "haarlightd", "haarlight-sim")


class Version(unittest.TestCase):
    def setUp(self):
        place = tempfile.TemporaryDirectory(prefix="haarlight-version.")
        self.addCleanup(place.cleanup)
        self.folder = pathlib.Path(place.name).resolve()

    def git(self, *words):
        return subprocess.run(["git", "-C", self.folder, "-c", "user.name=n", "-c", "user.email=n@n.org",
                               *words], capture_output=True, text=True, check=True).stdout.strip()

    def commit_of(self, folder):
        """What the build would write for sources in `folder`; the file's time of change, too."""
        file = self.folder / "made/commit.cpp"
        subprocess.run(["cmake", f"-DSOURCE={folder}", f"-DFILE={file}", "-P",
                        SOURCE / "cmake/write_commit.cmake"], capture_output=True, check=True)
        return re.search(r'return "(.*)";', file.read_text())[1], file.stat().st_mtime_ns

    def test_each_program_says_its_name_version_and_commit(self):
        version = re.search(r"project\(haarlight VERSION (\S+)", (SOURCE / "CMakeLists.txt").read_text())[1]
        said = set()
        for name in PROGRAMS:
            done = subprocess.run([pathlib.Path(BIN) / name / name, "--version"], capture_output=True,
                                  text=True, check=True)
            match = re.fullmatch(rf"{name} {re.escape(version)}( \([0-9a-f]{{7,}}(-dirty)?\))?\n", done.stdout)
            self.assertIsNotNone(match, done.stdout)
            said.add(match[1])
        self.assertEqual(len(said), 1, "all were built from the same commit")
        if (SOURCE / ".git").exists() and shutil.which("git"):
            self.assertNotEqual(said, {None})

    def test_a_changed_file_makes_it_dirty_and_nothing_new_is_not_written(self):
        self.git("init", "-q")
        (self.folder / ".gitignore").write_text("made/\n")
        (self.folder / "source.cpp").write_text("int a;\n")
        self.git("add", ".")
        self.git("commit", "-q", "-m", "one")
        commit = self.git("rev-parse", "--short=7", "HEAD")
        self.assertEqual(self.commit_of(self.folder)[0], commit)
        at = self.commit_of(self.folder)[1]
        (self.folder / "beside.txt").write_text("not tracked\n")
        self.assertEqual(self.commit_of(self.folder), (commit, at))
        (self.folder / "source.cpp").write_text("int b;\n")
        self.assertEqual(self.commit_of(self.folder)[0], commit + "-dirty")

    def test_an_archive_has_no_commit_wherever_it_is_unpacked(self):
        self.assertEqual(self.commit_of(self.folder)[0], "")
        self.git("init", "-q")
        inside = self.folder / "third_party/haarlight-0.1.0"
        inside.mkdir(parents=True)
        (inside / "source.cpp").write_text("int a;\n")
        self.git("add", ".")
        self.git("commit", "-q", "-m", "somebody's own project")
        self.assertEqual(self.commit_of(inside)[0], "")


if __name__ == "__main__":
    BIN = sys.argv.pop(1)
    unittest.main(verbosity=2)
