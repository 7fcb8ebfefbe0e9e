# SPDX-License-Identifier: Apache-2.0
"""Pictures of a chessboard, drawn in closed form, and a rig whose camera could have taken them."""

import math

from programs import SOURCE, png_bytes, rig_on_free_ports

WIDTH, HEIGHT = 192, 144
COLS, ROWS, SQUARE = 9, 6, 40.0
BOARD = ["--board", f"{COLS},{ROWS}", "--square", SQUARE]
LENS = (270.0, 268.0, 97.5, 70.5)  # fx, fy, cx, cy


def turned(axis, angle):
    """A rotation matrix about the x, y or z axis."""
    c, s = math.cos(angle), math.sin(angle)
    i, j = [(1, 2), (2, 0), (0, 1)][axis]
    m = [[float(a == b) for b in range(3)] for a in range(3)]
    m[i][i] = m[j][j] = c
    m[i][j], m[j][i] = -s, s
    return m


def times(a, b):
    return [[sum(a[i][k] * b[k][j] for k in range(3)) for j in range(3)] for i in range(3)]


def draw_board(path, k, turn, middle):
    """A chessboard seen by a pinhole camera: each of 3 x 3 samples of a pixel meets the board's plane.
    turn: the board's axes in the camera's frame, as columns; middle: of the board there, mm."""
    fx, fy, cx, cy = k
    n = [turn[i][2] for i in range(3)]
    d = sum(n[i] * middle[i] for i in range(3))
    offsets = [(i + 0.5) / 3 for i in range(3)]
    rows = []
    for y in range(HEIGHT):
        row = bytearray()
        for x in range(WIDTH):
            white = 0
            for oy in offsets:
                for ox in offsets:
                    way = ((x + ox - cx) / fx, (y + oy - cy) / fy, 1.0)
                    t = d / (n[0] * way[0] + n[1] * way[1] + n[2])
                    at = [t * way[i] - middle[i] for i in range(3)]
                    u = sum(turn[i][0] * at[i] for i in range(3)) / SQUARE + 0.5 * (COLS + 1)
                    v = sum(turn[i][1] * at[i] for i in range(3)) / SQUARE + 0.5 * (ROWS + 1)
                    on = 0 <= u < COLS + 1 and 0 <= v < ROWS + 1
                    white += 0 if on and (int(u) + int(v)) % 2 else 1
            row.append(15 + 25 * white)
        rows.append(bytes(row))
    path.write_bytes(png_bytes(WIDTH, HEIGHT, rows))


def write_lab(target, sockets, http_port, changes=()):
    """The test rig with a larger picture."""
    rig_on_free_ports(SOURCE / "configs/rigs/small8.toml", target, sockets, http_port,
                      [("size", "[192, 152]"), ("active_area", "144"), ("fps", "60.0"),
                       ("exposure_us", "8000.0"),
                       ("K", "[[263.76, 0.0, 96.0], [0.0, 263.76, 72.0], [0.0, 0.0, 1.0]]"), *changes])


def draw_lens_boards(files):
    """Up to five pictures of the board, held in different ways."""
    for file, (ax, ay, az, x, y) in zip(files, [(0.5, 0.0, 0.0, 0.0, 0.0), (-0.5, 0.1, 0.2, 30.0, 0.0),
                                                (0.1, 0.5, -0.2, -30.0, 10.0),
                                                (0.0, -0.5, 0.3, 20.0, -20.0),
                                                (0.35, 0.35, 0.1, -20.0, -15.0)]):
        turn = times(turned(2, az), times(turned(1, ay), turned(0, ax)))
        draw_board(file, LENS, turn, [x, y, 680.0])


def draw_flat_board(file, tilt):
    """The board 3 mm over the plane of the rig file's camera, tilted about x, radians."""
    cam = [[1, 0, 0, 0], [0, -0.643509750887, 0.765437914212, -560],
           [0, -0.765437914212, -0.643509750887, 520]]
    world_from_board = times(turned(0, tilt), turned(0, math.pi))  # x right, y to the camera
    cam_from_world = [[cam[j][i] for j in range(3)] for i in range(3)]
    turn = times(cam_from_world, world_from_board)
    centre = [cam[i][3] for i in range(3)]
    middle = [sum(cam_from_world[i][j] * ([0.0, 5.0, 3.0][j] - centre[j]) for j in range(3))
              for i in range(3)]
    draw_board(file, LENS, turn, middle)
