#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Writes the picture of tiles that configs/scenes/cornell_tiles.toml shows: make_tiles.py OUT.png

256 x 256 pixels, 4 x 4 tiles, sRGB; it repeats without a seam. The lower left tile has a red dot, so that
one sees how it lies.
"""

import math
import random
import struct
import sys
import zlib

SIZE, TILES, GROUT = 256, 4, 2
BLUE, CREAM, GREY, RED = (38, 72, 120), (222, 206, 172), (120, 116, 110), (190, 40, 30)


def pixel(x: int, y: int, shade: list[list[float]]) -> tuple[int, int, int]:
    side = SIZE // TILES
    column, row, dx, dy = x // side, y // side, x % side, y % side
    if min(dx, dy) < GROUT or max(dx, dy) >= side - GROUT:
        return GREY
    colour = BLUE if (column + row) % 2 else CREAM
    if (column, row) == (0, TILES - 1) and math.hypot(dx - side / 2, dy - side / 2) < side / 5:
        colour = RED
    cloud = math.sin(2 * math.pi * (3 * x + y) / SIZE) * math.sin(2 * math.pi * (x - 2 * y) / SIZE)
    factor = shade[row][column] + 0.06 * round(2 * cloud) / 2
    return tuple(min(255, round(factor * c)) for c in colour)


def chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def main() -> None:
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    chance = random.Random(4)
    shade = [[chance.uniform(0.85, 1.1) for _ in range(TILES)] for _ in range(TILES)]
    rows = b"".join(b"\0" + bytes(c for x in range(SIZE) for c in pixel(x, y, shade)) for y in range(SIZE))
    with open(sys.argv[1], "wb") as out:
        out.write(b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", struct.pack(">IIBBBBB", SIZE, SIZE, 8, 2, 0, 0, 0)) +
                  chunk(b"sRGB", b"\0") + chunk(b"IDAT", zlib.compress(rows, 9)) + chunk(b"IEND", b""))


if __name__ == "__main__":
    main()
