#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""`haarlight render surface --integrator auto` beside every fixed choice that it may take: the table of
docs/numerics/surface.md.

    python3 bench/render/auto_choice.py HAARLIGHT SCENE.toml... [--max-error 0.02] [--seeds 3] [--size 256x256]

HAARLIGHT: the program, of a release build. CPU seconds of the whole command until the film's own error is at most
--max-error, the pilot included; medians of the seeds, choices in turns.
"""

import argparse
import json
import os
import pathlib
import statistics
import subprocess
import tempfile


def render(options, scene, seed, words, folder):
    """@return CPU seconds of the command, its report"""
    report = folder / "report.json"
    size = ["--size", options.size] if options.size else []
    before = os.times()
    subprocess.run([options.haarlight, "render", "surface", scene, "-o", folder / "picture.tif", "--quiet", "--force", "--report", report,
                    "--max-error", str(options.max_error), "--seed", str(seed), *size, *words], check=True, stdout=subprocess.DEVNULL)
    after = os.times()
    seconds = after.children_user + after.children_system - before.children_user - before.children_system
    return seconds, json.loads(report.read_text())


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("haarlight")
    parser.add_argument("scenes", nargs="+", type=pathlib.Path)
    parser.add_argument("--max-error", type=float, default=0.02)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--size")
    options = parser.parse_args()
    print("| scene | choice | CPU s | samples | over the best | predicted / needed | pilot CPU s |\n|---|---|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as place:
        folder = pathlib.Path(place)
        for scene in options.scenes:
            found = {}
            for seed in range(1, options.seeds + 1):
                seconds, report = render(options, scene, seed, ["--integrator", "auto"], folder)
                found.setdefault("auto", []).append((seconds, report))
                for name in report["details"]["pilot_candidates"].split("; "):
                    found.setdefault(name, []).append(render(options, scene, seed, ["--integrator", *name.split()], folder))
            medians = {name: statistics.median(s for s, _ in runs) for name, runs in found.items()}
            best = min(seconds for name, seconds in medians.items() if name != "auto")
            for name, runs in found.items():
                samples = statistics.median(report["reached"]["samples_per_pixel"] for _, report in runs)
                ends = ""
                if name == "auto":
                    chosen = sorted({" ".join((r["reached"]["integrator"], r["reached"]["lights"], r["reached"]["sampling"]))
                                     for _, r in runs})
                    name = f"auto: {', '.join(chosen)}"
                    ratio = statistics.median(r["details"]["predicted_samples"] / r["reached"]["needed_samples"] for _, r in runs)
                    ends = f"{ratio:.2f} | {statistics.median(r['details']['pilot_cpu_seconds'] for _, r in runs):.3f}"
                print(f"| {scene.name} | {name} | {medians[name.split(':')[0]]:.2f} | {samples:g} | "
                      f"{medians[name.split(':')[0]] / best:.2f} | {ends or ' | '} |", flush=True)


if __name__ == "__main__":
    main()
