# SPDX-License-Identifier: Apache-2.0
"""Unit cubes cut into cells of one type, as .vtu files with raw appended data: what volume_report.py measures on."""

import itertools

import numpy as np

VTK_TYPES = {"tetrahedra": 10, "hexahedra": 12, "wedges": 13, "pyramids": 14, "quadratic tetrahedra": 24, "quadratic hexahedra": 25,
             "quadratic wedges": 26, "quadratic pyramids": 27, "triquadratic hexahedra": 29, "cubic tetrahedra": 71}
CUBE = ((0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1))  # VTK's order
INWARD_FACES = ((0, 1, 2, 3), (4, 7, 6, 5), (0, 4, 5, 1), (3, 2, 6, 7), (0, 3, 7, 4), (1, 5, 6, 2))
TETRAHEDRON_EDGES = ((0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3))
HEXAHEDRON_EDGES = ((0, 1), (1, 2), (2, 3), (3, 0), (4, 5), (5, 6), (6, 7), (7, 4), (0, 4), (1, 5), (2, 6), (3, 7))
THIRDS = tuple(edge for a, b in TETRAHEDRON_EDGES for edge in ((a, a, b), (a, b, b)))
# Corners whose mean a node beside them is, by kind: (kind of the corners, of each further node its corners), in VTK's order.
RAISED = {
    "quadratic tetrahedra": ("tetrahedra", TETRAHEDRON_EDGES),
    "cubic tetrahedra": ("tetrahedra", THIRDS + ((0, 1, 3), (1, 2, 3), (2, 0, 3), (0, 2, 1))),
    "quadratic hexahedra": ("hexahedra", HEXAHEDRON_EDGES),
    "triquadratic hexahedra": ("hexahedra", HEXAHEDRON_EDGES + ((0, 4, 7, 3), (1, 2, 6, 5), (0, 1, 5, 4), (3, 7, 6, 2), (0, 3, 2, 1),
                                                                (4, 5, 6, 7), tuple(range(8)))),
    "quadratic wedges": ("wedges", ((0, 1), (1, 2), (2, 0), (3, 4), (4, 5), (5, 3), (0, 3), (1, 4), (2, 5))),
    "quadratic pyramids": ("pyramids", ((0, 1), (1, 2), (2, 3), (3, 0), (0, 4), (1, 4), (2, 4), (3, 4))),
}
N_TYPES = np.dtype("u1")


def kuhn_tetrahedra():
    """@return the six of a cube, corners as (x, y, z), each of positive volume"""
    cells = []
    for axes in itertools.permutations(range(3)):
        corners = [np.zeros(3, int)]
        for axis in axes:
            corners.append(corners[-1] + np.eye(3, dtype=int)[axis])
        edges = np.array(corners[1:]) - corners[0]
        if np.linalg.det(edges) < 0:
            corners[2], corners[3] = corners[3], corners[2]
        cells.append(np.array(corners))
    return np.array(cells)


def cells_of_one_cube(kind):
    """@return (cells, nodes, 3) in half edges of the cube, so that all corners are whole"""
    cube = 2 * np.array(CUBE)
    if kind == "tetrahedra":
        return 2 * kuhn_tetrahedra()
    if kind == "hexahedra":
        return cube[None]
    if kind == "wedges":
        return cube[np.array([[0, 2, 1, 4, 6, 5], [0, 3, 2, 4, 7, 6]])]
    return np.array([[*cube[list(face)], (1, 1, 1)] for face in INWARD_FACES])


def raised(kind, points, cells):
    """The cells with the further nodes of the kind, where straight edges and the middles of corners have them.
    @param points  (n, 3), or with further columns, of which the nodes get means as well"""
    width = points.shape[1]
    nodes = [points[cells]]
    nodes += [points[cells[:, list(corners)]].mean(axis=1)[:, None] for corners in RAISED[kind][1]]
    nodes = np.concatenate(nodes, axis=1)
    # Nodes of neighbours are one: equal but for rounding.
    keys = np.round(nodes.reshape(-1, width)[:, :3] * 2.0**40).astype(np.int64)
    _, first, numbers = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    return nodes.reshape(-1, width)[first], numbers.reshape(nodes.shape[:2]).astype(np.int64)


def unit_cube(kind, n):
    """@return (points, cells) of n^3 cubes"""
    if kind in RAISED:
        return raised(kind, *unit_cube(RAISED[kind][0], n))
    starts = 2 * np.stack(np.meshgrid(*[np.arange(n)] * 3, indexing="ij"), axis=-1).reshape(-1, 1, 1, 3)
    places = starts + cells_of_one_cube(kind)[None]
    side = 2 * n + 1
    numbers = (places[..., 0] + side * (places[..., 1] + side * places[..., 2])).reshape(-1, places.shape[2])
    used = np.zeros(side**3, bool)
    used[numbers] = True
    kept = np.flatnonzero(used)
    renamed = np.cumsum(used) - 1
    points = np.stack([kept % side, kept // side % side, kept // side**2], axis=-1) / (2.0 * n)
    return points, renamed[numbers].astype(np.int64)


def bent(points):
    """The cube's inside moved about, smoothly, and its boundary not: cells that are no parallelepipeds."""
    wave = np.sin(np.pi * points).prod(axis=1)
    return points + 0.08 * np.stack([wave, -wave, 0.5 * wave], axis=1) * np.cos(3.0 * points[:, [1, 2, 0]])


def write_vtu(path, kind, points, cells, fields):
    """@param fields  {name: values on the points}"""
    n, nodes = cells.shape
    arrays = [("Points", "position", points, 3)]
    arrays += [("PointData", name, values, 1) for name, values in fields.items()]
    arrays += [("Cells", "connectivity", cells, 1), ("Cells", "offsets", np.arange(1, n + 1, dtype=np.int64) * nodes, 1),
               ("Cells", "types", np.full(n, VTK_TYPES[kind], N_TYPES), 1)]
    names = {"f8": "Float64", "i8": "Int64", "u1": "UInt8"}
    text = ('<?xml version="1.0"?>\n<VTKFile type="UnstructuredGrid" version="1.0" byte_order="LittleEndian" header_type="UInt64">\n'
            f'<UnstructuredGrid>\n<Piece NumberOfPoints="{len(points)}" NumberOfCells="{n}">\n')
    offset = 0
    for section in ("Points", "PointData", "Cells"):
        text += f"<{section}>\n"
        for where, name, values, components in arrays:
            if where == section:
                text += (f'<DataArray type="{names[values.dtype.str[1:]]}" Name="{name}" NumberOfComponents="{components}" '
                         f'format="appended" offset="{offset}"/>\n')
                offset += 8 + values.nbytes
        text += f"</{section}>\n"
    text += '</Piece>\n</UnstructuredGrid>\n<AppendedData encoding="raw">\n_'
    with open(path, "wb") as file:
        file.write(text.encode())
        for *_, values, _components in arrays:
            file.write(np.uint64(values.nbytes).tobytes() + np.ascontiguousarray(values).tobytes())
        file.write(b"\n</AppendedData>\n</VTKFile>\n")
