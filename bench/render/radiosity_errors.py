#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""The error of `haarlight render surface --integrator radiosity` by its patches, beside path tracing: the table of
docs/numerics/radiosity.md. Also of any other rows of options.

    /usr/bin/python3 bench/render/radiosity_errors.py HAARLIGHT [SCENE.toml] --work DIR

Two references of path tracing, of other seeds, are kept in DIR and not made again. RMSE over all colours without the light
and its rim (picture_errors.py), as the root of the mean of (picture - first)(picture - second): the references' own noise falls
out in the mean, the picture's stays. Over the mean of the references. HAARLIGHT: the program, of a release build. Needs Debian's
python3-numpy.
"""

import pathlib
import sys

import numpy as np

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parent))
from picture_errors import REFERENCE_SEED, arguments, called, colours, kept, parsed, read_tif, shown  # noqa: E402

SEEDS = (REFERENCE_SEED, 1000033)


def main():
    parser = arguments(__doc__, 2048)
    parser.add_argument("--size", default="128x128")
    parser.add_argument("--samples", default="256")
    parser.add_argument("--row", action="append")
    options = parsed(parser)
    rows = options.row or [*(f"--integrator radiosity --patches {n}" for n in (100, 1000, 10000)), "--integrator path"]
    references = [kept(options, f"path{options.reference}_{seed}", "--size", options.size, seed=seed)[0] for seed in SEEDS]
    where = shown(0.5 * (references[0] + references[1]))
    first, second = (colours(reference, where) for reference in references)
    mean = 0.5 * (first.mean() + second.mean())
    print(f"mean {mean:.5f}")
    print("| options | CPU s | MB | mean / path's | RMSE / mean |")
    print("|---|---|---|---|---|")
    for row in rows:
        picture = options.work / "row.tif"
        seconds, megabytes = called(options.haarlight, "surface", options.scene, "--size", options.size, "-o", picture,
                                    "--spp", options.samples, *row.split())
        found = colours(read_tif(picture), where)
        squared = ((found - first) * (found - second)).mean()
        error = f"{np.sqrt(squared) / mean:.4f}" if squared > 0 else "not seen"
        print(f"| {row} | {seconds:.1f} | {megabytes:.0f} | {found.mean() / mean:.4f} | {error} |", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
