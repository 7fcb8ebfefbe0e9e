# SPDX-License-Identifier: Apache-2.0
"""What surface_errors.py, radiosity_errors.py and smoothing_errors.py share: their arguments, a command's cost, the
reference, which is kept, and the pixels that are compared."""

import argparse
import os
import pathlib
import subprocess
import sys

import numpy as np

SOURCE = pathlib.Path(__file__).resolve().parent.parent.parent
sys.path.insert(0, str(SOURCE / "bench"))
from float_tif import read_tif  # noqa: E402

REFERENCE_SEED = 1000003


def arguments(description, samples=None):
    """@param samples  per pixel of the reference that is kept, where --reference says no other"""
    parser = argparse.ArgumentParser(description=description.split("\n", maxsplit=1)[0])
    parser.add_argument("haarlight", type=pathlib.Path)
    parser.add_argument("scene", nargs="?", type=pathlib.Path, default=SOURCE / "configs/scenes/cornell.toml")
    parser.add_argument("--work", type=pathlib.Path, required=True)
    if samples is not None:
        parser.add_argument("--reference", type=int, default=samples)
    return parser


def parsed(parser):
    options = parser.parse_args()
    options.work.mkdir(parents=True, exist_ok=True)
    return options


def called(haarlight, *words):
    """Runs `haarlight render`. @return CPU seconds of the command, files and all, and its most memory in MB"""
    child = subprocess.Popen([haarlight, "render", *words, "--quiet", "--force"], stdout=subprocess.DEVNULL)
    _, status, usage = os.wait4(child.pid, 0)
    child.returncode = os.waitstatus_to_exitcode(status)
    if child.returncode != 0:
        sys.exit(f"haarlight ends with {child.returncode}: {' '.join(map(str, words))}")
    return usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1000.0


def kept(options, name, *words, seed=REFERENCE_SEED):
    """A picture of many samples and its stated standard error, as they were made by these words before, if they were."""
    picture = options.work / f"{name}.tif"
    error = options.work / f"{name}_error.tif"
    if not picture.exists():
        made = options.work / "made.tif"
        called(options.haarlight, "surface", options.scene, "--spp", str(options.reference), "--seed", str(seed), "-o", made,
               "--error", error, *words)
        made.rename(picture)
    return read_tif(picture), read_tif(error)


def shown(reference, most=1.5):
    """Where pictures are compared: not at pixels above `most` and their neighbours within two, the light and its rim."""
    bright = (reference.reshape(reference.shape[0], -1, 3) > most).any(axis=2)
    grown = bright.copy()
    for dy in range(-2, 3):
        for dx in range(-2, 3):
            grown |= np.roll(bright, (dy, dx), (0, 1))
    return ~grown


def colours(picture, where):
    """(n, 3): of the pixels that are compared"""
    return picture.reshape(*where.shape, 3)[where]
