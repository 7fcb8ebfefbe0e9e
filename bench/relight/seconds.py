#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""Predicted and measured seconds of `haarlight relight --max-error` and `--seconds`: the table of docs/numerics/relight.md ("Seconds").

    /usr/bin/python3 bench/relight/seconds.py build/release/apps/haarlight/haarlight BASIS.hlb ... --sky SKY.hdr --work DIR [--old HAARLIGHT]

Every command is a process of its own with one thread; medians of --repeats runs in turns. Predicted: what the program says before
it sums; measured: CPU milliseconds of relighting by its report; then user and system milliseconds of the whole command, and those of
another build (--old) with the same --max-error.
"""

import argparse
import json
import os
import pathlib
import statistics
import subprocess
import sys

WAYS = [("a sky, 0.1", ["--max-error", "0.1"]), ("a sky, 0.03", ["--max-error", "0.03"]),
        ("a sky, all", ["--seconds", "1000"]), ("24 frames, 0.1", ["--max-error", "0.1", "--frames", "24"]),
        ("24 frames, 0.03", ["--max-error", "0.03", "--frames", "24"])]


def run(words):
    child = subprocess.Popen([str(word) for word in words], stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
    said = child.stdout.read().decode(errors="replace")
    _, status, used = os.wait4(child.pid, 0)
    child.returncode = os.waitstatus_to_exitcode(status)
    if child.returncode not in (0, 1):  # 1: the file cannot promise that error
        sys.exit(f"{' '.join(map(str, words))}\n{said}")
    return 1e3 * (used.ru_utime + used.ru_stime)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("haarlight", type=pathlib.Path)
    parser.add_argument("basis", type=pathlib.Path, nargs="+")
    parser.add_argument("--sky", type=pathlib.Path, required=True)
    parser.add_argument("--work", type=pathlib.Path, required=True)
    parser.add_argument("--old", type=pathlib.Path)
    parser.add_argument("--repeats", type=int, default=5)
    options = parser.parse_args()
    options.work.mkdir(parents=True, exist_ok=True)
    print("| file | request | terms | from | predicted | measured | ratio | command | before |\n|---|---|---|---|---|---|---|---|---|")
    for basis in options.basis:
        for what, request in WAYS:
            rows, commands, before = [], [], []
            report = options.work / "report.json"
            end = ["--cubemap", options.sky, *request, "-o", options.work / "out.exr", "--threads", "1", "--quiet", "--force"]
            for _ in range(options.repeats):
                commands.append(run([options.haarlight, "relight", basis, *end, "--report", report]))
                rows.append(json.loads(report.read_text()))
                if options.old and "--seconds" not in request:
                    before.append(run([options.old, "relight", basis, *end]))
            middle = lambda key: 1e3 * statistics.median(row["details"][key] for row in rows)
            predicted, measured = middle("predicted_seconds"), middle("relight_cpu_seconds")
            print(f"| {basis.name} | {what} | {rows[-1]['reached']['terms']} | {rows[-1]['details']['form']} | {predicted:.1f} | {measured:.1f} | "
                  f"{measured / predicted:.2f} | {statistics.median(commands):.0f} | {f'{statistics.median(before):.0f}' if before else ''} |", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
