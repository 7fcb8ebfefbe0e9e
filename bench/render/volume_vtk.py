#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""VTK's picture of a mesh, in a process of its own: volume_report.py runs it.

    /usr/bin/python3 bench/render/volume_vtk.py TASK.json

TASK.json: mesh, field, size, camera, density, colour, mapper (one of MAPPERS), frames, picture. Prints JSON:
VTK's version, CPU seconds of reading and of each frame, largest memory; writes the picture as an array of bytes.
Needs Debian's python3-vtk9, and an X server, of which nothing is shown (xvfb-run).
"""

import json
import pathlib
import resource
import sys
import time

import numpy as np
import vtk
from vtk.util.numpy_support import vtk_to_numpy

UNIT = 0.1  # of length for VTK's opacities, so that they stay below 1: its projected tetrahedra clip them
MAPPERS = {"ray caster": vtk.vtkUnstructuredGridVolumeRayCastMapper, "ZSweep": vtk.vtkUnstructuredGridVolumeZSweepMapper,
           "projected tetrahedra": vtk.vtkProjectedTetrahedraMapper}


def read_mesh(task):
    reader = vtk.vtkXMLUnstructuredGridReader()
    reader.SetFileName(task["mesh"])
    reader.Update()
    grid = reader.GetOutput()
    grid.GetPointData().SetActiveScalars(task["field"])
    return grid


def volume_of(task, grid):
    """Extinction per unit of length; a chromaticity; the linear ray integrator."""
    mapper = MAPPERS[task["mapper"]]()
    mapper.SetInputData(grid)
    if hasattr(mapper, "SetRayIntegrator"):
        mapper.SetRayIntegrator(vtk.vtkUnstructuredGridLinearRayIntegrator())
        mapper.AutoAdjustSampleDistancesOff()
        mapper.SetImageSampleDistance(1.0)
    if hasattr(mapper, "SetNumberOfThreads"):
        mapper.SetNumberOfThreads(1)
    extinction, colour = vtk.vtkPiecewiseFunction(), vtk.vtkColorTransferFunction()
    for value, density in task["density"]:
        extinction.AddPoint(value, UNIT * density)
    for row in task["colour"]:
        colour.AddRGBPoint(*row)
    look = vtk.vtkVolumeProperty()
    look.SetColor(colour)
    look.SetScalarOpacity(extinction)
    look.SetScalarOpacityUnitDistance(UNIT)
    look.SetInterpolationTypeToLinear()
    look.ShadeOff()
    volume = vtk.vtkVolume()
    volume.SetMapper(mapper)
    volume.SetProperty(look)
    return volume


def main():
    task = json.loads(pathlib.Path(sys.argv[1]).read_text())
    window = vtk.vtkRenderWindow()
    window.SetOffScreenRendering(1)
    window.SetSize(task["size"], task["size"])
    window.SetMultiSamples(0)
    renderer = vtk.vtkRenderer()
    window.AddRenderer(renderer)
    camera = renderer.GetActiveCamera()
    camera.SetPosition(task["camera"]["eye"])
    camera.SetFocalPoint(task["camera"]["target"])
    camera.SetViewUp(task["camera"]["up"])
    camera.SetViewAngle(task["camera"]["fov_y_deg"])
    window.Render()  # an empty picture: what the window itself costs is not counted
    begin = time.process_time()
    grid = read_mesh(task)
    read = time.process_time() - begin
    renderer.AddVolume(volume_of(task, grid))
    renderer.ResetCameraClippingRange()
    frames = []
    for _ in range(task["frames"]):
        begin = time.process_time()
        window.Render()
        frames.append(time.process_time() - begin)
    reader = vtk.vtkWindowToImageFilter()
    reader.SetInput(window)
    reader.SetInputBufferTypeToRGB()
    reader.ReadFrontBufferOff()
    reader.ShouldRerenderOff()
    reader.Update()
    values = vtk_to_numpy(reader.GetOutput().GetPointData().GetScalars())
    np.save(task["picture"], values.reshape(task["size"], task["size"], 3)[::-1])
    print(json.dumps({"version": vtk.vtkVersion.GetVTKVersion(), "read": read, "frames": frames, "cells": grid.GetNumberOfCells(),
                      "memory": 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss}))


if __name__ == "__main__":
    main()
