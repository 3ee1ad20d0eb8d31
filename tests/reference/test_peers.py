"""The mesher beside scikit-image and VTK, on smooth fields, where they are right: no ambiguous face, no exact zero.

All of them put their vertices on the same edges. Ours are rounded to a unit of the lattice, theirs are not, and a loop
may be cut along other diagonals; nothing else may differ.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial import KDTree
from skimage.measure import marching_cubes
from vtkmodules.util.numpy_support import numpy_to_vtk, numpy_to_vtkIdTypeArray, vtk_to_numpy
from vtkmodules.vtkCommonCore import vtkPoints
from vtkmodules.vtkCommonDataModel import vtkCellArray, vtkImageData, vtkPolyData
from vtkmodules.vtkFiltersCore import vtkFlyingEdges3D, vtkImplicitPolyDataDistance

from chunkserver.grid import POSITION_LOW, ChunkShape
from tests.worlds import Densities, grid_mesh

APART_MAX = 1.0
"""Lattice units, between the same vertex of two meshes: half for rounding, up to one where we keep off a corner."""
AREA_ERROR_MAX = 1e-4
VOLUME_ERROR_MAX = 1e-3
DISTANCE_MAX = 0.1
"""Cells, between surfaces: where a loop is cut along another diagonal, and the surface bends within a few cells."""
FLOAT32_ERROR = 1e-5
"""Cells: the peers' vertices are float32."""


class Shape(NamedTuple):
    """A mesh in cells: vertices (V, 3) float64, x y z; triangles (T, 3)."""

    vertices: NDArray[np.float64]
    triangles: NDArray[np.int64]


def by_skimage(density: Densities, method: str) -> Shape:
    vertices, triangles, _, _ = marching_cubes(density, 0.0, method=method, allow_degenerate=False)
    return Shape(vertices[:, [2, 0, 1]].astype(np.float64), triangles.astype(np.int64))


def by_vtk(density: Densities) -> Shape:
    image, side = vtkImageData(), len(density)
    image.SetDimensions(side, side, side)
    scalars = numpy_to_vtk(np.ascontiguousarray(density.swapaxes(0, 1)).reshape(-1), deep=True)
    image.GetPointData().SetScalars(scalars)
    edges = vtkFlyingEdges3D()
    edges.SetInputData(image)
    edges.SetValue(0, 0.0)
    edges.Update()
    found = edges.GetOutput()
    return Shape(
        vtk_to_numpy(found.GetPoints().GetData()).astype(np.float64),
        vtk_to_numpy(found.GetPolys().GetConnectivityArray()).reshape(-1, 3).astype(np.int64),
    )


def ours(density: Densities, cells: int) -> Shape:
    mesh = grid_mesh(density)
    positions = mesh.positions[:, :3].astype(np.float64) - POSITION_LOW
    return Shape(positions / ChunkShape(cells).units_per_cell, mesh.triangles.astype(np.int64))


PEERS: dict[str, Callable[[Densities], Shape]] = {
    "lorensen": lambda density: by_skimage(density, "lorensen"),
    "lewiner": lambda density: by_skimage(density, "lewiner"),
    "flying edges": by_vtk,
}


def ball(x, y, z):
    return np.sqrt(x**2 + y**2 + z**2) - 0.73


def torus(x, y, z):
    return np.hypot(np.hypot(x, 0.8 * y + 0.6 * z) - 0.55, 0.8 * z - 0.6 * y) - 0.27


def drops(x, y, z):
    centers = ((0.3, 0.2, -0.1), (-0.35, -0.1, 0.2), (0.05, -0.4, -0.3))
    return 0.5 - sum(np.exp(-((x - a) ** 2 + (y - b) ** 2 + (z - c) ** 2) / 0.08) for a, b, c in centers)


def sampled(field: Callable[..., NDArray[np.float64]], cells: int) -> Densities:
    """Return a field over [-1, 1] cubed as samples, axes (y, z, x), apron included, a bit off the middle."""
    side = ChunkShape(cells).samples
    y, z, x = (2 * (np.indices((side,) * 3) - 1) / cells - 1) + np.array([0.013, 0.007, -0.011])[:, None, None, None]
    return (field(x, y, z) * cells / 2).astype(np.float32)


def crossed(shape: Shape) -> NDArray[np.float64]:
    a, b, c = (shape.vertices[shape.triangles[:, i]] for i in range(3))
    return np.asarray(np.cross(b - a, c - a))


def area(shape: Shape) -> float:
    return float(np.linalg.norm(crossed(shape), axis=1).sum() / 2)


def volume(shape: Shape) -> float:
    return float(abs(np.einsum("ij,ij->", shape.vertices[shape.triangles[:, 0]], crossed(shape)) / 6))


def farthest(points: NDArray[np.float64], shape: Shape) -> float:
    """Return how far the farthest of some points is from a surface."""
    polygons, places, cells = vtkPolyData(), vtkPoints(), vtkCellArray()
    places.SetData(numpy_to_vtk(shape.vertices, deep=True))
    cells.SetData(3, numpy_to_vtkIdTypeArray(shape.triangles.reshape(-1), deep=True))
    polygons.SetPoints(places)
    polygons.SetPolys(cells)
    distance = vtkImplicitPolyDataDistance()
    distance.SetInput(polygons)
    return max(abs(distance.EvaluateFunction(point)) for point in points.tolist())


def hausdorff(a: Shape, b: Shape) -> float:
    """Return the Hausdorff distance of two surfaces, taken at vertices and middles of triangles."""
    points = [np.concatenate([s.vertices, s.vertices[s.triangles].mean(axis=1)]) for s in (a, b)]
    return max(farthest(points[0], b), farthest(points[1], a))


@pytest.mark.parametrize("peer", PEERS)
@pytest.mark.parametrize("field", [ball, torus, drops])
@pytest.mark.parametrize("cells", [32, 64])
def test_smooth_fields(cells, field, peer):
    density = sampled(field, cells)
    mine, theirs = ours(density, cells), PEERS[peer](density[1:-1, 1:-1, 1:-1].copy())
    assert len(mine.vertices) == len(theirs.vertices)
    assert len(mine.triangles) == len(theirs.triangles)
    apart = KDTree(mine.vertices).query(theirs.vertices)[0].max()
    assert apart <= APART_MAX / ChunkShape(cells).units_per_cell + FLOAT32_ERROR
    assert area(mine) == pytest.approx(area(theirs), rel=AREA_ERROR_MAX)
    assert volume(mine) == pytest.approx(volume(theirs), rel=VOLUME_ERROR_MAX)
    assert hausdorff(mine, theirs) <= DISTANCE_MAX
