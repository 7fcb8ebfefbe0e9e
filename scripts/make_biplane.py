#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Writes the demo's object, a toy biplane on a brass stand, and its ground: make_biplane.py OUT.obj

OUT.mtl is written beside it. The biplane is made in its own frame (x forward, y to its left, z up)
and then put into the rig's, in mm, its nose towards the camera. Nothing but the stand, within 30 mm
of the origin, is lower than 76 mm, so that stairs.toml can stand below it.
"""

import math
import pathlib
import sys

MATERIALS = {  # Kd, Ks, Ns
    "ground": ((0.8, 0.8, 0.8), 0.0, 1),
    "red": ((0.56, 0.028, 0.02), 0.20, 120),
    "cream": ((0.80, 0.70, 0.50), 0.05, 40),
    "white": ((0.82, 0.80, 0.74), 0.10, 80),
    "blue": ((0.03, 0.10, 0.38), 0.10, 80),
    "brass": ((0.55, 0.35, 0.10), 0.35, 90),
    "black": ((0.03, 0.03, 0.035), 0.12, 60),
    "steel": ((0.34, 0.35, 0.37), 0.35, 70),
    "wood": ((0.40, 0.18, 0.06), 0.12, 70),
    "leather": ((0.22, 0.09, 0.035), 0.06, 25),
    "skin": ((0.72, 0.42, 0.28), 0.03, 15),
    "yellow": ((0.88, 0.52, 0.03), 0.05, 30),
}
YAW, PITCH, ROLL = (math.radians(a) for a in (-122.0, 4.0, 9.0))
SCALE = 1.1
CENTRE = (2.0, 4.0, 132.0)


def in_rig(p):
    x, y, z = p
    y, z = y * math.cos(ROLL) - z * math.sin(ROLL), y * math.sin(ROLL) + z * math.cos(ROLL)
    x, z = x * math.cos(PITCH) - z * math.sin(PITCH), x * math.sin(PITCH) + z * math.cos(PITCH)
    x, y = x * math.cos(YAW) - y * math.sin(YAW), x * math.sin(YAW) + y * math.cos(YAW)
    return tuple(SCALE * a + b for a, b in zip((x, y, z), CENTRE))


def minus(a, b):
    return tuple(x - y for x, y in zip(a, b))


def cross(a, b):
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def unit(a):
    length = math.sqrt(sum(x * x for x in a))
    return tuple(x / length for x in a)


def spread(low, high, n):
    return [low + (high - low) * i / (n - 1) for i in range(n)]


def smooth_rows(table, n):
    """n rows along a table's rows, by Catmull-Rom cubics."""
    rows = []
    for position in spread(0.0, len(table) - 1.0, n):
        i = min(int(position), len(table) - 2)
        t = position - i
        p0, p1, p2, p3 = (table[min(max(k, 0), len(table) - 1)] for k in range(i - 1, i + 3))
        rows.append(tuple(b + 0.5 * t * (c - a + t * (2 * a - 5 * b + 4 * c - d + t * (3 * (b - c) + d - a)))
                          for a, b, c, d in zip(p0, p1, p2, p3)))
    return rows


class Mesh:
    """Smooth surfaces by material; points and normals that are equal are written once."""

    def __init__(self):
        self.points, self.normals, self.faces = {}, {}, {}

    def sheet(self, grid, material, place=in_rig):
        """A smooth surface through a grid of points; where its borders meet it has no edge.
        @param material  a name, or a function of the cell (i, j)"""
        keys = [[tuple(round(x, 2) for x in place(p)) for p in row] for row in grid]
        sums, cells = {}, []
        for i in range(len(grid) - 1):
            for j in range(len(grid[0]) - 1):
                face = [keys[i][j], keys[i + 1][j], keys[i + 1][j + 1], keys[i][j + 1]]
                area = cross(minus(face[2], face[0]), minus(face[3], face[1]))
                face = [key for n, key in enumerate(face) if key != face[n - 1]]
                if len(face) < 3 or area == (0.0, 0.0, 0.0):
                    continue
                for key in face:
                    sums[key] = tuple(x + y for x, y in zip(sums.get(key, (0.0, 0.0, 0.0)), area))
                cells.append((face, material(i, j) if callable(material) else material))
        for face, name in cells:
            self.faces.setdefault(name, []).append([
                (self.points.setdefault(key, len(self.points) + 1), self.normals.setdefault(
                    tuple(round(x, 3) for x in unit(sums[key])), len(self.normals) + 1)) for key in face])

    def tube(self, path, radius, material, n=8, ratio=1.0):
        """Along a path, flat by `ratio`, open at its ends. @param radius  one, or one a point"""
        rows = []
        for i, p in enumerate(path):
            along = unit(minus(path[min(i + 1, len(path) - 1)], path[max(i - 1, 0)]))
            side = unit(cross(along, (1, 0, 0) if abs(along[0]) < 0.7 else (0, 0, 1)))
            other = cross(along, side)
            r = radius[i] if isinstance(radius, list) else radius
            rows.append([tuple(p[k] + r * (ratio * math.cos(t) * side[k] + math.sin(t) * other[k]) for k in range(3))
                         for t in spread(0.0, 2 * math.pi, n + 1)])
        self.sheet(rows, material)

    def lathe(self, profile, material, n=28, axis="x", at=(0, 0, 0), place=in_rig):
        """Turned about an axis through `at`. @param profile  (along it, radius)"""
        order = {"x": (0, 1, 2), "y": (2, 0, 1), "z": (1, 2, 0)}[axis]
        rows = []
        for along, r in profile:
            turned = [(along, r * math.cos(t), r * math.sin(t)) for t in spread(0.0, 2 * math.pi, n + 1)]
            rows.append([tuple(q[order[k]] + at[k] for k in range(3)) for q in turned])
        self.sheet(rows, material, place)

    def ball(self, at, radii, material, n=16):
        self.sheet([[tuple(c + r * d for c, r, d in zip(at, radii, (
            math.cos(t) * math.sin(s), math.sin(t) * math.sin(s), math.cos(s))))
            for t in spread(0.0, 2 * math.pi, n + 1)] for s in spread(0.0, math.pi, n // 2 + 1)], material)

    def write(self, file):
        with open(file, "w", encoding="ascii") as out:
            out.write("# The demo's biplane, by scripts/make_biplane.py. SPDX-License-Identifier: Apache-2.0\n"
                      f"# millimetres, z up\nmtllib {file.with_suffix('.mtl').name}\no ground\nusemtl ground\n"
                      "v -1000 -1000 0\nv 1000 -1000 0\nv 1000 1000 0\nv -1000 1000 0\nf 1 2 3 4\no biplane\n")
            out.writelines("v " + " ".join(f"{x:.6g}" for x in p) + "\n" for p in self.points)
            out.writelines("vn " + " ".join(f"{x:.3g}" for x in n) + "\n" for n in self.normals)
            for name, faces in self.faces.items():
                out.write(f"usemtl {name}\n")
                out.writelines("f " + " ".join(f"{p + 4}//{n}" for p, n in face) + "\n" for face in faces)
        with open(file.with_suffix(".mtl"), "w", encoding="ascii") as out:
            out.write("# By scripts/make_biplane.py. SPDX-License-Identifier: Apache-2.0\n")
            for name, (kd, ks, exponent) in MATERIALS.items():
                out.write(f"newmtl {name}\nKd {' '.join(map(str, kd))}\nKs {ks} {ks} {ks}\nNs {exponent}\n")


class Wing:
    """From tip to tip, with rounded tips: x of the leading edge, chord, height, half a span."""

    def __init__(self, front, chord, height, half_span, dihedral=0.0, camber=0.0, thickness=0.09, tip=22.0):
        self.front, self.chord, self.height, self.half_span = front, chord, height, half_span
        self.dihedral, self.camber, self.thickness, self.tip = dihedral, camber, thickness, tip

    def at(self, x, y, side):
        """The point at fraction x of the chord. @param side  1: top, -1: bottom"""
        beyond = max(0.0, abs(y) - self.half_span + self.tip) / self.tip
        scale = 0.08 + 0.92 * math.sqrt(max(0.0, 1.0 - beyond**2.2)) if beyond < 1.0 else 0.0
        half = 5 * self.thickness * (0.2969 * math.sqrt(x) - 0.126 * x - 0.3516 * x**2 + 0.2843 * x**3 - 0.1036 * x**4)
        z = self.chord * scale * (4 * self.camber * x * (1 - x) + side * half)
        return (self.front - self.chord * (0.42 + (x - 0.42) * scale), y, self.height + self.dihedral * abs(y) + z)

    def draw(self, mesh, material, edges=(), place=in_rig, is_half=False):
        """@param material  a function of (y, x), the middle of a cell; @param edges  of |y| where it changes"""
        begin = self.half_span - self.tip
        half = sorted({0.0, *edges, *(begin + self.tip * math.sin(t) for t in spread(0.0, math.pi / 2, 8))})
        ys = half if is_half else [-y for y in reversed(half[1:])] + half
        xs = [0.5 - 0.5 * math.cos(t) for t in spread(0.0, math.pi, 13)]
        loop = [(x, 1) for x in reversed(xs)] + [(x, -1) for x in xs[1:]]
        mesh.sheet([[self.at(x, y, side) for x, side in loop] for y in ys],
                   lambda i, j: material(0.5 * (ys[i] + ys[i + 1]), 0.5 * (loop[j][0] + loop[j + 1][0])), place)

    def roundel(self, mesh, y, x, radius):
        rings = [0.0, 0.19, 0.38, 0.54, 0.70, 0.85, 1.0]
        grid = [[self.at(x - radius * r * math.cos(t) / self.chord, y + radius * r * math.sin(t), 1)
                 for t in spread(0.0, 2 * math.pi, 37)] for r in rings]
        mesh.sheet([[(a, b, c + 0.35) for a, b, c in row] for row in grid],
                   lambda i, j: ("red", "red", "white", "white", "blue", "blue")[i])


FUSELAGE = smooth_rows([  # x, half width, half height, height of the middle
    (48, 17.5, 18, 0), (36, 18, 18.6, 0), (20, 17.6, 18.4, 0.2), (2, 16, 17.6, 0.6), (-18, 13.6, 15.6, 1.6),
    (-40, 10.6, 12.2, 3.0), (-62, 7.6, 9.0, 4.2), (-84, 4.6, 6.4, 5.2), (-106, 1.6, 4.4, 6.0)], 33)


def fuselage_at(row, t):
    x, width, height, middle = row
    r = (abs(math.cos(t)) ** 2.5 + abs(math.sin(t)) ** 2.5) ** -0.4
    return (x, width * r * math.cos(t), middle + height * r * math.sin(t))


def fuselage_top(x, y):
    """The point of its upper side over (x, y)."""
    behind = next(i for i, row in enumerate(FUSELAGE) if row[0] <= x)
    front, back = FUSELAGE[behind - 1], FUSELAGE[behind]
    t = (front[0] - x) / (front[0] - back[0])
    _, width, height, middle = (a + t * (b - a) for a, b in zip(front, back))
    return (x, y, middle + height * max(0.0, 1 - abs(y / width) ** 2.5) ** 0.4)


def draw_fuselage(mesh):
    mesh.sheet([[fuselage_at(row, t) for t in spread(0.0, 2 * math.pi, 33)] for row in FUSELAGE],
               lambda i, j: "white" if i in (22, 23) else "red")
    mesh.lathe([(47, 17), (48, 19.4), (56, 19.8), (62, 18.8), (64.5, 17.0), (65, 15.2), (64, 14.4), (56, 14.2)], "brass", 36)
    mesh.lathe([(57, 0), (57, 14.3)], "black", 36)
    mesh.lathe([(57, 4.4), (63, 4.2), (64, 0)], "steel", 16)
    for k in range(7):  # the radial engine's cylinders, with their fins
        t = 2 * math.pi * (k + 0.25) / 7
        for i in range(4):
            rs = [4.6 + 2.6 * i + step for step in (0.0, 0.9, 1.8)]
            mesh.tube([(60.5, r * math.cos(t), r * math.sin(t)) for r in rs], [2.1, 2.9 - 0.1 * i, 2.1], "steel")


def draw_cockpit(mesh):
    rim = [fuselage_top(-10 + 12.5 * math.cos(t), 9.2 * math.sin(t)) for t in spread(0.0, 2 * math.pi, 29)]
    mesh.sheet([[(-10 + k * (x + 10), k * y, z + 1.2 - 0.7 * k) for x, y, z in rim] for k in (1.0, 0.5, 0.0)], "black")
    mesh.tube([(x, y, z + 0.5) for x, y, z in rim], 1.3, "leather")
    screen = [(5.0 - 3.8 * math.sin(t), 8.6 * math.cos(t), 15.8 + 10.5 * math.sin(t)) for t in spread(0, math.pi, 13)]
    mesh.tube(screen, 0.7, "brass", 6)
    mesh.tube([screen[6], (5.0, 0, 16.5)], 0.5, "brass", 6)
    mesh.ball((-12, 0, 17), (6, 8, 6), "leather")
    mesh.ball((-11, 0, 28.5), (6.3, 6.0, 7.2), "skin", 20)
    mesh.ball((-12.4, 0, 29.8), (6.7, 6.7, 7.2), "leather", 20)
    for side in (-1, 1):  # goggles
        mesh.ball((-5.2, 2.5 * side, 30.2), (1.2, 2.1, 2.1), "black", 12)
        mesh.tube([(-4.9, 2.5 * side + 2.3 * math.cos(t), 30.2 + 2.3 * math.sin(t)) for t in spread(0, 2 * math.pi, 15)],
                  0.6, "brass", 6)
    mesh.tube([(-11.6 + 5.0 * math.cos(t), 6.9 * math.sin(t), 30.4) for t in spread(0.5, 2 * math.pi - 0.5, 19)], 0.8, "black", 6)
    mesh.tube([(-11 + 4.9 * math.cos(t), 4.9 * math.sin(t), 22.6) for t in spread(0, 2 * math.pi, 17)], 1.9, "yellow")
    for shift, side in ((0.0, -3.0), (2.0, 2.0)):  # the scarf's ends
        mesh.tube([(-15.0 - 27 * s, side * (0.5 + s) + 2.4 * math.sin(7 * s + shift),
                    23.5 + 2.5 * s + 2.2 * math.sin(8 * s + shift)) for s in spread(0.0, 1.0, 14)],
                  [1.2 + 1.8 * s for s in spread(0.0, 1.0, 13)] + [0.0], "yellow", 8, 0.35)


def draw_wings(mesh):
    upper = Wing(43, 46, 38, 128, 0.02, 0.045, 0.11)
    lower = Wing(30, 42, -13, 114, 0.05, 0.045, 0.11)
    upper.draw(mesh, lambda y, x: "red" if 101 < abs(y) < 107 or abs(y) < 13 else "cream", (13, 101, 107))
    lower.draw(mesh, lambda y, x: "red" if 88 < abs(y) < 94 else "cream", (20, 88, 94))
    for side in (-1, 1):
        upper.roundel(mesh, 74 * side, 0.46, 18)
        for x in (0.18, 0.72):
            for y in (42, 84):
                mesh.tube([lower.at(x, y * side, 1), upper.at(x, (y + 2) * side, -1)], 1.5, "wood", 8, 0.6)
            for inner, outer in ((43, 84), (84, 43)):  # bracing wires, crossed
                mesh.tube([lower.at(x, inner * side, 1), upper.at(x, (outer + 2) * side, -1)], 0.4, "steel", 4)
            foot = 36 - 26 * x
            mesh.tube([fuselage_top(foot, 12 * side), upper.at(x, 16 * side, -1)], 1.2, "wood")
    Wing(-76, 30, 6.5, 46).draw(mesh, lambda y, x: "cream" if x < 0.6 else "red")
    Wing(-74, 36, 0.0, 38, tip=26.0).draw(
        mesh, lambda y, x: "red" if x < 0.43 else "blue" if x < 0.63 else "white" if x < 0.85 else "red",
        place=lambda p: in_rig((p[0] - 0.18 * p[1], p[2], 6.0 + p[1])), is_half=True)


def draw_propeller(mesh):
    table = [(3, 2.2, 2.2, 60), (8, 3.2, 1.6, 50), (18, 4.6, 1.1, 36), (28, 4.8, 0.8, 27), (36, 3.8, 0.6, 22), (40, 2.0, 0.4, 20)]
    sections = smooth_rows(table, 15) + [(41, 0.0, 0.0, 20)]
    for turn in (0.42, 0.42 + math.pi):
        rows = []
        for r, wide, thick, twist in sections:
            row = []
            for t in spread(0.0, 2 * math.pi, 11):
                u, v, a = wide * math.cos(t), thick * math.sin(t), math.radians(twist)
                x, across = 70 + u * math.sin(a) + v * math.cos(a), u * math.cos(a) - v * math.sin(a)
                row.append((x, r * math.sin(turn) + across * math.cos(turn), r * math.cos(turn) - across * math.sin(turn)))
            rows.append(row)
        mesh.sheet(rows, lambda i, j: "yellow" if i >= 12 else "wood")
    mesh.lathe([(62, 0), (66, 5.6), (69, 5.8), (73, 5.0), (77, 3.2), (79, 1.6), (79.8, 0)], "brass", 20)


def draw_gear(mesh):
    x0, z0 = 30.0, -35.0  # the axle
    mesh.tube([(x0, -30.0, z0), (x0, 30.0, z0)], 0.8, "steel")
    for side in (-1, 1):
        for x in (41.0, 14.0):
            mesh.tube([(x, 9.5 * side, -14.0), (x0, 21.0 * side, z0)], 1.2, "wood")
        y0 = 26.0 * side
        for major, minor, material, n in ((11.4, 2.4, "black", 10), (9.2, 0.8, "brass", 6)):
            mesh.sheet([[(x0 + (major + minor * math.cos(s)) * math.cos(t), y0 + minor * math.sin(s),
                          z0 + (major + minor * math.cos(s)) * math.sin(t)) for s in spread(0, 2 * math.pi, n + 1)]
                        for t in spread(0, 2 * math.pi, 33)], material)
        for k in range(12):  # spokes, left and right of the wheel's middle in turn
            t = math.pi * k / 6
            mesh.tube([(x0, y0 + (1.5 if k % 2 else -1.5), z0), (x0 + 9 * math.cos(t), y0, z0 + 9 * math.sin(t))], 0.45, "brass", 4)
        mesh.lathe([(-3.5, 0), (-3.5, 2.0), (3.5, 2.0), (3.5, 0)], "brass", 12, "y", (x0, y0, z0))
    mesh.tube([(-84, 0, 0), (-97, 0, -6), (-103, 0, -8)], [1.2, 1.0, 0.8], "wood")


def draw_stand(mesh):
    def stays(p):
        return p

    mesh.lathe([(0, 29), (2.4, 29), (3.6, 28.4), (4.2, 27.2), (5, 22), (6, 14), (7.5, 8)], "black", 40, "z", place=stays)
    mesh.lathe([(7.5, 8), (8.6, 7.6), (10, 5), (13, 3.6), (18, 2.8), (40, 2.4), (120, 2.2)], "brass", 20, "z", place=stays)
    mesh.lathe([(98, 2.2), (99, 3.6), (100.5, 4.2), (102, 3.6), (103, 2.2)], "brass", 20, "z", place=stays)


def main() -> int:
    if len(sys.argv) != 2:
        print("usage: make_biplane.py OUT.obj", file=sys.stderr)
        return 2
    mesh = Mesh()
    for draw in (draw_fuselage, draw_cockpit, draw_wings, draw_propeller, draw_gear, draw_stand):
        draw(mesh)
    mesh.write(pathlib.Path(sys.argv[1]))
    low = min(p[2] for p in mesh.points if math.hypot(p[0], p[1]) > 30.0)
    high = max(p[2] for p in mesh.points)
    print(f"{sum(map(len, mesh.faces.values()))} faces; from {low:.1f} to {high:.1f} mm, but for the stand")
    return 0


if __name__ == "__main__":
    sys.exit(main())
