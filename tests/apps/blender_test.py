#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Scenes made in Blender, exported as glTF and rendered without editing, beside Cycles: blender_test.py BIN

BIN: the folder of the programs. Without Blender it is skipped (77). Both pictures are compared in 8 x 8 parts.
What differs by design is in docs/reference/gltf.md: Blender's Principled diffuse is not Lambertian.
"""

import os
import pathlib
import shutil
import subprocess
import sys
import tempfile

from programs import Programs

SCENE = pathlib.Path(__file__).resolve().parent / "blender_scene.py"
# Scene: samples in Cycles, in ours, most that the means and the parts may differ (root of the mean square), over the mean.
SCENES = {"box": (64, 64, 0.03, 0.05), "lamps": (64, 64, 0.03, 0.06), "gloss": (256, 256, 0.05, 0.10)}


def blender(*words):
    # Blender's Python is the system's: another one first in PATH would hide its NumPy.
    done = subprocess.run(["blender", "-b", "--python", SCENE, "--", *map(str, words)], capture_output=True, text=True,
                          timeout=600, check=False, env={**os.environ, "PATH": "/usr/bin:/bin"})
    if done.returncode != 0 or "Traceback" in done.stderr:
        sys.exit(f"blender {words}: {done.stdout[-2000:]}{done.stderr[-2000:]}")
    return done.stdout


def means(pictures):
    lines = [line.split() for line in blender("means", *pictures).splitlines() if line.startswith("mean ")]
    return [[tuple(map(float, words[2:])) for words in lines if words[1] == str(picture)] for picture in pictures]


def differences(theirs, ours):
    """Of the means, and of the parts, both over the mean of theirs."""
    flat = [[value for part in parts for value in part] for parts in (theirs, ours)]
    mean = sum(flat[0]) / len(flat[0])
    squares = sum((a - b) ** 2 for a, b in zip(*flat)) / len(flat[0])
    return sum(flat[1]) / len(flat[1]) / mean - 1, squares**0.5 / mean


def main():
    if shutil.which("blender") is None:
        print("Blender is not installed")
        return 77
    programs = Programs(sys.argv[1])
    failed = 0
    with tempfile.TemporaryDirectory() as place:
        folder = pathlib.Path(place)
        for name, (theirs, ours, most_mean, most_parts) in SCENES.items():
            # Not .exr: Blender opens one with more channels as layers, which have no pixels for its Python.
            glb, cycles, picture = (folder / f"{name}{ending}" for ending in (".glb", "-cycles.exr", ".tif"))
            blender(name, glb, cycles, theirs)
            done = programs.run("render", "surface", glb, "-o", picture, "--spp", ours, "--size", "128x128")
            if done.returncode != 0:
                sys.exit(done.stderr)
            of_mean, of_parts = differences(*means([cycles, picture]))
            is_near = abs(of_mean) <= most_mean and of_parts <= most_parts
            failed += not is_near
            print(f"{name}: mean {of_mean:+.2%}, parts {of_parts:.2%}{'' if is_near else ': too far'}", flush=True)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
