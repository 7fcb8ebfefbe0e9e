#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""NumPy's weighted sum and PyWavelets' transform beside haarlight's, as records of
docs/reference/tradeoff.schema.json.

Each round measures every method here and then runs relight_kernels for the same number of pixels
and threads, so that both see the same machine. From the project's folder, with Debian's
python3-numpy and python3-pywt:

    /usr/bin/python3 bench/relight/kernels.py --json OUT.json
"""

import argparse
import json
import os
import platform
import subprocess
import sys
import tempfile
import time

LIGHTS = 1024
GRID = 32


def parse():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--program", default="build/release/bench/relight/relight_kernels")
    parser.add_argument("--json", help="records of everything measured")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--repeats", type=int, default=3, help="runs of a method in each round")
    parser.add_argument("--copies", type=int, default=8, help="of 16384 pixels")
    parser.add_argument("--threads", type=int, default=1)
    return parser.parse_args()


ARGUMENTS = parse()
for variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):  # read when numpy is loaded
    os.environ[variable] = str(ARGUMENTS.threads)

import numpy as np  # noqa: E402
import pywt  # noqa: E402


def machine():
    with open("/proc/cpuinfo", encoding="ascii", errors="replace") as file:
        for line in file:
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    return platform.machine()


def relative_l2(found, truth):
    return float(np.linalg.norm(found - truth) / np.linalg.norm(truth))


def methods(pixels):
    """(algorithm, mode, version, run, error, bytes) of each method; results are checked against
    double sums of a part."""
    random = np.random.default_rng(1)
    rows = random.random((pixels, LIGHTS), dtype=np.float32)
    images = np.ascontiguousarray(rows.T)
    weights = (random.random(LIGHTS) ** 8).astype(np.float32)
    part = slice(0, min(pixels, 4096))
    truth = rows[part].astype(np.float64) @ weights.astype(np.float64)
    blocks = rows.reshape(pixels, GRID, GRID)

    def transform(values):
        return pywt.wavedec2(values, "haar", axes=(1, 2))

    def haar_error():
        ours = blocks[:8].astype(np.float64)
        worst = 0.0
        for block in ours:
            exact, _ = pywt.coeffs_to_array(pywt.wavedec2(block, "haar"))
            single, _ = pywt.coeffs_to_array(pywt.wavedec2(block.astype(np.float32), "haar"))
            worst = max(worst, relative_l2(single.astype(np.float64), exact))
        return worst

    size = rows.nbytes
    return [
        ("NumPy", "w @ A, image by image", np.__version__, lambda: weights @ images,
         lambda: relative_l2((weights @ images)[part], truth), size),
        ("NumPy", "A @ w, pixel by pixel", np.__version__, lambda: rows @ weights,
         lambda: relative_l2((rows @ weights)[part], truth), size),
        ("PyWavelets", "wavedec2 haar, all pixels in one call", pywt.__version__,
         lambda: transform(blocks), haar_error, 2 * size),
    ]


def ours(arguments):
    """relight_kernels' records of one short run."""
    with tempfile.TemporaryDirectory() as folder:
        path = os.path.join(folder, "records.json")
        subprocess.run(
            [arguments.program, "--copies", str(arguments.copies), "--sparse-copies", "16",
             "--repeats", str(arguments.repeats), "--threads", str(arguments.threads),
             "--json", path],
            check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        with open(path, encoding="utf-8") as file:
            return json.load(file)


def main(arguments):
    pixels = arguments.copies * 128 * 128
    command = "kernels.py " + " ".join(sys.argv[1:])
    times = {}
    records = {}
    runs = methods(pixels)
    for algorithm, mode, version, _, error, size in runs:
        records[algorithm, mode] = {
            "algorithm": algorithm, "mode": mode, "error_norm": "relative L2",
            "error": error(), "seconds": 0.0, "bytes": size,
            "conditions": {
                "machine": machine(), "processors": os.cpu_count(), "version": version,
                "command": command, "threads": arguments.threads, "lights": LIGHTS,
                "pixels": pixels, "environments": 1,
                "repeats": arguments.rounds * arguments.repeats}}
        times[algorithm, mode] = []
    for _ in range(arguments.rounds):
        for _ in range(arguments.repeats):
            for algorithm, mode, _, run, _, _ in runs:
                start = time.perf_counter()
                run()
                times[algorithm, mode].append(time.perf_counter() - start)
        for record in ours(arguments):
            key = record["algorithm"], record["mode"]
            records[key] = record
            times.setdefault(key, []).append(record["seconds"])
    for key, record in records.items():
        found = sorted(times[key])
        record["seconds"] = found[len(found) // 2]
        record["conditions"].update(load=os.getloadavg()[0], seconds_least=found[0],
                                    seconds_most=found[-1])
        at = record["conditions"]
        each = 1e9 * record["seconds"] / at["pixels"] / at["environments"]
        print(f"| {key[0]}: {key[1]} | {1e3 * record['seconds']:.1f} | "
              f"{1e-9 * record['bytes'] / record['seconds']:.1f} | {each:.1f} | "
              f"{record['error']:.2g} {record['error_norm']} |")

    def ratio(name, slow, fast):
        print(f"{name}: {records[slow]['seconds'] / records[fast]['seconds']:.1f}")

    dense = "haarlight", "dense half"
    ratio("NumPy w @ A / dense half", ("NumPy", "w @ A, image by image"), dense)
    ratio("NumPy A @ w / dense half", ("NumPy", "A @ w, pixel by pixel"), dense)
    ratio("PyWavelets / Haar transform",
          ("PyWavelets", "wavedec2 haar, all pixels in one call"),
          ("haarlight", "Haar transform, by tiles"))
    if arguments.json:
        with open(arguments.json, "w", encoding="utf-8") as file:
            json.dump(list(records.values()), file, indent=1)


if __name__ == "__main__":
    main(ARGUMENTS)
