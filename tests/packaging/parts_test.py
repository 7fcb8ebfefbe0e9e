#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""A build of which all that can be left out is left out, where none of the libraries of those parts
can be found: parts_test.py BUILD, a folder that may be kept."""

import json
import os
import pathlib
import re
import subprocess
import sys
import tempfile
import unittest

import consumer

BUILD = pathlib.Path(sys.argv.pop(1)).resolve()
SOURCE = pathlib.Path(__file__).resolve().parent.parent.parent
LEFT_OUT = {"HAARLIGHT_DAEMON": ("capture", "status", "pause", "resume", "abort", "all-off", "reshoot", "preview",
                                 "shot", "sessions", "rig doctor", "rig commission"),
            "HAARLIGHT_STUDY": ("bases",)}
# No part's library may be found: CMake's packages, pkg-config's modules.
PACKAGES = ("GTest", "Ceres", "rapidcheck", "benchmark", "MPI")
MODULES = ("libsystemd", "libusb-1.0", "libmodbus", "libusbredirparser-0.5", "ompi", "ompi-c", "umockdev-1.0",
           "libcurl")


def run(*words, **more):
    return subprocess.run([str(word) for word in words], capture_output=True, text=True, check=False, **more)


class Parts(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        # A pkg-config that knows only what is needed: links to the others' descriptions.
        known = BUILD / "pkgconfig"
        known.mkdir(parents=True, exist_ok=True)
        folders = run("pkg-config", "--variable", "pc_path", "pkg-config").stdout.strip().split(":")
        for folder in map(pathlib.Path, folders):
            for file in folder.glob("*.pc"):
                link = known / file.name
                if file.stem not in MODULES and not link.is_symlink():
                    link.symlink_to(file)
        cls.environment = {**os.environ, "PKG_CONFIG_LIBDIR": str(known), "PKG_CONFIG_PATH": ""}
        # As the document says it.
        text = (SOURCE / "docs/reference/building.md").read_text()
        parts = re.findall(r"-DHAARLIGHT_\w+=OFF", re.search(r"cmake -B build/small (.|\n)*?\n\n", text)[0])
        assert len(parts) == 4, parts
        hidden = [f"-DCMAKE_DISABLE_FIND_PACKAGE_{name}=ON" for name in PACKAGES]
        cls.configured = run("cmake", "-S", SOURCE, "-B", BUILD, "-G", "Ninja", "-DCMAKE_BUILD_TYPE=Release",
                             "-DHAARLIGHT_PRECOMPILED=ON", "-DHAARLIGHT_WERROR=ON",
                             "-DCMAKE_EXPORT_COMPILE_COMMANDS=ON", *parts, *hidden, env=cls.environment)

    def test_it_configures_where_their_libraries_are_not(self):
        for module in MODULES:
            self.assertNotEqual(run("pkg-config", "--exists", module, env=self.environment).returncode, 0, module)
        self.assertEqual(self.configured.returncode, 0, self.configured.stderr)
        commands = json.loads((BUILD / "compile_commands.json").read_text())
        flags = " ".join(entry["command"] for entry in commands)
        for word in ("libusb", "modbus", "openmpi", "systemd", "gtest", "umockdev"):
            self.assertIsNone(re.search(rf"(-isystem|-I) \S*{word}", flags), word)
        files = {pathlib.Path(entry["file"]).name for entry in commands}
        self.assertFalse(files & {"usb_link.cpp", "modbus_bus.cpp", "ranks.cpp", "usb_redir_server.cpp",
                                  "daemon_client.cpp", "bases.cpp"})

    def test_in_another_projects_build_it_has_no_tests(self):
        folder = BUILD / "parent"
        folder.mkdir(exist_ok=True)
        (folder / "CMakeLists.txt").write_text(
            "cmake_minimum_required(VERSION 3.25)\nproject(parent LANGUAGES CXX)\nenable_testing()\n"
            f"add_subdirectory({SOURCE} haarlight)\n")
        done = run("cmake", "-S", folder, "-B", folder / "build", "-G", "Ninja")
        self.assertEqual(done.returncode, 0, done.stderr)
        self.assertIn("Total Tests: 0", run("ctest", "-N", "--test-dir", folder / "build").stdout)

    def test_the_command_names_what_it_lacks(self):
        built = run("cmake", "--build", BUILD, "--target", "haarlight", "--parallel", "2", env=self.environment)
        self.assertEqual(built.returncode, 0, built.stdout[-3000:])
        program = BUILD / "apps/haarlight/haarlight"
        shown = run(program, "--help").stdout
        for verb in ("import", "fit", "relight", "compress", "rig", "cameras"):
            self.assertRegex(shown, rf"(?m)^  {verb} ")
        for option, verbs in LEFT_OUT.items():
            for verb in verbs:
                *group, name = verb.split()
                self.assertNotRegex(run(program, *group, "--help").stdout, rf"(?m)^  {name} ")
                for more in ([], ["--help"], ["x.toml", "--report", "r.json"]):
                    lacks = run(program, *verb.split(), *more)
                    self.assertEqual((lacks.returncode, lacks.stdout), (2, ""), verb)
                    self.assertIn(f"haarlight {verb}: ", lacks.stderr)
                    self.assertIn(f"-D{option}=ON", lacks.stderr)
                self.assertNotRegex(run(program, "--completions", "bash").stdout, rf"[ '|]{name}[ ']")
        shared = run(program, "compress", "x", "-o", "y", env={**os.environ, "OMPI_COMM_WORLD_SIZE": "2"})
        self.assertEqual(shared.returncode, 2, shared.stderr)
        self.assertIn("HAARLIGHT_MPI", shared.stderr)

    def test_another_project_relights_with_what_is_left(self):
        with tempfile.TemporaryDirectory(prefix="haarlight-parts.") as folder:
            for words in (["--build", BUILD, "--parallel", "2"], ["--install", BUILD, "--prefix", f"{folder}/prefix"]):
                done = run("cmake", *words, env=self.environment)
                self.assertEqual(done.returncode, 0, done.stdout[-3000:] + done.stderr)
            consumer.check(pathlib.Path(folder) / "prefix", pathlib.Path(folder))


if __name__ == "__main__":
    unittest.main(verbosity=2)
