#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Writes the exact-image suite: meshes/*.vtu, *.toml and the true pictures *.npy. Takes some minutes. Needs mpmath.

    make_suite.py                  everything, into this folder
    make_suite.py NAME ...         these scenes only
    make_suite.py --check          what the truth guarantees: pixels of every scene once more in 60 digits with other parts
                                   and another rule, and in closed form
"""

import argparse
import array
import multiprocessing
import pathlib
import struct

import mpmath
from fractions import Fraction as F

import cube_meshes as cm
from cell_truth import CellTruth
from ray_truth import Truth
from scenes import BODIES, CELL_FIELDS, FIELDS, MESHES, NODE_FIELDS, SCENES

FOLDER = pathlib.Path(__file__).resolve().parent
CHECKED = 12  # pixels of a scene


def write_npy(path, rows):
    """Rows of pixels of numbers, in double precision."""
    shape = (len(rows), len(rows[0]), len(rows[0][0]))
    header = f"{{'descr': '<f8', 'fortran_order': False, 'shape': {shape}, }}"
    header += " " * (63 - (len(header) + 10) % 64) + "\n"
    numbers = array.array("d", [c for row in rows for pixel in row for c in pixel])
    path.write_bytes(b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header.encode() + numbers.tobytes())


def at(field):
    """The value of {(i, j, k): coefficient of x^i y^j z^k} at a point."""
    def value(p):
        return sum(c * p[0]**i * p[1]**j * p[2]**k for (i, j, k), c in field.items())
    return value


def write_mesh(name, folder):
    mesh = MESHES[name]
    cm.write_vtu(folder / f"meshes/{name}.vtu", mesh["cells"](),
                 {field: NODE_FIELDS.get(field) or at(FIELDS[field]) for field in mesh["fields"]},
                 {field: lambda p, field=field: F(CELL_FIELDS[field].value(p)) for field in mesh.get("cell_fields", ())})


def toml_rows(rows):
    if len(rows) == 1:
        return f"[{list(rows[0])}]"
    return "[\n" + "".join(f"  {list(row)},\n" for row in rows) + "]"


def write_scene(name, scene, folder):
    words = [f"# {scene['note']}", "schema = 1", f'name = "{name}"', "", "[mesh]", f'file = "meshes/{scene["mesh"]}.vtu"', ""]
    for table, field in (("density", scene["field"]), ("colour", scene.get("colour_field", scene["field"]))):
        words += [f"[{table}]", f'field = "{field}"']
        if field in CELL_FIELDS:
            words.append('on = "cells"')
        if table == "colour":
            words.append(f'glow = "{scene.get("glow", "chromaticity")}"')
        if f"{table}_scale" in scene:
            words.append(f"scale = {scene[f'{table}_scale']!r}")
        words += [f"points = {toml_rows(scene[table])}", ""]
    for contour in scene.get("contours", ()):
        words += ["[[contour]]", f'field = "{scene["contour_field"]}"']
        words += [f"{key} = {list(value) if isinstance(value, tuple) else value}" for key, value in contour.items()] + [""]
    if "background" in scene:
        words += ["[background]", f"colour = {list(scene['background'])}", ""]
    words.append("[camera]")
    for key, value in scene["camera"].items():
        rows = key in ("K", "world_from_cam")
        words.append(f"{key} = {toml_rows(value) if rows else list(value) if isinstance(value, tuple) else value}")
    (folder / f"{name}.toml").write_text("\n".join(words) + "\n")


def truth_of(name, **words):
    scene = SCENES[name]
    mesh = MESHES[scene["mesh"]]
    if scene["field"] in NODE_FIELDS:
        return CellTruth(scene, {"cells": mesh["cells"](), "node_fields": NODE_FIELDS}, FIELDS, CELL_FIELDS, **words)
    return Truth(scene, {"body": BODIES[mesh["body"]]}, FIELDS, CELL_FIELDS, **words)


def make_scene(job):
    name, folder = job
    write_scene(name, SCENES[name], folder)
    truth = truth_of(name)
    width, height = SCENES[name]["camera"]["size"]
    rows = [[[float(c) for c in truth.pixel(x, y) or 4 * [float("nan")]] for x in range(width)] for y in range(height)]
    write_npy(folder / f"{name}.npy", rows)
    return name


def is_piecewise_linear(scene):
    if scene["field"] in NODE_FIELDS:
        return all(kind == cm.TETRAHEDRON for kind, _ in MESHES[scene["mesh"]]["cells"]())
    return all(name in CELL_FIELDS or all(sum(powers) < 2 for powers in FIELDS[name])
               for name in (scene["field"], scene.get("colour_field", scene["field"])))


def check_scene(name):
    """The largest deviations, relative to the pixel's value, of the truth's 40 digits from two other ways."""
    width, height = SCENES[name]["camera"]["size"]
    places = [(x, y) for y in range(height) for x in range(width)]
    truth = truth_of(name)
    first = {}
    for x, y in sorted(places, key=lambda p: (p[0] * 7919 + p[1] * 104729) % 1009):
        pixel = truth.pixel(x, y)
        if pixel and pixel[3] > 0:
            first[x, y] = pixel
        if len(first) == CHECKED:
            break
    mpmath.mp.dps = 60
    finer = truth_of(name, points=24, depth=mpmath.mpf(1) / 3)
    again = max(deviation(pixel, finer.pixel(*place)) for place, pixel in first.items())
    closed = None
    if is_piecewise_linear(SCENES[name]):
        mpmath.mp.dps = 120
        other = truth_of(name)
        closed = max(deviation(pixel, other.closed_form(*place)) for place, pixel in first.items())
    mpmath.mp.dps = 40
    return name, again, closed


def deviation(a, b):
    return max(abs(x - y) / abs(y) if y else abs(x) for x, y in zip(a, b))


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("scenes", nargs="*", metavar="NAME")
    parser.add_argument("--check", action="store_true")
    parser.add_argument("--folder", type=pathlib.Path, default=FOLDER)
    parser.add_argument("--processes", type=int, default=2)
    arguments = parser.parse_args()
    names = arguments.scenes or list(SCENES)
    with multiprocessing.Pool(arguments.processes) as pool:
        if arguments.check:
            for name, again, closed in pool.imap(check_scene, names):
                form = "" if closed is None else f", closed form {mpmath.nstr(closed, 2)}"
                print(f"{name}: other rule {mpmath.nstr(again, 2)}{form}", flush=True)
            return
        (arguments.folder / "meshes").mkdir(parents=True, exist_ok=True)
        for mesh in sorted({SCENES[name]["mesh"] for name in names}):
            write_mesh(mesh, arguments.folder)
        for name in pool.imap_unordered(make_scene, [(name, arguments.folder) for name in names]):
            print(name, flush=True)


if __name__ == "__main__":
    main()
