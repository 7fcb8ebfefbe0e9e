# SPDX-License-Identifier: Apache-2.0
"""What a camera sees of a unit cube whose field is linear in x, y and z: no mesh, no cells, no code of the renderer."""

import numpy as np

GAUSS_POINTS = 32  # per part between two breakpoints, of depths up to ten: exact to rounding
ROWS = 16384  # rays at a time


def rays(camera, size, beside):
    """@param beside  the pixels' centres, (x, y) in pixels: right and down
    @return eye, and directions (size * size, 3), row by row from the top"""
    eye, target, up = (np.array(camera[name], float) for name in ("eye", "target", "up"))
    forward = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(forward, up)
    right /= np.linalg.norm(right)
    down = np.cross(forward, right)
    focal = 0.5 * size / np.tan(0.5 * np.radians(camera["fov_y_deg"]))
    steps = (np.arange(size) + 0.5 - 0.5 * size) / focal
    x, y = np.meshgrid(steps + beside[0] / focal, steps + beside[1] / focal)
    directions = forward + x.reshape(-1, 1) * right + y.reshape(-1, 1) * down
    return eye, directions / np.linalg.norm(directions, axis=1, keepdims=True)


def within_cube(eye, directions):
    """@return distances along the rays where they enter the unit cube and leave it; equal where they miss it"""
    with np.errstate(divide="ignore"):
        low, high = (0.0 - eye) / directions, (1.0 - eye) / directions
    enters = np.maximum(np.minimum(low, high).max(axis=1), 0.0)
    return enters, np.maximum(np.maximum(low, high).min(axis=1), enters)


def light(eye, directions, slopes, density, colour):
    """@param slopes  of the field, 0 at the origin @param density, colour  rows of breakpoint and values, the same breakpoints
    @return R, G, B and opacity of each ray"""
    points, weights = np.polynomial.legendre.leggauss(GAUSS_POINTS)
    points, weights = 0.5 * (points + 1.0), 0.5 * weights
    breakpoints = density[:, 0]
    enters, leaves = within_cube(eye, directions)
    start, rate = eye @ slopes, directions @ slopes
    crossings = (breakpoints - start) / rate[:, None]
    ends = np.sort(np.clip(crossings, enters[:, None], leaves[:, None]), axis=1)
    ends = np.concatenate([enters[:, None], ends, leaves[:, None]], axis=1)
    picture = np.zeros((len(directions), 4))
    depth = np.zeros(len(directions))
    for near, far in zip(ends.T[:-1], ends.T[1:]):
        length = far - near
        at = near[:, None] + length[:, None] * points
        value = start + rate[:, None] * at
        rho = np.interp(value, breakpoints, density[:, 1])
        rho_near = np.interp(start + rate * near, breakpoints, density[:, 1])
        rho_far = np.interp(start + rate * far, breakpoints, density[:, 1])
        # rho is linear here: its integral from the near end is that of a trapezium.
        depths = depth[:, None] + 0.5 * (rho_near[:, None] + rho) * points * length[:, None]
        emitted = rho * np.exp(-depths) * weights * length[:, None]
        for channel in range(3):
            picture[:, channel] += (emitted * np.interp(value, breakpoints, colour[:, 1 + channel])).sum(axis=1)
        depth += 0.5 * (rho_near + rho_far) * length
    picture[:, 3] = -np.expm1(-depth)
    return picture


def picture(camera, size, slopes, density, colour, beside=(0.0, 0.0)):
    """@return (size, size, 4) doubles"""
    eye, directions = rays(camera, size, beside)
    enters, leaves = within_cube(eye, directions)
    found = np.zeros((size * size, 4))
    hit = np.flatnonzero(leaves > enters)
    for part in np.array_split(hit, max(len(hit) // ROWS, 1)):
        found[part] = light(eye, directions[part], np.asarray(slopes), np.asarray(density), np.asarray(colour))
    return found.reshape(size, size, 4)
