# SPDX-License-Identifier: Apache-2.0
"""What a ray gathers, in 40 digits, without any mesh: the ray is cut where it meets a plane of the bodies or a breakpoint of a
transfer function. On each piece extinction and glow are polynomials of the ray's parameter t. The optical depth is integrated
in closed form, the light by Gauss's rule on parts of a depth of at most 1. Surfaces where a field has a value lie between pieces."""

import mpmath
from mpmath import mpf

mpmath.mp.dps = 40
ENOUGH = 100  # optical depth behind which e^-100 = 4e-44 of the light is left
IN_PLANE = mpf("1e-9")


def gauss(n):
    """Nodes and weights on 0 ... 1, by Newton's method on Legendre's polynomial."""
    rule = []
    for k in range(n):
        x = mpmath.cos(mpmath.pi * (k + mpf(3) / 4) / (n + mpf(1) / 2))
        for _ in range(8):
            before, now = mpf(1), x
            for j in range(2, n + 1):
                before, now = now, ((2 * j - 1) * x * now - (j - 1) * before) / j
            slope = n * (x * now - before) / (x * x - 1)
            x -= now / slope
        rule.append(((1 - x) / 2, 1 / ((1 - x * x) * slope * slope)))
    return rule


# ---- polynomials: lists of coefficients, that of 1 first ------------------------------------------


def value(poly, t):
    result = mpf(0)
    for c in reversed(poly):
        result = result * t + c
    return result


def added(a, b):
    n = max(len(a), len(b))
    return [(a[i] if i < len(a) else 0) + (b[i] if i < len(b) else 0) for i in range(n)]


def times(a, b):
    result = [mpf(0)] * (len(a) + len(b) - 1)
    for i, x in enumerate(a):
        for j, y in enumerate(b):
            result[i + j] += x * y
    return result


def roots_between(poly, low, high):
    """Where it changes its sign, ascending: between its extrema it is monotonic, so that bisecting finds them all."""
    if len(poly) < 2 or all(c == 0 for c in poly[1:]):
        return []
    if len(poly) == 2:
        root = -poly[0] / poly[1]
        return [root] if low < root < high else []
    slope = [i * c for i, c in enumerate(poly)][1:]
    reach = max(abs(low), abs(high))
    is_monotonic = abs(slope[0]) > sum(abs(c) * reach**(i + 1) for i, c in enumerate(slope[1:]))
    ends = [low, *([] if is_monotonic else roots_between(slope, low, high)), high]
    found = []
    for a, b in zip(ends, ends[1:]):
        rises = value(poly, b) > 0
        if (value(poly, a) > 0) != rises:
            for _ in range(140):
                middle = (a + b) / 2
                a, b = (a, middle) if (value(poly, middle) > 0) == rises else (middle, b)
            found.append((a + b) / 2)
    return found


def along(field, origin, direction):
    """A field, {(i, j, k): coefficient of x^i y^j z^k}, as a polynomial of t."""
    lines = [[origin[axis], direction[axis]] for axis in range(3)]
    total = [mpf(0)]
    for powers, coefficient in field.items():
        term = [mpf(coefficient.numerator) / coefficient.denominator]
        for line, power in zip(lines, powers):
            for _ in range(power):
                term = times(term, line)
        total = added(total, term)
    return total


def gradient(field, p):
    return [sum(mpf(c.numerator) / c.denominator * powers[axis] *
                mpmath.fprod(p[i]**(power - (i == axis)) for i, power in enumerate(powers) if power > 0)
                for powers, c in field.items() if powers[axis] > 0) for axis in range(3)]


# ---- a scene -------------------------------------------------------------------------------------


class Transfer:
    """Piecewise linear between rows (x, values ...), constant outside."""

    def __init__(self, rows, scale):
        self.xs = [mpf(row[0]) for row in rows]
        self.rows = [[mpf(x) * mpf(scale) for x in row[1:]] for row in rows]

    def at(self, field, middle):
        """One polynomial per column, of the piece about `middle`."""
        x = value(field, middle)
        if x <= self.xs[0] or x >= self.xs[-1]:
            return [[y] for y in self.rows[0 if x <= self.xs[0] else -1]]
        i = max(i for i, low in enumerate(self.xs) if low <= x)
        width = self.xs[i + 1] - self.xs[i]
        return [added([c * (high - low) / width for c in field], [low - self.xs[i] * (high - low) / width])
                for low, high in zip(self.rows[i], self.rows[i + 1])]


class Truth:
    """The picture of a scene: a dictionary as in make_suite.py. Its numbers are what a program reads from the file: doubles."""

    def __init__(self, scene, mesh, fields, cell_fields, points=16, depth=1):
        self.rule = gauss(points)
        self.depth = depth  # of a part
        self.scene, self.body = scene, mesh["body"]
        self.fields, self.cell_fields = fields, cell_fields
        self.density = Transfer(scene["density"], scene.get("density_scale", 1.0))
        self.colour = Transfer(scene["colour"], scene.get("colour_scale", 1.0))
        self.names = (scene["field"], scene.get("colour_field", scene["field"]))
        self.contours = [{key: mpf(x) if key != "colour" else [mpf(c) for c in x] for key, x in contour.items()}
                         for contour in scene.get("contours", ())]
        self.background = [mpf(x) for x in scene.get("background", (0, 0, 0))]
        self.camera = scene["camera"]
        self.frame = self.frame_of(self.camera)

    @staticmethod
    def frame_of(camera):
        """Eye, right, down, forward."""
        if "world_from_cam" in camera:
            rows = camera["world_from_cam"]
            return [[mpf(row[column]) for row in rows] for column in (3, 0, 1, 2)]
        eye, target = ([mpf(x) for x in camera[key]] for key in ("eye", "target"))
        up = [mpf(x) for x in camera.get("up", (0, 0, 1))]
        forward = unit([b - a for a, b in zip(eye, target)])
        right = unit(cross(forward, up))
        return [eye, right, cross(forward, right), forward]

    def ray(self, x, y):
        """Origin and direction, of length 1 along the camera's axis, through a pixel's centre."""
        width, height = self.camera["size"]
        eye, right, down, forward = self.frame
        off = [x + mpf(1) / 2 - mpf(width) / 2, y + mpf(1) / 2 - mpf(height) / 2]
        if "width_mm" in self.camera:
            off = [mpf(self.camera["width_mm"]) / width * c for c in off]
            return [e + off[0] * r + off[1] * d for e, r, d in zip(eye, right, down)], forward
        if "K" in self.camera:
            k = [[mpf(c) for c in row] for row in self.camera["K"]]
            off = [(x + mpf(1) / 2 - k[0][2]) / k[0][0], (y + mpf(1) / 2 - k[1][2]) / k[1][1]]
        else:
            focal = mpf(height) / 2 / mpmath.tan(mpf(self.camera["fov_y_deg"]) * mpmath.pi / 360)
            off = [c / focal for c in off]
        return eye, [f + off[0] * r + off[1] * d for f, r, d in zip(forward, right, down)]

    def cuts(self, origin, direction, of_fields):
        """Ascending values of t between which nothing changes its formula; empty: the ray lies in a face of a body."""
        low = mpf(self.camera.get("near_mm", 0))
        high = mpf(self.camera.get("far_mm", "1e6"))
        found = [low, high]
        planes = [(plane, True) for plane in self.body.planes]
        planes += [(plane, False) for name in self.names if name in self.cell_fields
                   for plane in self.cell_fields[name].planes]
        for (normal, offset), is_face in planes:
            slope = sum(n * d for n, d in zip(normal, direction))
            start = sum(n * o for n, o in zip(normal, origin)) - offset
            if abs(slope) < IN_PLANE:
                if is_face and abs(start) < IN_PLANE:
                    return []
                continue
            found.append(-start / slope)
        for poly, transfer in zip(of_fields, (self.density, self.colour)):
            for x in transfer.xs:
                found += roots_between(added(poly, [-x]), low, high)
        return sorted(t for t in found if low <= t <= high)

    def field_along(self, name, origin, direction):
        return along(self.fields[name], origin, direction) if name in self.fields else [mpf(0)]

    def surfaces(self, origin, direction):
        """Those that the ray passes: (t, its optical depth, its light)."""
        found = []
        if not self.contours:
            return found
        field = self.fields[self.scene["contour_field"]]
        near, far = (mpf(self.camera.get(key, other)) for key, other in (("near_mm", 0), ("far_mm", "1e6")))
        towards = unit(direction)
        for contour in self.contours:
            for t in roots_between(added(along(field, origin, direction), [-contour["value"]]), near, far):
                p = [o + t * d for o, d in zip(origin, direction)]
                if self.body.contains(p):
                    cosine = abs(sum(n * d for n, d in zip(unit(gradient(field, p)), towards)))
                    found.append((t, *seen_of(contour, cosine)))
        return found

    def pieces(self, x, y):
        """(from, to, polynomials of the extinction and of R, G, B of the glow), each per unit of t; of a surface (t, depth,
        None, light); None: in a face."""
        origin, direction = self.ray(x, y)
        stretch = mpmath.sqrt(sum(d * d for d in direction))
        of_fields = [self.field_along(name, origin, direction) for name in self.names]
        cuts = self.cuts(origin, direction, of_fields)
        if not cuts:
            return None
        result = []
        for a, b in zip(cuts, cuts[1:]):
            middle = (a + b) / 2
            p = [o + middle * d for o, d in zip(origin, direction)]
            if b <= a or not self.body.contains(p):
                continue
            values = [[mpf(float(self.cell_fields[name].value(p)))] if name in self.cell_fields else poly
                      for name, poly in zip(self.names, of_fields)]
            density = [stretch * c for c in self.density.at(values[0], middle)[0]]
            colour = self.colour.at(values[1], middle)
            glow = ([times(k, density) for k in colour] if self.scene.get("glow", "chromaticity") == "chromaticity"
                    else [[stretch * c for c in k] for k in colour])
            result.append((a, b, density, glow))
        surfaces = self.surfaces(origin, direction)
        result = [(low, high, density, glow) for a, b, density, glow in result
                  for low, high in parts_of([a, b, *(t for t, *_ in surfaces if a < t < b)])]
        result += [(t, depth, None, light) for t, depth, light in surfaces]
        return sorted(result, key=lambda piece: (piece[0], piece[2] is not None))

    def pixel(self, x, y):
        """Red, green, blue, opacity; None: not a number, as the ray lies in a face of a body."""
        pieces = self.pieces(x, y)
        if pieces is None:
            return None
        depth, light = mpf(0), [mpf(0)] * 3
        for a, b, density, glow in pieces:
            depth = self.gather(a, b, density, glow, depth, light) if density else pass_surface(b, glow, depth, light)
            if depth > ENOUGH:
                break
        behind = mpmath.exp(-depth)
        return [c + behind * g for c, g in zip(light, self.background)] + [-mpmath.expm1(-depth)]

    def gather(self, a, b, density, glow, depth, light):
        """Adds to `light` what a piece emits. @return  the depth behind it"""
        depths = [mpf(0)] + [c / (i + 1) for i, c in enumerate(density)]
        parts = [(a, b)]
        while parts and depth <= ENOUGH:
            a, b = parts.pop()
            start = value(depths, a)
            part = value(depths, b) - start
            if part > self.depth:
                parts += [((a + b) / 2, b), (a, (a + b) / 2)]
                continue
            for s, weight in self.rule:
                t = a + s * (b - a)
                passed = weight * (b - a) * mpmath.exp(-depth - (value(depths, t) - start))
                for i in range(3):
                    light[i] += passed * value(glow[i], t)
            depth += part
        return depth

    def closed_form(self, x, y):
        """As pixel(), where extinction and chromaticity, or glow, are linear on every piece: by error functions."""
        depth, light = mpf(0), [mpf(0)] * 3
        for a, b, density, glow in self.pieces(x, y):
            if not density:
                depth = pass_surface(b, glow, depth, light)
                continue
            near, far = value(density, a) * (b - a), value(density, b) * (b - a)
            p = moments(near, far - near)
            passed = mpmath.exp(-depth)
            for i in range(3):
                values = [value(glow[i], a + s * (b - a)) * (b - a) for s in (mpf(0), mpf(1) / 2, mpf(1))]
                bend = 2 * values[0] - 4 * values[1] + 2 * values[2]
                light[i] += passed * (values[0] * p[0] + (values[2] - values[0] - bend) * p[1] + bend * p[2])
            depth += (near + far) / 2
        behind = mpmath.exp(-depth)
        return [c + behind * g for c, g in zip(light, self.background)] + [-mpmath.expm1(-depth)]


def parts_of(ends):
    ends.sort()
    return zip(ends, ends[1:])


def seen_of(contour, cosine):
    """A surface's optical depth and light: lit from the eye, more opaque where it is seen edge-on."""
    cosine = max(cosine, mpf("1e-6"))
    depth = -mpmath.log1p(-contour["opacity"]) / cosine if contour["opacity"] < 1 else mpf(2 * ENOUGH)
    shine = contour["specular"] * max(mpf(0), 2 * cosine**2 - 1)**contour["exponent"]
    return depth, [-mpmath.expm1(-depth) * (c * (contour["ambient"] + contour["diffuse"] * cosine) + shine)
                   for c in contour["colour"]]


def pass_surface(surface_depth, seen, depth, light):
    """@return  the depth behind it"""
    for i in range(3):
        light[i] += mpmath.exp(-depth) * seen[i]
    return depth + surface_depth


def moments(a, d):
    """Integrals of 1, s and s^2 times e^-(a s + d s^2/2), s from 0 to 1."""
    last = mpmath.exp(-a - d / 2)
    if abs(d) < mpf(10)**(10 - mpmath.mp.dps):
        if a == 0:
            return [mpf(1), mpf(1) / 2, mpf(1) / 3]
        zeroth = -mpmath.expm1(-a) / a
        first = (zeroth - last) / a
        return [zeroth, first, (2 * first - last) / a]
    w = mpmath.sqrt(2 * abs(d))
    p, q = a / w, (a + d) / w
    scale = mpmath.sqrt(mpmath.pi) / w
    if d > 0:
        zeroth = scale * mpmath.exp(p * p) * (mpmath.erfc(p) - mpmath.erfc(q))
    else:
        zeroth = scale * mpmath.exp(-p * p) * (mpmath.erfi(p) - mpmath.erfi(q))
    first = (1 - last - a * zeroth) / d
    return [zeroth, first, (zeroth - last - a * first) / d]


def cross(a, b):
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


def unit(v):
    length = mpmath.sqrt(sum(c * c for c in v))
    return [c / length for c in v]
