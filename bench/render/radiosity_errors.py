#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""The error of `haarlight render surface --integrator radiosity` by its patches, beside path tracing: the table of
docs/numerics/radiosity.md. Also of any other rows of options.

    /usr/bin/python3 bench/render/radiosity_errors.py HAARLIGHT [SCENE.toml] --work DIR

Two references of path tracing, of other seeds, are kept in DIR and not made again. RMSE over all colours without the light
and its rim (surface_errors.py), as the root of the mean of (picture - first)(picture - second): the references' own noise falls
out in the mean, the picture's stays. Over the mean of the references. HAARLIGHT: the program, of a release build. Needs Debian's
python3-numpy.
"""

import argparse
import os
import pathlib
import subprocess
import sys

import numpy as np

SOURCE = pathlib.Path(__file__).resolve().parent.parent.parent
sys.path.insert(0, str(SOURCE / "bench"))
sys.path.insert(0, str(SOURCE / "bench/render"))
from float_tif import read_tif  # noqa: E402
from surface_errors import shown  # noqa: E402

SEEDS = (1000003, 1000033)


def render(options, picture, *words):
    """@return CPU seconds of the command, files and all, and its most memory in MB"""
    child = subprocess.Popen([options.haarlight, "render", "surface", options.scene, "--size", options.size, "-o", picture,
                              "--quiet", "--force", *words], stdout=subprocess.DEVNULL)
    _, status, usage = os.wait4(child.pid, 0)
    child.returncode = os.waitstatus_to_exitcode(status)
    if child.returncode != 0:
        sys.exit(f"haarlight ends with {child.returncode}: {words}")
    return usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1000.0


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("haarlight", type=pathlib.Path)
    parser.add_argument("scene", nargs="?", type=pathlib.Path, default=SOURCE / "configs/scenes/cornell.toml")
    parser.add_argument("--work", type=pathlib.Path, required=True)
    parser.add_argument("--size", default="128x128")
    parser.add_argument("--reference", type=int, default=2048)
    parser.add_argument("--samples", default="256")
    parser.add_argument("--row", action="append")
    options = parser.parse_args()
    rows = options.row or [*(f"--integrator radiosity --patches {n}" for n in (100, 1000, 10000)), "--integrator path"]
    options.work.mkdir(parents=True, exist_ok=True)
    references = []
    for seed in SEEDS:
        kept = options.work / f"path{options.reference}_{seed}.tif"
        if not kept.exists():
            made = options.work / "made.tif"
            render(options, made, "--spp", str(options.reference), "--seed", str(seed))
            made.rename(kept)
        references.append(read_tif(kept))
    where = shown(0.5 * (references[0] + references[1]), 1.5)
    first, second = (reference.reshape(*where.shape, 3)[where] for reference in references)
    mean = 0.5 * (first.mean() + second.mean())
    print(f"mean {mean:.5f}")
    print("| options | CPU s | MB | mean / path's | RMSE / mean |")
    print("|---|---|---|---|---|")
    for row in rows:
        picture = options.work / "row.tif"
        seconds, megabytes = render(options, picture, "--spp", options.samples, *row.split())
        found = read_tif(picture).reshape(*where.shape, 3)[where]
        squared = ((found - first) * (found - second)).mean()
        error = f"{np.sqrt(squared) / mean:.4f}" if squared > 0 else "not seen"
        print(f"| {row} | {seconds:.1f} | {megabytes:.0f} | {found.mean() / mean:.4f} | {error} |", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
