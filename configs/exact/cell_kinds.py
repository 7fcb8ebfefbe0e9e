# SPDX-License-Identifier: Apache-2.0
"""Types of cells by VTK's numbers: faces, anticlockwise seen from outside, edges, and shape functions, each a function of
(r, s, t) in [0, 1]."""

from fractions import Fraction as F

import cube_meshes as cm


def tetrahedron(r, s, t):
    return [1 - r - s - t, r, s, t]


def quadratic_tetrahedron(r, s, t):
    b = tetrahedron(r, s, t)
    return [x * (2 * x - 1) for x in b] + [4 * b[i] * b[j] for i, j in cm.TETRAHEDRON_EDGES]


def cubic_tetrahedron(r, s, t):
    b = tetrahedron(r, s, t)
    result = [x * (3 * x - 1) * (3 * x - 2) / 2 for x in b]
    for i, j in cm.TETRAHEDRON_EDGES:
        result += [9 * b[i] * b[j] * (3 * b[k] - 1) / 2 for k in (i, j)]
    return result + [27 * b[i] * b[j] * b[k] for i, j, k in cm.TETRAHEDRON_MIDDLES]


def hexahedron(r, s, t):
    return [(r if c[0] else 1 - r) * (s if c[1] else 1 - s) * (t if c[2] else 1 - t) for c in cm.CORNERS]


def quadratic_hexahedron(r, s, t):
    """In coordinates from -1 to 1, as textbooks have it."""
    x = (2 * r - 1, 2 * s - 1, 2 * t - 1)
    result = []
    for corner in cm.CORNERS:
        y = [a * (2 * c - 1) for a, c in zip(x, corner)]
        result.append((1 + y[0]) * (1 + y[1]) * (1 + y[2]) * (y[0] + y[1] + y[2] - 2) / 8)
    for i, j in cm.HEXAHEDRON_EDGES:
        product = 1
        for a, c, d in zip(x, cm.CORNERS[i], cm.CORNERS[j]):
            product = product * ((1 + a * (2 * c - 1)) if c == d else (1 - a * a))
        result.append(product / 4)
    return result


def parabolas(x):
    return (1 - x) * (1 - 2 * x), 4 * x * (1 - x), x * (2 * x - 1)


def triquadratic_hexahedron(r, s, t):
    along = parabolas(r), parabolas(s), parabolas(t)
    middles = [*cm.HEXAHEDRON_EDGES, *cm.HEXAHEDRON_MIDDLES, tuple(range(8))]
    result = []
    for corners in [(i,) for i in range(8)] + middles:
        i, j, k = (2 * sum(cm.CORNERS[c][axis] for c in corners) // len(corners) for axis in range(3))
        result.append(along[0][i] * along[1][j] * along[2][k])
    return result


def wedge(r, s, t):
    return [b * height for height in (1 - t, t) for b in (1 - r - s, r, s)]


def quadratic_wedge(r, s, t):
    b, z = (1 - r - s, r, s), 2 * t - 1
    result = [x * ((2 * x - 1) * (1 + sign * z) - (1 - z * z)) / 2 for sign in (-1, 1) for x in b]
    result += [2 * b[i] * b[j] * (1 + sign * z) for sign in (-1, 1) for i, j in ((0, 1), (1, 2), (2, 0))]
    return result + [x * (1 - z * z) for x in b]


def pyramid(r, s, t):
    return [(1 - r) * (1 - s) * (1 - t), r * (1 - s) * (1 - t), r * s * (1 - t), (1 - r) * s * (1 - t), t]


def quadratic_pyramid(r, s, t):
    """Expanded in coordinates from -1 to 1, x and y towards the corner or edge."""
    r, s, t = 2 * r - 1, 2 * s - 1, 2 * t - 1

    def corner(x, y):
        return (1 + x) * (1 + y) * (1 - t) * (3 * x + 3 * y - 2 * x * y + x * t + y * t - 2 * x * y * t - 2 * t - 4) / 16

    def on_base(x, y):
        return (1 - x * x) * (1 + y) * (1 - t) * (2 - y - y * t) / 8

    def on_side(x, y):
        return (1 + x) * (1 + y) * (1 - t * t) / 4

    around = ((-r, -s), (r, -s), (r, s), (-r, s))
    return [*(corner(x, y) for x, y in around), t * (1 + t) / 2, on_base(r, -s), on_base(s, r), on_base(r, s), on_base(s, -r),
            *(on_side(x, y) for x, y in around)]


TETRAHEDRAL = ((0, 2, 1), (0, 1, 3), (1, 2, 3), (2, 0, 3))
WEDGE_FACES = ((0, 1, 2), (3, 5, 4), (0, 3, 4, 1), (1, 4, 5, 2), (2, 5, 3, 0))
PYRAMID_FACES = ((0, 3, 2, 1), (0, 1, 4), (1, 2, 4), (2, 3, 4), (3, 0, 4))
WEDGE_EDGES = ((0, 1), (1, 2), (2, 0), (3, 4), (4, 5), (5, 3), (0, 3), (1, 4), (2, 5))


class Kind:
    """What a type of cell is made of."""

    def __init__(self, faces, shape, straight=None, is_linear=False, edges=(), on_edge=1, middles=()):
        """@param straight   shape functions of the corners alone, where nothing is bent
        @param is_linear  whether the coordinates of a straight one are linear in the position
        @param middles    corners between which nodes behind the edges' are, the last those of all"""
        self.faces, self.shape, self.straight, self.is_linear = faces, shape, straight or shape, is_linear
        self.edges, self.on_edge, self.middles = edges, on_edge, middles
        self.n_corners = 1 + max(i for face in faces for i in face)

    def between(self):
        """Of each node behind the corners: {corner: weight} where straight edges have it."""
        result = []
        for i, j in self.edges:
            n = self.on_edge + 1
            result += [{i: F(n - k, n), j: F(k, n)} for k in range(1, n)]
        return result + [{i: F(1, len(corners)) for i in corners} for corners in self.middles]

    def patch_nodes(self, face):
        """Of a face of a cell that may bend: the nodes of the patch, in the order of bent_faces.NODES, and its form."""
        corners = list(face)
        nodes = list(corners)
        for a, b in zip(corners, corners[1:] + corners[:1]):
            k = next(k for k, edge in enumerate(self.edges) if set(edge) == {a, b})
            own = [self.n_corners + self.on_edge * k + i for i in range(self.on_edge)]
            nodes += own if self.edges[k] == (a, b) else own[::-1]
        for k, middle in enumerate(self.middles):
            if set(middle) == set(corners):
                nodes.append(self.n_corners + self.on_edge * len(self.edges) + k)
        return nodes, {6: "quadratic", 10: "cubic", 8: "serendipity", 9: "biquadratic"}[len(nodes)]

    def depth_within(self, r, s, t):
        if self.n_corners == 4:
            return min(r, s, t, 1 - r - s - t)
        if self.n_corners == 6:
            return min(r, s, 1 - r - s, t, 1 - t)
        return min(r, s, t, 1 - r, 1 - s, 1 - t)


KINDS = {
    cm.TETRAHEDRON: Kind(TETRAHEDRAL, tetrahedron, is_linear=True),
    cm.HEXAHEDRON: Kind(cm.SIDES, hexahedron),
    cm.WEDGE: Kind(WEDGE_FACES, wedge),
    cm.PYRAMID: Kind(PYRAMID_FACES, pyramid),
    cm.QUADRATIC_TETRAHEDRON: Kind(TETRAHEDRAL, quadratic_tetrahedron, tetrahedron, True, cm.TETRAHEDRON_EDGES),
    cm.CUBIC_TETRAHEDRON: Kind(TETRAHEDRAL, cubic_tetrahedron, tetrahedron, True, cm.TETRAHEDRON_EDGES, 2, cm.TETRAHEDRON_MIDDLES),
    cm.QUADRATIC_HEXAHEDRON: Kind(cm.SIDES, quadratic_hexahedron, hexahedron, False, cm.HEXAHEDRON_EDGES),
    cm.TRIQUADRATIC_HEXAHEDRON: Kind(cm.SIDES, triquadratic_hexahedron, hexahedron, False, cm.HEXAHEDRON_EDGES, 1,
                                     (*cm.HEXAHEDRON_MIDDLES, tuple(range(8)))),
    cm.QUADRATIC_WEDGE: Kind(WEDGE_FACES, quadratic_wedge, wedge, False, WEDGE_EDGES),
    cm.QUADRATIC_PYRAMID: Kind(PYRAMID_FACES, quadratic_pyramid, pyramid, False, cm.PYRAMID_EDGES),
}
