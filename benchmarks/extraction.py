"""Milliseconds per chunk, from ready samples to triangles with normals, in one thread each.

We read 35^3 samples, apron included, and write indexed triangles with u16 positions, and gradient normals that agree
with the neighbours'. The peers get the 33^3 corners alone, 84 % of the samples, and write float32; their normals at the
border are one-sided. skimage refuses a block without a surface. What the meshes are worth is not compared here.
"""

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray
from skimage.measure import marching_cubes
from vtkmodules.util.numpy_support import numpy_to_vtk
from vtkmodules.vtkCommonCore import vtkSMPTools
from vtkmodules.vtkCommonDataModel import vtkImageData
from vtkmodules.vtkFiltersCore import vtkFlyingEdges3D

from benchmarks.measure import MS, Figure, Line, Scale, beside_first, in_turns, timed
from benchmarks.scenes import SCENES, Ready, prepare, triangles
from chunkserver.mesher import extract


def run(scale: Scale) -> Iterator[Line]:
    """Yield a line per scene: milliseconds per chunk for each candidate. skimage refuses a block without a surface."""
    for scene in SCENES.values():
        chunks = prepare(scene, scale.chunks)
        candidates = _candidates(chunks, skimage=scene.content == "surface")
        count = Figure("triangles", "a chunk", (triangles(chunks),))
        yield Line(scene.name, (count, *beside_first(in_turns(candidates, scale.rounds), "ms")))


def _candidates(chunks: list[Ready], skimage: bool) -> dict[str, Callable[[], float]]:
    corners = [_corners(chunk) for chunk in chunks]
    candidates = {
        "chunkserver": timed(lambda chunk: extract(chunk.samples), chunks, MS),
        "vtkFlyingEdges3D": timed(_flying_edges(), map(_image, corners), MS),
    }
    if skimage:
        for method in ("lorensen", "lewiner"):
            candidates[f"skimage {method}"] = timed(_skimage(method), corners, MS)
    return candidates


def _corners(chunk: Ready) -> NDArray[np.float32]:
    """Return a copy of the samples without their apron."""
    shape = chunk.samples.shape
    inner = slice(shape.apron, shape.apron + shape.corners)
    return np.ascontiguousarray(chunk.samples.density[inner, inner, inner])


def _image(corners: NDArray[np.float32]) -> vtkImageData:
    image = vtkImageData()
    image.SetDimensions(*reversed(corners.shape))
    image.GetPointData().SetScalars(numpy_to_vtk(corners.ravel()))  # type: ignore[no-untyped-call]
    return image


def _flying_edges() -> Callable[[vtkImageData], None]:
    vtkSMPTools.SetBackend("Sequential")  # one thread, as for everybody
    peer = vtkFlyingEdges3D()
    peer.SetValue(0, 0.0)
    peer.ComputeNormalsOn()
    peer.ComputeGradientsOff()
    peer.ComputeScalarsOff()

    def contour(image: vtkImageData) -> None:
        peer.SetInputData(image)
        peer.Update()

    return contour


def _skimage(method: str) -> Callable[[NDArray[np.float32]], Any]:
    return lambda corners: marching_cubes(corners, 0.0, method=method)  # type: ignore[no-untyped-call]
