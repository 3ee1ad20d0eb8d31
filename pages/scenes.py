"""Which chunks a picture shows: the finest where a cell would be seen, coarser ones further away and out of sight."""

import math
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache
from itertools import product
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from chunkserver.field import sample
from chunkserver.grid import LOD_MAX, ChunkKey, ChunkShape
from chunkserver.mesh import Mesh
from chunkserver.mesher import extract
from chunkserver.recipe import WorldRecipe

SHAPE: Final = ChunkShape()
THREADS: Final = 2
CHUNKS_MAX: Final = 30_000
"""Chunks of one scene, empty ones included: about a minute."""
UNSEEN_COARSER: Final = 3.0
"""How many times larger the cells may be of what is out of sight: it only throws shadows."""

Point = tuple[float, float, float]
Vector = NDArray[np.float64]
Scene = list[tuple[ChunkKey, Mesh]]


class Camera(NamedTuple):
    """A pinhole camera. Points in voxels; `up` need not be at right angles to the view; angles in degrees."""

    eye: Point
    target: Point
    up: Point = (0.0, 1.0, 0.0)
    across: float = 60.0
    width: int = 1280
    height: int = 720

    @property
    def pixel(self) -> float:
        """The width of a pixel at distance 1."""
        return 2 * math.tan(math.radians(self.across) / 2) / self.width

    def axes(self) -> Vector:
        """Return (3, 3): the unit vectors to the right, up and ahead, one a row."""
        return _axes(self.eye, self.target, self.up)


class Extent(NamedTuple):
    """How much of a world a picture takes in, in voxels.

    far: distance from the eye. floor: height under which everything is hidden anyway. radius: of a planet, from which
    height counts; 0 for flat worlds, where it is y. cell_pixels: how wide a cell may look.
    """

    far: float
    floor: float = -math.inf
    radius: float = 0.0
    cell_pixels: float = 4.0

    def hides(self, key: ChunkKey) -> bool:
        """Whether all of the chunk lies under the floor."""
        side = SHAPE.cells << key.lod
        low = key.low_corner(SHAPE.cells)
        furthest = math.hypot(*(max(abs(corner), abs(corner + side)) for corner in low))
        return (furthest - self.radius if self.radius else low[1] + side) < self.floor


def build(recipe: WorldRecipe, camera: Camera, extent: Extent) -> Scene:
    """Return the chunks with a surface that a picture takes in.

    Raises `ValueError` for more than CHUNKS_MAX chunks.
    """
    keys = [key for key in cut(camera, extent) if not extent.hides(key)]
    with ThreadPoolExecutor(THREADS) as pool:  # threads: kernels let go of the interpreter's lock
        meshes = pool.map(lambda key: extract(sample(recipe, key, SHAPE), normals="float32"), keys)
        return [(key, mesh) for key, mesh in zip(keys, meshes, strict=True) if not mesh.is_empty]


def cut(camera: Camera, extent: Extent) -> Iterator[ChunkKey]:
    """Yield keys that fill the ball of `far` voxels around the eye, each place once, what is hidden in large chunks."""
    far = extent.far
    lod = min(LOD_MAX, max(0, math.ceil(math.log2(far / SHAPE.cells))))
    side = SHAPE.cells << lod
    corners = (range(math.floor((c - far) / side), math.floor((c + far) / side) + 1) for c in camera.eye)
    waiting = [ChunkKey(lod, *place) for place in product(*corners)]
    for _ in range(CHUNKS_MAX):
        while waiting and _too_coarse(waiting[-1], camera, extent):
            key = waiting.pop()
            waiting += [_child(key, *place) for place in product((0, 1), repeat=3)]
        if not waiting:
            return
        yield waiting.pop()
    raise ValueError(f"the view wants more than {CHUNKS_MAX} chunks: a smaller `far` ({far:g}) or larger cells")


def _child(key: ChunkKey, x: int, y: int, z: int) -> ChunkKey:
    return ChunkKey(key.lod - 1, 2 * key.x + x, 2 * key.y + y, 2 * key.z + z)


def _too_coarse(key: ChunkKey, camera: Camera, extent: Extent) -> bool:
    """Whether a cell in the chunk's nearest place is wider than wanted; what lies beyond `far` is as good as it is."""
    side = float(SHAPE.cells << key.lod)
    to_middle = [low + side / 2 - eye for low, eye in zip(key.low_corner(SHAPE.cells), camera.eye, strict=True)]
    distance = math.hypot(*(max(abs(along) - side / 2, 0.0) for along in to_middle))
    wanted = extent.cell_pixels * (1.0 if _in_sight(to_middle, side, camera) else UNSEEN_COARSER)
    splits = key.lod > 0 and distance < extent.far and key.step > wanted * camera.pixel * distance
    return splits and not extent.hides(key)


def _in_sight(to_middle: list[float], side: float, camera: Camera) -> bool:
    """Whether the ball around the chunk reaches into the picture's pyramid."""
    radius = side * math.sqrt(3) / 2
    right, up, ahead = camera.axes() @ to_middle
    half_width = math.tan(math.radians(camera.across) / 2)
    for beside, half in ((right, half_width), (up, half_width * camera.height / camera.width)):
        if abs(beside) - half * ahead > radius * math.hypot(1, half):
            return False
    return bool(ahead > -radius)


@lru_cache(maxsize=1)
def _axes(eye: Point, target: Point, up: Point) -> Vector:
    """Chunks ask for the same axes thousands of times."""
    ahead = _unit(np.subtract(target, eye))
    right = _unit(np.cross(ahead, up))
    return np.stack([right, np.cross(right, ahead), ahead])


def _unit(vector: Vector) -> Vector:
    return vector / np.linalg.norm(vector)
