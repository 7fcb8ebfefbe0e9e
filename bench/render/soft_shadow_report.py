#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""Soft shadows by each method beside the exact ones, from file to file: the tables and plots of
docs/numerics/soft-shadow.md.

    /usr/bin/python3 bench/render/soft_shadow_report.py HAARLIGHT --work DIR [--size 512x512] [--repeats 5]
    ... --plot PLOTS.svg

HAARLIGHT: the program, of a release build. One thread; medians of the seconds that --report tells for grid and
shadows of one light (camera and pictures are not of any method). Writes DIR/report.json, and pictures of the
values, errors and kinds of each. Needs Debian's python3-numpy for --plot.
"""

import argparse
import json
import pathlib
import re
import statistics
import subprocess
import sys
import time

SOURCE = pathlib.Path(__file__).resolve().parent.parent.parent
SCENES = ("two", "distance", "small", "acute", "balls")
METHODS = {
    "exact": [],
    "d-buffer": ["--method", "d-buffer"],
    "paper": ["--method", "paper"],
    "paper, cubic": ["--method", "paper", "--visibility", "cubic"],
    "paper, linear": ["--method", "paper", "--visibility", "linear"],
    "point-silhouette": ["--method", "point-silhouette"],
    "1024 rays": ["--method", "rays", "--strata", "32"],
    "rays for 0.01 at 99 %": ["--method", "rays", "--max-error", "0.01"],
}


class Report:
    def __init__(self, options):
        self.options = options
        self.rows = []

    def run(self, scene, name, words, size, repeats=1):
        """@return the figures of one way to render a scene"""
        work = self.options.work
        compare = [] if not words else ["--compare", work / f"{name}-error.png"]
        shadows, whole = [], []
        for _ in range(repeats):
            begin = time.monotonic()
            subprocess.run([self.options.haarlight, "render", "soft-shadow", scene, "-o", work / f"{name}.exr", "--map",
                            work / f"{name}-map.png", "--size", size, "--threads", "1", "--quiet", "--force", "--report",
                            work / f"{name}.json", *words, *compare], check=True, stdout=subprocess.DEVNULL)
            whole.append(time.monotonic() - begin)
            told = json.loads((work / f"{name}.json").read_text())
            shadows.append(told["details"]["grid_seconds"] + told["details"]["shadow_seconds"])
        figures = {"scene": scene.stem, "name": name, "size": size, "seconds": statistics.median(shadows), "command_seconds":
                   statistics.median(whole), "penumbra_points": told["details"]["points_penumbra"],
                   "rays": told["details"]["rays"], "edges": told["details"]["edges"], **told["reached"]}
        self.rows.append(figures)
        return figures

    def methods(self, scene):
        exact = None
        print(f"\n{scene.stem}, {self.options.size}\n\n| method | s | of exact | mean | 99 % | worst | umbra, penumbra off by, pixels |\n"
              "|---|---|---|---|---|---|---|")
        for method, words in METHODS.items():
            name = f"{scene.stem}-{re.sub('[^a-z0-9]+', '-', method)}"
            repeats = 1 if "rays" in words else self.options.repeats  # hundreds of times as long
            found = self.run(scene, name, words, self.options.size, repeats)
            exact = exact or found
            errors = ("| | | | |" if not words else
                      f"| {found['mean_error']:.2g} | {found['error_at_99_percent']:.2g} | {found['worst_error']:.2g} "
                      f"| {found['umbra_border_pixels']:.0f}, {found['penumbra_border_pixels']:.0f} |")
            print(f"| {method} | {found['seconds']:.3f} | {found['seconds'] / exact['seconds']:.2f} {errors}", flush=True)

    def rates(self, scene):
        """The rows of the paper's table 1: pictures a second."""
        cells = []
        for size in ("300x300", "600x600", "1000x1000"):
            for method in ("exact", "d-buffer"):
                words = METHODS[method]
                found = self.run(scene, f"{scene.stem}-rate-{method}-{size}", words, size, self.options.repeats)
                cells.append(f"{1.0 / found['seconds']:.1f}")
        print(f"| {scene.stem} | {found['edges']} | {' | '.join(cells)} |", flush=True)

    def sweep(self, what, values, change, methods, words_of=lambda value: []):
        """@param change  the scene's text for a value @return {method: [(value, seconds, mean error)]}"""
        text = (SOURCE / "configs/scenes/soft_shadow_two.toml").read_text()
        series = {}
        print(f"\n| {what} | method | s | mean | 99 % |\n|---|---|---|---|---|")
        for value in values:
            scene = self.options.work / f"sweep-{what.replace(' ', '-')}-{value:g}.toml"
            scene.write_text(change(text, value))
            for method in methods:
                words = METHODS[method]
                found = self.run(scene, f"{scene.stem}-{method}", [*words, *(words_of(value) if words else [])], self.options.size,
                                 self.options.repeats)
                mean = found.get("mean_error", 0.0)
                series.setdefault(method, []).append((value, found["seconds"], mean))
                print(f"| {value:g} | {method} | {found['seconds']:.3f} | {mean:.2g} | {found.get('error_at_99_percent', 0.0):.2g} |", flush=True)
        return series


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("haarlight", type=pathlib.Path)
    parser.add_argument("--work", type=pathlib.Path, required=True)
    parser.add_argument("--size", default="512x512")
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--plot", type=pathlib.Path)
    options = parser.parse_args()
    options.work.mkdir(parents=True, exist_ok=True)
    report = Report(options)
    scenes = [SOURCE / f"configs/scenes/soft_shadow_{name}.toml" for name in SCENES]
    for scene in scenes:
        report.methods(scene)
    print("\n| scene | edges | 300: exact | d-buffer | 600: exact | d-buffer | 1000: exact | d-buffer |\n" + "|---" * 8 + "|")
    for scene in scenes:
        report.rates(scene)
    compared = ["exact", "d-buffer", "paper", "point-silhouette"]
    sweeps = {
        "texels of the D-buffer": report.sweep("texels", [32, 64, 128, 256, 512, 1024, 2048], lambda text, _: text,
                                               ["d-buffer", "paper"], lambda n: ["--d-buffer", str(n)]),
        "radius of the lamp, mm": report.sweep("radius", [1, 3, 10, 30, 60, 100],
                                               lambda text, r: text.replace("radius = 30", f"radius = {r}"), compared),
        "height of the lamp, mm": report.sweep("height", [200, 300, 500, 1000, 3000],
                                               lambda text, z: text.replace("[0, 0, 300]", f"[0, 0, {z}]"), compared),
    }
    (options.work / "report.json").write_text(json.dumps(report.rows, indent=1))
    if options.plot:
        from surface_plot import plot_sweeps
        plot_sweeps(sweeps, options.plot)
    return 0


if __name__ == "__main__":
    sys.exit(main())
