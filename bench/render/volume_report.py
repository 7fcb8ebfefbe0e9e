#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""Exact pictures of volumes beside VTK's, and both beside a closed form: the tables of docs/numerics/volume.md.

    /usr/bin/python3 bench/render/volume_report.py HAARLIGHT --work DIR [--repeats 3] [--only vtk error cells faces modes sort published preview]
    ... --only modes --plot PLOT.svg [--segment-cost PROGRAM]
    ... --only published [--depth-sort PROGRAM]

HAARLIGHT: the program, of a release build. Unit cubes of 6 n^3 tetrahedra with a linear field and five breakpoints, one
view, 300 x 300 and 1000 x 1000 pixels; one thread each, in turns, medians, and ZSweep once. Ours goes from file to file; `prepare` and
`render` are what --report tells, times the part of the processor that the command got: CPU seconds, as all the others.
Writes DIR/report.json. Needs Debian's python3-numpy; for VTK python3-vtk9 and an X server (xvfb-run -a ...), and goes
without where they are missing.
"""

import argparse
import itertools
import json
import math
import os
import pathlib
import statistics
import subprocess
import sys
import time

import numpy as np

import volume_closed_form
import volume_meshes

HERE = pathlib.Path(__file__).resolve().parent
CUBES = (13, 32, 46, 55)
SIZES = (300, 1000)
SLOPES = (1.0 / 6.0, 2.0 / 6.0, 3.0 / 6.0)
DENSITY = [[0.0, 0.25], [0.3, 4.5], [0.55, 0.5], [0.8, 5.0], [1.0, 1.0]]
COLOUR = [[0.0, 0.1, 0.2, 0.9], [0.3, 0.9, 0.1, 0.2], [0.55, 0.2, 0.9, 0.3], [0.8, 1.0, 0.9, 0.1], [1.0, 0.3, 0.3, 1.0]]
CAMERA = {"eye": [1.9, 2.2, 3.1], "target": [0.5, 0.5, 0.5], "up": [0.0, 0.0, 1.0], "fov_y_deg": 32.0}
HALF_PIXEL = (-0.5, 0.5)  # where VTK's ray caster has its rays; the others have them in the pixels' centres
ONCE = ("ZSweep",)  # takes many times as long
FROM_SMALL = ("sh", "-c", '"$0" "$@"; exit $?')  # a process begins with the largest memory of the one that starts it
RIM = 2  # pixels at the silhouette, left out of the second pair of errors
OPAQUE = 40.0  # times as dense
MODES = {  # the plot joins those of one name
    "exact": [("", [])],
    "gauss": [("2, 0.1", ["--points", "2", "--piece-depth", "0.1"]), ("3, 0.5", ["--points", "3"]), ("5, 0.5", []),
              ("10, 0.5", ["--points", "10"])],
    "series": [("1e-3", ["--max-error", "1e-3"]), ("1e-6", ["--max-error", "1e-6"]), ("1e-9", ["--max-error", "1e-9"]), ("0", [])],
    "paper": [("", [])],
    "approximate": [("", [])],
    "approximate-unsliced": [("", [])],
}
MODE_SIZES = (316, 1000)  # 10^5 and 10^6 pixels
MEASURES = ("vtk", "error", "cells", "faces", "modes", "sort", "published", "preview")
PUBLISHED = (("approximate", "tetrahedra", "linear", ["--mode", "approximate"]), ("exact linear", "tetrahedra", "linear", []),
             ("quadratic, 5 points", "quadratic tetrahedra", "squares", ["--mode", "paper"]),
             ("quadratic, exact", "quadratic tetrahedra", "squares", []))
PREVIEWS = {"m0": ("--preview", "m0"), "m1": ("--preview", "m1"), "m3": ("--preview", "m3"), "m1, exact order": ("--preview", "m1", "--order", "exact")}
KINDS = {"tetrahedra": 20, "pyramids": 20, "wedges": 29, "hexahedra": 36, "quadratic tetrahedra": 20, "cubic tetrahedra": 20,
         "quadratic pyramids": 20, "quadratic wedges": 29, "quadratic hexahedra": 36, "triquadratic hexahedra": 36}  # about 48 000 cells each


def scene_text(mesh, field, size, scale=1.0):
    camera = "\n".join(f"{key} = {value}" for key, value in CAMERA.items())
    return (f'schema = 1\n\n[mesh]\nfile = "{mesh}"\n\n[density]\nfield = "{field}"\nscale = {scale}\npoints = {DENSITY}\n\n'
            f'[colour]\nfield = "{field}"\npoints = {COLOUR}\n\n[camera]\nsize = [{size}, {size}]\n{camera}\n')


def reason_for_no_vtk():
    """@return why VTK is left out; empty: it is not"""
    if not os.environ.get("DISPLAY"):
        return "VTK left out: no DISPLAY; run this under xvfb-run -a"
    tried = subprocess.run([sys.executable, "-c", "import vtk"], stderr=subprocess.DEVNULL, check=False)
    return "" if tried.returncode == 0 else "VTK left out: no module vtk (Debian: python3-vtk9)"


def errors(found, exact):
    """@return root mean square and largest, of all pixels and of those away from the silhouette"""
    off = np.abs(found - exact).max(axis=2)
    seen = exact[..., :3].max(axis=2) > 0.0
    away = np.ones_like(seen)
    for dy, dx in itertools.product(range(-RIM, RIM + 1), repeat=2):
        away &= np.roll(seen, (dy, dx), (0, 1)) == seen
    squares = ((found - exact) ** 2)[seen]
    inside = ((found - exact) ** 2)[away & seen]
    return {"rms": math.sqrt(squares.mean()), "largest": off.max(), "rms_inside": math.sqrt(inside.mean()),
            "largest_inside": off[away].max()}


class Bench:
    def __init__(self, options):
        self.options = options
        self.work = options.work.resolve()
        self.exact = {}

    def mesh(self, kind, n, form="straight", field="linear"):
        """@return the file's name in the working folder"""
        name = f"{kind}-{n}-{form}-{field}.vtu".replace(" ", "-")
        if not (self.work / name).exists():
            points, cells = volume_meshes.unit_cube(kind, n)
            if form == "bent":
                points = volume_meshes.bent(points)
            if form in ("shuffled", "half"):
                chosen = np.random.default_rng(1).permutation(len(cells))
                cells = cells[chosen[:len(cells) // 2] if form == "half" else chosen]
            of_points = points if field == "linear" else points**2
            volume_meshes.write_vtu(self.work / name, kind, points, cells, {"value": of_points @ np.array(SLOPES)})
        return name

    def ours(self, mesh, size, words=(), scale=1.0):
        """One run. @return its figures, and the picture"""
        scene, picture, report = (self.work / name for name in ("scene.toml", "picture.npy", "run.json"))
        scene.write_text(scene_text(mesh, "value", size, scale))
        begin = time.monotonic()
        process = subprocess.Popen([*FROM_SMALL, self.options.haarlight, "render", "volume", scene, "-o", self.work / "picture.exr",
                                    "--float64", picture, "--threads", "1", "--quiet", "--force", "--report", report, *words],
                                   stdout=subprocess.DEVNULL)
        _, status, used = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        whole = time.monotonic() - begin
        if process.returncode != 0:
            raise RuntimeError(f"{mesh}: the command failed")
        cpu = used.ru_utime + used.ru_stime
        share = min(cpu / whole, 1.0)
        told = json.loads(report.read_text())
        details = told["details"]
        if "cell-projection" in words:
            return {"command": cpu, "memory": told["peak_memory_bytes"], "violations": told["reached"]["violations"],
                    "render": min(cpu / whole, 1.0) * details["render_seconds"],
                    **{key: details[key] for key in ("cells_of_mesh", "order_cpu_seconds", "relations_by_faces", "relations_by_boundary",
                                                     "exact_signs", "cyclic_cells", "pieces", "stretches")}}, np.load(picture)
        if "projected-tetrahedra" in words:
            once, view, render = (share * details[key] for key in ("prepare_seconds", "view_seconds", "render_seconds"))
            return {"command": cpu, "memory": told["peak_memory_bytes"], "first": once + view + render, "second": view + render,
                    "view": view, **{key: details[key] for key in ("cells_of_mesh", "tetrahedra_drawn")}}, np.load(picture)
        prepare, render = share * details["prepare_seconds"], share * details["render_seconds"]
        more = {key: details[key] for key in ("not_finite", "negative", "terms") if key in details}
        more |= {"error_bound": told["reached"]["error_bound"]} if "error_bound" in told["reached"] else {}
        return {**more, "prepare": prepare, "render": render, "first": prepare + render, "command": cpu, "memory": told["peak_memory_bytes"],
                "share": share, **{key: details[key] for key in ("cells_of_mesh", "rays", "cells_passed", "segments", "exact_sides",
                                                                 "opaque_rays", "lost_points", "unresolved")}}, np.load(picture)

    def vtk(self, mesh, size, mapper, frames=2):
        task = {"mesh": str(self.work / mesh), "field": "value", "size": size, "camera": CAMERA, "density": DENSITY, "colour": COLOUR,
                "mapper": mapper, "frames": frames, "picture": str(self.work / "vtk.npy")}
        (self.work / "task.json").write_text(json.dumps(task))
        alone = {"LP_NUM_THREADS": "0", "VTK_SMP_MAX_THREADS": "1"}
        done = subprocess.run([*FROM_SMALL, sys.executable, HERE / "volume_vtk.py", self.work / "task.json"], check=True,
                              capture_output=True, text=True, env={**os.environ, **alone})
        told = json.loads(done.stdout.splitlines()[-1])
        return {"first": told["frames"][0], "second": told["frames"][-1], **told}, np.load(self.work / "vtk.npy") / 255.0

    def exact_picture(self, size, beside=(0.0, 0.0)):
        if (size, beside) not in self.exact:
            self.exact[size, beside] = volume_closed_form.picture(CAMERA, size, SLOPES, DENSITY, COLOUR, beside)
        return self.exact[size, beside]

    def beside_vtk(self, n, size, mappers):
        """The peers in turns. @return a row"""
        mesh = self.mesh("tetrahedra", n)
        exact = self.exact_picture(size)
        runs = {name: [] for name in ("ours", *mappers)}
        off = {}
        for repeat in range(self.options.repeats):
            figures, picture = self.ours(mesh, size)
            runs["ours"].append(figures)
            off["ours"] = errors(picture[..., :3], exact[..., :3])
            off["ours"]["opacity"] = np.abs(picture[..., 3] - exact[..., 3]).max()
            for mapper in mappers:
                if mapper in ONCE and repeat > 0:
                    continue
                figures, picture = self.vtk(mesh, size, mapper)
                runs[mapper].append(figures)
                off[mapper] = errors(picture, exact[..., :3])
                off[mapper]["beside"] = errors(picture, self.exact_picture(size, HALF_PIXEL)[..., :3])
        row = {"n": n, "cells": 6 * n**3, "size": size}
        for name, of_name in runs.items():
            row[name] = {**{key: statistics.median(run[key] for run in of_name) for key, value in of_name[0].items()
                            if isinstance(value, (int, float))}, "errors": off[name]}
        for mapper in mappers:
            row[mapper]["version"] = runs[mapper][0]["version"]
        return row


def print_beside(rows, mappers):
    print("\n| tetrahedra | pixels | prepare | render | first |" + "".join(f" {m}: first | second |" for m in mappers)
          + " first over first | second over second |\n" + "|---" * (7 + 2 * len(mappers)) + "|")
    for row in rows:
        ours = row["ours"]
        cells = [f"{row[m][frame]:.3g}" for m in mappers for frame in ("first", "second")]
        over = [f"{ours['first'] / row[mappers[0]]['first']:.2f}", f"{ours['render'] / row[mappers[0]]['second']:.2f}"] if mappers else ["", ""]
        print(f"| {row['cells']} | {row['size']}^2 | {ours['prepare']:.2g} | {ours['render']:.3g} | {ours['first']:.3g} | "
              + " | ".join([*cells, *over]) + " |")
    print("\n| tetrahedra | pixels | of | rms | largest | rms inside | largest inside | rms, inside, of rays half a pixel beside "
          "| factor of rms |\n" + "|---" * 9 + "|")
    for row in rows:
        for name in ("ours", *mappers):
            off = row[name]["errors"]
            print(f"| {row['cells']} | {row['size']}^2 | {name} | {off['rms']:.2g} | {off['largest']:.2g} | {off['rms_inside']:.2g} "
                  f"| {off['largest_inside']:.2g} | {format(off['beside']['rms_inside'], '.2g') if 'beside' in off else ''} "
                  f"| {off['rms'] / row['ours']['errors']['rms']:.2g} |")
    print("\n| tetrahedra | pixels | command | memory, MB | cells passed | segments | ns per cell | million segments per second |"
          + "".join(f" {m}: reading | memory, MB |" for m in mappers) + "\n" + "|---" * (8 + 2 * len(mappers)) + "|")
    for row in rows:
        ours = row["ours"]
        theirs = "".join(f" {row[m]['read']:.2f} | {1e-6 * row[m]['memory']:.0f} |" for m in mappers)
        print(f"| {row['cells']} | {row['size']}^2 | {ours['command']:.2f} | {1e-6 * ours['memory']:.0f} | {ours['cells_passed']:.3g} "
              f"| {ours['segments']:.3g} | {1e9 * ours['render'] / ours['cells_passed']:.0f} "
              f"| {1e-6 * ours['segments'] / ours['render']:.1f} |{theirs}")


def exponent(points):
    """Of a power through (x, y), by least squares."""
    x, y = np.log(np.array(points, float)).T
    return float(np.polyfit(x, y, 1)[0])


def print_growth(rows, mappers):
    """@return {series: exponent}"""
    series = {("ours", "prepare"): "ours, prepare", ("ours", "render"): "ours, render"}
    series.update({(m, frame): f"{m}, {frame} frame" for m in mappers for frame in ("first", "second")})
    found = {}
    print("\n| seconds of | grow with the cells to the power of, 300^2 | 1000^2 | with the pixels, fewest cells | most cells |\n|---|---|---|---|---|")
    for (name, key), text in series.items():
        of_cells = [exponent([(row["cells"], row[name][key]) for row in rows if row["size"] == size]) for size in SIZES]
        of_pixels = [exponent([(row["size"]**2, row[name][key]) for row in rows if row["n"] == n]) for n in (CUBES[0], CUBES[-1])]
        found[text] = [*of_cells, *of_pixels]
        print(f"| {text} | " + " | ".join(f"{value:.2f}" for value in found[text]) + " |")
    return found


def medians(bench, repeats, *arguments, **named):
    runs = [bench.ours(*arguments, **named) for _ in range(repeats)]
    return {key: statistics.median(run[key] for run, _ in runs) for key in runs[0][0]}, runs[-1][1]


def measure_errors_allowed(bench):
    """What --max-error saves where little light comes from behind."""
    rows = []
    exact = None
    print(f"\n{OPAQUE:g} times as dense, {6 * CUBES[1]**3} tetrahedra, 300^2\n\n| --max-error | s | cells passed | rays ended | largest error |\n"
          "|---|---|---|---|---|")
    for allowed in ("0", "1e-4", "1e-2"):
        figures, picture = medians(bench, bench.options.repeats, bench.mesh("tetrahedra", CUBES[1]), 300,
                                   ("--max-error", allowed), scale=OPAQUE)
        exact = picture if exact is None else exact
        off = float(np.abs(picture - exact).max())
        rows.append({"max_error": float(allowed), "off": off, **figures})
        print(f"| {allowed} | {figures['render']:.3f} | {figures['cells_passed']:.3g} | {figures['opaque_rays']:.0f} of "
              f"{figures['rays']:.0f} | {off:.2g} |", flush=True)
    return rows


def measure_cell_types(bench):
    """A cell passed, by its type, its form and its field."""
    rows = []
    print("\n| cells | form | field on the points | number | cells passed | segments per cell | ns per cell | of straight tetrahedra | unresolved |\n"
          + "|---" * 9 + "|")
    for kind, n in KINDS.items():
        for form, field in itertools.product(("straight", "bent"), ("linear", "squares")):
            figures, _ = medians(bench, bench.options.repeats, bench.mesh(kind, n, form, field), 300)
            nanoseconds = 1e9 * figures["render"] / figures["cells_passed"]
            rows.append({"kind": kind, "form": form, "field": field, "ns": nanoseconds, **figures})
            print(f"| {kind} | {form} | {field} | {figures['cells_of_mesh']:.0f} | {figures['cells_passed']:.3g} "
                  f"| {figures['segments'] / figures['cells_passed']:.2f} | {nanoseconds:.0f} | {nanoseconds / rows[0]['ns']:.1f} "
                  f"| {figures['unresolved']:.0f} |", flush=True)
    return rows


def bilinear_picture(bench, n, field):
    """The bent hexahedra as ones of 20 nodes with straight edges: the same cells and fields, but faces are bilinear patches."""
    points, cells = volume_meshes.unit_cube("hexahedra", n)
    points = volume_meshes.bent(points)
    values = (points if field == "linear" else points**2) @ np.array(SLOPES)
    points, cells = volume_meshes.raised("quadratic hexahedra", np.column_stack([points, values]), cells)
    volume_meshes.write_vtu(bench.work / "bilinear.vtu", "quadratic hexahedra", np.ascontiguousarray(points[:, :3]), cells,
                            {"value": np.ascontiguousarray(points[:, 3])})
    return bench.ours("bilinear.vtu", 300)[1]


def measure_flat_faces(bench):
    """Faces of four corners that are not flat: two triangles each, beside bilinear patches."""
    rows = []
    print("\n| hexahedra | field | rms of the picture | off, rms | off, largest | pixels off by 1e-3 |\n" + "|---" * 6 + "|")
    for n, field in itertools.product((4, 8, 16), ("linear", "squares")):
        _, parted = bench.ours(bench.mesh("hexahedra", n, "bent", field), 300)
        bilinear = bilinear_picture(bench, n, field)
        off = np.abs(parted - bilinear).max(axis=2)
        seen = bilinear[..., 3] > 0.0
        size = math.sqrt((bilinear[seen] ** 2).mean())
        rms = math.sqrt(((parted - bilinear)[seen] ** 2).mean())
        rows.append({"n": n, "field": field, "rms": rms, "largest": off.max(), "of": size})
        print(f"| {n}^3 | {field} | {size:.3f} | {rms:.2g} | {off.max():.2g} | {(off > 1e-3).sum()} of {seen.sum()} |", flush=True)
    return rows


def measure_modes(bench):
    """Each mode's seconds and errors: cubes of tetrahedra beside the closed form, quadratic ones beside the exact picture."""
    rows = []
    if bench.options.segment_cost:
        told = subprocess.run([bench.options.segment_cost, "modes", "5"], check=True, capture_output=True, text=True).stdout
        rows += [json.loads(line) for line in told.splitlines()]
        print("\n| rule | depths | ns | terms | largest error, of the opacity |\n|---|---|---|---|---|")
        for row in rows:
            print(f"| {row['rule']} | {row['depths']} | {row['ns']:.0f} | {row['terms']:.1f} | {row['worst']:.2g} |")
    print("\n| cells | pixels | mode | of | s | of exact | rms | largest | bound | no number, negative |\n" + "|---" * 10 + "|")
    scenes = [("tetrahedra", n, "linear", size) for size, n in itertools.product(MODE_SIZES, CUBES[:2])]
    scenes.append(("quadratic tetrahedra", KINDS["quadratic tetrahedra"], "squares", MODE_SIZES[0]))
    for kind, n, field, size in scenes:
        mesh = bench.mesh(kind, n, "straight", field)
        exact = bench.exact_picture(size) if kind == "tetrahedra" else None
        first = None
        for mode, forms in MODES.items():
            for form, words in forms if size == MODE_SIZES[0] else forms[-2:-1] or forms:
                figures, picture = medians(bench, bench.options.repeats, mesh, size, ("--mode", mode, *words))
                exact = picture if exact is None else exact
                first = first or figures["render"]
                off = errors(picture[..., :3], exact[..., :3])
                rows.append({"kind": kind, "cells": figures["cells_of_mesh"], "size": size, "mode": mode, "form": form,
                             "rms": off["rms"], "largest": off["largest"], **figures})
                bound = f"{figures['error_bound']:.2g}" if "error_bound" in figures else ""
                print(f"| {figures['cells_of_mesh']:.0f} {kind} | {size}^2 | {mode} | {form} | {figures['render']:.3g} "
                      f"| {figures['render'] / first:.2f} | {off['rms']:.2g} | {off['largest']:.2g} | {bound} "
                      f"| {figures.get('not_finite', 0):.0f}, {figures.get('negative', 0):.0f} |", flush=True)
    if bench.options.plot:
        from surface_plot import plot_errors_by_time
        panels = {}
        for row in rows:
            if row.get("size") == MODE_SIZES[0] and row["rms"] > 0.0:
                panel = panels.setdefault(f"CPU seconds: {row['cells']:.0f} {row['kind']}", {mode: [] for mode in MODES})
                panel[row["mode"]].append((row["render"], row["rms"]))
        plot_errors_by_time(panels, bench.options.plot)
    return rows


def measure_order(bench):
    """Of --algorithm cell-projection: the order, and its picture beside that of rays."""
    rows = []
    print("\n| tetrahedra | numbered | relations by faces | by the boundary | exact signs | in rings | order, CPU s | picture, CPU s | rays, CPU s "
          "| differ by | violations |\n" + "|---" * 11 + "|")
    for form, n in itertools.product(("straight", "shuffled", "half"), CUBES):
        if form == "half" and n == CUBES[-1]:
            continue  # minutes
        mesh = bench.mesh("tetrahedra", n, form)
        rays, of_rays = bench.ours(mesh, 300)
        figures, of_cells = medians(bench, bench.options.repeats, mesh, 300, ("--algorithm", "cell-projection"))
        off = float(np.abs(of_rays - of_cells).max())
        rows.append({"form": form, "off": off, "rays": rays["render"], **figures})
        print(f"| {figures['cells_of_mesh']:.0f} | {form} | {figures['relations_by_faces']:.0f} | {figures['relations_by_boundary']:.0f} "
              f"| {figures['exact_signs']:.0f} | {figures['cyclic_cells']:.0f} | {figures['order_cpu_seconds']:.3g} | {figures['render']:.3g} "
              f"| {rays['render']:.3g} | {off:.2g} | {figures['violations']:.0f} |", flush=True)
    growth = {form: exponent([(row["cells_of_mesh"], row["order_cpu_seconds"]) for row in rows if row["form"] == form])
              for form in ("straight", "shuffled", "half")}
    print("\nthe order grows with the cells to the power of " + ", ".join(f"{value:.2f} ({form})" for form, value in growth.items()))
    return {"rows": rows, "growth": growth}



def measure_published_sort(bench):
    """Tables 1 and 2 of [Williams98]: its sort, in tiles and in one list, beside our order."""
    rows = []
    if not bench.options.depth_sort:
        return rows
    print("\n| tetrahedra | our order, CPU s | in tiles, CPU s | comparisons | in one list, CPU s | comparisons | one list over tiles "
          "| tiles over ours | rings, violations |\n" + "|---" * 9 + "|")
    for n in CUBES:
        scene = bench.work / "scene.toml"
        scene.write_text(scene_text(bench.mesh("tetrahedra", n), "value", 300))
        row = json.loads(subprocess.run([bench.options.depth_sort, scene, "one"], check=True, capture_output=True, text=True).stdout)
        rows.append(row)
        tiled, one = row["tiled"], row["one_list"]
        print(f"| {row['cells']} | {row['ours']:.3g} | {tiled['seconds']:.3g} | {tiled['comparisons']:.3g} | {one['seconds']:.3g} "
              f"| {one['comparisons']:.3g} | {one['seconds'] / tiled['seconds']:.1f} | {tiled['seconds'] / row['ours']:.0f} "
              f"| {tiled['rings'] + one['rings']}, {tiled['violations'] + one['violations']} |", flush=True)
    print("growth with the cells: " + ", ".join(f"{name} {exponent([(row['cells'], of(row)) for row in rows]):.2f}" for name, of in (
        ("ours", lambda row: row["ours"]), ("in tiles", lambda row: row["tiled"]["seconds"]),
        ("one list", lambda row: row["one_list"]["seconds"]))))
    return rows


def measure_published(bench):
    """The rows of [Williams98], tables 1 to 3."""
    rows = []
    print("\n| integration | cells | pixels | rays, CPU s | cell by cell, CPU s: order, pixels |\n" + "|---" * 5 + "|")
    for (name, kind, field, words), size, n in itertools.product(PUBLISHED, MODE_SIZES, (CUBES[0], CUBES[2])):
        if kind != "tetrahedra" and n != CUBES[0]:
            continue
        mesh = bench.mesh(kind, n, "straight", field)
        rays, _ = medians(bench, bench.options.repeats, mesh, size, words)
        row = {"name": name, "size": size, "cells": rays["cells_of_mesh"], "rays": rays["first"]}
        projected = ""
        if not words:  # modes go with rays alone
            cells, _ = medians(bench, bench.options.repeats, mesh, size, ("--algorithm", "cell-projection"))
            row |= {"order": cells["order_cpu_seconds"], "pixels": cells["render"]}
            projected = f"{row['order']:.3g}, {row['pixels']:.3g}"
        rows.append(row)
        print(f"| {name} | {row['cells']:.0f} | {size}^2 | {row['rays']:.3g} | {projected} |", flush=True)
    return {"rendering": rows, "sort": measure_published_sort(bench)}


def how_far_off(found, exact):
    """@return mean, 99 % and largest of R, G and B over the pixels that meet the mesh"""
    off = np.abs(found - exact)[exact.max(axis=2) > 0.0]
    return {"mean": float(off.mean()), "percentile_99": float(np.quantile(off, 0.99)), "largest": float(off.max())}


def measure_previews(bench):
    """Previews beside VTK's projected tetrahedra, in turns."""
    missing = reason_for_no_vtk()
    if missing:
        print(missing)
    peer = () if missing else ("projected tetrahedra",)
    rows = []
    print("\n| tetrahedra | pixels | of | first, CPU s | second, CPU s | view | over VTK's second | mean error | 99 % | largest |\n" + "|---" * 10 + "|")
    for size, n in itertools.product(SIZES, CUBES):
        mesh = bench.mesh("tetrahedra", n)
        exact = bench.exact_picture(size)[..., :3]
        runs = {name: [] for name in (*peer, *PREVIEWS)}
        for _ in range(bench.options.repeats):
            for name, of_name in runs.items():
                words = ("--algorithm", "projected-tetrahedra", *PREVIEWS.get(name, ()))
                of_name.append(bench.vtk(mesh, size, name) if name in peer else bench.ours(mesh, size, words))
        theirs = statistics.median(figures["second"] for figures, _ in runs[peer[0]]) if peer else math.nan
        for name, of_name in runs.items():
            row = {"cells": 6 * n**3, "size": size, "name": name, **how_far_off(of_name[-1][1][..., :3], exact),
                   **{key: statistics.median(figures[key] for figures, _ in of_name) for key in ("first", "second")}}
            row["view"] = 0.0 if name in peer else statistics.median(figures["view"] for figures, _ in of_name)
            rows.append(row)
            print(f"| {row['cells']} | {size}^2 | {name} | {row['first']:.2g} | {row['second']:.2g} | {row['view']:.2g} | {row['second'] / theirs:.2f} "
                  f"| {row['mean']:.2g} | {row['percentile_99']:.2g} | {row['largest']:.2g} |", flush=True)
    return rows


def measure_beside_vtk(bench):
    missing = reason_for_no_vtk()
    if missing:
        print(missing)
    mappers = () if missing else tuple(bench.options.mappers)
    rows = []
    for size, n in itertools.product(SIZES, CUBES):
        rows.append(bench.beside_vtk(n, size, mappers))
        print(json.dumps(rows[-1]), file=sys.stderr, flush=True)
    if mappers:
        print(f"\nVTK {rows[0][mappers[0]]['version']}")
    print_beside(rows, mappers)
    return {"rows": rows, "growth": print_growth(rows, mappers)}


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("haarlight", type=pathlib.Path)
    parser.add_argument("--work", type=pathlib.Path, required=True)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--mappers", nargs="*", default=["ray caster", "ZSweep", "projected tetrahedra"])
    parser.add_argument("--only", nargs="+", choices=MEASURES, default=MEASURES)
    parser.add_argument("--plot", type=pathlib.Path, help="error against time of the modes")
    parser.add_argument("--segment-cost", type=pathlib.Path, help="build/release/bench/render/segment_cost: modes of single segments")
    parser.add_argument("--depth-sort", type=pathlib.Path, help="build/release/bench/render/depth_sort: the sort of [Williams98]")
    options = parser.parse_args()
    options.work.mkdir(parents=True, exist_ok=True)
    bench = Bench(options)
    measures = {"vtk": measure_beside_vtk, "error": measure_errors_allowed, "cells": measure_cell_types, "faces": measure_flat_faces,
                "modes": measure_modes, "sort": measure_order,
                "published": measure_published, "preview": measure_previews}
    report = {name: measures[name](bench) for name in options.only}
    (options.work / "report.json").write_text(json.dumps(report, indent=1))
    return 0


if __name__ == "__main__":
    sys.exit(main())
