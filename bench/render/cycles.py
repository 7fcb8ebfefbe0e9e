#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""The error of `haarlight render surface` against CPU time beside Blender's Cycles: a table of
docs/numerics/surface.md.

    /usr/bin/python3 bench/render/cycles.py HAARLIGHT CORNELL.json --work DIR

HAARLIGHT: the program, of a release build; it renders configs/scenes/cornell.toml, which is checked to be the scene of
CORNELL.json. Needs Debian's python3-numpy, and as root installs Debian's blender where there is none. Blender runs this
file itself (`cycles.py -- JOB.json`), makes the scene of CORNELL.json and renders it: CPU, two threads, no denoiser,
no adaptive sampling, no clamping, 100 bounces, a box filter, a one-sided mesh as the light.

Each program has a reference of its own, the mean of two renders of other seeds (--references samples each), kept in DIR
and not made again; a quarter of the squared difference of the two is its variance. Left out: pixels above --most in
haarlight's reference, and their neighbours within two pixels: the light and its rim. RMSE over all colours, less the
reference's own variance; medians over seeds, which alternate between the programs. CPU seconds: user and system; of the
whole command from file to file, and for Blender also of its render operator alone.
"""

import argparse
import json
import math
import os
import pathlib
import shutil
import statistics
import subprocess
import sys
import tomllib

import numpy as np

SOURCE = pathlib.Path(__file__).resolve().parent.parent.parent
sys.path.insert(0, str(SOURCE / "bench"))
from float_tif import read_tif  # noqa: E402

REFERENCE_SEEDS = (1000003, 1000033)
SCENE = SOURCE / "configs/scenes/cornell.toml"
SIZE = 256
BOUNCES = 100
PATTERNS = {"sobol": "SOBOL", "pmj": "PROGRESSIVE_MULTI_JITTER"}


# ---- within Blender --------------------------------------------------------------------------


def material(bpy, name, albedo, emitted):
    made = bpy.data.materials.new(name)
    made.use_nodes = True
    made.use_backface_culling = False
    nodes, links = made.node_tree.nodes, made.node_tree.links
    nodes.clear()
    output = nodes.new("ShaderNodeOutputMaterial")
    if emitted is None:
        matte = nodes.new("ShaderNodeBsdfDiffuse")
        matte.inputs["Color"].default_value = (*albedo, 1.0)
        matte.inputs["Roughness"].default_value = 0.0
        links.new(matte.outputs[0], output.inputs["Surface"])
        return made
    # Light in front; behind, nothing at all: black and opaque.
    light, side, mix = (nodes.new("ShaderNode" + kind) for kind in ("Emission", "NewGeometry", "MixShader"))
    light.inputs["Color"].default_value = (*emitted, 1.0)
    light.inputs["Strength"].default_value = 1.0
    links.new(side.outputs["Backfacing"], mix.inputs[0])
    links.new(light.outputs[0], mix.inputs[1])
    links.new(mix.outputs[0], output.inputs["Surface"])
    return made


def in_blender(job):
    import bpy
    from mathutils import Matrix, Vector

    for thing in list(bpy.data.objects):
        bpy.data.objects.remove(thing)
    scene = bpy.context.scene
    scene.world = None
    box = json.loads(pathlib.Path(job["scene"]).read_text())
    for name, corners, albedo, emitted in box["quads"]:
        mesh = bpy.data.meshes.new(name)
        mesh.from_pydata(corners, [], [(0, 1, 2, 3)])
        mesh.materials.append(material(bpy, name, albedo, emitted))
        scene.collection.objects.link(bpy.data.objects.new(name, mesh))
    lens = bpy.data.cameras.new("camera")
    lens.sensor_fit = "VERTICAL"
    lens.angle = math.radians(box["fov_deg"])
    lens.clip_start, lens.clip_end = 1.0, 1e5
    camera = bpy.data.objects.new("camera", lens)
    eye = Vector(box["eye"])
    ahead = (Vector(box["look"]) - eye).normalized()
    right = ahead.cross(Vector(box["up"])).normalized()
    camera.matrix_world = Matrix.Translation(eye) @ Matrix((right, right.cross(ahead), -ahead)).transposed().to_4x4()
    scene.collection.objects.link(camera)
    scene.camera = camera

    picture = scene.render
    picture.engine = "CYCLES"
    picture.resolution_x = picture.resolution_y = SIZE
    picture.resolution_percentage = 100
    picture.threads_mode, picture.threads = "FIXED", job["threads"]
    picture.use_compositing = picture.use_sequencer = False
    picture.image_settings.file_format, picture.image_settings.color_depth = "OPEN_EXR", "32"
    picture.image_settings.color_mode = "RGB"
    scene.view_settings.view_transform = "Raw"
    for layer in scene.view_layers:
        layer.use_pass_z = False
    cycles = scene.cycles
    for key, value in {"device": "CPU", "use_adaptive_sampling": False, "use_denoising": False, "sample_clamp_direct": 0.0,
                       "sample_clamp_indirect": 0.0, "light_sampling_threshold": 0.0, "blur_glossy": 0.0,
                       "pixel_filter_type": "BOX", "filter_width": 1.0, "film_exposure": 1.0, "caustics_reflective": True,
                       "caustics_refractive": True, "max_bounces": BOUNCES, "diffuse_bounces": BOUNCES,
                       "glossy_bounces": BOUNCES, "transmission_bounces": BOUNCES, "volume_bounces": BOUNCES,
                       "transparent_max_bounces": BOUNCES, "sampling_pattern": PATTERNS[job["pattern"]],
                       "samples": job["samples"], "seed": job["seed"]}.items():
        setattr(cycles, key, value)
    before = os.times()
    bpy.ops.render.render()
    after = os.times()
    file = job["picture"] + ".exr"
    bpy.data.images["Render Result"].save_render(file)
    read = bpy.data.images.load(file)
    read.colorspace_settings.name = "Non-Color"
    values = np.empty(SIZE * SIZE * read.channels, np.float32)
    read.pixels.foreach_get(values)
    np.save(job["picture"], values.reshape(SIZE, SIZE, -1)[::-1, :, :3])
    pathlib.Path(job["picture"] + ".s").write_text(str(after.user + after.system - before.user - before.system))


# ---- the comparison --------------------------------------------------------------------------


def command(words):
    """@return the CPU seconds of a command"""
    before = os.times()
    subprocess.run(words, check=True, stdout=subprocess.DEVNULL)
    after = os.times()
    return after.children_user + after.children_system - before.children_user - before.children_system


def by_haarlight(options, samples, seed, words=()):
    """@return the picture, and the CPU seconds of the command"""
    picture = options.work / "haarlight.tif"
    seconds = command([options.haarlight, "render", "surface", SCENE, "-o", picture, "--quiet", "--force", "--bounces",
                       str(BOUNCES), "--threads", str(options.threads), "--spp", str(samples), "--seed", str(seed), *words])
    return read_tif(picture).reshape(SIZE, SIZE, 3), seconds


def by_cycles(options, samples, seed, pattern):
    """@return the picture, and the CPU seconds of the render alone and of the command"""
    job = options.work / "job.json"
    picture = options.work / "cycles"
    job.write_text(json.dumps({"scene": str(options.json.resolve()), "picture": str(picture.resolve()), "samples": samples,
                               "seed": seed, "pattern": pattern, "threads": options.threads}))
    whole = command(["blender", "--background", "--factory-startup", "--python-exit-code", "1",
                     "--python", pathlib.Path(__file__).resolve(), "--", job])
    return np.load(f"{picture}.npy").astype(float), float(pathlib.Path(f"{picture}.s").read_text()), whole


def check_scenes(options):
    """Ends the program unless the two files say the same; haarlight's axes are (x, -z, y)."""
    box, ours = json.loads(options.json.read_text()), tomllib.loads(SCENE.read_text())
    materials = {one["name"]: one for one in ours["material"]}

    def turned(point):
        return [point[0], -point[2], point[1]]
    same = len(box["quads"]) == len(ours["quad"])
    for (_, corners, albedo, emitted), quad in zip(box["quads"], ours["quad"]):
        its = materials[quad["material"]]
        same = same and [turned(corner) for corner in corners] == quad["corners"]
        same = same and its["kd"] == albedo and its.get("emits") == emitted
    camera = ours["camera"]
    same = same and [turned(box[key]) for key in ("eye", "look", "up")] == [camera[key] for key in ("eye", "target", "up")]
    if not (same and camera["fov_y_deg"] == box["fov_deg"] and camera["size"] == [SIZE, SIZE]):
        sys.exit(f"{options.json} is not the scene of {SCENE}")


def reference(options, name, samples, render):
    """@return the mean of two renders, kept, and its variance"""
    two = []
    for seed in REFERENCE_SEEDS:
        kept = options.work / f"reference_{name}_{samples}_{seed}.npy"
        if not kept.exists():
            np.save(kept, render(samples, seed)[0])
        two.append(np.load(kept))
    return (two[0] + two[1]) / 2, (two[0] - two[1]) ** 2 / 4


def shown(picture, most):
    """Where the picture is compared."""
    bright = (picture > most).any(axis=2)
    grown = bright.copy()
    for dy in range(-2, 3):
        for dx in range(-2, 3):
            grown |= np.roll(bright, (dy, dx), (0, 1))
    return ~grown


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("haarlight", type=pathlib.Path)
    parser.add_argument("json", type=pathlib.Path)
    parser.add_argument("--work", type=pathlib.Path, required=True)
    parser.add_argument("--references", type=lambda text: [int(n) for n in text.split(",")], default=[2048, 2048],
                        help="samples of each of the two renders of haarlight's reference, and of Cycles'")
    parser.add_argument("--samples", type=lambda text: [int(n) for n in text.split(",")], default=[16, 64, 256])
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--patterns", type=lambda text: text.split(","), default=list(PATTERNS))
    parser.add_argument("--most", type=float, default=1.5)
    options = parser.parse_args()
    options.work.mkdir(parents=True, exist_ok=True)
    check_scenes(options)
    if shutil.which("blender") is None:
        subprocess.run(["apt-get", "install", "-y", "--no-install-recommends", "blender"], check=True,
                       stdout=subprocess.DEVNULL, env={**os.environ, "DEBIAN_FRONTEND": "noninteractive"})
    print(subprocess.run(["blender", "--version"], check=True, capture_output=True, text=True).stdout.splitlines()[0])
    print(subprocess.run([options.haarlight, "--version"], check=True, capture_output=True, text=True).stdout.strip())

    pattern = options.patterns[0]
    references = {"haarlight": reference(options, "haarlight", options.references[0],
                                         lambda samples, seed: by_haarlight(options, samples, seed)),
                  "Cycles": reference(options, "cycles", options.references[1],
                                      lambda samples, seed: by_cycles(options, samples, seed, pattern))}
    where = shown(references["haarlight"][0], options.most)
    references = {name: (mean[where], own[where].mean()) for name, (mean, own) in references.items()}
    for name, (mean, own) in references.items():
        print(f"reference of {name}: mean {mean.mean():.5f}, by colour {mean.mean(axis=0).round(5)}, "
              f"sigma {math.sqrt(own):.5f}")
    (ours, own), (theirs, their_own) = references.values()
    print(f"Cycles' / haarlight's: {theirs.mean() / ours.mean():.4f}; RMS difference less both variances: "
          f"{math.sqrt(max(0.0, ((ours - theirs) ** 2).mean() - own - their_own)):.5f}")

    ways = {"haarlight": (), "haarlight, bidirectional": ("--integrator", "bidirectional")}
    programs = [*ways, *(f"Cycles, {one}" for one in options.patterns)]
    print("| program | samples | CPU s, render | CPU s, command | RMSE | to the other's reference | mean / reference "
          "| eff, render | eff, command |")
    print("|---|---|---|---|---|---|---|---|---|")
    for samples in options.samples:
        rows = {program: [] for program in programs}
        for seed in range(options.seeds):
            for program in programs:
                is_ours = program in ways
                if is_ours:
                    picture, whole = by_haarlight(options, samples, seed, ways[program])
                    render = whole
                else:
                    picture, render, whole = by_cycles(options, samples, seed, program.removeprefix("Cycles, "))
                picture = picture[where]
                squared, other = (((picture - mean) ** 2).mean() - own for mean, own in (
                    references.values() if is_ours else reversed(references.values())))
                rows[program].append((render, whole, squared, other,
                                      picture.mean() / references["haarlight" if is_ours else "Cycles"][0].mean(),
                                      1 / (squared * render), 1 / (squared * whole)))
        for program, of_seeds in rows.items():
            render, whole, squared, other, ratio, alone, all_of_it = map(statistics.median, zip(*of_seeds))
            print(f"| {program} | {samples} | {render:.2f} | {whole:.2f} | {math.sqrt(squared):.5f} | {math.sqrt(other):.5f} "
                  f"| {ratio:.4f} | {alone:.0f} | {all_of_it:.0f} |", flush=True)
        (options.work / f"rows{samples}.json").write_text(json.dumps(rows))
    return 0


if __name__ == "__main__":
    if "bpy" in sys.modules:
        in_blender(json.loads(pathlib.Path(sys.argv[sys.argv.index("--") + 1]).read_text()))
    else:
        sys.exit(main())
