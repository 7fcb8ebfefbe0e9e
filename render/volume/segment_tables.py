#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Writes segment_tables.cpp: polynomials of the two functions that segment_kernel.h needs.

    render/volume/segment_tables.py > render/volume/segment_tables.cpp

Needs python3-mpmath. With F(x) = (sqrt(pi)/2) erfcx(x), or Dawson's integral, and u = c/(c + x):

    phi(u) = 2c F(x)/u,   psi(u) = -+2 c^2 F'(x)/u^2   (both 1 at x = infinity)

On each of 64 equal parts of u in (0, 1]: the polynomial of degree 9 through the Chebyshev points, in
the powers of t = -1..1. Largest deviations, of the largest value in the part: phi 1.4e-17, psi 1.5e-16.
"""
import mpmath as mp

C = 4
PARTS = 64
DEGREE = 9


def series(x, sign, is_derivative):
    """Asymptotic, of F or of sign (1 - 2 x F)."""
    term = 1 / (2 * x * x) if is_derivative else 1 / (2 * x)
    total, k = term, 2 if is_derivative else 1
    while abs(term) > abs(total) * mp.mpf(10) ** -40:
        term *= -sign * mp.mpf(2 * k - 1) / (2 * x * x)
        total += term
        k += 1
    return total


def phi_psi(u, sign):
    x = C * (1 - u) / u
    if x > 40:
        f, h = series(x, sign, False), series(x, sign, True)
    elif sign > 0:
        f = mp.sqrt(mp.pi) / 2 * mp.erfc(x) * mp.exp(x * x)
        h = 1 - 2 * x * f
    else:
        f = mp.sqrt(mp.pi) / 2 * mp.erfi(x) * mp.exp(-x * x)
        h = 2 * x * f - 1
    return 2 * C * f / u, 2 * C * C * h / u**2


def powers(values):
    """Coefficients of 1, t, t^2 ... of the polynomial through the Chebyshev points."""
    n = len(values)
    angles = [mp.pi * (2 * j + 1) / (2 * n) for j in range(n)]
    chebyshev = [2 * mp.fsum(v * mp.cos(k * a) for v, a in zip(values, angles)) / n for k in range(n)]
    chebyshev[0] /= 2
    before, now = [mp.mpf(1)] + [mp.mpf(0)] * (n - 1), [mp.mpf(0), mp.mpf(1)] + [mp.mpf(0)] * (n - 2)
    total = [chebyshev[0] * before[i] + chebyshev[1] * now[i] for i in range(n)]
    for k in range(2, n):
        following = [2 * (now[i - 1] if i else 0) - before[i] for i in range(n)]
        before, now = now, following
        total = [total[i] + chebyshev[k] * now[i] for i in range(n)]
    return total


def main():
    mp.mp.dps = 60
    print("""// SPDX-License-Identifier: Apache-2.0
/// @file
/// Written by segment_tables.py.

#include "render/volume/segment_tables.h"

namespace haarlight::render {

// clang-format off
const SegmentTables kSegmentTables = {""")
    for sign in (1, -1):
        for part in range(PARTS):
            n = DEGREE + 1
            points = [(part + (1 + mp.cos(mp.pi * (2 * j + 1) / (2 * n))) / 2) / PARTS for j in range(n)]
            values = [phi_psi(u, sign) for u in points]
            phi, psi = (powers([v[w] for v in values]) for w in (0, 1))
            numbers = [float(p[k]) for k in range(n) for p in (phi, psi)]
            for i in range(0, len(numbers), 4):
                print("    " + " ".join(f"{x!r}," for x in numbers[i:i + 4]))
    print("""};
// clang-format on

}  // namespace haarlight::render""")


if __name__ == "__main__":
    main()
