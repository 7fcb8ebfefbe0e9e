#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Writes the environment that the demo uses where no real one is at hand: make_environment.py OUT.hdr

A latitude-longitude picture in Radiance's format: a room with a blue ceiling light, a warm square
softbox, and a small bright lamp, all high up, where the top face of a rig can see them.
"""

import math
import struct
import sys

WIDTH, HEIGHT = 256, 128
LAMPS = [  # direction (polar angle, azimuth) in degrees, half size in degrees, RGB radiance, square?
    (17.0, 35.0, 6.0, (60.0, 42.0, 24.0), True),
    (22.0, 160.0, 1.5, (500.0, 480.0, 450.0), False),
    (12.0, 275.0, 8.0, (4.0, 9.0, 22.0), False),
]


def direction(row: float, column: float) -> tuple[float, float, float]:
    theta = math.pi * row / HEIGHT
    phi = math.pi - 2.0 * math.pi * column / WIDTH
    return (math.sin(theta) * math.cos(phi), math.sin(theta) * math.sin(phi), math.cos(theta))


def radiance(d: tuple[float, float, float]) -> tuple[float, float, float]:
    up = 0.5 * (1.0 + d[2])
    colour = [0.12 + 0.5 * up, 0.11 + 0.55 * up, 0.10 + 0.7 * up]
    for theta, phi, half, rgb, is_square in LAMPS:
        t, p = math.radians(theta), math.radians(phi)
        axis = (math.sin(t) * math.cos(p), math.sin(t) * math.sin(p), math.cos(t))
        u = (math.cos(t) * math.cos(p), math.cos(t) * math.sin(p), -math.sin(t))
        v = (-math.sin(p), math.cos(p), 0.0)
        along = sum(a * b for a, b in zip(d, axis))
        if along <= 0.0:
            continue
        x = math.degrees(math.atan2(sum(a * b for a, b in zip(d, u)), along))
        y = math.degrees(math.atan2(sum(a * b for a, b in zip(d, v)), along))
        inside = max(abs(x), abs(y)) < half if is_square else math.hypot(x, y) < half
        if inside:
            colour = [c + light for c, light in zip(colour, rgb)]
    return tuple(colour)


def rgbe(colour: list[float]) -> bytes:
    peak = max(colour)
    mantissa, exponent = math.frexp(peak)
    scale = mantissa * 256.0 / peak
    return struct.pack("4B", *(min(255, int(c * scale)) for c in colour), exponent + 128)


def main() -> int:
    if len(sys.argv) != 2:
        print("usage: make_environment.py OUT.hdr", file=sys.stderr)
        return 2
    samples = 4  # each way inside a pixel
    with open(sys.argv[1], "wb") as out:
        out.write(b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y %d +X %d\n" % (HEIGHT, WIDTH))
        for row in range(HEIGHT):
            for column in range(WIDTH):
                total = [0.0, 0.0, 0.0]
                for i in range(samples):
                    for j in range(samples):
                        sample = radiance(direction(row + (i + 0.5) / samples,
                                                    column + (j + 0.5) / samples))
                        total = [a + b / samples**2 for a, b in zip(total, sample)]
                out.write(rgbe(total))
    return 0


if __name__ == "__main__":
    sys.exit(main())
