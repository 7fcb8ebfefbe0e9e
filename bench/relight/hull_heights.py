#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""Whether an object's surface lies within the heights that its shadow hull states.

    build/release/apps/haarlight/haarlight hull airplane.hlb -o airplane.vtu
    /usr/bin/python3 bench/relight/hull_heights.py airplane.vtu configs/scenes/airplane.obj

Draws points on the true surface, by area, those on the plane z = 0 left out, and looks for a run of
cells over the plane (height_low_mm to height_high_mm, one voxel wider on every side) that holds them.
The captured plane has to be z = 0. Needs Debian's python3-meshio and python3-numpy."""

import argparse
import collections

import meshio
import numpy as np

ON_PLANE = 0.5  # mm


def read_obj(obj):
    """Vertices and triangles."""
    vertices, triangles = [], []
    for line in open(obj):
        words = line.split()
        if words[:1] == ["v"]:
            vertices.append([float(w) for w in words[1:4]])
        elif words[:1] == ["f"]:
            corners = [int(w.split("/")[0]) for w in words[1:]]
            corners = [c - 1 if c > 0 else len(vertices) + c for c in corners]
            triangles += [(corners[0], b, c) for b, c in zip(corners[1:], corners[2:])]
    vertices, triangles = np.array(vertices), np.array(triangles)
    return vertices, triangles


def surface_points(obj, n):
    """On the object, by area."""
    vertices, triangles = read_obj(obj)
    triangles = triangles[(vertices[triangles][:, :, 2] > ON_PLANE).any(axis=1)]
    a, b, c = (vertices[triangles[:, i]] for i in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    random = np.random.default_rng(1)
    which = random.choice(len(triangles), n, p=area / area.sum())
    u, v = random.random((2, n, 1))
    u, v = np.where(u + v > 1, 1 - u, u), np.where(u + v > 1, 1 - v, v)
    return a[which] + u * (b - a)[which] + v * (c - a)[which]


def stated_heights(mesh, points):
    """Of the points within the heights that the cells state: how far these reach. @return  these, the voxel"""
    low = mesh.points[mesh.cells[0].data].min(axis=1)
    voxel = float(np.median(mesh.points[mesh.cells[0].data].max(axis=1) - low))
    origin = low.min(axis=0)
    columns = np.rint((low[:, :2] - origin[:2]) / voxel).astype(int)
    runs = collections.defaultdict(set)
    for column, bottom, top in zip(map(tuple, columns), mesh.cell_data["height_low_mm"][0],
                                   mesh.cell_data["height_high_mm"][0]):
        runs[column].add((float(bottom), float(top)))
    heights = []
    for x, y, z in points:
        column, row = (int(i) for i in np.floor(([x, y] - origin[:2]) / voxel))
        found = [top - bottom for i in (-1, 0, 1) for j in (-1, 0, 1)
                 for bottom, top in runs.get((column + i, row + j), ())
                 if bottom - voxel <= z <= top + voxel]
        if found:
            heights.append(min(found))
    return heights, voxel


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("hull", help="hull.vtu")
    parser.add_argument("truth", help="the object's .obj, mm in the rig's frame")
    parser.add_argument("--points", type=int, default=20000)
    arguments = parser.parse_args()
    points = surface_points(arguments.truth, arguments.points)
    heights, voxel = stated_heights(meshio.read(arguments.hull), points)
    print(f"{len(points)} points: {100 * len(heights) / len(points):.1f} % within the stated heights; "
          f"these are {np.median(heights):.1f} mm in the median, 9 of 10 within {np.quantile(heights, 0.9):.1f} mm "
          f"(voxels of {voxel:.2f} mm)")


if __name__ == "__main__":
    main()
