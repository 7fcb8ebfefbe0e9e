#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""What meshio reads of a .vtu and a .ply: read_with_meshio.py HULL.vtu HULL.ply"""

import sys

import meshio
import numpy as np

cells = meshio.read(sys.argv[1])
assert [block.type for block in cells.cells] == ["hexahedron"]
corners = cells.points[cells.cells[0].data].astype(float)
sides = [corners[:, i] - corners[:, 0] for i in (1, 3, 4)]
volumes = np.einsum("ij,ij->i", np.cross(sides[0], sides[1]), sides[2])
print(len(volumes), volumes.min(), volumes.max())
for name in ("state", "opacity", "lit_evidence", "seen_fraction", "height_low_mm", "height_high_mm"):
    print(name, float(np.sum(cells.cell_data[name][0], dtype=float)))
surface = meshio.read(sys.argv[2])
triangles = surface.points[surface.cells_dict["triangle"]].astype(float)
print("volume", np.einsum("ij,ij->i", triangles[:, 0],
                          np.cross(triangles[:, 1], triangles[:, 2])).sum() / 6.0)
