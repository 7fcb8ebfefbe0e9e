#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""What the shells complete: bash asked word by word, fish too where it is installed, zsh for its
grammar. completions_test.py BIN, the build's folder apps/."""

import pathlib
import re
import shutil
import subprocess
import sys
import tempfile
import unittest

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parent.parent / "apps"))
from programs import Programs  # noqa: E402

PROGRAMS = ("haarlight", "haarlightd", "haarlight-sim")


class Completions(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.programs = Programs(BIN)
        place = tempfile.TemporaryDirectory(prefix="haarlight-completions.")
        cls.addClassCleanup(place.cleanup)
        cls.folder = pathlib.Path(place.name)
        for name in PROGRAMS:
            for shell in ("bash", "zsh", "fish"):
                done = subprocess.run([cls.programs.bin / name / name, "--completions", shell],
                                      capture_output=True, text=True, check=True)
                assert done.stderr == "", done.stderr
                (cls.folder / f"{name}.{shell}").write_text(done.stdout)
        (cls.folder / "two words.hlb").write_text("")
        (cls.folder / "sky.hdr").write_text("")

    def bash(self, line):
        """What bash offers for the last word of the line."""
        name = line.split()[0]
        script = ('source "$1"; shift; COMP_WORDS=("$@"); COMP_CWORD=$(($# - 1)); '
                  f'_{name.replace("-", "_")}; printf "%s\\n" "${{COMPREPLY[@]}}"')
        words = [word for part in line.split(" ") for word in re.split("(=)", part) if word or "=" not in part]
        done = subprocess.run(["bash", "-c", script, "bash", self.folder / f"{name}.bash", *words],
                              capture_output=True, text=True, cwd=self.folder, check=True)
        self.assertEqual(done.stderr, "", line)
        return [word for word in done.stdout.splitlines() if word]

    def fish(self, line):
        done = subprocess.run(["fish", "--no-config", "-c", f'source $argv[1]; complete -C "{line}"',
                               self.folder / f"{line.split()[0]}.fish"], capture_output=True, text=True,
                              cwd=self.folder, env={"HOME": str(self.folder), "PATH": "/usr/bin:/bin"}, check=True)
        self.assertEqual(done.stderr, "", line)
        return [word.split("\t")[0] for word in done.stdout.splitlines()]

    # A line, words that are offered, words that are not.
    CASES = (
        ("haarlight re", {"relight", "rebuild", "resume", "reshoot"}, {"rig", "verify"}),
        ("haarlight relight --ex", {"--exposure"}, {"--order", "sky.hdr"}),
        ("haarlight relight --order ", {"transport", "light"}, {"--exposure", "sky.hdr"}),
        ("haarlight relight --order t", {"transport"}, {"light"}),
        ("haarlight relight --cubemap ", {"sky.hdr"}, {"--exposure"}),
        ("haarlight relight --terms ", set(), {"sky.hdr", "--order"}),
        ("haarlight relight tw", {"two words.hlb"}, {"sky.hdr"}),
        ("haarlight rig ", {"doctor", "commission", "calibrate", "predict"}, {"sky.hdr"}),
        ("haarlight rig do", {"doctor"}, {"commission"}),
        ("haarlight rig doctor --", {"--json", "--report"}, {"--lobe", "--flash-ok"}),
        ("haarlight rig calibrate ", {"camera", "plane", "lights"}, {"doctor"}),
        ("haarlight rig calibrate lights --lobe ", {"free", "given"}, set()),
        ("haarlight develop --without ", {"dark", "flat", "drift"}, {"sky.hdr"}),
        ("haarlight shadow b.hlb --plate f", {"falloff"}, set()),
        ("haarlight check s", {"sky.hdr"}, {"relight"}),
        ("haarlightd --al", {"--all-off"}, set()),
        ("haarlight-sim --see", {"--seed"}, set()),
    )

    def check_cases(self, ask):
        for line, offered, absent in self.CASES:
            with self.subTest(line=line):
                words = {word.replace("\\ ", " ") for word in ask(line)}
                self.assertLessEqual(offered, words)
                self.assertFalse(absent & words, words)

    def test_bash_completes_verbs_options_choices_and_files(self):
        self.check_cases(self.bash)
        self.assertEqual(self.bash("haarlight relight --order=t"), ["transport"])
        self.assertEqual(set(self.bash("haarlight ")) - {"--help", "-h", "--version"},
                         set(self.programs.verbs()))

    def test_every_option_of_the_help_is_offered(self):
        for whole in self.programs.whole_verbs():
            with self.subTest(verb=whole):
                shown = self.programs.run(*whole.split(), "--help").stdout
                options = set(re.findall(r"(?m)^  (?:-\w,)?((?:--[a-z0-9-]+,?)+)", shown))
                options = {name for names in options for name in names.split(",") if name}
                self.assertGreater(len(options), 4)
                self.assertEqual({word for word in self.bash(f"haarlight {whole} --")}, options)

    def test_fish_completes_the_same(self):
        if not shutil.which("fish"):
            self.skipTest("fish is not installed")
        self.check_cases(self.fish)

    def test_zsh_understands_the_file(self):
        if not shutil.which("zsh"):
            self.skipTest("zsh is not installed")
        for name in PROGRAMS:
            done = subprocess.run(["zsh", "-n", self.folder / f"{name}.zsh"], capture_output=True, text=True,
                                  check=False)
            self.assertEqual((done.returncode, done.stderr), (0, ""))

    def test_another_shell_is_refused(self):
        done = self.programs.run("--completions", "csh")
        self.assertEqual(done.returncode, 2)
        self.assertIn("csh", done.stderr)


if __name__ == "__main__":
    BIN = sys.argv.pop(1)
    unittest.main(verbosity=2)
