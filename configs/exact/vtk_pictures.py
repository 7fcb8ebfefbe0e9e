# SPDX-License-Identifier: Apache-2.0
"""Scenes of the suite as VTK renders them: vtkUnstructuredGridVolumeRayCastMapper with the linear ray integrator, its most
accurate way for unstructured meshes. Cells that are no tetrahedra are divided into some, as this mapper needs."""

import functools
import math
import tomllib

import numpy as np
import vtk
from vtk.util.numpy_support import vtk_to_numpy

DROPPED = "density breakpoints after the first in a cell are dropped"
LINEARISED = "the field is made linear between the nodes"
EDGE_ON = "cells are lost where rays run in faces and along edges"
INSIDE = "black: nothing is drawn when the eye is in the mesh"
CLIPPED = "cells are lost that near_mm or far_mm cuts or touches"
DEFECTS = {
    "spikes": f"black: {DROPPED}", "five_tetrahedra": DROPPED, "background": DROPPED, "twelve_breakpoints": DROPPED,
    "nearly_constant": "precision is lost where the density hardly changes within a cell", "quadratic": LINEARISED,
    "hexahedron_product": LINEARISED, "random_quadratic": LINEARISED, "tapered_hexahedra": LINEARISED, "along_z": EDGE_ON, "along_z_perspective": EDGE_ON, "eye_in_cell": INSIDE,
    "eye_at_vertex": INSIDE, "eye_at_corner": INSIDE, "bent_from_node": INSIDE, "clipped": CLIPPED, "clipped_at_faces": CLIPPED,
    "opaque_1e12": "single pixels of the outline", "thin": "black: pixels of 8 bits"}


def version():
    return vtk.vtkVersion.GetVTKVersion()


def read_scene(path):
    with path.open("rb") as file:
        return tomllib.load(file)


def why_not(scene):
    """What VTK has no setting for; empty: nothing."""
    if scene["colour"]["glow"] == "own":
        return "glow of its own"
    if scene["colour"]["field"] != scene["density"]["field"]:
        return "two fields"
    if "contour" in scene:
        return "contours within a medium"
    return ""


def volume_of(scene, folder):
    reader = vtk.vtkXMLUnstructuredGridReader()
    reader.SetFileName(str(folder / scene["mesh"]["file"]))
    tetrahedra = vtk.vtkDataSetTriangleFilter()
    tetrahedra.SetInputConnection(reader.GetOutputPort())
    tetrahedra.TetrahedraOnlyOn()
    mapper = vtk.vtkUnstructuredGridVolumeRayCastMapper()
    mapper.SetInputConnection(tetrahedra.GetOutputPort())
    mapper.SetRayIntegrator(vtk.vtkUnstructuredGridLinearRayIntegrator())
    mapper.AutoAdjustSampleDistancesOff()
    mapper.SetImageSampleDistance(1.0)
    if scene["density"].get("on") == "cells":
        mapper.SetScalarModeToUseCellFieldData()
    else:
        mapper.SetScalarModeToUsePointFieldData()
    mapper.SelectScalarArray(scene["density"]["field"])
    density, colour = vtk.vtkPiecewiseFunction(), vtk.vtkColorTransferFunction()
    for x, rho in scene["density"]["points"]:
        density.AddPoint(x, rho * scene["density"].get("scale", 1.0))
    for x, *rgb in scene["colour"]["points"]:
        colour.AddRGBPoint(x, *(c * scene["colour"].get("scale", 1.0) for c in rgb))
    look = vtk.vtkVolumeProperty()
    look.SetScalarOpacity(density)
    look.SetScalarOpacityUnitDistance(1.0)
    look.SetColor(colour)
    look.SetInterpolationTypeToLinear()
    look.ShadeOff()
    volume = vtk.vtkVolume()
    volume.SetMapper(mapper)
    volume.SetProperty(look)
    return volume


def set_camera(table, renderer):
    camera = renderer.GetActiveCamera()
    width, height = table["size"]
    if "K" in table:
        pose = np.array(table["world_from_cam"])
        camera.SetPosition(pose[:, 3])
        camera.SetFocalPoint(pose[:, 3] + pose[:, 2])
        camera.SetViewUp(-pose[:, 1])
        camera.SetViewAngle(math.degrees(2 * math.atan(height / 2 / table["K"][1][1])))
    else:
        camera.SetPosition(table["eye"])
        camera.SetFocalPoint(table["target"])
        camera.SetViewUp(table.get("up", (0, 0, 1)))
        if "width_mm" in table:
            camera.ParallelProjectionOn()
            camera.SetParallelScale(table["width_mm"] / width * height / 2)
        else:
            camera.SetViewAngle(table["fov_y_deg"])
    renderer.ResetCameraClippingRange()
    near, far = camera.GetClippingRange()
    camera.SetClippingRange(table.get("near_mm", near), table.get("far_mm", far))


@functools.cache
def the_window():
    """One for all pictures: an X server without a screen may end with its last window."""
    window = vtk.vtkRenderWindow()
    window.SetOffScreenRendering(1)
    window.SetMultiSamples(0)
    window.SetAlphaBitPlanes(1)
    return window


def larger(camera, factor):
    """The same view in more pixels."""
    camera = {**camera, "size": [factor * n for n in camera["size"]]}
    if "K" in camera:
        camera["K"] = [[factor * c for c in row] for row in camera["K"][:2]] + camera["K"][2:]
    return camera


def render(scene, folder, factor=1):
    """(height, width, 4): R, G, B, opacity, from the window's 8-bit pixels. @param factor  odd: of a picture that is larger
    by it in both directions the pixels with the same centres, so that errors of half a pixel count as much less"""
    table = larger(scene["camera"], factor)
    renderer = vtk.vtkRenderer()
    renderer.AddVolume(volume_of(scene, folder))
    renderer.SetBackground(scene.get("background", {}).get("colour", (0.0, 0.0, 0.0)))
    renderer.SetBackgroundAlpha(0.0)
    window = the_window()
    window.SetSize(table["size"])
    window.AddRenderer(renderer)
    set_camera(table, renderer)
    window.Render()
    grab = vtk.vtkWindowToImageFilter()
    grab.SetInput(window)
    grab.SetInputBufferTypeToRGBA()
    grab.ReadFrontBufferOff()
    grab.Update()
    window.RemoveRenderer(renderer)
    image = grab.GetOutput()
    width, height, _ = image.GetDimensions()
    pixels = vtk_to_numpy(image.GetPointData().GetScalars()).reshape(height, width, 4)
    return pixels[::-1][factor // 2::factor, factor // 2::factor] / 255.0
