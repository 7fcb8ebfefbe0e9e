# SPDX-License-Identifier: Apache-2.0
"""What a ray gathers where a field is given at the nodes alone, whatever they hold: by ray_truth.py, piece by piece of the cells
that the ray passes. Every cell is tried against every ray, and must have flat faces. In a tetrahedron of four nodes the field is
linear along the ray, in one of ten quadratic. In other cells it is what their shape functions say: the coordinates within the
cell are found by Newton's method, and the field is the polynomial through its values at Chebyshev's points, of a degree that
leaves less than 10^-26 of its range out; a piece that needs a higher one is halved.

Cells with nodes beside their corners may be bent: bent_faces.py finds where rays pass their faces."""

import functools

import mpmath
from mpmath import mpf

import cube_meshes as cm
from bent_faces import Patch, crossings
from cell_kinds import KINDS
from ray_truth import IN_PLANE, Truth, added, times, value


def is_bent(kind, nodes):
    """Whether a node is not where straight edges have it, or a face of a cell with further nodes is not flat."""
    of_kind = KINDS[kind]
    if any(tuple(node) != tuple(sum(w * nodes[i][axis] for i, w in weights.items()) for axis in range(3))
           for node, weights in zip(nodes[of_kind.n_corners:], of_kind.between())):
        return True
    return bool(of_kind.edges) and not all(is_flat([nodes[i] for i in face]) for face in of_kind.faces)


def is_flat(points):
    try:
        plane_of(points)
    except ValueError:
        return False
    return True


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
        self.kind = KINDS[kind]
        self.shape, self.is_linear, self.place = self.kind.shape, self.kind.is_linear, self.kind.straight
        self.planes = [plane_of([nodes[i] for i in face]) for face in self.kind.faces]
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
            n = self.place(*r)
            off = [x - sum(w * q[i] for w, q in zip(n, self.nodes)) for i, x in enumerate(p)]
            step = mpmath.lu_solve(self.slopes(r), mpmath.matrix(off))
            r = [a + b for a, b in zip(r, step)]
            if max(abs(b) for b in step) < mpf(10)**(6 - mpmath.mp.dps):
                return [sum(w * x for w, x in zip(self.shape(*r), of_field)) for of_field in self.values], r
        raise ValueError("Newton's method does not end")

    def slopes(self, r):
        """The position's derivatives: shape functions are linear in each coordinate alone, so that differences are exact."""
        columns = []
        for i in range(3):
            ends = [self.place(*(end if i == j else x for j, x in enumerate(r))) for end in (mpf(0), mpf(1))]
            columns.append([sum((b - a) * q[axis] for a, b, q in zip(*ends, self.nodes)) for axis in range(3)])
        return mpmath.matrix(columns).T

    def polynomials(self, origin, direction, low, high, degree, left_out):
        """[(low, high, a polynomial of u per field)], u from -1 at low to 1 at high."""
        r, rows = [mpf(1) / 4] * 3, []
        for u in chebyshev_points(3 if self.is_linear else degree, mpmath.mp.dps):
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
    """One whose nodes beside its corners bend it."""

    def __init__(self, kind, nodes, values):
        self.kind = KINDS[kind]
        self.shape = self.place = self.kind.shape
        self.is_linear = False
        self.nodes = [[mpf(x.numerator) / x.denominator for x in p] for p in nodes]
        self.floats = [[float(x) for x in p] for p in nodes]
        self.values = [[mpf(x) for x in of_field] for of_field in values]
        self.patches = []
        for face in self.kind.faces:
            of_patch, form = self.kind.patch_nodes(face)
            self.patches.append(Patch([nodes[i] for i in of_patch], form))

    def intervals(self, origin, direction, low, high):
        """All of them, as interval(). @throws ValueError  the ray passes an edge, or touches a face, or nearly so"""
        ts = sorted(t for patch in self.patches for t in crossings(patch, origin, direction))
        if len(ts) % 2:
            raise ValueError("a face that is passed alone")
        ends = [(max(a, low), min(b, high)) for a, b in zip(ts[::2], ts[1::2])]
        return [(a, b) for a, b in ends if a < b]

    def fields_at(self, p, guess):
        """By Newton's method in doubles, then with the inverse of the slopes there in all digits."""
        r, inverse = self.about(p, guess)
        for _ in range(60):
            n = self.place(*r)
            off = [x - sum(w * q[i] for w, q in zip(n, self.nodes)) for i, x in enumerate(p)]
            step = [sum(x * y for x, y in zip(row, off)) for row in inverse]
            r = [a + b for a, b in zip(r, step)]
            if max(abs(b) for b in step) < mpf(10)**(4 - mpmath.mp.dps):
                break
        else:
            raise ValueError("Newton's method does not end")
        if self.kind.depth_within(*r) < -mpf(10)**-20:
            raise ValueError("another point of the cell's map than that within it")
        return [sum(w * x for w, x in zip(n, of_field)) for of_field in self.values], r

    def about(self, p, guess):
        """Coordinates in double precision, and the inverse of the position's slopes there."""
        p, r = [float(x) for x in p], [min(max(float(x), 0.0), 1.0) for x in guess]
        for _ in range(60):
            n = self.place(*r)
            off = [x - sum(w * q[i] for w, q in zip(n, self.floats)) for i, x in enumerate(p)]
            columns = []
            for i in range(3):  # central differences of either width: exact for degrees up to 4
                d = [self.place(*(x + h if i == j else x for j, x in enumerate(r))) for h in (-2.0, -1.0, 1.0, 2.0)]
                slopes = [(8 * (c - b) - (e - a)) / 12 for a, b, c, e in zip(*d)]
                columns.append([sum(w * q[axis] for w, q in zip(slopes, self.floats)) for axis in range(3)])
            inverse = inverse_of_columns(columns)
            step = [sum(x * y for x, y in zip(row, off)) for row in inverse]
            r = [min(max(a + b, -0.2), 1.2) for a, b in zip(r, step)]
            if max(abs(b) for b in step) < 1e-11:
                return [mpf(x) for x in r], [[mpf(x) for x in row] for row in inverse]
        raise ValueError("Newton's method does not end")


def inverse_of_columns(columns):
    """Of a matrix of three columns, its rows; in doubles."""
    def cross(u, v):
        return [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]]

    rows = [cross(columns[1], columns[2]), cross(columns[2], columns[0]), cross(columns[0], columns[1])]
    det = sum(x * y for x, y in zip(columns[0], rows[0]))
    return [[x / det for x in row] for row in rows]


def turns_of(poly, low, high):
    """Where its slope changes its sign, ascending: of that, too, between the turns."""
    slope = [i * c for i, c in enumerate(poly)][1:]
    if not slope or abs(slope[0]) > sum(abs(c) * max(abs(low), abs(high))**(i + 1) for i, c in enumerate(slope[1:])):
        return []
    return crossings_of(slope, 0, [low, *turns_of(slope, low, high), high])


def crossings_of(poly, level, ends):
    """Where a polynomial that only rises or only falls between neighbours of `ends` has a value."""
    poly = [poly[0] - level, *poly[1:]]
    slope = [i * c for i, c in enumerate(poly)][1:]
    found = []
    for a, b in zip(ends, ends[1:]):
        rises = value(poly, b) > 0
        if (value(poly, a) > 0) == rises:
            continue
        x, before = (a + b) / 2, b - a
        for _ in range(2000):  # Newton's method, or halving where it leaves the bracket or is slow
            y = value(poly, x)
            a, b = (a, x) if (y > 0) == rises else (x, b)
            m = value(slope, x)
            step = -y / m if m else b - a
            if not (a < x + step < b and abs(step) < before / 2):
                step = (a + b) / 2 - x
            x, before = x + step, abs(step)
            if before <= abs(x) * mpf(2)**(2 - mpmath.mp.prec):
                break
        found.append(x)
    return found


@functools.lru_cache(maxsize=None)
def chebyshev_points(degree, digits):
    """@param digits  of the precision at work, for the cache"""
    return [mpmath.cos(mpmath.pi * (2 * i + 1) / (2 * degree + 2)) for i in range(degree + 1)]


@functools.lru_cache(maxsize=None)
def cosines(n, digits):
    """@param digits  as chebyshev_points()"""
    return [[mpmath.cos(mpmath.pi * k * (2 * i + 1) / (2 * n)) for i in range(n)] for k in range(n)]


def chebyshev_coefficients(values):
    n = len(values)
    return [(2 if k else 1) * sum(x * c for x, c in zip(values, row)) / n for k, row in enumerate(cosines(n, mpmath.mp.dps))]


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
        return (BentCell if is_bent(kind, nodes) else Cell)(kind, nodes, values)

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
            ends = [mpf(-1), *turns_of(poly, mpf(-1), mpf(1)), mpf(1)]
            for x in transfer.xs:
                cuts += crossings_of(poly, x, ends)
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
