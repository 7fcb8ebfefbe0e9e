# SPDX-License-Identifier: Apache-2.0
"""Scenes whose light is known in closed form, the true picture of each, and what renderers with a known fault would show.

Lengths in mm, z up, right-handed. A picture is the orthographic view of a small square; its value is the mean over all of
its pixels, red, green and blue. Surfaces are matte with an albedo, unless `kind` says "mirror" or "glass"; `emits` is the radiance that leaves
the front, which is where the corners go counter-clockwise. Backs emit nothing.
"""

import math

import numpy as np

RED_GREEN_BLUE = np.array([3.0, 2.0, 1.0])
ALBEDO = 0.7
MIDDLE = (12.0, -7.0)  # of the square on the floor that is seen
SQUARE = 40.0  # its side
SIDE = 16  # pixels


# ---- closed forms ---------------------------------------------------------------------------------


def polygon_irradiance(corners, point):
    """Of a horizontal floor at a point, under a polygon of radiance 1 above it [Lambert 1760]: half the sum over the edges of
    the angle that each is seen in, times the vertical part of the unit normal of its plane through the point."""
    ways = np.asarray(corners, float) - point
    ways /= np.linalg.norm(ways, axis=1)[:, None]
    total = 0.0
    for a, b in zip(ways, np.roll(ways, -1, axis=0)):
        normal = np.cross(a, b)
        length = np.linalg.norm(normal)
        total += math.atan2(length, a @ b) * normal[2] / length
    return abs(total) / 2.0


def disk_irradiance(centre, radius, point):
    """Under a disk of radiance 1 that is parallel to the floor: pi/2 (1 - (h^2 + a^2 - r^2)/sqrt((h^2 + a^2 + r^2)^2 - 4 r^2 a^2)), a the
    distance to its axis and h its height [Naraghi 1988]."""
    h = centre[2] - point[2]
    a = math.hypot(centre[0] - point[0], centre[1] - point[1])
    z = h * h + a * a + radius * radius
    return math.pi / 2.0 * (1.0 - (h * h + a * a - radius * radius) / math.sqrt(z * z - 4.0 * radius * radius * a * a))


def sphere_irradiance(centre, radius, point):
    """Of a sphere of radiance 1 that is above the horizon: pi (r/d)^2 cos."""
    way = np.subtract(centre, point)
    d = np.linalg.norm(way)
    return math.pi * radius**2 * way[2] / d**3


def by_points(corners, point, cosines=(1, 1), power=2):
    """The same as polygon_irradiance of a parallelogram, by 32 x 32 Gauss points; with other powers of the cosines at the floor and at the lamp, and of the distance."""
    nodes, weights = np.polynomial.legendre.leggauss(32)
    s, ws = (nodes + 1.0) / 2.0, weights / 2.0
    corners = np.asarray(corners, float)
    one, two = corners[1] - corners[0], corners[3] - corners[0]
    area = np.linalg.norm(np.cross(one, two))
    normal = np.cross(one, two) / area
    at = corners[0] + s[:, None, None] * one + s[None, :, None] * two
    ways = at - point
    d = np.linalg.norm(ways, axis=2)
    floor = ways[..., 2] / d
    lamp = np.abs(ways @ normal) / d
    values = floor**cosines[0] * lamp**cosines[1] / d**power
    return area * float(ws @ values @ ws)


def mean_over_square(function, middle=MIDDLE, side=SQUARE, n=8):
    """Of a smooth function of the floor's point, by n x n Gauss points."""
    nodes, weights = np.polynomial.legendre.leggauss(n)
    total = 0.0
    for x, wx in zip(nodes, weights):
        for y, wy in zip(nodes, weights):
            total += wx * wy / 4.0 * function(np.array([middle[0] + side / 2 * x, middle[1] + side / 2 * y, 0.0]))
    return total


# ---- what scenes are made of ----------------------------------------------------------------------


def quad(corners, albedo=0.0, emits=None, kind="matte"):
    return {"corners": [list(map(float, corner)) for corner in corners], "albedo": albedo, "emits": emits, "kind": kind}


def floor():
    return quad([(-300, -300, 0), (300, -300, 0), (300, 300, 0), (-300, 300, 0)], ALBEDO)


def lamp(low, high, z, emits=RED_GREEN_BLUE):
    """A rectangle that shines down."""
    return quad([(low[0], low[1], z), (low[0], high[1], z), (high[0], high[1], z), (high[0], low[1], z)],
                emits=list(map(float, emits)))


def down(middle=MIDDLE, side=SQUARE, height=40.0):
    """Looks straight down at a square of the floor."""
    return {"eye": [middle[0], middle[1], height], "target": [middle[0], middle[1], 0.0], "up": [0.0, 1.0, 0.0],
            "width": side, "size": SIDE}


def ball(radius, subdivisions, inwards):
    """Vertices and triangles of a ball about the origin, made of an icosahedron; its area is that of the sphere."""
    t = (1.0 + math.sqrt(5.0)) / 2.0
    vertices = [np.array(v) / math.hypot(1.0, t) for v in
                [(-1, t, 0), (1, t, 0), (-1, -t, 0), (1, -t, 0), (0, -1, t), (0, 1, t), (0, -1, -t), (0, 1, -t), (t, 0, -1),
                 (t, 0, 1), (-t, 0, -1), (-t, 0, 1)]]
    faces = [(0, 11, 5), (0, 5, 1), (0, 1, 7), (0, 7, 10), (0, 10, 11), (1, 5, 9), (5, 11, 4), (11, 10, 2), (10, 7, 6),
             (7, 1, 8), (3, 9, 4), (3, 4, 2), (3, 2, 6), (3, 6, 8), (3, 8, 9), (4, 9, 5), (2, 4, 11), (6, 2, 10), (8, 6, 7),
             (9, 8, 1)]
    for _ in range(subdivisions):
        middles, finer = {}, []

        def middle(a, b):
            key = (min(a, b), max(a, b))
            if key not in middles:
                between = vertices[a] + vertices[b]
                middles[key] = len(vertices)
                vertices.append(between / np.linalg.norm(between))
            return middles[key]
        for a, b, c in faces:
            ab, bc, ca = middle(a, b), middle(b, c), middle(c, a)
            finer += [(a, ab, ca), (b, bc, ab), (c, ca, bc), (ab, bc, ca)]
        faces = finer
    points, faces = np.array(vertices), np.array(faces)
    corners = points[faces]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum() / 2.0
    points *= radius * math.sqrt(4.0 * math.pi / area)
    return points, faces[:, ::-1] if inwards else faces


def mesh(radius, subdivisions, inwards, albedo=0.0, emits=None, kind="matte"):
    return {"radius": radius, "subdivisions": subdivisions, "inwards": inwards, "albedo": albedo, "emits": emits, "kind": kind}


# ---- the scenes -----------------------------------------------------------------------------------
# A scene: its parts, its picture's true value (RGB), by how much the parts may be off themselves (relative), and
# `faults`: what would be seen instead, by a fault's name.


def under(irradiance, parts, faults, rounding=2e-6, colour=RED_GREEN_BLUE):
    """A floor in the light of lamps: rho/pi E."""
    def shown(function):
        return ALBEDO / math.pi * colour * mean_over_square(function)
    return {**parts, "quads": [floor(), *parts.get("quads", [])], "camera": down(), "truth": shown(irradiance),
            "faults": {name: shown(function) for name, function in faults.items()}, "rounding": rounding}


def under_a_quad():
    one = lamp((-90, -50), (80, 70), 150)
    at = one["corners"]

    def shifted(point):
        return polygon_irradiance(at, point + np.array([SQUARE / SIDE / 2, SQUARE / SIDE / 2, 0.0]))
    return under(lambda p: polygon_irradiance(at, p), {"quads": [one]}, {
        "cosine at the floor twice": lambda p: by_points(at, p, (2, 1)),
        "no cosine at the floor": lambda p: by_points(at, p, (0, 1)),
        "cosine at the lamp twice": lambda p: by_points(at, p, (1, 2)),
        "no cosine at the lamp": lambda p: by_points(at, p, (1, 0)),
        "one of the lamp's two triangles": lambda p: polygon_irradiance(at[:3], p),
        "albedo instead of albedo/pi": lambda p: math.pi * polygon_irradiance(at, p),
        "pixels shifted by half a pixel": shifted,
        "k/(pi r^2) instead of (k - 1)/(pi r^2), k = 50": lambda p: 50.0 / 49.0 * polygon_irradiance(at, p)})


def under_a_disk():
    centre, radius = np.array([90.0, 60.0, 180.0]), 70.0
    nodes, weights = np.polynomial.legendre.leggauss(32)
    r, angle = radius * (nodes + 1.0) / 2.0, 2.0 * math.pi * np.arange(64) / 64
    ring = np.stack([np.cos(angle), np.sin(angle), 0.0 * angle], axis=1)

    def by_radius(p):
        """The area's part at r is drawn R/(2r) times as often as it should."""
        ways = centre + r[:, None, None] * ring - p
        values = (ways[..., 2] ** 2 / np.linalg.norm(ways, axis=2) ** 4).mean(axis=1)
        return math.pi * radius**2 * float(weights @ values) / 2.0
    return under(lambda p: disk_irradiance(centre, radius, p),
                 {"disks": [{"centre": centre.tolist(), "radius": radius, "emits": list(RED_GREEN_BLUE)}]},
                 {"drawn evenly by radius, weighted as by area": by_radius,
                  "the square around it": lambda p: polygon_irradiance(
                      [(20, -10, 180), (160, -10, 180), (160, 130, 180), (20, 130, 180)], p)}, rounding=1e-5)


def under_a_sphere():
    centre, radius = (40.0, 30.0, 120.0), 60.0
    return under(lambda p: sphere_irradiance(centre, radius, p),
                 {"spheres": [{"centre": list(centre), "radius": radius, "emits": list(RED_GREEN_BLUE)}]},
                 {"the disk through its middle": lambda p: disk_irradiance(centre, radius, p)})


def under_a_point():
    position = np.array([150.0, 90.0, 200.0])

    def light(p, power=3, cosine=1):
        way = position - p
        return 4e4 * way[2]**cosine / np.linalg.norm(way)**power
    return under(light, {"points": [{"position": list(position), "intensity": list(4e4 * RED_GREEN_BLUE)}]},
                 {"no cosine at the floor": lambda p: light(p, 2, 0),
                  "a power of 4 pi I taken for I": lambda p: light(p) / (4.0 * math.pi)})


def under_a_sun():
    way = np.array([0.3, -0.2, -0.7]) / math.sqrt(0.62)
    return under(lambda p: -2.5 * way[2], {"suns": [{"direction": list(way), "irradiance": list(2.5 * RED_GREEN_BLUE)}]},
                 {"no cosine at the floor": lambda p: 2.5})


def under_an_even_sky():
    return under(lambda p: math.pi, {"sky": 1.0}, {
        "no cosine at the floor": lambda p: 2.0 * math.pi,
        "directions drawn by the cosine, weighted as if evenly": lambda p: 4.0 * math.pi / 3.0}, colour=np.ones(3))


def under_nine_lamps():
    lamps = []
    for i in range(9):
        low = (-200 + 140 * (i % 3), -190 + 130 * (i // 3))
        lamps.append(lamp(low, (low[0] + 70, low[1] + 60), 140 + 4 * i, (i + 1) ** 2 * RED_GREEN_BLUE))
    last = lamps[-1]["corners"]

    def light(p, weights=None):
        return sum((1.0 if weights is None else weights[i]) * (i + 1) ** 2 * polygon_irradiance(one["corners"], p)
                   for i, one in enumerate(lamps))
    powers = np.array([(i + 1.0) ** 2 for i in range(9)])
    return under(light, {"quads": lamps},
                 {"lamps drawn by power, weighted as if evenly": lambda p: light(p, 9.0 * powers / powers.sum()),
                  "the last lamp is never drawn": lambda p: light(p) - 81.0 * polygon_irradiance(last, p)})


def in_a_mirror():
    """A lamp, and its image in a mirror that stands upright: both light the floor. Floor and mirror are perpendicular, so that
    nothing else goes from one to the other."""
    one = [(60, -40, 60), (60, -40, 140), (60, 60, 140), (60, 60, 60)]
    image = [(-2.0 * 60 - x, y, z) for x, y, z in one]
    mirror = quad([(-60, -290, 1), (-60, 290, 1), (-60, 290, 280), (-60, -290, 280)], kind="mirror")

    def light(p, reflected=1.0):
        return polygon_irradiance(one, p) + reflected * polygon_irradiance(image, p)
    return under(light, {"quads": [mirror, quad(one, emits=list(RED_GREEN_BLUE))]},
                 {"no light by way of mirrors": lambda p: light(p, 0.0), "a mirror of 98 %": lambda p: light(p, 0.98)})


def furnace():
    """Inside a box that glows and reflects: L/(1 - rho)."""
    rho, emits = 0.6, np.array([0.5, 1.0, 2.0])
    s = 100.0
    corners = [(x, y, z) for x in (-s, s) for y in (-s, s) for z in (-s, s)]
    sides = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)]
    quads = []
    for side in sides:
        at = np.array([corners[i] for i in side])
        normal = np.cross(at[1] - at[0], at[2] - at[0])
        if normal @ at[0] > 0.0:  # outwards
            at = at[::-1]
        quads.append(quad([tuple(corner) for corner in at], rho, list(emits)))
    camera = {"eye": [10.0, -20.0, 5.0], "target": [40.0, 30.0, -100.0], "up": [0.0, 1.0, 0.0], "width": 60.0, "size": SIDE}
    whole = emits / (1.0 - rho)
    return {"quads": quads, "camera": camera, "truth": whole, "rounding": 2e-6,
            "faults": {"paths end after 12 bounces": emits * (1.0 - rho**13) / (1.0 - rho),
                       "roulette after three bounces, by the albedo, without its weight":
                           emits * (1.0 + rho + rho**2 + rho**3 + rho**5 / (1.0 - rho**2))}}


def integrating_sphere():
    """A lamp without extent in the middle of a white ball: rho/pi I/R^2 / (1 - rho)."""
    rho, radius, intensity = 0.8, 100.0, 1e4 * RED_GREEN_BLUE
    direct = rho / math.pi * intensity / radius**2
    camera = {"eye": [0.0, 20.0, 30.0], "target": [0.0, 20.0, 100.0], "up": [0.0, 1.0, 0.0], "width": 30.0, "size": SIDE}
    return {"meshes": [mesh(radius, 6, True, rho)], "points": [{"position": [0.0, 0.0, 0.0], "intensity": list(intensity)}],
            "camera": camera, "truth": direct / (1.0 - rho), "rounding": 1e-4,
            "faults": {"one bounce is missing": direct / (1.0 - rho) - direct * rho,
                       "paths end after 20 bounces": direct * (1.0 - rho**20) / (1.0 - rho)}}


def ball_in_a_ball():
    """A glowing ball in a white one: B1 = E + rho1 B2, B2 = rho2 (F B1 + (1 - F) B2), F = A1/A2."""
    rho1, rho2, emits = 0.3, 0.75, np.array([2.0, 1.0, 0.5])
    f = (40.0 / 100.0) ** 2
    share = rho2 * f / (1.0 - rho2 * (1.0 - f))  # B2 = share B1
    outer = emits * share / (1.0 - rho1 * share)
    wrong = rho2 * 0.4 / (1.0 - rho2 * 0.6)
    camera = {"eye": [0.0, 0.0, 50.0], "target": [0.0, 0.0, 100.0], "up": [0.0, 1.0, 0.0], "width": 40.0, "size": SIDE}
    return {"meshes": [mesh(40.0, 6, False, rho1, list(emits)), mesh(100.0, 6, True, rho2)], "camera": camera,
            "truth": outer, "rounding": 1e-4,
            "faults": {"the inner ball reflects nothing": emits * share,
                       "the form factor by radius": emits * wrong / (1.0 - rho1 * wrong)}}


def glass_in_a_furnace():
    """A ball of glass under an even sky: whatever is reflected and refracted, 1."""
    camera = {"eye": [0.0, 0.0, 150.0], "target": [0.0, 0.0, 0.0], "up": [0.0, 1.0, 0.0], "width": 80.0, "size": SIDE}
    one, ior = np.ones(3), 1.5

    def fresnel(p):
        """Of what the ball reflects, seen from above: at the same angle also within."""
        sine = math.hypot(p[0], p[1]) / 60.0
        c, t = math.sqrt(1.0 - sine**2), math.sqrt(1.0 - (sine / ior) ** 2)
        return (((c - ior * t) / (c + ior * t)) ** 2 + ((ior * c - t) / (ior * c + t)) ** 2) / 2.0

    def seen(value):
        return one * mean_over_square(lambda p: value(fresnel(p)), (0.0, 0.0), 80.0)
    return {"meshes": [mesh(60.0, 5, False, kind="glass")], "sky": 1.0, "camera": camera, "truth": one, "rounding": 2e-6,
            "faults": {"radiance is divided by ior^2 on the way in, but not multiplied on the way out":
                           seen(lambda f: f + (1.0 - f) / ior**2),
                       "0.1 % is lost at each surface":
                           seen(lambda f: 0.999 * f + (0.999 * (1.0 - f)) ** 2 / (1.0 - 0.999 * f))}}


def through_a_pane():
    """A lamp straight through a pane of glass, all reflections between its sides: (1 - R)/(1 + R)."""
    r = ((1.5 - 1.0) / (1.5 + 1.0)) ** 2
    pane = []
    low, high = np.array([-100.0, -100.0, 20.0]), np.array([100.0, 100.0, 30.0])
    for axis in range(3):
        for end in (0, 1):
            a, b = (axis + 1) % 3, (axis + 2) % 3
            at = []
            for u, v in ((0, 0), (1, 0), (1, 1), (0, 1)):
                corner = np.zeros(3)
                corner[axis] = (low, high)[end][axis]
                corner[a], corner[b] = (low, high)[u][a], (low, high)[v][b]
                at.append(tuple(corner))
            pane.append(quad(at if end else at[::-1], kind="glass"))
    under_it = quad([(-50, -50, 0), (50, -50, 0), (50, 50, 0), (-50, 50, 0)], emits=list(RED_GREEN_BLUE))
    camera = {"eye": [0.0, 0.0, 60.0], "target": [0.0, 0.0, 0.0], "up": [0.0, 1.0, 0.0], "width": 40.0, "size": SIDE}
    return {"quads": [*pane, under_it], "camera": camera, "truth": RED_GREEN_BLUE * (1.0 - r) / (1.0 + r), "rounding": 2e-6,
            "faults": {"no reflection between the sides": RED_GREEN_BLUE * (1.0 - r) ** 2, "no Fresnel reflection": 1.0 * RED_GREEN_BLUE}}


SCENES = {one.__name__: one for one in
          (under_a_quad, under_a_disk, under_a_sphere, under_a_point, under_a_sun, under_an_even_sky, under_nine_lamps,
           in_a_mirror, furnace, integrating_sphere, ball_in_a_ball, glass_in_a_furnace, through_a_pane)}
