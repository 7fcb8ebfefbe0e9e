#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""What `cmake --install` leaves: each component's files, no path of the build's, programs that find
their pages, and a project of somebody else's that links the libraries. install_test.py BUILD"""

import pathlib
import re
import subprocess
import sys
import tempfile
import unittest

import consumer

BUILD = pathlib.Path(sys.argv.pop(1)).resolve()
SOURCE = pathlib.Path(__file__).resolve().parent.parent.parent

# Component -> what it installs, among others.
FILES = {
    "runtime": ("bin/haarlight", "share/haarlight/web/index.html", "share/haarlight/web/viewer/main.js",
                "share/doc/haarlight/LICENSE", "share/doc/haarlight/NOTICE", "share/man/man1/haarlight.1",
                "share/man/man1/haarlight-relight.1", "share/man/man1/haarlight-rig-calibrate-lights.1",
                "share/bash-completion/completions/haarlight", "share/zsh/site-functions/_haarlight",
                "share/fish/vendor_completions.d/haarlight.fish"),
    "daemon": ("bin/haarlightd", "share/man/man8/haarlightd.8", "lib/systemd/system/haarlightd.service",
               "lib/sysusers.d/haarlight.conf", "lib/udev/rules.d/99-haarlight.rules",
               "share/bash-completion/completions/haarlightd"),
    "sim": ("bin/haarlight-sim", "share/man/man1/haarlight-sim.1",
            "share/bash-completion/completions/haarlight-sim"),
    "data": ("share/haarlight/rigs/cube32.toml", "share/haarlight/plans/quick.toml",
             "share/haarlight/scenes/airplane.toml", "share/haarlight/environments/room.hdr"),
    "doc": ("share/doc/haarlight/README.md", "share/doc/haarlight/docs/guides/my-first-rig.md"),
    "development": ("include/haarlight/core/error.h", "include/haarlight/core/image.h",
                    "include/haarlight/relight/basis/relight.h"),
}


def run(*words, **more):
    return subprocess.run([str(word) for word in words], capture_output=True, text=True, check=False, **more)


class Install(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        place = tempfile.TemporaryDirectory(prefix="haarlight-install.")
        cls.addClassCleanup(place.cleanup)
        cls.folder = pathlib.Path(place.name)
        cls.prefix = cls.folder / "all"
        done = run("cmake", "--install", BUILD, "--prefix", cls.prefix)
        assert done.returncode == 0, done.stdout + done.stderr

    def files(self, prefix):
        return {path.relative_to(prefix).as_posix() for path in prefix.rglob("*") if not path.is_dir()}

    def test_every_file_belongs_to_one_component(self):
        together = []
        for component, expected in FILES.items():
            prefix = self.folder / component
            done = run("cmake", "--install", BUILD, "--prefix", prefix, "--component", component)
            self.assertEqual(done.returncode, 0, done.stderr)
            found = self.files(prefix)
            self.assertLessEqual(set(expected), found, component)
            together += found
        self.assertEqual(sorted(together), sorted(self.files(self.prefix)))

    def test_the_document_tells_the_components_and_the_package(self):
        text = (SOURCE / "docs/reference/building.md").read_text()
        table = text.split("## What is installed", 1)[1]
        self.assertEqual(set(re.findall(r"(?m)^\| `(\w+)` \|", table)), set(FILES))
        self.assertIn(re.search(r"find_package\(.*\)", text)[0],
                      (SOURCE / "tests/consumer/CMakeLists.txt").read_text())
        for target in re.findall(r"haarlight::[a-z]\w+", text):
            self.assertIn(target, (SOURCE / "tests/consumer/CMakeLists.txt").read_text())

    def test_nothing_names_the_folders_it_was_built_in(self):
        needles = [str(BUILD).encode(), str(SOURCE).encode()]
        for name in sorted(self.files(self.prefix)):
            content = (self.prefix / name).read_bytes()
            for needle in needles:
                self.assertNotIn(needle, content, name)

    def test_the_programs_work_from_the_prefix(self):
        moved = self.folder / "moved"
        run("cp", "-r", self.prefix, moved)
        share = moved / "share/haarlight"
        done = run(moved / "bin/haarlight", "plate", share / "rigs/small8.toml", "-o", "plate.hlb",
                   cwd=self.folder)
        self.assertEqual(done.returncode, 0, done.stderr)
        done = run(moved / "bin/haarlight", "publish", "plate.hlb", "-o", "site", "--environment",
                   share / "environments/room.hdr", cwd=self.folder)
        self.assertEqual(done.returncode, 0, done.stderr)
        self.assertTrue((self.folder / "site/viewer/main.js").is_file() or
                        (self.folder / "site/index.html").is_file())
        done = run(moved / "bin/haarlightd", share / "rigs/small8.toml", "--check-config",
                   cwd=self.folder)
        self.assertEqual(done.returncode, 0, done.stderr)

    def test_man_pages_are_roff(self):
        for page in sorted(self.prefix.glob("share/man/man*/*")):
            self.assertTrue(page.read_text().startswith(".TH "), page)
            self.assertEqual(page.suffix, f".{page.parent.name[-1]}")

    def test_the_public_headers_and_no_others(self):
        folder = self.prefix / "include/haarlight"
        headers = {header.relative_to(folder) for header in folder.rglob("*.h")}
        public = SOURCE / "include/haarlight"
        self.assertEqual(headers, {header.relative_to(public) for header in public.rglob("*.h")})
        for header in headers:
            for name in re.findall(r'(?m)^#include "(.+)"', (folder / header).read_text()):
                self.assertTrue((folder.parent / name).is_file(), f"{header} includes {name}")

    def test_another_project_links_the_libraries(self):
        consumer.check(self.prefix, self.folder)

    def test_the_readme_shows_that_project(self):
        text = (SOURCE / "README.md").read_text().split("## In your own program", 1)[1].split("\n## ", 1)[0]
        lines = [line.strip() for line in text.split("\n") if line.startswith("    ")]
        self.assertEqual(len(lines), 6)
        project = "".join((SOURCE / "tests/consumer" / name).read_text()
                          for name in ("CMakeLists.txt", "relit.cpp"))
        known = {line.strip() for line in project.split("\n")}
        for line in lines:
            self.assertIn(line, known)


if __name__ == "__main__":
    unittest.main(verbosity=2)
