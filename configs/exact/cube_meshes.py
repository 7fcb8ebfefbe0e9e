# SPDX-License-Identifier: Apache-2.0
"""The meshes of the exact-image suite. Every coordinate and every value of a field is a binary fraction, so that files and
doubles hold it without rounding; what is made inexactly is an error."""

import itertools
from fractions import Fraction as F

TETRAHEDRON, HEXAHEDRON, WEDGE, PYRAMID, QUADRATIC_TETRAHEDRON = 10, 12, 13, 14, 24  # of VTK
QUADRATIC_HEXAHEDRON, QUADRATIC_WEDGE, QUADRATIC_PYRAMID, TRIQUADRATIC_HEXAHEDRON, CUBIC_TETRAHEDRON = 25, 26, 27, 29, 71
CORNERS = ((0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1))
SIDES = ((0, 4, 7, 3), (1, 2, 6, 5), (0, 1, 5, 4), (3, 7, 6, 2), (0, 3, 2, 1), (4, 5, 6, 7))  # anticlockwise from outside
# The corners between which further nodes are, in VTK's order.
TETRAHEDRON_EDGES = ((0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3))
TETRAHEDRON_MIDDLES = ((0, 1, 3), (1, 2, 3), (2, 0, 3), (0, 2, 1))
HEXAHEDRON_EDGES = ((0, 1), (1, 2), (2, 3), (3, 0), (4, 5), (5, 6), (6, 7), (7, 4), (0, 4), (1, 5), (2, 6), (3, 7))
HEXAHEDRON_MIDDLES = ((0, 4, 7, 3), (1, 2, 6, 5), (0, 1, 5, 4), (3, 7, 6, 2), (0, 3, 2, 1), (4, 5, 6, 7))
PYRAMID_EDGES = ((0, 1), (1, 2), (2, 3), (3, 0), (0, 4), (1, 4), (2, 4), (3, 4))


def plus(a, b, factor=1):
    return tuple(x + factor * y for x, y in zip(a, b))


def exact(number):
    """@return  the double that is this fraction"""
    if F(float(number)) != number:
        raise ValueError(f"{number} is no double")
    return float(number)


def volume_of(a, b, c, d):
    """Six times a tetrahedron's."""
    u, v, w = plus(b, a, -1), plus(c, a, -1), plus(d, a, -1)
    return (u[0] * (v[1] * w[2] - v[2] * w[1]) + u[1] * (v[2] * w[0] - v[0] * w[2]) +
            u[2] * (v[0] * w[1] - v[1] * w[0]))


def upright(nodes):
    """Of a tetrahedron: its nodes in an order that is not inverted."""
    volume = volume_of(*nodes)
    if volume == 0:
        raise ValueError("a flat tetrahedron")
    return nodes if volume > 0 else (nodes[1], nodes[0], *nodes[2:])


# ---- a box in cells: lists of (type, nodes) -----------------------------------------------------


def corners_of(low, size):
    return [tuple(l + s * c for l, s, c in zip(low, size, corner)) for corner in CORNERS]


def one_hexahedron(low, size, index):
    return [(HEXAHEDRON, corners_of(low, size))]


def two_wedges(low, size, index):
    p = corners_of(low, size)
    return [(WEDGE, [p[a], p[c], p[b], p[a + 4], p[c + 4], p[b + 4]]) for a, b, c in ((0, 1, 2), (0, 2, 3))]


def six_pyramids(low, size, index):
    p = corners_of(low, size)
    middle = plus(low, size, F(1, 2))
    return [(PYRAMID, [p[side[0]], p[side[3]], p[side[2]], p[side[1]], middle]) for side in SIDES]


def six_tetrahedra(low, size, index):
    """About the diagonal from the lowest corner to the highest."""
    cells = []
    for axes in itertools.permutations(range(3)):
        nodes = [tuple(low)]
        for axis in axes:
            nodes.append(tuple(x + (size[i] if i == axis else 0) for i, x in enumerate(nodes[-1])))
        cells.append((TETRAHEDRON, upright(tuple(nodes))))
    return cells


def five_tetrahedra(low, size, index):
    """One in the middle, four at corners; neighbouring boxes take the other corners."""
    p = corners_of(low, size)
    odd = sum(index) % 2
    cut = [i for i, corner in enumerate(CORNERS) if sum(corner) % 2 == odd]
    cells = [(TETRAHEDRON, upright(tuple(p[i] for i in range(8) if i not in cut)))]
    for i in cut:
        neighbours = [j for j in range(8) if sum(a != b for a, b in zip(CORNERS[i], CORNERS[j])) == 1]
        cells.append((TETRAHEDRON, upright((p[i], *(p[j] for j in neighbours)))))
    return cells


def raised(kind, between, cells):
    """Cells with the further nodes of another kind, where straight edges have them.
    @param between  of each such node {corner: weight}"""
    return [(kind, [*nodes, *(tuple(sum(w * nodes[i][axis] for i, w in weights.items()) for axis in range(3))
                              for weights in between)]) for _, nodes in cells]


def six_quadratic_tetrahedra(low, size, index):
    halves = [{i: F(1, 2), j: F(1, 2)} for i, j in TETRAHEDRON_EDGES]
    return raised(QUADRATIC_TETRAHEDRON, halves, six_tetrahedra(low, size, index))


def box(low, high, counts, divide, is_there=lambda index: True):
    """A box of counts[0] x counts[1] x counts[2] equal boxes, each of them divided into cells."""
    low, high = [F(x) for x in low], [F(x) for x in high]
    size = [(h - l) / n for l, h, n in zip(low, high, counts)]
    return [cell for index in itertools.product(*(range(n) for n in counts)) if is_there(index)
            for cell in divide(tuple(l + s * i for l, s, i in zip(low, size, index)), size, index)]


def cube(n, divide, **words):
    return box((0, 0, 0), (1, 1, 1), (n, n, n), divide, **words)


def moved(cells, where):
    """With every point p at where(p); tetrahedra stay upright or it is an error."""
    cells = [(kind, [where(p) for p in nodes]) for kind, nodes in cells]
    for kind, nodes in cells:
        if kind == TETRAHEDRON and volume_of(*nodes) <= 0:
            raise ValueError("an inverted tetrahedron")
    return cells


def jittered(p):
    """A point of the unit cube's inside, moved by up to 1/16 along each axis; its surface stays."""
    if any(x in (0, 1) for x in p):
        return p
    seed = int(64 * (p[0] + 5 * p[1] + 11 * p[2]))
    moves = []
    for axis in range(3):
        seed = (1103515245 * seed + 12345 + axis) % 2**31
        moves.append(F((seed >> 12) % 9 - 4, 64))
    return plus(p, moves)


def bent_by(p, across):
    """Of a cube's six_quadratic_tetrahedra(): a node in the middle of an edge moved by up to 1/32 along each axis, across the cube's
    surface only where asked; corners of cells stay."""
    if all((4 * x).denominator == 1 and 4 * x % 2 == 0 for x in p):
        return p
    seed = int(64 * (p[0] + 7 * p[1] + 13 * p[2]))
    moves = []
    for axis in range(3):
        seed = (1103515245 * seed + 12345 + axis) % 2**31
        is_free = across or p[axis] not in (0, 1)
        moves.append(F((seed >> 12) % 9 - 4, 128) if is_free else 0)
    return plus(p, moves)


def bent_about(p, most, across):
    """Any point moved by up to `most` along each axis, in steps of 1/256, on the surface of the unit cube across it only where asked.
    Coordinates that are no such fractions become such."""
    seed = int(192 * (p[0] + 7 * p[1] + 13 * p[2]))
    n = int(256 * most)
    moves = []
    for axis in range(3):
        seed = (1103515245 * seed + 12345 + axis) % 2**31
        moves.append(F((seed >> 12) % (2 * n + 1) - n, 256) if across or p[axis] not in (0, 1) else 0)
    return plus(tuple(F(round(256 * x), 256) for x in p), moves)


def bent_inside(p):
    return bent_by(p, across=False)


def bent_everywhere(p):
    return bent_by(p, across=True)


def sheared(p):
    return (p[0] + p[1] / 4 + p[2] / 8, p[1] + p[2] / 4, p[2])


def tapered(p):
    """Towards z = 1 down to three quarters: faces stay flat, hexahedra, wedges and pyramids are no affine cells any more."""
    return (p[0] * (1 - p[2] / 4), p[1] * (1 - p[2] / 4), p[2])


def mixed():
    """The unit cube: a slab of one hexahedron under four quarters of pyramids, wedges, tetrahedra and small hexahedra, so
    that every inner face between the parts meets smaller ones, or triangles, of which each is a part of it."""
    h = F(1, 2)
    return (box((0, 0, 0), (1, 1, h), (1, 1, 1), one_hexahedron) +
            box((0, 0, h), (h, h, 1), (1, 1, 1), six_pyramids) +
            box((h, 0, h), (1, h, 1), (1, 1, 1), two_wedges) +
            box((0, h, h), (h, 1, 1), (1, 1, 1), six_tetrahedra) +
            box((h, h, h), (1, 1, 1), (2, 2, 2), one_hexahedron))


# ---- files ---------------------------------------------------------------------------------------


def write_vtu(path, cells, fields, cell_fields):
    """@param fields       name -> its value at a point, a fraction
    @param cell_fields  name -> its value at a cell's middle"""
    numbers = {}
    for _, nodes in cells:
        for p in nodes:
            numbers.setdefault(tuple(p), len(numbers))
    points = list(numbers)
    offsets = list(itertools.accumulate(len(nodes) for _, nodes in cells))

    def array(kind, name, rows, more=""):
        body = "\n".join(" ".join(repr(x).removesuffix(".0") for x in row) for row in rows)
        return f'<DataArray type="{kind}" Name="{name}"{more} format="ascii">\n{body}\n</DataArray>'

    def in_rows(values):
        return [values[i:i + 16] for i in range(0, len(values), 16)]

    middles = [tuple(sum(x) / len(nodes) for x in zip(*nodes)) for _, nodes in cells]
    of_points = [array("Float64", name, in_rows([exact(value(p)) for p in points])) for name, value in fields.items()]
    of_cells = [array("Float64", name, in_rows([exact(value(p)) for p in middles]))
                for name, value in cell_fields.items()]
    path.write_text("\n".join([
        '<?xml version="1.0"?>', '<VTKFile type="UnstructuredGrid" version="1.0" byte_order="LittleEndian">',
        f'<UnstructuredGrid><Piece NumberOfPoints="{len(points)}" NumberOfCells="{len(cells)}">',
        "<Points>", array("Float64", "points", [[exact(x) for x in p] for p in points], ' NumberOfComponents="3"'), "</Points>",
        "<Cells>", array("Int32", "connectivity", [[numbers[tuple(p)] for p in nodes] for _, nodes in cells]),
        array("Int32", "offsets", in_rows(offsets)), array("UInt8", "types", in_rows([kind for kind, _ in cells])), "</Cells>",
        "<PointData>", *of_points, "</PointData>", "<CellData>", *of_cells, "</CellData>",
        "</Piece></UnstructuredGrid></VTKFile>", ""]))
