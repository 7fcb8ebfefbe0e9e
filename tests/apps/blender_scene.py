# SPDX-License-Identifier: Apache-2.0
"""Run by Blender: blender -b --python blender_scene.py -- NAME OUT.glb OUT.exr SAMPLES

Makes a scene, exports it as glTF as a user would, and renders it in Cycles: linear, without denoising. With
`means A.exr B.exr` instead it prints the mean colour of each of 8 x 8 parts of both.
"""

import math
import sys

import bpy

WORDS = sys.argv[sys.argv.index("--") + 1:]
SIZE = 128


def material(name, colour=(0.8, 0.8, 0.8), emission=0.0, **inputs):
    made = bpy.data.materials.new(name)
    made.use_nodes = True
    principled = made.node_tree.nodes["Principled BSDF"]
    principled.inputs["Base Color"].default_value = (*colour, 1.0)
    principled.inputs["Specular"].default_value = 0.0
    if emission > 0.0:
        principled.inputs["Emission"].default_value = (1.0, 0.8, 0.5, 1.0)
        principled.inputs["Emission Strength"].default_value = emission
    for key, value in inputs.items():
        principled.inputs[key].default_value = value
    return made


def mesh(name, corners, faces, of):
    data = bpy.data.meshes.new(name)
    data.from_pydata(corners, [], faces)
    data.materials.append(of)
    bpy.context.scene.collection.objects.link(bpy.data.objects.new(name, data))


def quad(name, corners, of):
    mesh(name, corners, [(0, 1, 2, 3)], of)


def ball(name, centre, radius, of):
    bpy.ops.mesh.primitive_ico_sphere_add(subdivisions=5, radius=radius, location=centre)
    bpy.ops.object.shade_smooth()
    bpy.context.object.data.materials.append(of)


def lamp(kind, location, energy, turn=(0.0, 0.0, 0.0), **more):
    data = bpy.data.lights.new(kind, kind)
    data.energy = energy
    if kind == "SUN":
        data.angle = 0.0
    else:
        data.shadow_soft_size = 0.0
    for key, value in more.items():
        setattr(data, key, value)
    made = bpy.data.objects.new(kind, data)
    made.location, made.rotation_euler = location, turn
    bpy.context.scene.collection.objects.link(made)


def camera(location, turn, angle):
    data = bpy.data.cameras.new("camera")
    data.sensor_fit, data.angle = "VERTICAL", angle
    made = bpy.data.objects.new("camera", data)
    made.location, made.rotation_euler = location, turn
    bpy.context.scene.collection.objects.link(made)
    bpy.context.scene.camera = made


def box():
    """A box after the one of Cornell University, 1 m wide: matte, under a panel."""
    grey, red, green = material("grey"), material("red", (0.6, 0.05, 0.05)), material("green", (0.1, 0.5, 0.1))
    quad("floor", [(-.5, -.5, 0), (.5, -.5, 0), (.5, .5, 0), (-.5, .5, 0)], grey)
    quad("ceiling", [(-.5, -.5, 1), (-.5, .5, 1), (.5, .5, 1), (.5, -.5, 1)], grey)
    quad("back", [(-.5, .5, 0), (.5, .5, 0), (.5, .5, 1), (-.5, .5, 1)], grey)
    quad("left", [(-.5, -.5, 0), (-.5, .5, 0), (-.5, .5, 1), (-.5, -.5, 1)], red)
    quad("right", [(.5, -.5, 0), (.5, -.5, 1), (.5, .5, 1), (.5, .5, 0)], green)
    quad("panel", [(-.15, -.15, .98), (.15, -.15, .98), (.15, .15, .98), (-.15, .15, .98)],
         material("panel", (0.0, 0.0, 0.0), 15.0))
    bpy.ops.mesh.primitive_cube_add(size=0.3, location=(0.15, 0.1, 0.15), rotation=(0.0, 0.0, 0.3))
    bpy.context.object.data.materials.append(grey)
    camera((0.0, -2.2, 0.5), (math.pi / 2, 0.0, 0.0), 0.6)


def lamps():
    """A matte ground under a point, a spot and the sun."""
    quad("ground", [(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)], material("ground", (0.6, 0.5, 0.4)))
    ball("clay", (0.0, 0.0, 0.2), 0.2, material("clay", (0.3, 0.5, 0.7)))
    lamp("POINT", (-0.5, -0.5, 1.0), 30.0, color=(1.0, 0.7, 0.4))
    lamp("SPOT", (0.6, 0.0, 1.2), 40.0, spot_size=0.9, spot_blend=0.0)
    lamp("SUN", (0, 0, 3), 0.5, (0.5, 0.3, 0.0))
    camera((0.0, -2.5, 1.5), (1.1, 0.0, 0.0), 0.7)


def gloss():
    """A metal and lacquer under a panel and a point."""
    quad("ground", [(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)], material("ground", (0.5, 0.5, 0.5)))
    ball("gold", (-0.3, 0.0, 0.25), 0.25, material("gold", (1.0, 0.77, 0.34), Metallic=1.0, Roughness=0.3))
    ball("lacquer", (0.3, 0.0, 0.25), 0.25, material("lacquer", (0.5, 0.05, 0.05), Specular=0.5, Roughness=0.3))
    quad("panel", [(-.5, -.3, 1.5), (.5, -.3, 1.5), (.5, .3, 1.5), (-.5, .3, 1.5)],
         material("panel", (0.0, 0.0, 0.0), 5.0))
    lamp("POINT", (0.0, -1.0, 1.0), 10.0)
    camera((0.0, -2.0, 0.9), (1.2, 0.0, 0.0), 0.6)


def make(name, glb, picture, samples):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    {"box": box, "lamps": lamps, "gloss": gloss}[name]()
    scene = bpy.context.scene
    scene.render.resolution_x = scene.render.resolution_y = SIZE
    bpy.ops.export_scene.gltf(filepath=glb, export_cameras=True, export_lights=True)
    scene.render.engine = "CYCLES"
    scene.cycles.samples = int(samples)
    scene.cycles.use_adaptive_sampling = scene.cycles.use_denoising = False
    scene.cycles.max_bounces = scene.cycles.diffuse_bounces = scene.cycles.glossy_bounces = 64
    scene.cycles.sample_clamp_indirect = 0.0
    scene.cycles.blur_glossy = 0.0
    scene.cycles.pixel_filter_type = "BOX"
    scene.view_settings.view_transform = "Raw"
    scene.render.image_settings.file_format, scene.render.image_settings.color_depth = "OPEN_EXR", "32"
    scene.render.filepath = picture
    bpy.ops.render.render(write_still=True)


def means(*pictures):
    for name in pictures:
        image = bpy.data.images.load(name)
        image.colorspace_settings.name = "Non-Color"
        numbers = list(image.pixels)
        width, height = image.size
        part = width // 8
        for row in range(8):
            for column in range(8):
                total = [0.0] * 3
                for y in range(row * part, (row + 1) * part):
                    at = 4 * (y * width + column * part)
                    for c in range(3):
                        total[c] += sum(numbers[at + c:at + 4 * part:4])
                print("mean", name, *(t / part**2 for t in total))


if WORDS[0] == "means":
    means(*WORDS[1:])
else:
    make(*WORDS)
