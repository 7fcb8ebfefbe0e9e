#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""How often the truth lies within the standard error that `haarlight render surface --error` states: the table of
docs/numerics/surface.md ("Does the stated error cover the truth?").

    /usr/bin/python3 bench/render/coverage.py HAARLIGHT --work DIR [--seeds 1000] [--row="--integrator path --spp 16"]

Small pictures of many seeds; of each pixel and colour the fraction of seeds whose value differs from the truth by at most 1 and
1.96 stated errors: 68.3 % and 95 % of normal estimates with a known error; with an error that n samples tell, a little less.
Truth: the mean over --truth-seeds other, longer pictures by --truth, whose own error is told. Of direct light: --truth "--integrator path --bounces 1 --spp 4096". HAARLIGHT: the program, of a release build.
"""

import pathlib
import sys

import numpy as np

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parent))
from picture_errors import arguments, called, parsed, read_tif  # noqa: E402

ROWS = tuple(f"--integrator {name} --sampler {sampler} --spp {n}" for name in ("path", "bidirectional")
             for sampler in ("independent", "sobol") for n in (16, 64))
WITHIN = (1.0, 1.96)


def picture(options, seed, words, error=None):
    made = options.work / "seed.tif"
    called(options.haarlight, "surface", options.scene, "--size", options.size, *options.common.split(), "-o", made, "--seed",
           str(seed), *words.split(), *(() if error is None else ("--error", error)))
    return read_tif(made).ravel()


def truth_of(options):
    """(values,): and its standard error"""
    many = [picture(options, 10 ** 6 + i, options.truth) for i in range(options.truth_seeds)]
    return np.mean(many, axis=0), np.std(many, axis=0, ddof=1) / options.truth_seeds ** 0.5


def main():
    parser = arguments(__doc__)
    parser.add_argument("--seeds", type=int, default=1000)
    parser.add_argument("--size", default="16x16")
    parser.add_argument("--truth", default="--integrator bidirectional --spp 4096")
    parser.add_argument("--truth-seeds", type=int, default=16)
    parser.add_argument("--common", default="", help="options of all rows and of the truth")
    parser.add_argument("--row", action="append")
    options = parsed(parser)
    truth, own = truth_of(options)
    print(f"truth {truth.mean():.5f}, its own error {np.sqrt((own ** 2).mean()):.2g}; {options.seeds} seeds")
    print("| options | within 1 error % | within 1.96 % | stated / true error | mean / truth, t |")
    print("|---|---|---|---|---|")
    for row in options.row or ROWS:
        error = options.work / "seed_error.tif"
        inside, squares, stated_squares, means = np.zeros((2, truth.size)), 0.0, 0.0, []
        for seed in range(options.seeds):
            values = picture(options, seed, row, error)
            stated = read_tif(error).ravel()
            off = np.abs(values - truth)
            inside += off <= np.outer(WITHIN, stated)
            squares += (off ** 2 - own ** 2).mean()
            stated_squares += (stated ** 2).mean()
            means.append(values.mean())
        share = 100.0 * inside.mean(axis=1) / options.seeds
        # Errors of the means over seeds and of the truth.
        t = (np.mean(means) - truth.mean()) / np.hypot(np.std(means, ddof=1) / len(means) ** 0.5, own.mean() / own.size ** 0.5)
        print(f"| `{row}` | {share[0]:.1f} | {share[1]:.1f} | {np.sqrt(stated_squares / squares):.3f} "
              f"| {np.mean(means) / truth.mean():.5f}, {t:+.2f} |", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
