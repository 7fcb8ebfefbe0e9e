#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""How `mpirun -n N haarlight compress` scales on this machine: the same capture by one and two
processes (strong), and its left half by one beside the whole by two (weak). Captures the twin's
airplane twice on the virtual rig, with one thread per process, medians of interleaved runs.

ranks.py BIN [--repeats 5] [--size 320x240], BIN the build's folder apps/."""

import argparse
import hashlib
import json
import os
import pathlib
import re
import statistics
import subprocess
import sys
import tempfile

SOURCE = pathlib.Path(__file__).resolve().parent.parent.parent
sys.path.insert(0, str(SOURCE / "tests/apps"))
from programs import Programs, VirtualRig, free_port, rig_on_free_ports  # noqa: E402

STAGES = ("plate", "looked", "coded", "written")


def capture(programs, folder, width, height, of_width):
    """The demo's capture with another camera: the left `width` of `of_width` columns."""
    folder.mkdir()
    port = free_port()
    url = f"http://127.0.0.1:{port}"
    rig = folder / "rig.toml"
    focal = 439.596387 * of_width / 320
    changes = [("size", f"[{width}, {height + 8}]"), ("active_area", str(height)),
               ("K", f"[[{focal}, 0.0, {of_width / 2}], [0.0, {focal}, {height / 2}], [0.0, 0.0, 1.0]]")]
    rig_on_free_ports(SOURCE / "configs/rigs/cube32.toml", rig, folder, port, changes)
    virtual = VirtualRig(programs, rig, SOURCE / "configs/scenes/airplane.toml", folder, url)
    try:
        done = programs.run("capture", SOURCE / "configs/plans/quick.toml", "--daemon", url, "-o",
                            folder / "session", "--quiet", timeout=600)
        assert done.returncode == 0, done.stderr
    finally:
        virtual.end()
    return folder / "session"


def compress(programs, session, n):
    """One run by n processes of one thread. @return (seconds, seconds by stage, file's hash)"""
    file, report = session.parent / "basis.hlb", session.parent / "compress.json"
    words = [programs.haarlight, "compress", session, "-o", file, "--max-error", "0.01", "--threads",
             "1", "--memory", "1G", "--quiet", "--force", "--report", report]
    environment = dict(os.environ, OMPI_ALLOW_RUN_AS_ROOT="1", OMPI_ALLOW_RUN_AS_ROOT_CONFIRM="1",
                       OMPI_MCA_btl="self,vader")
    subprocess.run(["mpirun", "-n", str(n), "--bind-to", "none", *map(str, words)], check=True,
                   env=environment, stdout=subprocess.DEVNULL)
    said = json.loads(report.read_text())
    assert said["details"]["processes"] == n
    return (said["seconds"], {s: said["details"][f"seconds_{s}"] for s in STAGES},
            hashlib.sha256(file.read_bytes()).hexdigest())


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("bin")
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--size", default="320x240")
    arguments = parser.parse_args()
    width, height = map(int, re.fullmatch(r"(\d+)x(\d+)", arguments.size).groups())
    programs = Programs(arguments.bin)
    with tempfile.TemporaryDirectory(prefix="haarlight-ranks.") as place:
        place = pathlib.Path(place)
        whole = capture(programs, place / "whole", width, height, width)
        half = capture(programs, place / "half", width // 2, height, width)
        cases = {"the whole, 1 process": (whole, 1), "the whole, 2 processes": (whole, 2),
                 "its left half, 1 process": (half, 1)}
        found = {name: [] for name in cases}
        for _ in range(arguments.repeats):
            for name, (session, n) in cases.items():
                found[name].append(compress(programs, session, n))
        assert len({run[2] for name in list(cases)[:2] for run in found[name]}) == 1, \
            "the bytes depend on the processes"
        print(f"{width} x {height} pixels, 1024 lights, one thread per process, medians of "
              f"{arguments.repeats}; load {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores")
        print("| | seconds | " + " | ".join(STAGES) + " | rest |")
        print("|---|---|" + "---|" * (len(STAGES) + 1))
        median = {}
        for name, runs in found.items():
            total = statistics.median(run[0] for run in runs)
            parts = [statistics.median(run[1][s] for run in runs) for s in STAGES]
            median[name] = total
            print(f"| {name} | {total:.2f} | " + " | ".join(f"{p:.2f}" for p in parts) +
                  f" | {total - sum(parts):.2f} |")
        one, two, small = (median[name] for name in cases)
        print(f"\nstrong: {one / two:.2f} times as fast by two processes, efficiency {one / two / 2:.2f}")
        print(f"weak: two processes on twice the columns take {two / small:.2f} of one's time, "
              f"efficiency {small / two:.2f}")


if __name__ == "__main__":
    main()
