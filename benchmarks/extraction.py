"""Milliseconds per chunk, from ready samples to triangles with normals, in one thread each.

We read 35^3 samples, apron included, and write indexed triangles with u16 positions, and gradient normals that agree
with the neighbours'. The peers get the 33^3 corners alone, 84 % of the samples, as float32, and PyMCubes as the float64
that it is faster with. They write float32; their normals at the border are one-sided. PyMCubes writes float64 and makes
no normals. skimage refuses a block without a surface. What the meshes are worth is not compared here.
"""

from collections.abc import Callable, Iterator
from typing import Any, Final, NamedTuple

import mcubes  # type: ignore[import-untyped]
import numpy as np
from numpy.typing import NDArray
from skimage.measure import marching_cubes
from vtkmodules.util.numpy_support import numpy_to_vtk, vtk_to_numpy
from vtkmodules.vtkCommonCore import vtkSMPTools
from vtkmodules.vtkCommonDataModel import vtkImageData, vtkPolyData
from vtkmodules.vtkFiltersCore import vtkFlyingEdges3D

from benchmarks.measure import MS, Figure, Line, Scale, beside_first, in_turns, timed
from benchmarks.scenes import SCENES, Ready, prepare, triangles
from chunkserver.mesher import extract

Corners = NDArray[np.float32]
Surface = tuple[NDArray[Any], NDArray[Any]]
"""Vertices (V, 3) in cells, axes as the samples have them: y, z, x; and triangles (T, 3)."""


class Peer(NamedTuple):
    """Somebody else's extraction.

    ready: from (33, 33, 33) float32 to the input that it likes best; not counted.
    extract: what is counted. surface: its result as a `Surface`, for the tests.
    empty: whether it takes a block without a surface.
    """

    ready: Callable[[Corners], Any]
    extract: Callable[[Any], Any]
    surface: Callable[[Any], Surface]
    empty: bool = True


def run(scale: Scale) -> Iterator[Line]:
    """Yield a line per scene: milliseconds per chunk for each candidate."""
    for scene in SCENES.values():
        chunks = prepare(scene, scale.chunks)
        candidates = {"chunkserver": timed(lambda chunk: extract(chunk.samples), chunks, MS)}
        for name, peer in PEERS.items():
            if peer.empty or scene.content == "surface":
                candidates[name] = timed(peer.extract, [peer.ready(corners(chunk)) for chunk in chunks], MS)
        count = Figure("triangles", "a chunk", (triangles(chunks),))
        yield Line(scene.name, (count, *beside_first(in_turns(candidates, scale.rounds), "ms")))


def corners(chunk: Ready) -> Corners:
    """Return a copy of the samples without their apron."""
    shape = chunk.samples.shape
    inner = slice(shape.apron, shape.apron + shape.corners)
    return np.ascontiguousarray(chunk.samples.density[inner, inner, inner])


def _image(density: Corners) -> vtkImageData:
    image = vtkImageData()
    image.SetDimensions(*reversed(density.shape))
    image.GetPointData().SetScalars(numpy_to_vtk(density.ravel(), deep=True))  # type: ignore[no-untyped-call]
    return image


def _flying_edges() -> Callable[[vtkImageData], vtkPolyData]:
    vtkSMPTools.SetBackend("Sequential")  # one thread, as for everybody
    peer = vtkFlyingEdges3D()
    peer.SetValue(0, 0.0)
    peer.ComputeNormalsOn()
    peer.ComputeGradientsOff()
    peer.ComputeScalarsOff()

    def contour(image: vtkImageData) -> vtkPolyData:
        peer.SetInputData(image)
        peer.Update()
        found: vtkPolyData = peer.GetOutput()
        return found

    return contour


def _vtk_surface(found: vtkPolyData) -> Surface:
    points = vtk_to_numpy(found.GetPoints().GetData())  # type: ignore[no-untyped-call]
    triangles = vtk_to_numpy(found.GetPolys().GetConnectivityArray())  # type: ignore[no-untyped-call]
    return points[:, ::-1], triangles.reshape(-1, 3)


def _skimage(method: str) -> Peer:
    return Peer(
        np.ascontiguousarray,
        lambda density: marching_cubes(density, 0.0, method=method),  # type: ignore[no-untyped-call]
        lambda found: (found[0], found[1]),
        empty=False,
    )


PEERS: Final = {
    "vtkFlyingEdges3D": Peer(_image, _flying_edges(), _vtk_surface),
    "skimage lorensen": _skimage("lorensen"),
    "skimage lewiner": _skimage("lewiner"),
    "PyMCubes": Peer(
        lambda density: density.astype(np.float64),
        lambda density: mcubes.marching_cubes(density, 0.0),
        lambda found: (found[0], found[1]),
    ),
}
