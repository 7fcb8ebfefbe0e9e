# SPDX-License-Identifier: Apache-2.0
"""What a ray gathers where a field is given at the nodes alone, whatever they hold: by ray_truth.py, piece by piece of the cells
that the ray passes. Every cell is tried against every ray, and must have flat faces. In a tetrahedron of four nodes the field is
linear along the ray, in one of ten quadratic. In other cells it is what their shape functions say: the coordinates within the
cell are found by Newton's method, and the field is the polynomial through its values at Chebyshev's points, of a degree that
leaves less than 10^-26 of its range out; a piece that needs a higher one is halved.

A face of a quadratic tetrahedron with bent edges is the patch of its six nodes. Of the two quadratic equations in its coordinates
(u, v) by which a ray passes it u is eliminated: a polynomial of degree 4 in v, whose roots mpmath finds."""

import functools

import mpmath
from mpmath import mpf

import cube_meshes as cm
from ray_truth import IN_PLANE, Truth, added, roots_between, times


# ---- cells: faces, anticlockwise seen from outside, and shape functions, each a function of (r, s, t) -------


def tetrahedron(r, s, t):
    return [1 - r - s - t, r, s, t]


def quadratic_tetrahedron(r, s, t):
    b = tetrahedron(r, s, t)
    return [x * (2 * x - 1) for x in b] + [4 * b[i] * b[j] for i, j in ((0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3))]


def hexahedron(r, s, t):
    return [(r if c[0] else 1 - r) * (s if c[1] else 1 - s) * (t if c[2] else 1 - t) for c in cm.CORNERS]


def wedge(r, s, t):
    return [b * height for height in (1 - t, t) for b in (1 - r - s, r, s)]


def pyramid(r, s, t):
    return [(1 - r) * (1 - s) * (1 - t), r * (1 - s) * (1 - t), r * s * (1 - t), (1 - r) * s * (1 - t), t]


TETRAHEDRAL_FACES = ((0, 2, 1), (0, 1, 3), (1, 2, 3), (2, 0, 3))
KINDS = {  # faces, shape functions, a point inside, whether the coordinates are linear in the position
    cm.TETRAHEDRON: (TETRAHEDRAL_FACES, tetrahedron, True),
    cm.QUADRATIC_TETRAHEDRON: (TETRAHEDRAL_FACES, quadratic_tetrahedron, True),
    cm.HEXAHEDRON: (cm.SIDES, hexahedron, False),
    cm.WEDGE: (((0, 1, 2), (3, 5, 4), (0, 3, 4, 1), (1, 4, 5, 2), (2, 5, 3, 0)), wedge, False),
    cm.PYRAMID: (((0, 3, 2, 1), (0, 1, 4), (1, 2, 4), (2, 3, 4), (3, 0, 4)), pyramid, False),
}


EDGES = ((0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3))


def is_bent(kind, nodes):
    return kind == cm.QUADRATIC_TETRAHEDRON and any(
        2 * m != a + b for k, (i, j) in enumerate(EDGES) for m, a, b in zip(nodes[4 + k], nodes[i], nodes[j]))


def plane_of(points):
    """Normal outwards, not of length 1, and offset; exact."""
    u, v = cm.plus(points[1], points[0], -1), cm.plus(points[2], points[0], -1)
    normal = (u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0])
    offset = sum(n * x for n, x in zip(normal, points[0]))
    if any(sum(n * x for n, x in zip(normal, p)) != offset for p in points):
        raise ValueError("a face that is not flat")
    return [mpf(n.numerator) / n.denominator for n in normal], mpf(offset.numerator) / offset.denominator


class Cell:
    def __init__(self, kind, nodes, values):
        faces, self.shape, self.is_linear = KINDS[kind]
        self.planes = [plane_of([nodes[i] for i in face]) for face in faces]
        middle = [sum(x) / len(nodes) for x in zip(*nodes)]
        for normal, offset in self.planes:
            if sum(n * mpf(x.numerator) / x.denominator for n, x in zip(normal, middle)) >= offset:
                raise ValueError("faces that are not seen anticlockwise from outside")
        self.nodes = [[mpf(x.numerator) / x.denominator for x in p] for p in nodes]
        self.values = [[mpf(x) for x in of_field] for of_field in values]

    def interval(self, origin, direction, low, high):
        """Of t, between low and high, in which the ray is inside; None: nowhere. @throws ValueError  it runs in a face"""
        for normal, offset in self.planes:
            slope = sum(n * d for n, d in zip(normal, direction))
            start = offset - sum(n * o for n, o in zip(normal, origin))
            size = sum(abs(n) for n in normal)
            if abs(slope) < IN_PLANE * size:
                if abs(start) < IN_PLANE * size:
                    raise ValueError("the ray runs in a face")
                if start < 0:
                    return None
            elif slope > 0:
                high = min(high, start / slope)
            else:
                low = max(low, start / slope)
        return (low, high) if low < high else None

    def intervals(self, *ray):
        ends = self.interval(*ray)
        return [ends] if ends else []

    def fields_at(self, p, guess):
        """The fields' values at a point, and its coordinates within the cell."""
        r = list(guess)
        for _ in range(60):
            n = self.shape_of_position(*r)
            off = [x - sum(w * q[i] for w, q in zip(n, self.nodes)) for i, x in enumerate(p)]
            step = mpmath.lu_solve(self.slopes(r), mpmath.matrix(off))
            r = [a + b for a, b in zip(r, step)]
            if max(abs(b) for b in step) < mpf(10)**(6 - mpmath.mp.dps):
                return [sum(w * x for w, x in zip(self.shape(*r), of_field)) for of_field in self.values], r
        raise ValueError("Newton's method does not end")

    def shape_of_position(self, r, s, t):
        return tetrahedron(r, s, t) if self.is_linear else self.shape(r, s, t)

    def slopes(self, r):
        """The position's derivatives: shape functions are linear in each coordinate alone, so that differences are exact."""
        columns = []
        for i in range(3):
            ends = [self.shape_of_position(*(end if i == j else x for j, x in enumerate(r))) for end in (mpf(0), mpf(1))]
            columns.append([sum((b - a) * q[axis] for a, b, q in zip(*ends, self.nodes)) for axis in range(3)])
        return mpmath.matrix(columns).T

    def polynomials(self, origin, direction, low, high, degree, left_out):
        """[(low, high, a polynomial of u per field)], u from -1 at low to 1 at high."""
        r, rows = [mpf(1) / 4] * 3, []
        for u in chebyshev_points(2 if self.is_linear else degree, mpmath.mp.dps):
            t = (low + high) / 2 + u * (high - low) / 2
            fields, r = self.fields_at([o + t * d for o, d in zip(origin, direction)], r)
            rows.append(fields)
        polynomials = []
        for k, of_field in enumerate(self.values):
            c = chebyshev_coefficients([row[k] for row in rows])
            if not self.is_linear and max(abs(x) for x in c[-3:]) > left_out * max(abs(x) for x in of_field):
                return [piece for ends in ((low, (low + high) / 2), ((low + high) / 2, high))
                        for piece in self.polynomials(origin, direction, *ends, degree, left_out)]
            polynomials.append(powers_of(c))
        return [(low, high, polynomials)]


class BentCell(Cell):
    """A quadratic tetrahedron with bent edges."""

    def __init__(self, nodes, values):
        self.shape, self.is_linear = quadratic_tetrahedron, False
        middle = {frozenset(edge): 4 + k for k, edge in enumerate(EDGES)}
        self.nodes = [[mpf(x.numerator) / x.denominator for x in p] for p in nodes]
        self.values = [[mpf(x) for x in of_field] for of_field in values]
        bezier = self.nodes[:4] + [[2 * m - (a + b) / 2 for m, a, b in zip(self.nodes[4 + k], self.nodes[i], self.nodes[j])]
                                   for k, (i, j) in enumerate(EDGES)]
        self.middle = [sum(x) / len(bezier) for x in zip(*bezier)]  # of a ball about the cell
        self.radius = max(mpmath.sqrt(sum((a - b)**2 for a, b in zip(p, self.middle))) for p in bezier)
        self.patches = []  # {(i, j): coefficient of u^i v^j}, a vector
        for a, b, c in TETRAHEDRAL_FACES:
            p, q, r, pq, qr, rp = (self.nodes[i] for i in (a, b, c, *(middle[frozenset(e)] for e in ((a, b), (b, c), (c, a)))))
            self.patches.append([{(0, 0): p[k], (1, 0): 4 * pq[k] - 3 * p[k] - q[k], (0, 1): 4 * rp[k] - 3 * p[k] - r[k],
                                  (2, 0): 2 * (p[k] + q[k]) - 4 * pq[k], (0, 2): 2 * (p[k] + r[k]) - 4 * rp[k],
                                  (1, 1): 4 * (p[k] + qr[k] - pq[k] - rp[k])} for k in range(3)])

    def intervals(self, origin, direction, low, high):
        """All of them, as interval(). @throws ValueError  the ray passes an edge, or touches a face, or nearly so"""
        to = [m - o for m, o in zip(self.middle, origin)]
        along = sum(a * d for a, d in zip(to, direction)) / sum(d * d for d in direction)
        if sum((a - along * d)**2 for a, d in zip(to, direction)) > self.radius**2:
            return []
        ts = sorted(t for patch in self.patches for t in crossings(patch, origin, direction))
        if len(ts) % 2:
            raise ValueError("a face that is passed alone")
        ends = [(max(a, low), min(b, high)) for a, b in zip(ts[::2], ts[1::2])]
        return [(a, b) for a, b in ends if a < b]

    def slopes(self, r):
        b = tetrahedron(*r)
        db = ((-1, -1, -1), (1, 0, 0), (0, 1, 0), (0, 0, 1))
        dn = [[(4 * b[i] - 1) * db[i][k] for k in range(3)] for i in range(4)]
        dn += [[4 * (b[i] * db[j][k] + b[j] * db[i][k]) for k in range(3)] for i, j in EDGES]
        return mpmath.matrix([[sum(d[k] * q[axis] for d, q in zip(dn, self.nodes)) for k in range(3)] for axis in range(3)])

    def fields_at(self, p, guess):
        fields, r = super().fields_at(p, guess)
        if min(tetrahedron(*r)) < -mpf(10)**-20:
            raise ValueError("another point of the cell's map than that within it")
        return fields, r


def crossings(patch, origin, direction):
    """Of t where origin + t direction is on the patch."""
    axis = max(range(3), key=lambda k: abs(direction[k]))
    across = []  # two polynomials in u and v that are 0 on the ray
    for k in range(3):
        if k != axis:
            slope = direction[k] / direction[axis]
            poly = {e: patch[k][e] - slope * patch[axis][e] for e in patch[k]}
            poly[0, 0] -= origin[k] - slope * origin[axis]
            across.append([[poly[0, 0], poly[0, 1], poly[0, 2]], [poly[1, 0], poly[1, 1]], [poly[2, 0]]])  # by u, of v

    def by(x, y, sign=1):
        return [sign * c for c in times(x, y)]

    (c1, b1, a1), (c2, b2, a2) = across
    ac = added(by(a1, c2), by(a2, c1, -1))
    ab = added(by(a1, b2), by(a2, b1, -1))
    bc = added(by(b1, c2), by(b2, c1, -1))
    resultant = added(by(ac, ac), by(ab, bc, -1))
    size = max(abs(c) for c in resultant)
    while resultant and abs(resultant[-1]) < size * mpf(10)**(5 - mpmath.mp.dps):
        resultant.pop()
    near = mpf(10)**-9

    def at(poly, x):
        return sum(c * x**i for i, c in enumerate(poly))

    result = []
    for v in mpmath.polyroots(resultant[::-1], maxsteps=500, extraprec=4 * mpmath.mp.dps):
        v, off = mpmath.re(v), abs(mpmath.im(v))
        if off > mpf(10)**-6 or not -near < v < 1 + near:
            continue
        if off > mpf(10)**(-mpmath.mp.dps / 2):
            raise ValueError("the ray nearly touches a face")
        divisor = at(ab, v)
        if abs(divisor) < mpf(10)**-12:
            raise ValueError("a ray and a face in a special position")
        u = -at(ac, v) / divisor
        if abs(sum(at(poly, v) * u**i for i, poly in enumerate(across[0]))) > mpf(10)**(10 - mpmath.mp.dps):
            continue
        least = min(u, v, 1 - u - v)
        if abs(least) < near:
            raise ValueError("the ray passes an edge")
        if least > 0:
            x = sum(c * u**i * v**j for (i, j), c in patch[axis].items())
            result.append((x - origin[axis]) / direction[axis])
    return result


@functools.lru_cache(maxsize=None)
def chebyshev_points(degree, digits):
    """@param digits  of the precision at work, for the cache"""
    return [mpmath.cos(mpmath.pi * (2 * i + 1) / (2 * degree + 2)) for i in range(degree + 1)]


def chebyshev_coefficients(values):
    n = len(values)
    return [(2 if k else 1) * sum(x * mpmath.cos(mpmath.pi * k * (2 * i + 1) / (2 * n)) for i, x in enumerate(values)) / n
            for k in range(n)]


def powers_of(coefficients):
    """The polynomial in u of sum c_k T_k(u); small leading ones, rounding of lower degrees, are left out."""
    before, now, total = [mpf(1)], [mpf(0), mpf(1)], [coefficients[0]]
    size = max(abs(c) for c in coefficients)
    coefficients = [c if abs(c) > size * mpf(10)**(12 - mpmath.mp.dps) else mpf(0) for c in coefficients]
    for c in coefficients[1:]:
        total = added(total, [c * x for x in now])
        before, now = now, added([0, *(2 * x for x in now)], [-x for x in before])
    while len(total) > 1 and total[-1] == 0:
        total.pop()
    return total


class CellTruth(Truth):
    """As Truth, of a mesh: {"cells": [(type, nodes)], "node_fields": name -> value at a point}."""

    def __init__(self, scene, mesh, fields, cell_fields, points=16, **words):
        """With more points of Gauss's rule the fields' polynomials have a higher degree, too."""
        super().__init__(scene, {"body": None}, fields, cell_fields, points=points, **words)
        self.degree, self.left_out = 2 * points, mpf(10)**-(10 + points)
        fields = [mesh["node_fields"][name] for name in self.names]
        self.cells = [self.cell(kind, nodes, [[float(field(p)) for p in nodes] for field in fields])
                      for kind, nodes in mesh["cells"]]

    @staticmethod
    def cell(kind, nodes, values):
        return BentCell(nodes, values) if is_bent(kind, nodes) else Cell(kind, nodes, values)

    def pieces(self, x, y):
        """(from, to, polynomials of the extinction and the glow), each over a parameter of its own; None: in a face."""
        origin, direction = self.ray(x, y)
        stretch = mpmath.sqrt(sum(d * d for d in direction))
        low = mpf(self.camera.get("near_mm", 0))
        high = mpf(self.camera.get("far_mm", "1e6"))
        try:
            passed = [(ends, cell) for cell in self.cells for ends in cell.intervals(origin, direction, low, high)]
        except ValueError:
            return None
        passed = sorted(((*ends, i, cell) for i, (ends, cell) in enumerate(passed)), key=lambda p: p[:3])
        for (_, end, *_), (begin, *_) in zip(passed, passed[1:]):
            if begin < end - mpf(10)**(8 - mpmath.mp.dps):
                raise ValueError("cells that overlap")
        result = []
        for a, b, _, cell in passed:
            for begin, end, polynomials in cell.polynomials(origin, direction, a, b, self.degree, self.left_out):
                result += self.pieces_of(polynomials, stretch * (end - begin) / 2)
        return result

    def pieces_of(self, fields, length):
        """@param length  of the ray over the difference of u"""
        cuts = [mpf(-1), mpf(1)]
        for poly, transfer in zip(fields, (self.density, self.colour)):
            for x in transfer.xs:
                cuts += roots_between(added(poly, [-x]), mpf(-1), mpf(1))
        result = []
        cuts.sort()
        for a, b in zip(cuts, cuts[1:]):
            if b <= a:
                continue
            density = [length * c for c in self.density.at(fields[0], (a + b) / 2)[0]]
            colour = self.colour.at(fields[1], (a + b) / 2)
            glow = ([times(k, density) for k in colour] if self.scene.get("glow", "chromaticity") == "chromaticity"
                    else [[length * c for c in k] for k in colour])
            result.append((a, b, density, glow))
        return result
