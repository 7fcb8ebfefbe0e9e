#!/usr/bin/python3
"""Draws this folder's pictures again: a relief with a grey card beside it under 16 warm lamps, by a forward
model of its own (NumPy); ImageMagick's convert makes the JPEGs. make.py FOLDER"""

import math
import pathlib
import subprocess
import sys

import numpy as np

WIDTH, HEIGHT, LIGHTS = 96, 72, 16
LAMP = np.array([1.0, 0.8, 0.55])  # its colour; the card's gains are 1 / LAMP
CARD, CARD_REFLECTANCE = (74, 50, 16, 16), 0.5  # x, y, width, height


def directions():
    """Unit, 25 to 75 degrees up; x right, y up, z to the camera."""
    k = np.arange(LIGHTS)
    up, turn = np.radians(25.0 + 50.0 * (k + 0.5) / LIGHTS), 2.399963 * k
    return np.stack([np.cos(up) * np.cos(turn), np.cos(up) * np.sin(turn), np.sin(up)], 1)


def scene():
    """Normals and reflectances of a sheet with a dome, a ring and a ridge."""
    x, y = np.meshgrid(np.arange(WIDTH) + 0.5, HEIGHT - np.arange(HEIGHT) - 0.5)
    r = np.hypot(x - 36.0, y - 38.0)
    height = 9.0 * np.exp(-(r / 13.0) ** 2) + 2.5 * np.exp(-((r - 27.0) / 2.5) ** 2)
    height += 2.0 * np.exp(-((x + 0.5 * y - 92.0) / 3.0) ** 2)
    left, top, width, depth = CARD
    inside = np.s_[top - 1:top + depth + 1, left - 1:left + width + 1]
    height[inside] = 0.0
    slope_y, slope_x = np.gradient(height)
    normal = np.stack([-slope_x, slope_y, np.ones_like(x)], -1)
    normal[inside] = [0.0, 0.0, 1.0]
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    rho = np.stack([0.55 + 0.1 * np.sin(x / 7.0), 0.42 + 0.12 * np.sin(y / 9.0), 0.3 + 0.0 * x], -1)
    rho[r < 10.0] = [0.25, 0.4, 0.6]
    rho[inside] = CARD_REFLECTANCE
    shine = np.where(r < 24.0, 0.25, 0.0)
    shine[inside] = 0.0
    return normal, rho, shine


def picture(light, normal, rho, shine):
    """Linear: Lambert, and Blinn's highlight of exponent 40."""
    cosine = np.maximum(normal @ light, 0.0)
    half = (light + [0.0, 0.0, 1.0]) / np.linalg.norm(light + [0.0, 0.0, 1.0])
    gloss = np.where(cosine > 0.0, np.maximum(normal @ half, 0.0) ** 40, 0.0)
    return LAMP * (rho * cosine[..., None] + (shine * gloss)[..., None])


def srgb(linear):
    linear = np.clip(linear, 0.0, 1.0)
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)


def main(folder):
    lines = [str(LIGHTS)]
    for k, light in enumerate(directions()):
        codes = np.round(255.0 * srgb(picture(light, *scene()))).astype(np.uint8)
        name = f"relief_{k:02}.jpg"
        subprocess.run(["convert", "ppm:-", "-quality", "88", "-sampling-factor", "1x1", "-strip",
                        f"jpg:{folder / name}"], check=True,
                       input=b"P6 %d %d 255\n" % (WIDTH, HEIGHT) + codes.tobytes())
        lines.append(f"{name} " + " ".join(f"{c:.6f}" for c in light))
    (folder / "relief.lp").write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    main(pathlib.Path(sys.argv[1]))
