#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""The figures of [Williams98], methods side by side, on meshes that are to be had: docs/images/volume-methods.png, and
by how much each method is off.

    /usr/bin/python3 bench/render/volume_figures.py HAARLIGHT MESHES --work DIR --picture docs/images/volume-methods.png

MESHES: the folder with QuadraticCylinder of VTK's data, as vtkdata_Quadratic_CylinderQuadratic.vtk and ...Linear.vtk (1522
tetrahedra, with and without nodes on their edges; the speed of a flow).
Needs Debian's python3-numpy.
"""

import argparse
import pathlib
import subprocess
import sys

import numpy as np

from surface_plot import write_png

CYLINDER = {True: ("vtkdata_Quadratic_CylinderQuadratic.vtk", "velocity_norm"), False: ("vtkdata_Quadratic_CylinderLinear.vtk", "vel_norm")}
FLOW = """
[density]
field = "{field}"
points = [[0.0, 1.0], [0.25, 30.0], [0.35, 1.0], [0.55, 8.0], [0.6, 120.0], [0.65, 8.0], [0.85, 10.0], [0.95, 90.0], [1.01, 90.0]]

[colour]
field = "{field}"
points = [[0.0, 0.1, 0.2, 0.9], [0.3, 0.1, 0.7, 1.0], [0.6, 0.2, 1.0, 0.3], [0.8, 1.0, 0.9, 0.1], [1.01, 1.0, 0.2, 0.1]]
"""
GLASS = """
[density]
field = "{field}"
points = [[0.0, 0.0], [1.01, 0.0]]
""" + "".join(f"""
[[contour]]
field = "{{field}}"
value = {value}
colour = {colour}
opacity = 0.45
""" for value, colour in ((0.3, [0.2, 0.5, 1.0]), (0.6, [0.3, 0.9, 0.3]), (0.9, [1.0, 0.5, 0.2])))
SIDE = {"eye": [0.0, -0.16, 0.05], "target": [0.0, 0.0, 0.05], "up": [1.0, 0.0, 0.0], "fov_y_deg": 8.5}
MORE = 8.0  # times differences


class Figures:
    def __init__(self, options):
        self.options = options

    def render(self, mesh, look, words=()):
        """(100, 440, 3)"""
        work = self.options.work
        camera = "\n".join(f"{key} = {value}" for key, value in SIDE.items())
        (work / "figure.toml").write_text(f'schema = 1\n\n[mesh]\nfile = "{(self.options.meshes / mesh).resolve()}"\n{look}\n'
                                          f"[camera]\nsize = [440, 100]\n{camera}\n")
        subprocess.run([self.options.haarlight, "render", "volume", work / "figure.toml", "-o", work / "figure.exr", "--float64",
                        work / "figure.npy", "--quiet", "--force", *words], check=True, stdout=subprocess.DEVNULL)
        return np.load(work / "figure.npy")[..., :3]

    def flow(self, is_quadratic, look=FLOW, words=()):
        mesh, field = CYLINDER[is_quadratic]
        return self.render(mesh, look.format(field=field), words)


def told(name, picture, truth):
    off = picture - truth
    print(f"| {name} | {np.sqrt((off**2).mean()):.2g} | {np.abs(off).max():.2g} |")
    return np.hstack([picture, np.full((len(picture), 6, 3), 1.0), np.minimum(MORE * np.abs(off), 1.0)])


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("haarlight", type=pathlib.Path)
    parser.add_argument("meshes", type=pathlib.Path)
    parser.add_argument("--work", type=pathlib.Path, required=True)
    parser.add_argument("--picture", type=pathlib.Path, required=True)
    options = parser.parse_args()
    options.work.mkdir(parents=True, exist_ok=True)
    figures = Figures(options)
    print("| method | off, rms | largest |\n|---|---|---|")
    truth = figures.flow(True)
    linear = figures.flow(False)
    rows = [told("quadratic", truth, truth), told("linear, from the quadratic one", linear, truth)]
    for name, words in (("mean colours, cut at the tables' rows, from the linear one", ("--mode", "approximate")),
                        ("mean colours, whole cells", ("--mode", "approximate-unsliced")),
                        ("projected tetrahedra (m1)", ("--algorithm", "projected-tetrahedra"))):
        rows.append(told(name, figures.flow(False, words=words), linear))
    glass = figures.flow(True, GLASS)
    rows.append(told("surfaces in the quadratic field", glass, glass))
    rows.append(told("in the linear one, from these", figures.flow(False, GLASS), glass))
    gap = np.full((6, rows[0].shape[1], 3), 1.0)
    picture = np.vstack([part for row in rows for part in (row, gap)][:-1])
    write_png(options.picture, np.rint(255.0 * np.clip(picture, 0.0, 1.0)**(1.0 / 2.2)).astype(np.uint8))
    return 0


if __name__ == "__main__":
    sys.exit(main())
