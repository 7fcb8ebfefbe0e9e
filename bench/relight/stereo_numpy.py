#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""Photometric stereo by NumPy's masked least squares beside `haarlight shape --method least-squares`.

Both read the frames of an imported session (8-bit sRGB, lights by direction) and write normals;
each run is a process of its own, of one thread, in turn; CPU seconds with everything inside.
NumPy does less: no mask, albedo, standard errors, heights or previews. From the project's
folder, with Debian's python3-numpy:

    build/release/apps/haarlight/haarlight import FOLDER --lights FOLDER/dirs.lp -o ball.session
    /usr/bin/python3 bench/relight/stereo_numpy.py ball.session
"""

import argparse
import json
import os
import pathlib
import resource
import statistics
import struct
import subprocess
import sys
import tempfile

for variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):  # read when numpy is loaded
    os.environ[variable] = "1"

import numpy as np  # noqa: E402

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[2] / "tests" / "apps"))
from picture_files import read_exr  # noqa: E402

DARK = 0.05  # of the value that a tenth of the samples exceed: as haarlight shape


def parse():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("session", type=pathlib.Path)
    parser.add_argument("--program", default=["build/release/apps/haarlight/haarlight"], nargs="+",
                        help="one or more, for an older one beside it")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--solve", type=pathlib.Path, help="only NumPy's: normals to this .npy")
    return parser.parse_args()


def frame_of(path, height, width, channels):
    """The samples of an uncompressed TIFF."""
    data = path.read_bytes()
    at, = struct.unpack_from("<I", data, 4)
    n, = struct.unpack_from("<H", data, at)
    tags = {}
    for i in range(n):
        tag, kind, count, value = struct.unpack_from("<HHII", data, at + 2 + 12 * i)
        size = {3: 2, 4: 4}.get(kind, 0)
        if size and count * size > 4:
            value = struct.unpack_from("<" + "HI"[size == 4] * count, data, value)
        tags[tag] = value if isinstance(value, tuple) else (value & 0xFFFF if kind == 3 else value,)
    assert tags[259] == (1,), "no compression"
    strips = [data[begin:begin + size] for begin, size in zip(tags[273], tags[279])]
    return np.frombuffer(b"".join(strips), np.uint8).reshape(height * width, channels)


def solve(session, output):
    told = json.loads((session / "session.json").read_text())
    form = told["form"]
    assert form["sample"] == "u8" and form["transfer"] == "srgb", "8-bit sRGB"
    coded = np.arange(256) / 255.0
    linear = np.where(coded <= 0.04045, coded / 12.92, ((coded + 0.055) / 1.055) ** 2.4).astype(np.float32)
    lights = np.array([light["direction"] for light in told["lights"]])
    values = np.empty((len(lights), form["height"] * form["width"]), np.float32)
    is_open = np.empty(values.shape, bool)
    for k, frame in enumerate(told["frames"]):
        samples = frame_of(session / frame["file"], form["height"], form["width"], form["channels"])
        linear[samples].mean(axis=1, out=values[k])
        is_open[k] = samples.max(axis=1) < 255
    rank = int(0.9 * (len(lights) - 1))
    least = DARK * np.partition(np.where(is_open, values, -1.0), rank, axis=0)[rank]
    counts = ((values > least) & is_open).astype(np.float64)
    products = np.stack([lights[:, i] * lights[:, j] for i in range(3) for j in range(3)], axis=1)
    matrix = (counts.T @ products).reshape(-1, 3, 3)
    right = (counts * values).T @ lights
    is_known = np.linalg.det(matrix) > 1e-6
    matrix[~is_known] = np.eye(3)
    b = np.linalg.solve(matrix, right[..., None])[..., 0]
    b[~is_known] = 0.0
    normals = b / np.maximum(np.linalg.norm(b, axis=1, keepdims=True), 1e-30)
    np.save(output, normals.reshape(form["height"], form["width"], 3).astype(np.float32))


def cpu_seconds(command):
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def main():
    arguments = parse()
    if arguments.solve:
        solve(arguments.session, arguments.solve)
        return
    with tempfile.TemporaryDirectory() as folder:
        normals = pathlib.Path(folder) / "normals.npy"
        shape = pathlib.Path(folder) / "shape"
        commands = {"numpy": [sys.executable, __file__, str(arguments.session), "--solve", str(normals)]}
        for program in arguments.program:
            commands[program] = [program, "shape", str(arguments.session), "-o", str(shape), "--method",
                                 "least-squares", "--light", "far", "--mask", "none", "--mesh", "none",
                                 "--threads", "1", "--quiet", "--force"]
        seconds = {name: [] for name in commands}
        for _ in range(arguments.rounds):
            for name, command in commands.items():
                seconds[name].append(cpu_seconds(command))
        for name, times in seconds.items():
            print(f"{name}: {statistics.median(times):.2f} CPU s")
        ours = read_exr(shape / "normals.exr")[2]
        mine = np.stack([np.array(ours[c]) for c in "RGB"], axis=1).astype(np.float64)
        other = np.load(normals).reshape(-1, 3).astype(np.float64)
        both = (np.linalg.norm(mine, axis=1) > 0) & (np.linalg.norm(other, axis=1) > 0)
        angles = np.degrees(np.arctan2(np.linalg.norm(np.cross(mine[both], other[both]), axis=1),
                                       (mine[both] * other[both]).sum(axis=1)))
        print(f"{both.sum()} pixels: median {np.median(angles):.2g}, largest {angles.max():.2g} degrees apart")


if __name__ == "__main__":
    main()
