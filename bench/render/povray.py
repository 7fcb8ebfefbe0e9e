#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""The irradiance cache and the photon map of `haarlight render surface` beside POV-Ray's radiosity: a table of
docs/numerics/surface.md.

    /usr/bin/python3 bench/render/povray.py HAARLIGHT CORNELL.json --work DIR

HAARLIGHT: the program, of a release build; it renders configs/scenes/cornell.toml, which is checked to be the scene of
CORNELL.json. Needs Debian's python3-numpy, and as root installs Debian's povray where there is none. POV-Ray gets the same
quads, in a right-handed camera; the lamp as a grid of point lights that shine as a Lambertian square does (area_light
N x N, adaptive off, a spotlight of radius 90, falloff 90, tightness 1; fade_distance 1, fade_power 2, L A / (2 pi)), the
quad itself black; no ambient light; assumed_gamma 1; 16 bits a colour. It draws nothing at random: all its seeds are one.

One reference, the mean of two path-traced pictures of other seeds (--reference samples each), kept in DIR and not made
again; a quarter of the squared difference of the two is its variance. Left out: pixels above --most in the reference, and
their neighbours within two pixels: the light and its rim. RMSE over all colours, less the reference's own variance;
medians over seeds, which alternate between the programs. CPU seconds, user and system: of the whole commands from file to
file, of one picture of 256 x 256 pixels.
"""

import argparse
import json
import math
import os
import pathlib
import re
import shutil
import statistics
import subprocess
import sys

import numpy as np

HERE = pathlib.Path(__file__).resolve().parent
sys.path[:0] = [str(HERE), str(HERE.parent)]
from cycles import BOUNCES, SCENE, SIZE, by_haarlight, check_scenes, command, reference, shown  # noqa: E402
from float_tif import read_tif  # noqa: E402

ROWS = ["irradiance-cache --spp 16 --sampling light", "irradiance-cache --spp 64 --sampling light",
        "photon-map --final-gather --photons 800000 --nearest 20 --kernel epanechnikov --spp 16 --gather-rays 8"]


def vector(values):
    return "<" + ", ".join(f"{value:.9g}" for value in values) + ">"


def scene_of(box, side, radiosity):
    """The scene in POV-Ray's language."""
    words = ["#version 3.7;", f"global_settings {{ assumed_gamma 1 radiosity {{ {radiosity} }} }}",
             "background { rgb 0 }",
             f"camera {{ perspective location {vector(box['eye'])} right -x up y sky {vector(box['up'])} "
             f"angle {box['fov_deg']} look_at {vector(box['look'])} }}"]
    for name, corners, albedo, emitted in box["quads"]:
        first, second, third, fourth = map(vector, corners)
        finish = "finish { ambient 0 emission 0 diffuse 1 specular 0 }"
        shade = "no_shadow" if emitted else ""
        words.append(f"mesh {{ triangle {{ {first}, {second}, {third} }} triangle {{ {first}, {third}, {fourth} }} "
                     f"texture {{ pigment {{ rgb {vector(albedo)} }} {finish} }} {shade} }}  // {name}")
        if emitted:
            points = np.array(corners, float)
            sides = points[1] - points[0], points[3] - points[0]
            normal = np.cross(*sides)
            area = float(np.linalg.norm(normal))
            middle = points.mean(axis=0)
            colour = [value * area / (2 * math.pi) for value in emitted]
            words.append(f"light_source {{ {vector(middle)} rgb {vector(colour)} spotlight radius 90 falloff 90 tightness 1 "
                         f"point_at {vector(middle + normal / area)} area_light {vector(sides[0])}, {vector(sides[1])}, "
                         f"{side}, {side} area_illumination on fade_distance 1 fade_power 2 }}")
    return "\n".join(words) + "\n"


def read_ppm(path):
    """@return (h, w, 3), 1 for the largest value"""
    data = path.read_bytes()
    head = re.match(rb"P6\s+(?:#.*\n)*(\d+)\s+(\d+)\s+(\d+)\s", data)
    width, height, most = map(int, head.groups())
    return np.frombuffer(data, ">u2", width * height * 3, head.end()).reshape(height, width, 3) / float(most)


def by_povray(options, setting):
    """@return the picture, and the CPU seconds of the command"""
    side, radiosity, antialias = setting
    scene, picture = options.work / "box.pov", options.work / "box.ppm"
    scene.write_text(scene_of(json.loads(options.json.read_text()), side, radiosity))
    seconds = command(["povray", f"+I{scene}", f"+O{picture}", f"+W{SIZE}", f"+H{SIZE}", "+FP16", "File_Gamma=1.0", "-D",
                       "-C", "-GA", "-V", f"+WT{options.threads}", *antialias])
    return read_ppm(picture), seconds


def by_row(options, setting, seed):
    """@return the picture, and the CPU seconds of the command"""
    picture = options.work / "row.tif"
    seconds = command([options.haarlight, "render", "surface", SCENE, "-o", picture, "--quiet", "--force", "--bounces",
                       str(BOUNCES), "--threads", str(options.threads), "--seed", str(seed), "--integrator", *setting])
    return read_tif(picture).reshape(SIZE, SIZE, 3), seconds


def settings_of(options):
    """What is compared, by name."""
    rows = {}
    for side, count in (words.split() for words in options.povray):
        rows[f"POV-Ray, light {side}², count {count}"] = (
            by_povray, (side, f"count {count} {options.radiosity}", options.antialias.split()))
    for words in options.rows:
        rows[f"haarlight, {words}"] = (by_row, words.split())
    return rows


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("haarlight", type=pathlib.Path)
    parser.add_argument("json", type=pathlib.Path)
    parser.add_argument("--work", type=pathlib.Path, required=True)
    parser.add_argument("--reference", type=int, default=4096, help="samples of each of its two renders")
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--most", type=float, default=1.5)
    parser.add_argument("--radiosity", default="recursion_limit 8 error_bound 0.9 pretrace_end 0.01", help="POV-Ray's, beside its count")
    parser.add_argument("--antialias", default="+A0.05 +AM1 +R4", help="POV-Ray's options")
    parser.add_argument("--povray", nargs="*", default=["8 50", "16 200"], help="points on a side of the lamp, count; a row each")
    parser.add_argument("--rows", nargs="*", default=ROWS, help="integrators of haarlight and their options, a row each")
    options = parser.parse_args()
    options.work.mkdir(parents=True, exist_ok=True)
    check_scenes(options)
    if shutil.which("povray") is None:
        subprocess.run(["apt-get", "install", "-y", "--no-install-recommends", "povray"], check=True,
                       stdout=subprocess.DEVNULL, env={**os.environ, "DEBIAN_FRONTEND": "noninteractive"})
    version = subprocess.run(["povray", "--version"], capture_output=True, text=True, check=False)
    print(next(line for line in (version.stdout + version.stderr).splitlines() if "POV-Ray" in line))
    print(subprocess.run([options.haarlight, "--version"], check=True, capture_output=True, text=True).stdout.strip())
    truth, own = reference(options, "haarlight", options.reference,
                           lambda samples, seed: by_haarlight(options, samples, seed))
    where = shown(truth, options.most)
    truth, own = truth[where], own[where].mean()
    print(f"reference: mean {truth.mean():.5f}, sigma {math.sqrt(own):.5f}, brightest {truth.max():.2f}")

    print("| program | CPU s | RMSE | least, most | mean / reference | its mean | eff |\n|---|---|---|---|---|---|---|")
    found = {name: [] for name in settings_of(options)}
    for seed in range(options.seeds):
        for name, (render, setting) in settings_of(options).items():
            picture, seconds = render(options, setting) if render is by_povray else render(options, setting, seed)
            squared = ((picture[where] - truth) ** 2).mean() - own
            found[name].append((seconds, math.sqrt(max(0.0, squared)), picture[where].mean() / truth.mean()))
    for name, runs in found.items():
        seconds, error, ratio = map(statistics.median, zip(*runs))
        errors, ratios = [run[1] for run in runs], [run[2] for run in runs]
        print(f"| {name} | {seconds:.2f} | {error:.5f} | {min(errors):.5f}, {max(errors):.5f} | {ratio:.4f} "
              f"| {statistics.mean(ratios):.4f} ± {statistics.pstdev(ratios) / math.sqrt(max(1, len(ratios) - 1)):.4f} "
              f"| {1 / (error ** 2 * seconds):.0f} |", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
