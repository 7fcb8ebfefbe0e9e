#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""The box of cornell.toml by a path tracer that shares nothing with haarlight: triangles one by one in double
precision, a point of the light by area at each bounce, no weights, no tree. Is haarlight's picture as bright?

    /usr/bin/python3 bench/render/plain_box.py HAARLIGHT --work DIR [--samples 64] [--size 128]

Prints the mean over the pixels that do not show the light, of direct and of all other light, beside haarlight's, each
with its standard error from parts of the samples.
"""

import tomllib

import numpy as np
from picture_errors import arguments, called, colours, parsed, read_tif, shown

PARTS = 8
LENGTH = 64  # bounces: what is left of them is below 1e-8


class Box:
    def __init__(self, path):
        scene = tomllib.loads(path.read_text())
        kinds = {material["name"]: material for material in scene["material"]}
        self.camera = scene["camera"]
        corners, albedo, emitted = [], [], []
        for quad in scene["quad"]:
            for triangle in ((0, 1, 2), (0, 2, 3)):
                corners.append([quad["corners"][i] for i in triangle])
                albedo.append(kinds[quad["material"]]["kd"])
                emitted.append(kinds[quad["material"]].get("emits", [0, 0, 0]))
        corners = np.array(corners, float)
        self.first = corners[:, 0]
        self.edges = corners[:, 1:] - corners[:, :1]
        cross = np.cross(self.edges[:, 0], self.edges[:, 1])
        self.areas = np.linalg.norm(cross, axis=1) / 2.0
        self.normals = cross / (2.0 * self.areas[:, None])
        self.albedo, self.emitted = np.array(albedo, float), np.array(emitted, float)
        self.lights = np.flatnonzero(self.emitted.any(axis=1))

    def meet(self, origin, direction, most=np.inf):
        """@return for each ray the number of the nearest triangle before `most` (-1: none), and how far it is"""
        nearest = np.broadcast_to(np.asarray(most, float), len(origin)).copy()
        which = np.full(len(origin), -1)
        for i, (first, (a, b)) in enumerate(zip(self.first, self.edges)):  # Cramer's rule
            normal = np.cross(a, b)
            determinant = -direction @ normal
            with np.errstate(divide="ignore", invalid="ignore"):
                inverse = 1.0 / determinant
                from_first = origin - first
                t = from_first @ normal * inverse
                turned = np.cross(from_first, direction)
                u = turned @ b * inverse
                v = -(turned @ a) * inverse
                met = (t > 1e-7) & (t < nearest) & (u >= 0.0) & (v >= 0.0) & (u + v <= 1.0)
            nearest[met] = t[met]
            which[met] = i
        return which, nearest

    def rays(self, size, random):
        """One through each pixel, evenly over it."""
        axis = np.subtract(self.camera["target"], self.camera["eye"]).astype(float)
        axis /= np.linalg.norm(axis)
        right = np.cross(axis, self.camera.get("up", [0, 0, 1]))
        right /= np.linalg.norm(right)
        down = np.cross(axis, right)
        half = np.tan(np.radians(self.camera["fov_y_deg"]) / 2.0)
        y, x = np.mgrid[0:size, 0:size].reshape(2, -1)
        x = half * (2.0 * (x + random.random(x.size)) / size - 1.0)
        y = half * (2.0 * (y + random.random(y.size)) / size - 1.0)
        direction = axis + x[:, None] * right + y[:, None] * down
        direction /= np.linalg.norm(direction, axis=1)[:, None]
        return np.broadcast_to(np.asarray(self.camera["eye"], float), direction.shape).copy(), direction


def facing(normal, direction):
    return np.where(np.einsum("ij,ij->i", normal, direction)[:, None] > 0.0, -normal, normal)


def asked(box, point, normal, random):
    """Irradiance by one point of the light, of all its area."""
    areas = box.areas[box.lights]
    light = box.lights[random.choice(len(areas), len(point), p=areas / areas.sum())]
    u, v = np.sqrt(random.random(len(point))), random.random(len(point))
    at = box.first[light] + (u * (1.0 - v))[:, None] * box.edges[light, 0] + (u * v)[:, None] * box.edges[light, 1]
    way = at - point
    squared = np.einsum("ij,ij->i", way, way)
    way /= np.sqrt(squared)[:, None]
    cosines = np.maximum(0.0, np.einsum("ij,ij->i", way, normal)) * np.maximum(0.0, -np.einsum("ij,ij->i", way, box.normals[light]))
    seen = cosines > 0.0
    hidden, _ = box.meet(point[seen], way[seen], np.sqrt(squared[seen]) * (1.0 - 1e-9))
    seen[seen] = hidden < 0
    return box.emitted[light] * (np.where(seen, cosines, 0.0) * areas.sum() / squared)[:, None]


def sample(box, size, random):
    """@return (2, pixels, 3): direct light, and all other, of a path through each pixel"""
    origin, direction = box.rays(size, random)
    light = np.zeros((2, len(origin), 3))
    pixel = np.arange(len(origin))
    carried = np.ones((len(origin), 3))
    for bounce in range(LENGTH):
        which, t = box.meet(origin, direction)
        met = which >= 0
        origin, direction, which, t, pixel, carried = (a[met] for a in (origin, direction, which, t, pixel, carried))
        if len(pixel) == 0:
            break
        normal = facing(box.normals[which], direction)
        point = origin + t[:, None] * direction + 1e-6 * normal
        carried = carried * box.albedo[which]
        light[min(bounce, 1), pixel] += carried / np.pi * asked(box, point, normal, random)
        lives = np.minimum(1.0, carried.max(axis=1)) if bounce >= 3 else (carried.max(axis=1) > 0.0).astype(float)
        on = random.random(len(pixel)) < lives
        normal, point, pixel, carried = normal[on], point[on], pixel[on], carried[on] / lives[on, None]
        # By the cosine law: a point of the unit sphere on top of the normal.
        z, phi = 2.0 * random.random(len(pixel)) - 1.0, 2.0 * np.pi * random.random(len(pixel))
        ring = np.sqrt(1.0 - z * z)
        direction = normal + np.stack([ring * np.cos(phi), ring * np.sin(phi), z], axis=1)
        direction /= np.linalg.norm(direction, axis=1)[:, None]
        origin = point
    return light


def told(means):
    """@param means  (parts, 2, 3) @return direct, other, all: mean over the colours and its standard error"""
    parts = np.mean(means, axis=2)
    parts = np.concatenate([parts, parts.sum(axis=1, keepdims=True)], axis=1)
    return parts.mean(axis=0), parts.std(axis=0, ddof=1) / np.sqrt(len(parts))


def main():
    parser = arguments(__doc__)
    parser.add_argument("--samples", type=int, default=64)
    parser.add_argument("--size", type=int, default=128)
    options = parsed(parser)
    by_haarlight = []
    where = None
    for seed in range(PARTS):
        pictures = []
        for integrator in ("direct", "path"):
            name = options.work / f"{integrator}.tif"
            called(options.haarlight, "surface", options.scene, "--integrator", integrator, "--size", f"{options.size}x{options.size}",
                   "--spp", str(options.samples), "--seed", str(seed), "-o", name)
            pictures.append(read_tif(name))
        where = shown(pictures[1]) if where is None else where
        direct, every = (colours(picture, where).mean(axis=0) for picture in pictures)
        by_haarlight.append([direct, every - direct])
    box = Box(options.scene)
    plain = []
    for part in range(PARTS):
        random = np.random.default_rng(part)
        light = sum(sample(box, options.size, random) for _ in range(options.samples // PARTS)) / (options.samples // PARTS)
        plain.append([colours(of, where).mean(axis=0) for of in light])
        print(f"part {part + 1} of {PARTS}", flush=True)
    ours, our_error = told(by_haarlight)
    theirs, their_error = told(plain)
    print("| light | haarlight | standard error | plain | standard error | haarlight / plain - 1, % |\n|---|---|---|---|---|---|")
    for name, a, b, c, d in zip(("direct", "all other", "together"), ours, our_error, theirs, their_error):
        off = 100.0 * (a / c - 1.0)
        print(f"| {name} | {a:.6f} | {b:.1e} | {c:.6f} | {d:.1e} | {off:+.3f} ± {100.0 * np.hypot(b / a, d / c):.3f} |")


if __name__ == "__main__":
    main()
