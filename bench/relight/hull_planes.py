#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""What a second camera, a second plane and lights on four more faces add to the shadow hull and to
cast shadows: a table of docs/numerics/hull.md, by the user's own commands from file to file.

    /usr/bin/python3 bench/relight/hull_planes.py build/release/apps --work DIR

Captures each object on small virtual rigs (8 x 8 lights per face, 160 x 120 pixels, noise), carves
voxels of 3 mm, casts shadows, and compares with the true object and with ray-traced pictures:

    wrong        ||picture - truth||_1 / ||unshadowed - truth||_1, method `both`, in %
    false        volume of the hull outside the true object, cm^3
    missing      volume of the true object outside the hull, cm^3
    heights      as bench/relight/hull_heights.py counts: true surface within the stated heights, in
                 %, and their median, mm

What DIR holds already is not made again. Needs Debian's python3-meshio and python3-numpy."""

import argparse
import json
import pathlib
import re

import meshio
import numpy as np

import hull_heights
from hull_table import (LED, LIGHTS, RECEIVERS, SOURCE, Programs, capture, json_rows, line, measure, nearest_lights,
                        percent, require, rig_text, vertices_of, write_receivers)

SIDE, PITCH = 8, 90.0
VOXEL = 3.0
GROUND = 999.0  # the scenes' ground reaches farther, their objects do not
WALL_Y, WALL_HEIGHT = 200.0, 160.0
WALL = f"""[[plane]]
id = "wall"
n = [0.0, -1.0, 0.0]
d = {WALL_Y}
origin = [0.0, {WALL_Y}, {WALL_HEIGHT / 2}]
u = [1.0, 0.0, 0.0]
v = [0.0, 0.0, 1.0]
extent = [400.0, {WALL_HEIGHT}]
texel = 2.0

"""
# The camera turned about z by 90 degrees: it sees the wall's front and the ground beside the object.
BESIDE = """world_from_cam = [
    [0, 0.643509750887, -0.765437914212, 560],
    [1, 0, 0, 0],
    [0, -0.765437914212, -0.643509750887, 520]]"""
# Rig: side faces, a wall, cameras.
RIGS = {"one face, one plane, one camera": (False, False, 1), "+ second camera": (False, False, 2),
        "+ second plane": (False, True, 1), "+ four side faces": (True, False, 1), "all of these": (True, True, 2),
        "all but the second plane": (True, False, 2)}


def side_faces():
    """Four arrays of 8 x 8 LEDs around the object, 600 mm from the middle, 135 to 765 mm high."""
    faces = []
    for name, x, y in (("left", -1, 0), ("right", 1, 0), ("front", 0, -1), ("back", 0, 1)):
        faces.append({"id": name, "centre": [600.0 * x, 600.0 * y, 450.0], "u": [float(-y), float(x), 0.0],
                      "v": [0.0, 0.0, 1.0], "emits": [float(-x), float(-y), 0.0], "rows": SIDE, "cols": SIDE,
                      "pitch": PITCH})
    return faces


def text_of(has_sides, has_wall, camera):
    text = rig_text("grid8", is_ideal=False, finer=0.5)
    if has_sides:
        faces = "".join("[[face]]\n" + "".join(f"{key} = {json.dumps(value)}\n" for key, value in {**f, **LED}.items())
                        + "\n" for f in side_faces())
        text = text.replace("[[plane]]", faces + "[[plane]]", 1)
    if has_wall:
        text = text.replace("[[camera]]", WALL + "[[camera]]", 1)
    if camera == 2:
        text, n = re.subn(r"world_from_cam = \[\n.*\n.*\n.*\]\]", BESIDE, text)
        assert n == 1
    return text


def scene_with(scene, has_wall, folder):
    """The object's scene, with the wall behind it where the rig has one."""
    if not has_wall:
        return scene
    half = 200.0
    corners = [[-half, WALL_Y, 0.0], [half, WALL_Y, 0.0], [half, WALL_Y, WALL_HEIGHT], [-half, WALL_Y, WALL_HEIGHT]]
    file = folder / f"{scene.stem}_wall.toml"
    file.write_text(f'schema = 1\nname = "{file.stem}"\n\n[[material]]\nname = "paper"\nkd = [0.7]\n\n[[quad]]\n'
                    f'corners = {corners}\nmaterial = "paper"\n\n[[mesh]]\nfile = "{scene.parent / scene.stem}.obj"\n')
    return file


# ---- the hull beside the true object ---------------------------------------------------------------


def true_voxels(obj, low, n, voxel):
    """Whether each voxel's centre is inside: crossings of the vertical line through it, signed."""
    vertices, triangles = hull_heights.read_obj(obj)
    triangles = triangles[np.abs(vertices[triangles]).max(axis=(1, 2)) < GROUND]
    crossings = np.zeros((n[0], n[1], n[2] + 1))
    for a, b, c in vertices[triangles]:
        normal = np.cross(b - a, c - a)
        if abs(normal[2]) < 1e-9:
            continue
        box = np.array([np.minimum(np.minimum(a, b), c)[:2], np.maximum(np.maximum(a, b), c)[:2]])
        first = np.maximum(np.ceil((box[0] - low[:2]) / voxel - 0.5).astype(int), 0)
        last = np.minimum(np.floor((box[1] - low[:2]) / voxel - 0.5).astype(int), np.array(n[:2]) - 1)
        if (first > last).any():
            continue
        i, j = np.meshgrid(np.arange(first[0], last[0] + 1), np.arange(first[1], last[1] + 1), indexing="ij")
        # A little aside, so that no line runs along an edge.
        x, y = low[0] + voxel * (i + 0.5) + 1.234e-4, low[1] + voxel * (j + 0.5) + 2.345e-4
        u = ((x - a[0]) * (c - a)[1] - (y - a[1]) * (c - a)[0]) / normal[2]
        v = ((y - a[1]) * (b - a)[0] - (x - a[0]) * (b - a)[1]) / normal[2]
        inside = (u >= 0) & (v >= 0) & (u + v <= 1)
        z = a[2] + u * (b - a)[2] + v * (c - a)[2]
        k = np.clip(np.ceil((z - low[2]) / voxel - 0.5).astype(int), 0, n[2])  # first centre above
        np.add.at(crossings, (i[inside], j[inside], k[inside]), -np.sign(normal[2]))
    return np.abs(np.cumsum(crossings, axis=2)[:, :, :n[2]]) > 0.5


def beside_truth(vtu, obj):
    """Volumes in cm^3, and what hull_heights counts."""
    mesh = meshio.read(vtu)
    corners = mesh.points[mesh.cells[0].data]
    low = corners.min(axis=1)
    voxel = float(np.median(corners.max(axis=1) - low))
    is_matter = mesh.cell_data["opacity"][0].ravel() > 0
    vertices = hull_heights.read_obj(obj)[0]
    vertices = vertices[np.abs(vertices).max(axis=1) < GROUND]
    origin = low.min(axis=0)
    # The same lattice, around both.
    reach = np.ceil((origin - vertices.min(axis=0)) / voxel).clip(0).astype(int)
    origin = origin - voxel * reach
    n = np.ceil((np.maximum(corners.max(axis=(0, 1)), vertices.max(axis=0)) - origin) / voxel).astype(int)
    hull = np.zeros(n, bool)
    hull[tuple(np.rint((low[is_matter] - origin) / voxel).astype(int).T)] = True
    true = true_voxels(obj, origin, n, voxel)
    cm3 = 1e-3 * voxel ** 3
    points = hull_heights.surface_points(obj, 20000)
    heights, _ = hull_heights.stated_heights(mesh, points)
    return {"true": true.sum() * cm3, "false": (hull & ~true).sum() * cm3, "missing": (true & ~hull).sum() * cm3,
            "within": len(heights) / len(points), "height": float(np.median(heights))}


def hull_row(programs, captures, scene, folder):
    folder.mkdir(parents=True, exist_ok=True)
    require(programs.run("hull", *captures, "--voxel", VOXEL, "-o", folder / "hull.vtu", "--force", "--quiet",
                         "--report", folder / "hull.json", timeout=3600))
    return beside_truth(folder / "hull.vtu", scene.with_suffix(".obj"))


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("bin", help="the build's folder apps/")
    parser.add_argument("--work", required=True, help="folder for everything that is made")
    parser.add_argument("--objects", default="airplane,blocks", help="scenes of configs/scenes")
    parser.add_argument("--receivers", default="flat,stairs")
    parser.add_argument("--lights", default="1,4,room", help="those of the top face nearest to cube32's, or the room")
    parser.add_argument("--rigs", default=",".join(map(str, range(len(RIGS)))), help="numbers of the table's rows")
    arguments = parser.parse_args()
    programs, work = Programs(arguments.bin), pathlib.Path(arguments.work).resolve()
    work.mkdir(parents=True, exist_ok=True)
    receivers = write_receivers(work / "receivers")
    shadows = [(r, k) for r in arguments.receivers.split(",") for k in arguments.lights.split(",")]
    line(["object", "rig", *(f"{r}, {k}" for r, k in shadows), "false", "missing", "true", "heights"])
    line(["---"] * (6 + len(shadows)))
    for thing in arguments.objects.split(","):
        scene = SOURCE / f"configs/scenes/{thing}.toml"
        vertices = vertices_of(scene)
        for i in map(int, arguments.rigs.split(",")):
            name, (has_sides, has_wall, n_cameras) = list(RIGS.items())[i]
            files = []
            for camera in range(1, n_cameras + 1):
                kind = ("five" if has_sides else "top") + ("_wall" if has_wall else "")
                files.append(work / f"{thing}_{kind}_{camera}.hlb")
                if not files[-1].exists():
                    capture(programs, text_of(has_sides, has_wall, camera), [], scene_with(scene, has_wall, work),
                            False, files[-1])
            captures = [files[0], *(word for file in files[1:] for word in ("--also", file))]
            folder = work / "rows" / f"{thing}-{i}"
            hull = json_rows(folder / "hull_row.json", lambda: hull_row(programs, captures, scene, folder))
            cells = []
            for receiver, light in shadows:
                if any(z < RECEIVERS[receiver][1](x, y) - 0.01 for x, y, z in vertices):
                    cells.append("")
                    continue
                source = LIGHTS[light]
                source = nearest_lights("grid8", source) if isinstance(source, list) else source
                job = {"captures": [*captures, "--voxel", VOXEL], "scene": scene, "receiver": receivers[receiver],
                       "height": None}
                at = folder / f"{receiver}-{light}"
                row = json_rows(at / "row.json", lambda: measure(programs, job, source, at))
                cells.append(f"{percent(row['both'])} / {percent(row['hull'])}")
            line([thing, name, *cells, f"{hull['false']:.0f}", f"{hull['missing']:.1f}", f"{hull['true']:.0f}",
                  f"{percent(hull['within'])}, {hull['height']:.0f}"])


if __name__ == "__main__":
    main()
