#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Writes light weights for 32 x 32 lights, as if painted with three soft brushes: painted_light.py OUT.json

For `haarlight relight --weights`: [r, g, b] per light, rows from the top.
"""

import json
import math
import sys

SIDE = 32
STROKES = [  # from (row, column) to (row, column), width in lights, colour
    ((4, 3), (27, 3), 2.2, (1.0, 0.45, 0.12)),
    ((5, 28), (20, 29), 2.2, (0.13, 0.45, 1.3)),
    ((29, 12), (30, 20), 2.0, (0.72, 0.12, 0.48)),
]


def amount(row: int, column: int, start: tuple, end: tuple, width: float) -> float:
    """Of a stroke's colour at a light: a Gaussian of its distance from the stroke."""
    along = (end[0] - start[0], end[1] - start[1])
    t = ((row - start[0]) * along[0] + (column - start[1]) * along[1]) / (along[0] ** 2 + along[1] ** 2)
    t = min(max(t, 0.0), 1.0)
    distance = math.hypot(row - start[0] - t * along[0], column - start[1] - t * along[1])
    return math.exp(-((distance / width) ** 2))


def main() -> int:
    if len(sys.argv) != 2:
        print("usage: painted_light.py OUT.json", file=sys.stderr)
        return 2
    weights = [[round(sum(colour[k] * amount(row, column, start, end, width)
                         for start, end, width, colour in STROKES), 4) for k in range(3)]
              for row in range(SIDE) for column in range(SIDE)]
    with open(sys.argv[1], "w", encoding="utf-8") as out:
        json.dump(weights, out)
        out.write("\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
