#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""Pictures of a sheet under a dome and of mirror balls, from forward models of their own (NumPy): they
share no code with what is fitted. made_lights.py FOLDER draws chrome/, balls/ and
paper/."""

import math
import pathlib
import struct
import sys
import zlib

import numpy as np


def write_png16(path, values):
    """Linear 0..1, (height, width), as 16-bit grey."""
    height, width = values.shape
    data = np.round(np.clip(values, 0.0, 1.0) * 65535.0).astype(">u2")
    raw = b"".join(b"\0" + data[y].tobytes() for y in range(height))

    def chunk(kind, body):
        return (struct.pack(">I", len(body)) + kind + body +
                struct.pack(">I", zlib.crc32(kind + body)))

    path.write_bytes(b"\x89PNG\r\n\x1a\n" +
                     chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 16, 0, 0, 0, 0)) +
                     chunk(b"IDAT", zlib.compress(raw, 1)) + chunk(b"IEND", b""))


def unit(v):
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def dome(n, radius, rng):
    """Positions over a hemisphere from 25 to 80 degrees up, a little irregular."""
    k = np.arange(n)
    up = np.radians(25.0 + 55.0 * (k + 0.5) / n)
    turn = 2.399963 * k
    place = np.stack([np.cos(up) * np.cos(turn), np.cos(up) * np.sin(turn), np.sin(up)], 1)
    return radius * place + rng.normal(0.0, 0.01 * radius, (n, 3))


def across(axis):
    """Two unit vectors at right angles to axis and to each other."""
    helper = np.where(np.abs(axis[:, :1]) < 0.5, [[1.0, 0.0, 0.0]], [[0.0, 1.0, 0.0]])
    u = unit(np.cross(axis, helper))
    return u, np.cross(axis, u)


class Sheet:
    """A flat sheet seen from straight above, one picture per light. is_drawn: bow, sheen and lens
    are drawn with the standard deviations that `calibrate` takes good matte paper and a calibrated
    lens to have."""

    def __init__(self, seed, n=40, radius=500.0, size=(192, 144), width_mm=250.0, camera_mm=740.0,
                 mu=1.0, aim_deg=0.0, noise=0.01, slope=0.0, arch_mm=0.0, gauss_deg=0.0, tilt_deg=0.0,
                 is_drawn=False):
        rng = np.random.default_rng(seed)
        drawn = np.random.default_rng([seed, 1]).normal(size=5) if is_drawn else np.zeros(5)
        self.bow_mm, sheen, lens = drawn[:3], 0.1 * drawn[3], 0.005 * drawn[4]
        self.arch_mm = arch_mm
        self.size, self.width_mm, self.camera_mm = size, width_mm, camera_mm
        self.places = dome(n, radius, rng)
        self.powers = rng.uniform(0.7, 1.3, n)
        self.powers /= self.powers.mean()
        axis = unit(-self.places)
        u, v = across(axis)
        off = np.radians(aim_deg) * rng.normal(size=(n, 2))
        axis = unit(axis + off[:, :1] * u + off[:, 1:] * v)
        width, height = size
        # The camera's rays, perhaps aslant, meet the sheet.
        focal = width * camera_mm / width_mm
        x, y = np.meshgrid((np.arange(width) + 0.5 - 0.5 * width) / focal,
                           (0.5 * height - np.arange(height) - 0.5) / focal)
        stretch = 1.0 + lens * (x ** 2 + y ** 2) / (0.25 * (width ** 2 + height ** 2) / focal ** 2)
        x, y = stretch * x, stretch * y
        tilt = math.radians(tilt_deg)
        ray = np.stack([x, math.cos(tilt) * y - math.sin(tilt), -math.cos(tilt) - math.sin(tilt) * y], 2)
        eye = np.array([0.0, camera_mm * math.sin(tilt), camera_mm * math.cos(tilt)])
        depth = np.full((height, width), eye[2]) / -ray[..., 2]
        for _ in range(20):
            point = eye + depth[..., None] * ray
            depth = (eye[2] - self.surface(point)) / -ray[..., 2]
        point = eye + depth[..., None] * ray
        normal = self.normals(point)
        texture = 0.8 * (1.0 + 0.1 * rng.uniform(-1.0, 1.0, (height, width)))
        texture *= 1.0 - 0.2 * ((x * focal) ** 2 + (y * focal) ** 2) / (0.25 * (width ** 2 + height ** 2))
        to_eye = unit(eye - point)
        self.pictures = []
        for place, power, a in zip(self.places, self.powers, axis):
            way = place - point
            r = np.linalg.norm(way, axis=2)
            facing = np.maximum(0.0, (normal * way).sum(2))
            cosine = np.maximum(1e-9, -(way @ a) / r)
            lobe = np.exp(-np.arccos(cosine) ** 2 / (2 * math.radians(gauss_deg) ** 2)) if gauss_deg \
                else cosine ** mu
            self.pictures.append(power * texture * lobe * facing / r ** 3 *
                                 rough(slope, normal, way / r[..., None], to_eye) *
                                 shiny(sheen, normal, way / r[..., None], to_eye))
        most = max(p.max() for p in self.pictures)
        self.pictures = [0.9 / most * p for p in self.pictures]
        self.pictures = [np.maximum(0.0, p * (1.0 + noise * rng.normal(size=p.shape)) +
                                    1e-4 * rng.normal(size=p.shape)) for p in self.pictures]

    def surface(self, point):
        """The sheet's height: an arch, and the three shapes of bow, 1 at half of what counts."""
        half = 0.5 * 0.9 * self.width_mm
        x, y = point[..., 0] / half, point[..., 1] / half
        along = (point[..., 0] * math.cos(0.5) + point[..., 1] * math.sin(0.5)) / (0.5 * self.width_mm)
        return (self.arch_mm * np.cos(0.5 * math.pi * along) +
                self.bow_mm[0] * x * x + self.bow_mm[1] * x * y + self.bow_mm[2] * y * y)

    def normals(self, point):
        d = 1e-3
        dx = (self.surface(point + [d, 0, 0]) - self.surface(point - [d, 0, 0])) / (2 * d)
        dy = (self.surface(point + [0, d, 0]) - self.surface(point - [0, d, 0])) / (2 * d)
        return unit(np.stack([-dx, -dy, np.ones_like(dx)], 2))

    def write(self, folder):
        folder.mkdir(parents=True)
        for k, picture in enumerate(self.pictures):
            write_png16(folder / f"light{k}.png", picture)


def rough(slope, normal, to_light, to_eye):
    """Oren and Nayar (1994), equation 30, over Lambert's; their sigma in radians."""
    if not slope:
        return 1.0
    theta_i = np.arccos(np.clip((normal * to_light).sum(2), -1, 1))
    theta_r = np.arccos(np.clip((normal * to_eye).sum(2), -1, 1))
    flat_i = to_light - (normal * to_light).sum(2)[..., None] * normal
    flat_r = to_eye - (normal * to_eye).sum(2)[..., None] * normal
    cos_phi = (flat_i * flat_r).sum(2) / np.maximum(
        1e-12, np.linalg.norm(flat_i, axis=2) * np.linalg.norm(flat_r, axis=2))
    s2 = slope * slope
    return (1 - 0.5 * s2 / (s2 + 0.33) + 0.45 * s2 / (s2 + 0.09) * np.maximum(0.0, cos_phi) *
            np.sin(np.maximum(theta_i, theta_r)) * np.tan(np.minimum(theta_i, theta_r)))


def shiny(sheen, normal, to_light, to_eye):
    """A broad lobe about the mirror direction, over Lambert's."""
    half = unit(to_light + to_eye)
    return 1.0 + sheen * np.maximum(0.0, (normal * half).sum(2)) ** 10


class Balls:
    """Mirror balls on a plane under a camera that looks straight down. Each pixel is 3 x 3 rays that
    meet a ball and are turned; lamps are spheres, the room is dim and smooth, the plane matte."""

    def __init__(self, seed, middles, radius=12.0, lamps=None, lamp_mm=8.0, size=(640, 480), camera_mm=700.0,
                 focal=1600.0, noise=0.002, over=3):
        rng = np.random.default_rng(seed)
        self.size, self.camera_mm, self.focal = size, camera_mm, focal
        self.lamps = dome(12, 500.0, rng) if lamps is None else lamps
        width, height = size
        x, y = np.meshgrid(((np.arange(width * over) + 0.5) / over - 0.5 * width) / focal,
                           (0.5 * height - (np.arange(height * over) + 0.5) / over) / focal)
        ray = unit(np.stack([x, y, -np.ones_like(x)], 2))
        eye = np.array([0.0, 0.0, camera_mm])
        on_plane = eye + ray * (camera_mm / -ray[..., 2])[..., None]
        base = 0.06 + 0.02 * np.sin(on_plane[..., 0] / 60.0)
        hit = np.zeros(x.shape, bool)
        at = np.zeros_like(ray)
        out = np.zeros_like(ray)
        self.balls = []
        for mx, my in middles:
            centre = np.array([mx, my, radius])
            self.balls.append(centre)
            b = ((eye - centre) * ray).sum(2)
            root = b * b - ((eye - centre) ** 2).sum() + radius * radius
            on = root > 0
            p = eye + ray * (-b - np.sqrt(np.maximum(root, 0)))[..., None]
            n = (p - centre) / radius
            hit |= on
            at[on], out[on] = p[on], (ray - 2 * (n * ray).sum(2)[..., None] * n)[on]
        room = np.where(hit, 0.01 + 0.008 * out[..., 0], base)
        self.pictures = []
        for lamp in self.lamps:
            way = lamp - at
            far = (way * out).sum(2)
            miss = np.linalg.norm(way - far[..., None] * out, axis=2)
            lit = np.where(hit & (far > 0) & (miss < lamp_mm), 3.0, room * (0.8 + 0.4 * rng.uniform()))
            picture = lit.reshape(height, over, width, over).mean((1, 3))
            self.pictures.append(np.clip(picture + noise * rng.normal(size=picture.shape), 0, 1))
        self.mask_of = lambda i: self.mask(ray, eye, i, radius, over)

    def mask(self, ray, eye, i, radius, over):
        width, height = self.size
        b = ((eye - self.balls[i]) * ray).sum(2)
        on = b * b - ((eye - self.balls[i]) ** 2).sum() + radius * radius > 0
        return on.reshape(height, over, width, over).mean((1, 3))

    def write(self, folder):
        folder.mkdir(parents=True)
        for k, picture in enumerate(self.pictures):
            write_png16(folder / f"light{k}.png", picture)


def make_examples(folder):
    Balls(1, [(0, 0)], radius=40.0, size=(320, 240), focal=800.0).write(folder / "chrome")
    Balls(2, [(-90, -60), (90, -50), (70, 60), (-80, 55)]).write(folder / "balls")
    Sheet(3, n=24).write(folder / "paper")


if __name__ == "__main__":
    make_examples(pathlib.Path(sys.argv[1]))
