# SPDX-License-Identifier: Apache-2.0
"""Where rays pass curved faces. A face is the patch through its nodes: three polynomials of its coordinates (u, v), interpolated
exactly. Of the two equations by which a ray passes it u is eliminated by Sylvester's resultant: a polynomial in v, whose roots
mpmath finds."""

import functools
import math
from fractions import Fraction as F

import mpmath
from mpmath import mpf

from ray_truth import added, times

# Form: where its nodes are, and the powers of u and v of its polynomials.
THIRDS = ((F(1, 3), 0), (F(2, 3), 0), (F(2, 3), F(1, 3)), (F(1, 3), F(2, 3)), (0, F(2, 3)), (0, F(1, 3)), (F(1, 3), F(1, 3)))
SQUARE = ((0, 0), (1, 0), (1, 1), (0, 1), (F(1, 2), 0), (1, F(1, 2)), (F(1, 2), 1), (0, F(1, 2)))
POWERS = tuple((i, j) for i in range(3) for j in range(3))
NODES = {
    "quadratic": (((0, 0), (1, 0), (0, 1), (F(1, 2), 0), (F(1, 2), F(1, 2)), (0, F(1, 2))),
                  tuple((i, j) for i in range(3) for j in range(3 - i))),
    "cubic": (((0, 0), (1, 0), (0, 1), *THIRDS), tuple((i, j) for i in range(4) for j in range(4 - i))),
    "serendipity": (SQUARE, POWERS[:8]),
    "biquadratic": ((*SQUARE, (F(1, 2), F(1, 2))), POWERS),
}


@functools.lru_cache(maxsize=None)
def inverse_of(form):
    """Of the matrix of powers at the nodes, by elimination in fractions."""
    nodes, powers = NODES[form]
    n = len(nodes)
    rows = [[F(u)**i * F(v)**j for i, j in powers] + [F(int(k == row)) for k in range(n)] for row, (u, v) in enumerate(nodes)]
    for column in range(n):
        pivot = next(k for k in range(column, n) if rows[k][column] != 0)
        rows[column], rows[pivot] = rows[pivot], rows[column]
        rows[column] = [x / rows[column][column] for x in rows[column]]
        for k in range(n):
            if k != column and rows[k][column] != 0:
                factor = rows[k][column]
                rows[k] = [a - factor * b for a, b in zip(rows[k], rows[column])]
    return [row[n:] for row in rows]


class Patch:
    def __init__(self, nodes, form):
        """@param nodes  fractions"""
        self.form, self.is_triangle = form, form in ("quadratic", "cubic")
        powers = NODES[form][1]
        coefficients = [[sum(w * node[axis] for w, node in zip(row, nodes)) for axis in range(3)] for row in inverse_of(form)]
        self.degree = 3 if form == "cubic" else 2
        self.poly = [{e: mpf(row[axis].numerator) / row[axis].denominator for e, row in zip(powers, coefficients)}
                     for axis in range(3)]
        bezier = self.bezier_points(dict(zip(powers, coefficients)))
        self.middle = [mpf(float(sum(x) / len(bezier))) for x in zip(*bezier)]
        self.radius = max(mpmath.sqrt(sum((mpf(float(a)) - b)**2 for a, b in zip(p, self.middle))) for p in bezier) + mpf(10)**-9

    def bezier_points(self, coefficients):
        """Between which the patch is."""
        n, zero = self.degree, [F(0)] * 3

        def factor(i, j, k, l):
            if self.is_triangle:
                whole = F(math.factorial(n), math.factorial(k) * math.factorial(l) * math.factorial(n - k - l))
                return F(math.comb(i, k) * math.comb(j, l)) / whole
            return F(math.comb(i, k) * math.comb(j, l), math.comb(n, k) * math.comb(n, l))

        return [[sum(factor(i, j, k, l) * coefficients.get((k, l), zero)[axis] for k in range(i + 1) for l in range(j + 1))
                 for axis in range(3)] for i in range(n + 1) for j in range(n + 1) if not self.is_triangle or i + j <= n]

    def is_near(self, origin, direction):
        to = [m - o for m, o in zip(self.middle, origin)]
        along = sum(a * d for a, d in zip(to, direction)) / sum(d * d for d in direction)
        return sum((a - along * d)**2 for a, d in zip(to, direction)) <= self.radius**2

    def depth_within(self, u, v):
        return min(u, v, 1 - u - v) if self.is_triangle else min(u, v, 1 - u, 1 - v)


def at(poly, x):
    result = mpf(0)
    for c in reversed(poly):
        result = result * x + c
    return result


def resultant_of(first, second):
    """Of two lists of polynomials in v, by powers of u."""
    if len(first) == 3:
        (c1, b1, a1), (c2, b2, a2) = first, second

        def minor(x1, y2, y1, x2):
            return added(times(x1, y2), [-c for c in times(y1, x2)])

        ac, ab, bc = minor(a1, c2, c1, a2), minor(a1, b2, b1, a2), minor(b1, c2, c1, b2)
        return added(times(ac, ac), [-c for c in times(ab, bc)])
    # Of cubics of degree 9: Sylvester's determinant at ten points.
    places = [mpf(2 * k - 9) / 9 for k in range(10)]
    values = []
    for v in places:
        rows = mpmath.matrix(6, 6)
        for k in range(3):
            for i in range(4):
                rows[k, k + i] = at(first[3 - i], v)
                rows[3 + k, k + i] = at(second[3 - i], v)
        values.append(mpmath.det(rows))
    powers = mpmath.matrix([[v**k for k in range(10)] for v in places])
    return list(mpmath.lu_solve(powers, mpmath.matrix(values)))


def crossings(patch, origin, direction):
    """Of t where origin + t direction is on the patch. @throws ValueError  it passes an edge, or touches it, or nearly so"""
    if not patch.is_near(origin, direction):
        return []
    axis = max(range(3), key=lambda k: abs(direction[k]))
    across = []  # two polynomials in u and v that are 0 on the ray, by u
    for k in range(3):
        if k != axis:
            slope = direction[k] / direction[axis]
            poly = {e: patch.poly[k][e] - slope * patch.poly[axis][e] for e in patch.poly[k]}
            poly[0, 0] -= origin[k] - slope * origin[axis]
            across.append([[poly.get((i, j), mpf(0)) for j in range(patch.degree + 1)] for i in range(patch.degree + 1)])
    resultant = resultant_of(*across)
    size = max(abs(c) for c in resultant)
    while resultant and abs(resultant[-1]) < size * mpf(10)**(8 - mpmath.mp.dps):
        resultant.pop()
    near = mpf(10)**-9
    result = []
    if len(resultant) < 2:
        return result
    for v in mpmath.polyroots(resultant[::-1], maxsteps=500, extraprec=4 * mpmath.mp.dps):
        v, off = mpmath.re(v), abs(mpmath.im(v))
        if off > mpf(10)**-6 or not -near < v < 1 + near:
            continue
        if off > mpf(10)**(-mpmath.mp.dps / 2):
            raise ValueError("the ray nearly touches a face")
        u = common_root(across, v)
        if u is None:
            continue
        depth = patch.depth_within(u, v)
        if abs(depth) < near:
            raise ValueError("the ray passes an edge")
        if depth > 0:
            x = sum(c * u**i * v**j for (i, j), c in patch.poly[axis].items())
            result.append((x - origin[axis]) / direction[axis])
    return result


def common_root(across, v):
    """The u at which both polynomials are 0; None: none is real."""
    first, second = ([at(c, v) for c in poly] for poly in across)
    if len(first) == 3:
        (c1, b1, a1), (c2, b2, a2) = first, second
        divisor = a1 * b2 - a2 * b1
        if abs(divisor) < mpf(10)**-12 * max(abs(x) for x in (*first, *second))**2:
            raise ValueError("a ray and a face in a special position")
        u = -(a1 * c2 - a2 * c1) / divisor
        return u if abs(at(first, u)) <= mpf(10)**(10 - mpmath.mp.dps) else None
    found = None
    for u in mpmath.polyroots(first[::-1], maxsteps=500, extraprec=4 * mpmath.mp.dps):
        if abs(mpmath.im(u)) < mpf(10)**-15 and abs(at(second, mpmath.re(u))) < mpf(10)**(12 - mpmath.mp.dps):
            if found is not None:
                raise ValueError("a ray and a face in a special position")
            found = mpmath.re(u)
    return found
