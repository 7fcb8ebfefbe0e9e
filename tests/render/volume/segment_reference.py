#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Weights of linear segments in arithmetic of 70 digits and more, for segment_test.cpp, and of quadratic
ones in 40 digits, for quadratic_segment_test.cpp.

    segment_reference.py hard > tests/golden/volume_segment_sweep.json
    segment_reference.py random [COUNT [SEED]] > FILE      (HAARLIGHT_SEGMENT_CASES=FILE volume_test)
    segment_reference.py check                             the formulas below against quadrature

Needs python3-mpmath. With a, b the optical depths at the near and far end, d = b - a, T and P0 as in
docs/numerics/volume.md: P0 from erfc or erfi, and P1 = (1 - T - a P0)/d, by parts; what cancels in them
is made up for by digits. Quadratic segments: Gauss's rule of 24 points on 64 panels. random: a and b log-uniform over 24 decades, with equal and nearly equal ends and
zeros among them.
"""
import json
import math
import random
import sys

import mpmath as mp

DECADES = 12
SWITCHES = (0.01, 0.69, 2.0)


def tail_function(x, sign):
    """(sqrt(pi)/2) e^(x^2) erfc(x), or Dawson's integral for sign < 0."""
    if x > 2 * mp.sqrt(mp.mp.dps):  # the asymptotic series' least term is e^(-x^2)
        term, total, k = 1 / (2 * x), 1 / (2 * x), 1
        while abs(term) > abs(total) * mp.mpf(10) ** -mp.mp.dps:
            term *= -sign * (2 * k - 1) / (2 * x * x)
            total += term
            k += 1
        return total
    f = mp.erfc(x) if sign > 0 else mp.erfi(x)
    return mp.sqrt(mp.pi) / 2 * mp.exp(sign * x * x) * f


def digits_for(a, b):
    sizes = [abs(math.log10(x)) for x in (a, b, abs(b - a)) if x > 0]
    return 70 + int(4 * max(sizes, default=0))


def weights(a, b):
    """near and far weight of a chromaticity, of a glow, T; a and b doubles, taken exactly."""
    mp.mp.dps = digits_for(a, b)
    a, b = mp.mpf(a), mp.mpf(b)
    d = b - a
    t = mp.exp(-(a + b) / 2)
    if d == 0:
        p0 = (1 - t) / a if a else mp.mpf(1)
        p1 = (p0 - t) / a if a else mp.mpf(1) / 2
    else:
        sign = 1 if d > 0 else -1
        root = mp.sqrt(2 * abs(d))
        p0 = 2 / root * (tail_function(a / root, sign) - t * tail_function(b / root, sign))
        p1 = (1 - t - a * p0) / d
    return 1 - p0, p0 - t, p0 - p1, p1, t


def quadrature(a, b):
    mp.mp.dps = 40
    a, b = mp.mpf(a), mp.mpf(b)
    d = b - a
    ends = [mp.mpf(k) / 16 for k in range(17)]

    def integral(f):
        return mp.quad(lambda s: f(s) * mp.exp(-a * s - d * s * s / 2), ends)

    return (integral(lambda s: (1 - s) * (a + d * s)), integral(lambda s: s * (a + d * s)),
            integral(lambda s: 1 - s), integral(lambda s: s), mp.exp(-(a + b) / 2))


def depth(rng):
    return 10.0 ** rng.uniform(-DECADES, DECADES)


def random_pair(rng):
    kind = rng.randrange(10)
    a = depth(rng)
    if kind == 0:
        return a, a
    if kind == 1:
        return a, a * (1.0 + rng.choice((-1, 1)) * 10.0 ** rng.uniform(-16, -1))
    if kind == 2:
        return rng.choice(((a, 0.0), (0.0, a)))
    return a, depth(rng)


def hard_pairs():
    pairs = [(0.0, 0.0)]
    for m in SWITCHES:
        for x in (math.nextafter(m, 0.0), m, math.nextafter(m, 9.0)):
            for ratio in (0.0, 1e-9, 0.3, 0.999, 1.0):
                pairs += [(x, ratio * x), (ratio * x, x)]
    for m in (2.5, 3.0, 8.0, 30.0, 72.0, 1e3, 1e6, 1e12):
        for off in (2e-16, 1e-14, 1e-10, 1e-8, 1e-6, 1e-4, 1e-2, 0.2):
            pairs += [(m, m * (1.0 - off)), (m * (1.0 - off), m)]
    # p = a/sqrt(2 |b - a|) through the table of the closed form, and across the zero of Dawson's slope
    for p in (0.05, 0.3, 0.8, 0.9, 0.92413887, 0.95, 1.2, 2.0, 2.5, 3.0, 4.0, 5.9, 6.1, 9.0, 30.0):
        for d in (2.5, 40.0, -2.5, -40.0):
            a = p * math.sqrt(2.0 * abs(d))
            if a + d >= 0.0:
                pairs.append((a, a + d))
    for size in (1e-280, 1e-150, 1e-30, 1e30, 1e150, 1e300):
        pairs += [(size, size), (size, 0.0), (0.0, size), (size, 0.5 * size)]
    rng = random.Random(1)
    pairs += [random_pair(rng) for _ in range(150)]
    return pairs


def function_cases():
    """phi and psi of segment_tables.py at u: of erfcx, of Dawson's integral; inside and beside all parts."""
    c = 4
    inside = [(i + 0.37) / 64 for i in range(64)]
    beside = [x for i in range(1, 64, 7) for x in (math.nextafter(i / 64, 0.0), i / 64, math.nextafter(i / 64, 1.0))]
    rows = []
    for u in inside + beside + [1e-300, 1e-100, 1e-20, 1e-5, 1.0]:
        mp.mp.dps = 60 + int(4 * -math.log10(u))
        exact = mp.mpf(u)
        x = c * (1 - exact) / exact
        row = [repr(u)]
        for sign in (1, -1):
            f = tail_function(x, sign)
            row += [mp.nstr(2 * c * f / exact, 25), mp.nstr(2 * c * c * sign * (1 - 2 * x * f) / exact**2, 25)]
        rows.append(json.dumps(row))
    return ",\n".join(rows)


def quadratic_weights(rho, rule):
    """Of (1 - s)^2, 2 s (1 - s), s^2 as chromaticities, as glows; rho: three doubles, taken exactly."""
    r0, r1, r2 = (mp.mpf(r) for r in rho)
    panels = 64
    sums = [mp.mpf(0)] * 6
    for panel in range(panels):
        for x, w in rule:
            s = (panel + x) / panels
            rest = 1 - s
            value = rest * rest * r0 + 2 * s * rest * r1 + s * s * r2
            tau = s * (r0 + s * ((r1 - r0) + s * (r0 - 2 * r1 + r2) / 3))
            e = w / panels * mp.exp(-tau)
            basis = (rest * rest, 2 * s * rest, s * s)
            for j in range(3):
                sums[j] += basis[j] * value * e
                sums[3 + j] += basis[j] * e
    return sums


def gauss_rule(n):
    """Points and weights of Gauss and Legendre's rule on 0..1."""
    rule = []
    for i in range(n):
        x = mp.cos(mp.pi * (i + mp.mpf(3) / 4) / (n + mp.mpf(1) / 2))
        for _ in range(8):
            p, before = x, mp.mpf(1)
            for k in range(2, n + 1):
                p, before = ((2 * k - 1) * x * p - (k - 1) * before) / k, p
            slope = n * (x * p - before) / (x * x - 1)
            x -= p / slope
        rule.append(((1 + x) / 2, 1 / ((1 - x * x) * slope * slope)))
    return rule


def quadratic_cases():
    """Parabolas >= 0: any, with a zero inside or nearly so, steep at the eye or far from it."""
    mp.mp.dps = 40
    rule = gauss_rule(24)
    rng = random.Random(3)
    rows = []
    for i in range(90):
        size = 10.0 ** rng.uniform(-4.0, 2.0)
        r0 = size * rng.random()
        r2 = size * rng.random()
        lowest = -math.sqrt(r0 * r2)
        r1 = (lowest * (1.0 - 1e-15), lowest + 0.01 * size * rng.random(), size * rng.random())[i % 3]
        if i % 10 == 9:
            r0, r1, r2 = rng.choice(((size, 0.0, 0.0), (0.0, size, 0.0), (0.0, 0.0, size)))
        values = quadratic_weights((r0, r1, r2), rule)
        rows.append(json.dumps([repr(r0), repr(r1), repr(r2)] + [mp.nstr(w, 25) for w in values]))
    return ",\n".join(rows)


def cases_of(pairs):
    rows = []
    for a, b in pairs:
        row = [repr(a), repr(b)] + [mp.nstr(w, 25) for w in weights(a, b)]
        rows.append(json.dumps(row))
    return ",\n".join(rows)


def check():
    worst = mp.mpf(0)
    for a, b in hard_pairs()[::6]:
        if max(a, b) < 100.0 and max(a, b) > 1e-10:
            for x, y in zip(weights(a, b), quadrature(a, b)):
                worst = max(worst, abs(x - y) / abs(y))
    print("largest relative difference", mp.nstr(worst, 3))
    return 0 if worst < mp.mpf(10) ** -25 else 1


def main():
    mode = sys.argv[1] if len(sys.argv) > 1 else ""
    if mode == "check":
        return check()
    if mode == "hard":
        pairs, how = hard_pairs(), "hard"
    elif mode == "random":
        count = int(sys.argv[2]) if len(sys.argv) > 2 else 100000
        rng = random.Random(int(sys.argv[3]) if len(sys.argv) > 3 else 2)
        pairs, how = [random_pair(rng) for _ in range(count)], f"random {count}"
    else:
        print(__doc__, file=sys.stderr)
        return 2
    print(f"""{{
"provenance": "tests/render/volume/segment_reference.py {how}: mpmath, at least 70 digits, 25 of them here",
"columns": "a, b, 1 - P0, P0 - T, P0 - P1, P1, T",
"cases": [
{cases_of(pairs)}
]""")
    if mode == "hard":
        print(f""",
"function columns": "u; phi and psi of erfcx; of Dawson's integral",
"functions": [
{function_cases()}
],
"quadratic columns": "extinction near, middle, far; weights of a chromaticity near, middle, far; of a glow",
"quadratic": [
{quadratic_cases()}
]""")
    print("}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
