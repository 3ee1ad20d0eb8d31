"""Transition cells again, slowly: plain Python numbers, one coarse cell after the other, corners named by level.

Shares with the mesher the triangles of a case and the axes of a face (`tests/unit/mesher` checks both).
"""

import math
from itertools import product

from chunkserver.grid import POSITION_HIGH, POSITION_LOW
from chunkserver.mesh import Mesh
from chunkserver.mesher.cases import case_triangles
from chunkserver.mesher.cell import CUBE, TRANSITION, Point
from chunkserver.mesher.faces import FRAMES
from chunkserver.mesher.room import SLIDE_CELLS
from chunkserver.mesher.transitions import TWIN_SHARE
from chunkserver.samples import Samples, coarse_box
from tests.reference.marching_cubes import Normals, Vertex, cube_triangles, nearest, stored

Corner = tuple[int, int, int, int]
"""Level (0 fine, 1 coarse) and place, x y z, in fine cells."""
Edge = tuple[Corner, Corner]
Triangles = list[tuple[Vertex, Vertex, Vertex]]


class Chunk:
    """The samples of one chunk, and the vertices that its cells ask for."""

    def __init__(self, samples: Samples) -> None:
        assert samples.coarse is not None
        self.mask, self.cells, self.units = samples.coarser, samples.shape.cells, samples.shape.units_per_cell
        self.apron, self.low = samples.shape.apron, coarse_box(self.cells, self.mask).low
        self.grids = samples.density.tolist(), samples.coarse.tolist()
        self.vertices: dict[Edge, Vertex] = {}
        self.places: dict[Edge, list[int]] = {}

    def density(self, corner: Corner, step: Point = (0, 0, 0)) -> float:
        """Return the sample of a corner, or of another one so many steps of its level on."""
        level, *place = corner
        x, y, z = (
            at // 2 - low + on if level else at + self.apron + on
            for at, low, on in zip(place, self.low, step, strict=True)
        )
        return float(self.grids[level][y][z][x])

    def gradient(self, corner: Corner) -> list[float]:
        """Return twice the gradient of a corner, per cell of its level."""
        steps = ((1, 0, 0), (0, 1, 0), (0, 0, 1))
        return [self.density(corner, step) - self.density(corner, (-step[0], -step[1], -step[2])) for step in steps]

    def vertex(self, low: Corner, high: Corner) -> Vertex:
        """Return the vertex between two corners: of one level, or a fine one and its coarse twin."""
        if (low, high) not in self.vertices:
            self.vertices[low, high] = self.between(low, high) if low[0] != high[0] else self.along(low, high)
        return self.vertices[low, high]

    def along(self, low: Corner, high: Corner) -> Vertex:
        """Return the vertex between two corners of one level."""
        place, t = self.crossed(low, high)
        normal = self.slope(low, high, t)
        if normal == [0.0, 0.0, 0.0]:
            sign = 1.0 if self.density(high) > self.density(low) else -1.0
            normal = [sign * (b > a) for a, b in zip(low[1:], high[1:], strict=True)]
        return _point(place if low[0] else self.places[low, high]), stored(normal)

    def crossed(self, low: Corner, high: Corner) -> tuple[list[int], float]:
        """Return where the surface crosses an edge, and at which t."""
        units = nearest(self.density(low), self.density(high), self.units)
        ends = zip(low[1:], high[1:], strict=True)
        return [POSITION_LOW + self.units * a + units * (b - a) for a, b in ends], units / self.units

    def slope(self, low: Corner, high: Corner, t: float) -> list[float]:
        """Return twice the gradient at t on an edge."""
        return [a + t * (b - a) for a, b in zip(self.gradient(low), self.gradient(high), strict=True)]

    def between(self, fine: Corner, coarse: Corner) -> Vertex:
        """Return the vertex between a corner and its twin."""
        place = [POSITION_LOW + self.units * at for at in fine[1:]]
        middle = [at + int(TWIN_SHARE * away) for at, away in zip(place, self.room(place), strict=True)]
        normal = [2 * a + b for a, b in zip(self.gradient(fine), self.gradient(coarse), strict=True)]
        return _point(middle), stored(normal if any(normal) else [0.0, 1.0, 0.0])

    def room(self, place: list[int]) -> list[float]:
        """Return how far a vertex is to get from masked faces: nowhere, if it touches a face that is not masked."""
        faces = [(axis, far) for axis in range(3) for far in (0, 1)]
        distances = [place[a] - POSITION_LOW if not far else POSITION_HIGH - place[a] for a, far in faces]
        away = [0.0, 0.0, 0.0]
        if any(not distance and not self.mask >> face & 1 for face, distance in enumerate(distances)):
            return away
        for face, (axis, far) in enumerate(faces):
            if self.mask >> face & 1 and distances[face] < self.units:
                away[axis] = (self.units - distances[face]) / 4 * (-1 if far else 1)
        return away

    def slid(self, low: Corner, high: Corner) -> list[int]:
        """Return where a vertex goes by itself."""
        place, t = self.crossed(low, high)
        away, slope = self.room(place), self.slope(low, high, t)
        up = _dot(away, slope) / _dot(slope, slope) if any(slope) else 0.0
        way = [a - up * b for a, b in zip(away, slope, strict=True)]
        along = _dot(way, way)
        if not along:
            return place
        stretch = _dot(away, away) / along
        if stretch * _dot(away, away) > (SLIDE_CELLS * self.units) ** 2:
            stretch = SLIDE_CELLS * self.units / math.sqrt(along)
        result = []
        for at, wanted, on in zip(place, away, way, strict=True):
            step = math.floor(on * stretch + 0.5)
            back, forth = (at - POSITION_LOW) // 2, (POSITION_HIGH - at) // 2
            result.append(at + (0 if step * wanted < 0 else min(max(step, -back), forth)))
        return result

    def make_room(self, triangles: list[list[Edge]]) -> None:
        """Work out where all vertices of the regular mesh are: moves that turn a triangle are halved."""
        before = {edge: self.crossed(*edge)[0] for row in triangles for edge in row}
        self.places = {edge: self.slid(*edge) for edge in before}
        while too_far := {edge for row in triangles if _is_turned(row, before, self.places) for edge in row}:
            for edge in too_far:
                ends = zip(before[edge], self.places[edge], strict=True)
                self.places[edge] = [a + int((b - a) / 2) for a, b in ends]

    def case(self, corners: list[Corner]) -> int:
        """Return which of a cell's corners are inside."""
        return sum(1 << number for number, corner in enumerate(corners) if self.density(corner) < 0.0)


def twin(samples: Samples) -> Triangles:
    """Return the triangles of one chunk with a mask, sorted; each in its own sense, the lowest vertex first."""
    chunk = Chunk(samples)
    regular: list[list[Edge]] = []
    for z, x, y in product(range(chunk.cells), repeat=3):
        corners = [(0, x + i, y + j, z + k) for i, j, k in CUBE.corners]
        edges = [(corners[low], corners[high]) for low, high in CUBE.edges]
        regular += [[edges[edge] for edge in triangle] for triangle in cube_triangles(chunk.case(corners))]
    chunk.make_room(regular)
    found = [[chunk.vertex(*edge) for edge in row] for row in regular]
    faces = [face for face in range(6) if chunk.mask >> face & 1]
    for face, i, j in product(faces, *[range(0, chunk.cells, 2)] * 2):
        corners = [_placed(chunk.cells, face, i + u, j + v, w) for u, v, w in TRANSITION.corners]
        for triangle in case_triangles(TRANSITION, chunk.case(corners)):
            vertices = [chunk.vertex(*(corners[c] for c in TRANSITION.edges[edge])) for edge in triangle]
            if len({place for place, _ in vertices}) == 3:
                found.append(vertices)
    return sorted(_lowest_first(*row) for row in found)


def triangles_of(mesh: Mesh, mesh_float32: Mesh) -> Triangles:
    """Return the mesher's triangles in the same form. Its two meshes differ in the kind of normals alone."""
    places = [_point(row) for row in mesh.positions[:, :3].tolist()]
    normals: list[Normals] = [
        ((x, y, z, w), row.tobytes())
        for (x, y, z, w), row in zip(mesh.normals.tolist(), mesh_float32.normals, strict=True)
    ]
    vertices = list(zip(places, normals, strict=True))
    return sorted(_lowest_first(*(vertices[i] for i in row)) for row in mesh.triangles.tolist())


def _placed(cells: int, face: int, u: int, v: int, w: int) -> Corner:
    """Return the corner of a transition cell at (u, v) on a face."""
    place = [0, 0, 0]
    axes = FRAMES[face]
    place[axes[0]], place[axes[1]], place[axes[2]] = u, v, cells * (face & 1)
    return 1 - w, place[0], place[1], place[2]


def _dot(a: list[float], b: list[float]) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _is_turned(row: list[Edge], before: dict[Edge, list[int]], after: dict[Edge, list[int]]) -> bool:
    """Return whether a triangle has turned by 60 degrees or more. Exact: these are integers."""
    old, new = _normal(*(before[edge] for edge in row)), _normal(*(after[edge] for edge in row))
    dot = sum(a * b for a, b in zip(old, new, strict=True))
    return dot <= 0 or 4 * dot * dot <= sum(a * a for a in old) * sum(a * a for a in new)


def _normal(a: list[int], b: list[int], c: list[int]) -> list[int]:
    u, v = ([x - y for x, y in zip(end, a, strict=True)] for end in (b, c))
    return [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]]


def _point(place: list[int]) -> Point:
    x, y, z = place
    return x, y, z


def _lowest_first(a: Vertex, b: Vertex, c: Vertex) -> tuple[Vertex, Vertex, Vertex]:
    return min((a, b, c), (b, c, a), (c, a, b))
