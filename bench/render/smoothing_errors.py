#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""The error of `haarlight render smooth`: the table of docs/numerics/smoothing.md.

    /usr/bin/python3 bench/render/smoothing_errors.py HAARLIGHT [SCENE.toml] --work DIR

Pictures of a few samples, filtered each way, beside a reference of many (kept in DIR and not made again). As in
surface_errors.py: RMSE over all colours, less the reference's own variance, without the light and its rim; beside it
over all pixels; medians over seeds. HAARLIGHT: the program, of a release build. Needs Debian's python3-numpy.
"""

import pathlib
import statistics
import sys

import numpy as np

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parent))
from picture_errors import arguments, called, kept, parsed, read_tif, shown  # noqa: E402


def main():
    parser = arguments(__doc__, 2048)
    parser.add_argument("--size", default="128x128")
    parser.add_argument("--samples", type=lambda text: [int(n) for n in text.split(",")], default=[4, 16, 64])
    parser.add_argument("--seeds", type=int, default=3)
    options = parsed(parser)
    reference, own = kept(options, f"long{options.reference}", "--size", options.size)
    where = shown(reference)
    reference = reference.reshape(*where.shape, 3)
    own = own.reshape(*where.shape, 3)

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
            words = (options.haarlight, "surface", options.scene, "--size", options.size, "--spp", str(samples), "--seed",
                     str(seed), "-o")
            noisy = options.work / "noisy.exr"
            seconds, _ = called(*words, noisy)
            plain = options.work / "noisy.tif"
            called(*words, plain)
            rows.setdefault("none", []).append((seconds, *errors(plain)))
            for kind in ("low-pass", "median", "features"):
                smooth = options.work / "smooth.tif"
                added, _ = called(options.haarlight, "smooth", noisy, "--by", kind, "-o", smooth)
                rows.setdefault(kind, []).append((seconds + added, *errors(smooth)))
        for kind, of_seeds in rows.items():
            seconds, error, ratio, with_light = map(statistics.median, zip(*of_seeds))
            print(f"| {samples} | {kind} | {seconds:.2f} | {error:.4f} | {ratio:.4f} | {with_light:.3f} |", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
