#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""The error of `haarlight render surface` against samples and CPU time: the table of
docs/numerics/surface.md.

    /usr/bin/python3 bench/render/surface_errors.py HAARLIGHT [SCENE.toml] --work DIR
    ... --common="--integrator direct" --row="--lights power" --row="--lights tree"
    ... --plot ERRORS.svg --strips STRIPS.png --strip-seconds 1 --strip-crop 80x200+10+40

--strips: a crop of the picture of each row, of as many samples as fit into the same CPU seconds, and of the reference.

Rows: options of the command to compare, by default two samplers; --common are those of all rows and the
reference, which gets those of the last row, too. HAARLIGHT: the program, of a release build. Needs Debian's python3-numpy. The reference (--reference
samples per pixel, another seed) is kept in DIR and not made again. Left out: pixels above --most in the reference,
and their neighbours within two pixels: the light and its rim. RMSE over all colours, less the reference's
own variance; medians over seeds, which alternate between the rows. ± over seeds: the standard error of the mean ratio.
"""

import json
import pathlib
import statistics
import sys

import numpy as np

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parent))
from picture_errors import arguments, called, colours, kept, parsed, read_tif, shown  # noqa: E402
from surface_plot import plot, strips  # noqa: E402


def render(options, name, *words):
    """@return the picture and the CPU seconds of the command, files and all"""
    picture = options.work / f"{name}.tif"
    seconds, _ = called(options.haarlight, "surface", options.scene, "-o", picture, *options.common.split(), *words)
    return read_tif(picture), seconds


def make_strips(options, measured, reference, white):
    """@param measured  {row: [(samples, CPU seconds, RMSE)]}"""
    size, x, y = options.strip_crop.split("+")
    width, height = map(int, size.split("x"))
    part = np.s_[int(y):int(y) + height, int(x):int(x) + width]
    pictures = []
    for row, points in measured.items():
        # Seconds by samples: a start and a rate.
        rate, start = np.polyfit([p[0] for p in points], [p[1] for p in points], 1)
        samples = max(1, round((options.strip_seconds - start) / rate))
        picture, seconds = render(options, "strip", "--spp", str(samples), "--seed", "77", *row.split())
        print(f"strip of {row}: {samples} samples, {seconds:.2f} CPU s")
        pictures.append(picture.reshape(reference.shape)[part])
    strips([*pictures, reference[part]], white, options.strips)


def main():
    parser = arguments(__doc__, 4096)
    parser.add_argument("--samples", type=lambda text: [int(n) for n in text.split(",")], default=[4, 16, 64, 256])
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--most", type=float, default=1.5)
    parser.add_argument("--common", default="")
    parser.add_argument("--row", action="append")
    parser.add_argument("--plot", type=pathlib.Path)
    parser.add_argument("--strips", type=pathlib.Path)
    parser.add_argument("--strip-seconds", type=float, default=1.0)
    parser.add_argument("--strip-crop", default="80x200+10+40")
    options = parsed(parser)
    rows_wanted = options.row or ["--sampler sobol", "--sampler independent"]
    whole, own = kept(options, f"reference{options.reference}", *options.common.split(), *(options.row or [""])[-1].split())
    where = shown(whole, options.most)
    own = colours(own, where)
    reference = colours(whole, where)
    print(f"mean {reference.mean():.5f}; the reference's own standard error at most {np.sqrt((own ** 2).mean()):.5f}")
    print("| row | samples | CPU s | RMSE | mean / reference | ± over seeds | 1 / (RMSE^2 CPU s) | stated / true error |")
    print("|---|---|---|---|---|---|---|---|")
    slopes = {}
    for samples in options.samples:
        rows = {}
        for seed in range(options.seeds):
            for row in rows_wanted:
                picture, seconds = render(options, "run", "--spp", str(samples), "--seed", str(seed), *row.split(),
                                          "--error", options.work / "run_error.tif")
                picture = colours(picture, where)
                stated = colours(read_tif(options.work / "run_error.tif"), where)
                squared = ((picture - reference) ** 2).mean() - (own ** 2).mean()
                rows.setdefault(row, []).append((seconds, squared, picture.mean() / reference.mean(),
                                                     1.0 / (squared * seconds),
                                                     np.sqrt((stated ** 2).mean() / squared)))
        for row, of_seeds in rows.items():
            seconds, squared, ratio, efficiency, stated = map(statistics.median, zip(*of_seeds))
            ratios = [one[2] for one in of_seeds]
            spread = statistics.stdev(ratios) / len(ratios) ** 0.5 if len(ratios) > 1 else float("nan")
            slopes.setdefault(row, []).append((samples, seconds, np.sqrt(squared)))
            print(f"| {row.removeprefix('--sampler ')} | {samples} | {seconds:.2f} | {np.sqrt(squared):.4f} | {ratio:.4f} | {spread:.4f} | {efficiency:.0f} "
                  f"| {stated:.2f} |", flush=True)
    slope = {}
    for row, points in slopes.items():
        n, _, error = np.log(np.array(points)).T
        slope[row] = np.polyfit(n, error, 1)[0]
        print(f"{row}: slope {slope[row]:.3f}")
    (options.work / "slopes.json").write_text(json.dumps(slopes))
    if options.plot:
        plot(slopes, slope, options.plot)
    if options.strips:
        make_strips(options, slopes, whole.reshape(*where.shape, 3), np.quantile(reference, 0.995))
    return 0


if __name__ == "__main__":
    sys.exit(main())
