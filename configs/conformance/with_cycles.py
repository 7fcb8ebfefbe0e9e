# SPDX-License-Identifier: Apache-2.0
"""Pictures of the conformance scenes by Blender's Cycles, run by Blender itself:

    blender --background --factory-startup --python-exit-code 1 --python with_cycles.py -- DIR [--spp N] [--seeds N]

DIR: what `conformance.py write` made. CPU, no denoiser, no clamping, no adaptive sampling, 1024 bounces of every kind, caustics on.
A lamp is a mesh whose back is black; a disk is 1024 quads, a ball 81 920 triangles, of equal area.
"""

import argparse
import json
import math
import pathlib
import sys

import bpy
import numpy as np
from mathutils import Matrix, Vector

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parent))
import scenes  # noqa: E402

BOUNCES = 1024


def material(part):
    made = bpy.data.materials.new("surface")
    made.use_nodes = True
    made.use_backface_culling = False
    nodes, links = made.node_tree.nodes, made.node_tree.links
    nodes.clear()
    output = nodes.new("ShaderNodeOutputMaterial")
    kind, emits = part.get("kind", "matte"), part.get("emits")
    if kind == "mirror":
        surface = nodes.new("ShaderNodeBsdfGlossy")
        surface.distribution = "SHARP"
        surface.inputs["Color"].default_value = (1.0, 1.0, 1.0, 1.0)
    elif kind == "glass":
        surface = nodes.new("ShaderNodeBsdfGlass")
        surface.distribution = "SHARP"
        surface.inputs["Color"].default_value = (1.0, 1.0, 1.0, 1.0)
        surface.inputs["IOR"].default_value = 1.5
    else:
        surface = nodes.new("ShaderNodeBsdfDiffuse")
        surface.inputs["Color"].default_value = (*[part.get("albedo", 0.0)] * 3, 1.0)
        surface.inputs["Roughness"].default_value = 0.0
    found = surface.outputs[0]
    if emits:  # in front; behind, nothing
        light, side, mix, both = (nodes.new("ShaderNode" + name) for name in ("Emission", "NewGeometry", "MixShader", "AddShader"))
        strength = max(emits)  # a colour is at most 1
        light.inputs["Color"].default_value = (*[value / strength for value in emits], 1.0)
        light.inputs["Strength"].default_value = strength
        links.new(side.outputs["Backfacing"], mix.inputs[0])
        links.new(light.outputs[0], mix.inputs[1])
        links.new(found, both.inputs[0])
        links.new(mix.outputs[0], both.inputs[1])
        found = both.outputs[0]
    links.new(found, output.inputs["Surface"])
    return made


def add_mesh(scene, part, points, faces):
    mesh = bpy.data.meshes.new("part")
    mesh.from_pydata([tuple(point) for point in points], [], [tuple(face) for face in faces])
    mesh.materials.append(material(part))
    scene.collection.objects.link(bpy.data.objects.new("part", mesh))


def add_lamp(scene, kind, values, strength, matrix):
    """Its colour is the values', over the largest."""
    lamp = bpy.data.lights.new("lamp", kind)
    most = max(values)
    lamp.color = [value / most for value in values]
    lamp.energy = most * strength
    if kind == "SUN":
        lamp.angle = 0.0
    else:
        lamp.shadow_soft_size = 0.0
    made = bpy.data.objects.new("lamp", lamp)
    made.matrix_world = matrix
    scene.collection.objects.link(made)


def disk(centre, radius, n=32):
    """Quads of the square [-1, 1]^2, mapped to the disk [Shirley 1997], that look down; their area is the disk's."""
    u, v = np.meshgrid(np.linspace(-1.0, 1.0, n + 1), np.linspace(-1.0, 1.0, n + 1), indexing="ij")
    wide = np.abs(u) > np.abs(v)
    r = np.where(wide, u, v)
    with np.errstate(divide="ignore", invalid="ignore"):
        angle = np.where(wide, math.pi / 4.0 * v / u, math.pi / 2.0 - math.pi / 4.0 * u / v)
    angle[n // 2, n // 2] = 0.0
    points = np.stack([r * np.cos(angle), r * np.sin(angle), 0.0 * r], axis=2).reshape(-1, 3)
    corners = [(i * (n + 1) + j, i * (n + 1) + j + 1, (i + 1) * (n + 1) + j + 1, (i + 1) * (n + 1) + j) for i in range(n) for j in range(n)]
    at = points[corners]
    area = np.linalg.norm(np.cross(at[:, 2] - at[:, 0], at[:, 3] - at[:, 1]), axis=1).sum() / 2.0
    return points * radius * math.sqrt(math.pi / area) + centre, corners


def build(box):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    for part in box.get("quads", []):
        add_mesh(scene, part, part["corners"], [(0, 1, 2, 3)])
    for part in box.get("disks", []):
        add_mesh(scene, part, *disk(part["centre"], part["radius"]))
    for part in box.get("spheres", []):
        points, faces = scenes.ball(part["radius"], 6, False)
        add_mesh(scene, part, points + part["centre"], faces)
    for part in box.get("meshes", []):
        points, faces = scenes.ball(part["radius"], part["subdivisions"], part["inwards"])
        add_mesh(scene, part, points, faces)
    for part in box.get("points", []):  # its energy is 4 pi times the radiant intensity
        add_lamp(scene, "POINT", part["intensity"], 4.0 * math.pi, Matrix.Translation(part["position"]))
    for part in box.get("suns", []):  # shines along its -z
        add_lamp(scene, "SUN", part["irradiance"], 1.0, Vector(part["direction"]).to_track_quat("-Z", "Y").to_matrix().to_4x4())
    world = bpy.data.worlds.new("sky")
    world.use_nodes = True
    world.node_tree.nodes["Background"].inputs["Color"].default_value = (1.0, 1.0, 1.0, 1.0)
    world.node_tree.nodes["Background"].inputs["Strength"].default_value = box.get("sky", 0.0)
    scene.world = world

    view = box["camera"]
    lens = bpy.data.cameras.new("camera")
    lens.type, lens.ortho_scale = "ORTHO", view["width"]
    lens.clip_start, lens.clip_end = 1e-3, 1e5
    camera = bpy.data.objects.new("camera", lens)
    eye = Vector(view["eye"])
    ahead = (Vector(view["target"]) - eye).normalized()
    right = ahead.cross(Vector(view["up"])).normalized()
    camera.matrix_world = Matrix.Translation(eye) @ Matrix((right, right.cross(ahead), -ahead)).transposed().to_4x4()
    scene.collection.objects.link(camera)
    scene.camera = camera
    return scene


def render(scene, name, side, spp, seed):
    picture = scene.render
    picture.engine = "CYCLES"
    picture.resolution_x = picture.resolution_y = side
    picture.resolution_percentage = 100
    picture.use_compositing = picture.use_sequencer = False
    picture.image_settings.file_format, picture.image_settings.color_depth = "OPEN_EXR", "32"
    picture.image_settings.color_mode = "RGB"
    scene.view_settings.view_transform = "Raw"
    cycles = scene.cycles
    for key, value in {"device": "CPU", "use_adaptive_sampling": False, "use_denoising": False, "sample_clamp_direct": 0.0,
                       "sample_clamp_indirect": 0.0, "light_sampling_threshold": 0.0, "blur_glossy": 0.0,
                       "pixel_filter_type": "BOX", "filter_width": 1.0, "film_exposure": 1.0, "caustics_reflective": True,
                       "caustics_refractive": True, "max_bounces": BOUNCES, "diffuse_bounces": BOUNCES,
                       "glossy_bounces": BOUNCES, "transmission_bounces": BOUNCES, "volume_bounces": BOUNCES,
                       "transparent_max_bounces": BOUNCES, "samples": spp, "seed": seed}.items():
        setattr(cycles, key, value)
    bpy.ops.render.render()
    file = f"{name}.exr"
    bpy.data.images["Render Result"].save_render(file)
    read = bpy.data.images.load(file)
    read.colorspace_settings.name = "Non-Color"
    values = np.empty(side * side * read.channels, np.float32)
    read.pixels.foreach_get(values)
    bpy.data.images.remove(read)
    pathlib.Path(file).unlink()
    np.save(f"{name}.npy", values.reshape(side, side, -1)[::-1, :, :3])


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("folder", type=pathlib.Path)
    parser.add_argument("--spp", type=int, default=1024)
    parser.add_argument("--seeds", type=int, default=16)
    arguments = parser.parse_args(sys.argv[sys.argv.index("--") + 1:])
    for path in sorted(arguments.folder.glob("*.json")):
        box = json.loads(path.read_text())
        scene = build(box)
        for seed in range(arguments.seeds):
            render(scene, str(path.with_suffix(f".{seed}").resolve()), box["camera"]["size"], arguments.spp, seed)


main()
