# SPDX-License-Identifier: Apache-2.0
"""Figures of surface_errors.py: error against samples and CPU time in the logarithms, strips of pictures; and of
soft_shadow_report.py and volume_report.py."""

import math
import struct
import zlib

import numpy as np

WIDTH, HEIGHT, LEFT, TOP, SIDE = 400, 300, 60, 30, 16
COLOURS = ["#1b6ca8", "#c44536", "#3a7d44", "#7b4b94", "#b07d2b", "#555555"]


def decades(values):
    low, high = math.log10(min(values)), math.log10(max(values))
    margin = 0.08 * (high - low) + 0.05
    return low - margin, high + margin


def ticks(low, high):
    marks = [m * 10.0 ** e for e in range(math.floor(low), math.ceil(high) + 1) for m in (1, 2, 5)]
    shown = [v for v in marks if low <= math.log10(v) <= high]
    return shown if len(shown) <= 8 else [v for v in shown if math.log10(v) % 1 < 1e-9]


def panel(x0, series, x_of, x_name, guide=None, y_of=lambda p: p[2]):
    """One plot. @param series  {row: [(samples, seconds, rmse)]} @param guide  of this row: dashed, slope -1/2"""
    points = {row: [(x_of(p), y_of(p)) for p in of_row] for row, of_row in series.items()}
    all_points = [p for of_row in points.values() for p in of_row]
    (x_low, x_high), (y_low, y_high) = (decades([p[i] for p in all_points]) for i in (0, 1))

    def at(x, y):
        return (x0 + LEFT + WIDTH * (math.log10(x) - x_low) / (x_high - x_low),
                TOP + HEIGHT * (y_high - math.log10(y)) / (y_high - y_low))

    out = [f'<rect x="{x0 + LEFT}" y="{TOP}" width="{WIDTH}" height="{HEIGHT}" fill="none" stroke="#888"/>',
           f'<text x="{x0 + LEFT + WIDTH / 2}" y="{TOP + HEIGHT + 36}" text-anchor="middle">{x_name}</text>']
    for value in ticks(x_low, x_high):
        x, _ = at(value, 10.0 ** y_low)
        out.append(f'<path d="M{x:.1f} {TOP}v{HEIGHT}" stroke="#ddd"/>'
                   f'<text x="{x:.1f}" y="{TOP + HEIGHT + 16}" text-anchor="middle">{value:g}</text>')
    for value in ticks(y_low, y_high):
        _, y = at(10.0 ** x_low, value)
        out.append(f'<path d="M{x0 + LEFT} {y:.1f}h{WIDTH}" stroke="#ddd"/>'
                   f'<text x="{x0 + LEFT - 6}" y="{y + 4:.1f}" text-anchor="end">{value:g}</text>')
    if guide is not None:
        start_x, start_y = points[guide][0]
        end_x = min(max(p[0] for p in all_points), start_x * (start_y / 10.0 ** y_low) ** 2)
        (ax, ay), (bx, by) = at(start_x, start_y), at(end_x, start_y * math.sqrt(start_x / end_x))
        out.append(f'<path d="M{ax:.1f} {ay:.1f}L{bx:.1f} {by:.1f}" stroke="#444" stroke-dasharray="5 4" fill="none"/>')
    for i, (row, of_row) in enumerate(points.items()):
        colour = COLOURS[i % len(COLOURS)]
        corners = [at(*p) for p in of_row]
        if not corners:
            continue
        out.append(f'<path d="M{"L".join(f"{x:.1f} {y:.1f}" for x, y in corners)}" stroke="{colour}" fill="none" '
                   'stroke-width="2"/>' + "".join(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="3" fill="{colour}"/>' for x, y in corners))
    return out


def plot(series, slopes, path):
    """Error against samples, and against CPU seconds. @param slopes  {row: slope by samples}"""
    rows = list(series)
    width = 2 * (LEFT + WIDTH) + SIDE
    height = TOP + HEIGHT + 50 + 18 * len(rows)
    out = [f'<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="{height}" font-family="sans-serif" font-size="12">',
           '<rect width="100%" height="100%" fill="white"/>',
           f'<text x="{LEFT}" y="18">RMSE; dashed: slope -1/2 from the first point of {rows[-1]}</text>']
    out += panel(0, series, lambda p: p[0], "samples per pixel", rows[-1])
    out += panel(LEFT + WIDTH, series, lambda p: p[1], "CPU seconds of the command", rows[-1])
    for i, row in enumerate(rows):
        y = TOP + HEIGHT + 56 + 18 * i
        out.append(f'<path d="M{LEFT} {y - 4}h24" stroke="{COLOURS[i % len(COLOURS)]}" stroke-width="2"/>'
                   f'<text x="{LEFT + 32}" y="{y}">{row}: slope {slopes[row]:.2f} by samples</text>')
    path.write_text("\n".join([*out, "</svg>\n"]))


def plot_sweeps(sweeps, path):
    """Mean error above, seconds below. @param sweeps  {what is varied: {row: [(value, seconds, error)]}}"""
    rows = list(dict.fromkeys(row for series in sweeps.values() for row in series))
    below = TOP + HEIGHT + 50
    width = len(sweeps) * (LEFT + WIDTH) + SIDE
    height = 2 * below + 18 * len(rows)
    out = [f'<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="{height}" font-family="sans-serif" font-size="12">',
           '<rect width="100%" height="100%" fill="white"/>',
           f'<text x="{LEFT}" y="18">mean error over the penumbra (the exact way has none); below: seconds a light</text>']
    for i, (what, series) in enumerate(sweeps.items()):
        # Every row keeps its colour; what has no error has no logarithm.
        padded = {row: series.get(row, []) for row in rows}
        out += panel(i * (LEFT + WIDTH), {row: [p for p in points if p[2] > 0.0] for row, points in padded.items()},
                     lambda p: p[0], what)
        out += [f'<g transform="translate(0 {below})">',
                *panel(i * (LEFT + WIDTH), padded, lambda p: p[0], what, y_of=lambda p: p[1]), "</g>"]
    for i, row in enumerate(rows):
        y = 2 * below + 18 * i
        out.append(f'<path d="M{LEFT} {y - 4}h24" stroke="{COLOURS[i % len(COLOURS)]}" stroke-width="2"/>'
                   f'<text x="{LEFT + 32}" y="{y}">{row}</text>')
    path.write_text("\n".join([*out, "</svg>\n"]))


def plot_errors_by_time(panels, path):
    """@param panels  {what x is: {row: [(seconds, error)]}}, the same rows in all"""
    rows = list(next(iter(panels.values())))
    width = len(panels) * (LEFT + WIDTH) + SIDE
    height = TOP + HEIGHT + 50 + 18 * len(rows)
    out = [f'<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="{height}" font-family="sans-serif" font-size="12">',
           '<rect width="100%" height="100%" fill="white"/>',
           f'<text x="{LEFT}" y="18">root mean square error of red, green and blue, against the seconds that the rays took</text>']
    for i, (what, series) in enumerate(panels.items()):
        out += panel(i * (LEFT + WIDTH), series, lambda p: p[0], what, y_of=lambda p: p[1])
    for i, row in enumerate(rows):
        y = TOP + HEIGHT + 56 + 18 * i
        out.append(f'<path d="M{LEFT} {y - 4}h24" stroke="{COLOURS[i % len(COLOURS)]}" stroke-width="2"/>'
                   f'<text x="{LEFT + 32}" y="{y}">{row}</text>')
    path.write_text("\n".join([*out, "</svg>\n"]))


def write_png(path, picture):
    """@param picture  (height, width, 3), 0..255"""
    def chunk(kind, body):
        return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))

    height, width, _ = picture.shape
    rows = b"".join(b"\0" + row.tobytes() for row in picture.astype(np.uint8))
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)) +
                     chunk(b"IDAT", zlib.compress(rows, 9)) + chunk(b"IEND", b""))


def strips(pictures, white, path):
    """Pictures side by side, each pixel 2 x 2, 8 between them. @param white  radiance that is shown as white"""
    height = pictures[0].shape[0]
    between = np.full((2 * height, 8, 3), 255.0)
    shown = []
    for picture in pictures:
        seen = 255.0 * np.clip(picture / white, 0.0, 1.0) ** (1.0 / 2.2)
        shown += [seen.repeat(2, axis=0).repeat(2, axis=1), between]
    write_png(path, np.concatenate(shown[:-1], axis=1))
