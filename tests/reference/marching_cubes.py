"""Marching cubes again, slowly: plain Python numbers, one cell after the other, a dictionary of vertices.

Shares with the mesher only the triangles of a case (`tests/unit/mesher/test_cases.py` checks those). Where a vertex
lies on its edge is worked out in exact whole numbers.
"""

import math
from collections.abc import Callable, Iterable
from functools import lru_cache
from itertools import product
from typing import NamedTuple

import numpy as np

from chunkserver.grid import POSITION_LOW
from chunkserver.mesh import POSITION_W, Mesh
from chunkserver.mesher.cases import Triangle, case_triangles
from chunkserver.mesher.cell import CUBE, Point
from chunkserver.samples import Samples

Bytes = tuple[int, int, int, int]
Normals = tuple[Bytes, bytes]
Vertex = tuple[Point, Normals]
Table = Callable[[int], Iterable[Triangle]]


class Unnumbered(NamedTuple):
    """A mesh without its numbering: equal if the same triangles join the same vertices.

    vertices: position (lattice units) -> its normal as int8 x 4, and as the bytes of float32 x 3.
    triangles: sorted; each as positions in its own sense, the lowest first.
    """

    vertices: dict[Point, Normals]
    triangles: list[tuple[Point, Point, Point]]


@lru_cache(maxsize=256)
def cube_triangles(case: int) -> tuple[Triangle, ...]:
    """Return the triangles of a case as the mesher's table is made from them."""
    return case_triangles(CUBE, case)


def twin(samples: Samples, table: Table = cube_triangles) -> Unnumbered:
    """Return the mesh of one chunk."""
    density, apron, units = samples.density.tolist(), samples.shape.apron, samples.shape.units_per_cell
    crossings: dict[tuple[Point, Point], Vertex] = {}
    triangles = []
    for x, z, y in product(range(samples.shape.cells - 1, -1, -1), repeat=3):
        case = 0
        for number, (i, j, k) in enumerate(CUBE.corners):
            if density[y + j + apron][z + k + apron][x + i + apron] < 0.0:
                case += 1 << number
        for triangle in table(case):
            places = []
            for edge in triangle:
                low, high = (_sum((x, y, z), CUBE.corners[number]) for number in CUBE.edges[edge])
                if (low, high) not in crossings:
                    crossings[low, high] = _vertex(density, apron, units, low, high)
                places.append(crossings[low, high][0])
            triangles.append(_lowest_first(*places))
    vertices = dict(crossings.values())
    assert len(vertices) == len(crossings), "two vertices in one place"
    return Unnumbered(vertices, sorted(triangles))


def unnumbered(mesh: Mesh, mesh_float32: Mesh) -> Unnumbered:
    """Return the mesher's two meshes of one chunk, which must agree on everything but the kind of normals."""
    assert np.array_equal(mesh.positions, mesh_float32.positions)
    assert np.array_equal(mesh.triangles, mesh_float32.triangles)
    assert (mesh.positions[:, 3] == POSITION_W).all()
    places: list[Point] = [(x, y, z) for x, y, z, _ in mesh.positions.tolist()]
    normals = zip(map(tuple, mesh.normals.tolist()), (row.tobytes() for row in mesh_float32.normals), strict=True)
    vertices = dict(zip(places, normals, strict=True))
    assert len(vertices) == len(places), "two vertices in one place"
    return Unnumbered(vertices, sorted(_lowest_first(*(places[i] for i in row)) for row in mesh.triangles.tolist()))


def _lowest_first(a: Point, b: Point, c: Point) -> tuple[Point, Point, Point]:
    return min((a, b, c), (b, c, a), (c, a, b))


def _vertex(density: list[list[list[float]]], apron: int, units: int, low: Point, high: Point) -> Vertex:
    """Return position and normals of the vertex between two corners, given in cells."""

    def at(point: Point) -> float:
        x, y, z = point
        return density[y + apron][z + apron][x + apron]

    def gradient(point: Point) -> list[float]:
        x, y, z = point
        return [
            at((x + 1, y, z)) - at((x - 1, y, z)),
            at((x, y + 1, z)) - at((x, y - 1, z)),
            at((x, y, z + 1)) - at((x, y, z - 1)),
        ]

    crossing = nearest(at(low), at(high), units)
    x, y, z = (POSITION_LOW + units * a + crossing * (b - a) for a, b in zip(low, high, strict=True))
    t = crossing / units
    normal = [a + t * (b - a) for a, b in zip(gradient(low), gradient(high), strict=True)]
    if normal == [0.0, 0.0, 0.0]:
        towards_air = 1.0 if at(high) > at(low) else -1.0
        normal = [towards_air * (b - a) for a, b in zip(low, high, strict=True)]
    return (x, y, z), stored(normal)


def nearest(low: float, high: float, units: int) -> int:
    """Return `-low / (high - low)` in units, rounded half up and kept off both ends: exact, in whole numbers."""
    (p, q), (r, s) = low.as_integer_ratio(), high.as_integer_ratio()
    part, whole = -p * s, r * q - p * s
    return min(max((2 * units * part + whole) // (2 * whole), 1), units - 1)


def _sum(a: Point, b: Point) -> Point:
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


def stored(normal: list[float]) -> Normals:
    length = math.sqrt(normal[0] * normal[0] + normal[1] * normal[1] + normal[2] * normal[2])
    unit = [value / length for value in normal]
    x, y, z = (math.floor(value * 127.0 + 0.5) for value in unit)
    return (x, y, z, 0), np.array(unit, np.float32).tobytes()
