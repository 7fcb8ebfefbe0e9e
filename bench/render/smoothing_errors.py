#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""The error of `haarlight render smooth`: the table of docs/numerics/smoothing.md.

    /usr/bin/python3 bench/render/smoothing_errors.py HAARLIGHT [SCENE.toml] --work DIR

Pictures of a few samples, filtered each way, beside a reference of many (kept in DIR and not made again). As in
surface_errors.py: RMSE over all colours, less the reference's own variance, without the light and its rim; beside it
over all pixels; medians over seeds. HAARLIGHT: the program, of a release build. Needs Debian's python3-numpy.
"""

import argparse
import os
import pathlib
import statistics
import subprocess
import sys

import numpy as np

SOURCE = pathlib.Path(__file__).resolve().parent.parent.parent
sys.path.insert(0, str(SOURCE / "bench"))
sys.path.insert(0, str(SOURCE / "bench/render"))
from float_tif import read_tif  # noqa: E402
from surface_errors import REFERENCE_SEED, shown  # noqa: E402


def called(options, *words):
    """@return CPU seconds of the command, files and all"""
    before = os.times()
    subprocess.run([options.haarlight, "render", *words, "--quiet", "--force"], check=True, stdout=subprocess.DEVNULL)
    after = os.times()
    return after.children_user + after.children_system - before.children_user - before.children_system


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("haarlight", type=pathlib.Path)
    parser.add_argument("scene", nargs="?", type=pathlib.Path, default=SOURCE / "configs/scenes/cornell.toml")
    parser.add_argument("--work", type=pathlib.Path, required=True)
    parser.add_argument("--size", default="128x128")
    parser.add_argument("--reference", type=int, default=2048)
    parser.add_argument("--samples", type=lambda text: [int(n) for n in text.split(",")], default=[4, 16, 64])
    parser.add_argument("--seeds", type=int, default=3)
    options = parser.parse_args()
    options.work.mkdir(parents=True, exist_ok=True)
    long = options.work / f"long{options.reference}.tif"
    own_file = options.work / f"long{options.reference}_error.tif"
    if not long.exists():
        called(options, "surface", options.scene, "--size", options.size, "--spp", str(options.reference), "--seed",
               str(REFERENCE_SEED), "-o", long, "--error", own_file)
    reference = read_tif(long)
    where = shown(reference, 1.5)
    reference = reference.reshape(*where.shape, 3)
    own = read_tif(own_file).reshape(*where.shape, 3)

    def errors(path):
        """RMSE without the light and its rim, mean beside the reference's, RMSE of all"""
        picture = read_tif(path).reshape(*where.shape, 3)
        squared = (picture - reference) ** 2 - own ** 2
        # 0: less than the reference's own error, as it is stated.
        return (np.sqrt(max(0.0, squared[where].mean())), picture[where].mean() / reference[where].mean(),
                np.sqrt(max(0.0, squared.mean())))

    print("| samples | filter | CPU s | RMSE | mean / reference | RMSE with the light |")
    print("|---|---|---|---|---|---|")
    for samples in options.samples:
        rows = {}
        for seed in range(options.seeds):
            noisy = options.work / "noisy.exr"
            seconds = called(options, "surface", options.scene, "--size", options.size, "--spp", str(samples), "--seed",
                             str(seed), "-o", noisy)
            plain = options.work / "noisy.tif"
            called(options, "surface", options.scene, "--size", options.size, "--spp", str(samples), "--seed", str(seed),
                   "-o", plain)
            rows.setdefault("none", []).append((seconds, *errors(plain)))
            for kind in ("low-pass", "median", "features"):
                smooth = options.work / "smooth.tif"
                added = called(options, "smooth", noisy, "--by", kind, "-o", smooth)
                rows.setdefault(kind, []).append((seconds + added, *errors(smooth)))
        for kind, of_seeds in rows.items():
            seconds, error, ratio, with_light = map(statistics.median, zip(*of_seeds))
            print(f"| {samples} | {kind} | {seconds:.2f} | {error:.4f} | {ratio:.4f} | {with_light:.3f} |", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
