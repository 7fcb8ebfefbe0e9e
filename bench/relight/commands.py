#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""What a user's commands cost beside NumPy and OpenCV, from file to file: the table of docs/numerics/relight.md ("Commands").

    /usr/bin/python3 bench/relight/commands.py build/release/apps/haarlight/haarlight SESSION --sky SKY.hdr --work DIR [--old HAARLIGHT]

SESSION: grey, 16 bit, a frame per light, as the virtual rig's. Every command is a process of its own with one thread; user and
system seconds of it, medians of --repeats runs in turns. NumPy reads the same frames and keeps the light transport matrix as
float32 in a .npy; it relights by matrix products and writes PNGs by zlib. It states no error, knows no dark frames, exposures or
clipped values, and is given the weights of a sky. OpenCV does the same with cv2.imread, cv2.gemm and cv2.imwrite; its version is
printed. --old: another build of haarlight, in the same turns. Needs Debian's python3-numpy; without python3-opencv its column is left out.
"""

import argparse
import json
import os
import pathlib
import statistics
import subprocess
import sys

NUMPY = '''
import sys, struct, zlib, json, pathlib
import numpy as np
def frame(path):
    data = np.fromfile(path, np.uint8)
    at = struct.unpack_from("<I", data, 4)[0]
    tags = {}
    for i in range(struct.unpack_from("<H", data, at)[0]):
        tag, kind, n, value = struct.unpack_from("<HHII", data, at + 2 + 12 * i)
        tags[tag] = value if n == 1 or tag != 273 else np.frombuffer(data, "<u4", 1, value)[0]
    first = tags[273]  # of the strips, which lie one after the other
    return data[first:first + 2 * tags[256] * tags[257]].view("<u2"), tags[256]
def png(path, picture, width):
    white = np.percentile(picture, 99.5)
    rows = (255 * np.clip(picture / white, 0, 1) ** (1 / 2.2)).astype(np.uint8).reshape(-1, width)
    raw = np.zeros((len(rows), width + 1), np.uint8)
    raw[:, 1:] = rows
    part = lambda name, body: struct.pack(">I", len(body)) + name + body + struct.pack(">I", zlib.crc32(name + body))
    head = struct.pack(">IIBBBBB", width, len(rows), 8, 0, 0, 0, 0)
    pathlib.Path(path).write_bytes(b"\\x89PNG\\r\\n\\x1a\\n" + part(b"IHDR", head) + part(b"IDAT", zlib.compress(raw.tobytes(), 6)) + part(b"IEND", b""))
work = sys.argv[2]
if sys.argv[1] == "build":
    files = sorted(pathlib.Path(sys.argv[3]).glob("frames/*.tif"))
    pixels, width = frame(files[0])
    matrix = np.empty((len(files), pixels.size), np.float32)
    for k, file in enumerate(files):
        matrix[k] = frame(file)[0]
    np.save(work + "/matrix.npy", matrix)
    json.dump(int(width), open(work + "/width.json", "w"))
else:
    width = json.load(open(work + "/width.json"))
    matrix = np.load(work + "/matrix.npy", mmap_mode="r")
    n = len(matrix)
    if sys.argv[1] == "light":
        pictures = matrix[200][None]
    else:
        weights = np.random.default_rng(1).random((24 if sys.argv[1] == "frames" else 1, n), np.float32)
        pictures = weights @ matrix
    for i, picture in enumerate(pictures):
        png(f"{work}/numpy-{i:04}.png", picture, width)
'''

OPENCV = '''
import sys, json, pathlib
import cv2
import numpy as np
cv2.setNumThreads(1)
def show(path, picture):
    white = np.percentile(picture, 99.5)
    cv2.imwrite(path, (255 * np.clip(picture / white, 0, 1) ** (1 / 2.2)).astype(np.uint8))
work = sys.argv[2]
if sys.argv[1] == "build":
    files = sorted(pathlib.Path(sys.argv[3]).glob("frames/*.tif"))
    first = cv2.imread(str(files[0]), cv2.IMREAD_UNCHANGED)
    matrix = np.empty((len(files), first.size), np.float32)
    for k, file in enumerate(files):
        matrix[k] = cv2.imread(str(file), cv2.IMREAD_UNCHANGED).ravel()
    np.save(work + "/matrix_cv.npy", matrix)
    json.dump(first.shape[:2], open(work + "/shape_cv.json", "w"))
else:
    shape = json.load(open(work + "/shape_cv.json"))
    matrix = np.load(work + "/matrix_cv.npy", mmap_mode="r")
    if sys.argv[1] == "light":
        pictures = matrix[200][None]
    else:
        weights = np.random.default_rng(1).random((24 if sys.argv[1] == "frames" else 1, len(matrix)), np.float32)
        pictures = cv2.gemm(weights, np.asarray(matrix), 1.0, None, 0.0)
    for i, picture in enumerate(pictures):
        show(f"{work}/opencv-{i:04}.png", picture.reshape(shape))
'''


def opencv_version():
    told = subprocess.run(["/usr/bin/python3", "-c", "import cv2; print(cv2.__version__)"], capture_output=True, text=True, check=False)
    return told.stdout.strip()


def cpu_seconds(words, environment):
    child = subprocess.Popen([str(word) for word in words], env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
    said = child.stdout.read()
    _, status, used = os.wait4(child.pid, 0)
    child.returncode = os.waitstatus_to_exitcode(status)
    if child.returncode != 0:
        sys.exit(f"{' '.join(map(str, words))}\n{said.decode(errors='replace')}")
    return used.ru_utime + used.ru_stime, used.ru_maxrss / 1024


def jobs(program, name, options):
    """(what, words, files that it writes) of haarlight's commands."""
    basis = options.work / f"{name}.hlb"
    out = options.work / f"{name}.png"
    frames = options.work / f"{name}_turn.png"
    turned = [frames.with_name(f"{frames.stem}-{i:04}.png") for i in range(24)]
    end = ["--threads", "1", "--quiet"]
    shadow = ["shadow", basis, "--light", "200", "--scene", options.scene, "--size", "240x180", "-o", out]
    return [("make the file", [program, "compress", options.session, "-o", basis, *end], [basis]),
            ("one light", [program, "relight", basis, "--light", "200", "-o", out, *end], [out]),
            ("a sky", [program, "relight", basis, "--cubemap", options.sky, "-o", out, *end], [out]),
            ("24 frames of a sky", [program, "relight", basis, "--cubemap", options.sky, "--frames", "24", "-o", frames, *end], turned),
            ("carve the hull, a shadow", [program, *shadow, *end], [out, pathlib.Path(f"{basis}.hull")]),
            ("a shadow from the kept hull", [program, *shadow, *end], [out])]


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("haarlight", type=pathlib.Path)
    parser.add_argument("session", type=pathlib.Path)
    parser.add_argument("--sky", type=pathlib.Path, required=True)
    parser.add_argument("--scene", default="configs/scenes/stairs.toml")
    parser.add_argument("--work", type=pathlib.Path, required=True)
    parser.add_argument("--old", type=pathlib.Path)
    parser.add_argument("--repeats", type=int, default=5)
    options = parser.parse_args()
    options.work.mkdir(parents=True, exist_ok=True)
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
    (options.work / "by_numpy.py").write_text(NUMPY)
    columns = {"haarlight": jobs(options.haarlight, "new", options)}
    if options.old:
        columns["before"] = jobs(options.old, "old", options)
    (options.work / "by_opencv.py").write_text(OPENCV)
    peers = {"NumPy": "by_numpy.py"}
    version = opencv_version()
    if version:
        peers[f"OpenCV {version}"] = "by_opencv.py"
    for name, script in peers.items():
        columns[name] = [(what, ["/usr/bin/python3", options.work / script, word, options.work, options.session], []) for what, word in
                         (("make the file", "build"), ("one light", "light"), ("a sky", "sky"), ("24 frames of a sky", "frames"))]
    seconds, memory = {}, {}
    for _ in range(options.repeats):
        for column, work in columns.items():
            for what, words, files in work:
                for file in files:
                    file.unlink(missing_ok=True)
                used, megabytes = cpu_seconds(words, environment)
                seconds.setdefault((what, column), []).append(used)
                memory[what, column] = max(megabytes, memory.get((what, column), 0.0))
    print(f"CPU seconds, medians of {options.repeats}, one thread (and the most memory, MB)\n")
    print("| | " + " | ".join(columns) + " |\n|---|" + "---|" * len(columns))
    for what, _, _ in columns["haarlight"]:
        cells = [f"{statistics.median(seconds[what, c]):.2f} ({memory[what, c]:.0f})" if (what, c) in seconds else "" for c in columns]
        print(f"| {what} | " + " | ".join(cells) + " |")
    sizes = [options.work / name for name in ("new.hlb", "matrix.npy")]
    print("\nbytes: " + json.dumps({path.name: path.stat().st_size for path in sizes}))
    return 0


if __name__ == "__main__":
    sys.exit(main())
