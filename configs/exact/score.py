#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Compares pictures with the truth of the exact-image suite. Needs NumPy, --vtk also VTK.

    score.py SCENE.toml PICTURE.npy    mean, rms and largest error; PICTURE is (height, width, 4): R, G, B, opacity
    score.py --vtk                     the table of what VTK renders of every scene that it can
"""

import argparse
import os
import pathlib
import sys

import numpy as np

FOLDER = pathlib.Path(__file__).resolve().parent
FACTOR = 15  # VTK's pictures are off by half a pixel: theirs are made larger by it


def errors_of(picture, truth):
    """Of the pixels that the truth knows: mean, rms and largest error, and the largest error over the true value. Where the
    truth is 0 any light is an infinite relative error."""
    if picture.shape != truth.shape:
        raise SystemExit(f"the picture is of shape {picture.shape}, the truth of {truth.shape}")
    known = ~np.isnan(truth)
    truth = truth[known]
    error = np.abs(picture[known].astype(np.float64) - truth)
    error = np.where(np.isnan(error), np.inf, error)
    with np.errstate(divide="ignore", invalid="ignore"):
        relative = np.where(error == 0.0, 0.0, error / np.abs(truth))
    return error.mean(), np.sqrt((error**2).mean()), error.max(), relative.max()


def score(scene, picture):
    errors = errors_of(np.load(picture), np.load(scene.with_suffix(".npy")))
    for name, error in zip(("mean", "rms", "largest", "largest relative"), errors):
        print(f"{name:17}{error:.3g}")


def table_of_vtk():
    try:
        import vtk_pictures
    except ImportError as error:
        print(f"no VTK for this Python ({error}): Debian's is python3-vtk9, for /usr/bin/python3")
        return
    if not os.environ.get("DISPLAY"):
        print("VTK needs an X server, also to render off-screen: xvfb-run -a score.py --vtk")
        return
    print(f"VTK {vtk_pictures.version()}, {FACTOR} times as large (every {FACTOR}th pixel), and as large as the truth\n")
    not_compared = {}
    print("| scene | mean | rms | largest | rms, same size | largest, same size | what is seen |\n|---|---|---|---|---|---|---|")
    for path in sorted(FOLDER.glob("*.toml")):
        scene = vtk_pictures.read_scene(path)
        reason = vtk_pictures.why_not(scene)
        if reason:
            not_compared.setdefault(reason, []).append(f"`{path.stem}`")
            continue
        truth = np.load(path.with_suffix(".npy"))
        fine, same = (errors_of(vtk_pictures.render(scene, path.parent, factor), truth) for factor in (FACTOR, 1))
        numbers = " | ".join(f"{error:.2g}" for error in (*fine[:3], *same[1:3]))
        print(f"| `{path.stem}` | {numbers} | {vtk_pictures.DEFECTS.get(path.stem, '')} |", flush=True)
    for reason, names in not_compared.items():
        print(f"\nNot compared, {reason}: {', '.join(names)}")


def main():
    parser = argparse.ArgumentParser(description="Compares pictures with the truth of the exact-image suite.")
    parser.add_argument("scene", nargs="?", type=pathlib.Path, metavar="SCENE.toml")
    parser.add_argument("picture", nargs="?", metavar="PICTURE.npy")
    parser.add_argument("--vtk", action="store_true", help="render with VTK what it can, and print the table")
    arguments = parser.parse_args()
    if arguments.vtk:
        table_of_vtk()
    elif arguments.picture:
        score(arguments.scene, arguments.picture)
    else:
        parser.print_usage()
        sys.exit(2)


if __name__ == "__main__":
    main()
