"""Which chunks to show a viewer, and how each has to fit its neighbours: docs/level-of-detail.md.

lod = LevelOfDetail(world)
selection = lod.select(position)
for mesh in client.chunks(world, selection.chunks, viewer=position): ...
selection = lod.select(position, velocity, previous=selection)
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Final

from numpy.typing import NDArray

from chunkserver_client.cut import Cut, Octree, Viewer
from chunkserver_client.descriptors import Descriptor
from chunkserver_client.ladder import WIDTHS_MAX, Rung, rungs
from chunkserver_client.layers import Box, FittedChunk
from chunkserver_client.mesh import Triple

Point = Sequence[float] | NDArray[Any]
"""(x, y, z)."""

ERROR_OF_A_CELL: Final = 0.25
"""How far a surface may be off, in cells, where the descriptor does not say."""
REACH_CHUNKS_MIN: Final = 8
"""Chunks of LOD 0 that are within reach at least, where nobody says."""
CHUNKS_MAX: Final = 16384
CHUNKS_LEAST: Final = 64
"""More than the last rung of the ladder can have."""
VIEWER_MAX: Final = 1 << 42
"""Voxels. Nothing is within reach of who is further out."""


@dataclass(frozen=True, eq=False, slots=True)
class Selection:
    """What to show.

    chunks: they fill what is within reach and do not overlap. `Client.chunks` takes them as they are.
    coarsened: how much had to be given up to have `chunks_max` chunks at most; 0 is nothing.
    """

    chunks: frozenset[FittedChunk]
    coarsened: int
    _shown: Cut = field(repr=False)
    _maker: "LevelOfDetail" = field(repr=False)


class LevelOfDetail:
    """Cuts the octree of a world so that nothing that is seen is off by more than some pixels.

    Chunks that touch, also at an edge or a corner, differ by one level at most.

    world: what `seed`, `world` or `create_world` returned.
    error_pixels: how far the surface may seem to be off before a chunk is split. It merges again at four fifths.
    screen_pixels: height of the picture. fov_degrees: its vertical angle.
    ahead_seconds: how much of the viewer's way is looked ahead.
    reach: chunks of the last level are shown if they are nearer, in voxels. By default the width of one, and at least
        8 chunks of LOD 0; at most 16 of the last level.
    box: (low, high) corner, in voxels: where there is anything. Chunks that have none of it in them are left out.
    chunks_max: at least 64; what is given up for it first is seen least.

    Raises `ValueError`, which names the value, for what makes no view.
    """

    def __init__(
        self,
        world: Descriptor,
        *,
        error_pixels: float = 4.0,
        screen_pixels: float = 1080.0,
        fov_degrees: float = 60.0,
        ahead_seconds: float = 1.0,
        reach: int | None = None,
        box: tuple[Triple, Triple] | None = None,
        chunks_max: int = CHUNKS_MAX,
    ) -> None:
        for name, value in {"error_pixels": error_pixels, "screen_pixels": screen_pixels}.items():
            _check(0 < value < math.inf, name, value, "a positive number")
        _check(0 < fov_degrees < 180, "fov_degrees", fov_degrees, "between 0 and 180")
        _check(0 <= ahead_seconds < math.inf, "ahead_seconds", ahead_seconds, "not negative")
        _check(chunks_max >= CHUNKS_LEAST, "chunks_max", chunks_max, f"at least {CHUNKS_LEAST}")
        sides = [world.chunk_cells << lod for lod in range(world.lods)]
        widest = sides[-1]
        if reach is None:
            reach = max(widest, REACH_CHUNKS_MIN * world.chunk_cells)
        _check(0 < reach <= WIDTHS_MAX * widest, "reach", reach, f"1 to {WIDTHS_MAX * widest} voxels")
        self._octree: Final = Octree(sides, _box_of(world, box, widest))
        self._chunks_max: Final = chunks_max
        self._ahead_seconds: Final = ahead_seconds
        errors = world.geometric_errors or [ERROR_OF_A_CELL * (1 << lod) for lod in range(world.lods)]
        sharpness = screen_pixels / (2 * math.tan(math.radians(fov_degrees) / 2)) / error_pixels
        self._rungs: Final = rungs(world.chunk_cells, errors, sharpness, reach)

    def select(
        self,
        position: Point,
        velocity: Point = (0.0, 0.0, 0.0),
        previous: Selection | None = None,
    ) -> Selection:
        """Return what to show to a viewer. If that is the same as before, so is the object in `chunks`.

        position: (x, y, z) in voxels. velocity: voxels a second.
        previous: what this object has returned for the frame before; whatever was split then merges later.

        Raises `ValueError` for what is no finite point, and for a selection of another object.
        """
        if previous is not None and previous._maker is not self:
            raise ValueError("previous is a selection of another LevelOfDetail")
        viewer = Viewer(
            _voxels("position", position), _voxels("velocity", [speed * self._ahead_seconds for speed in velocity])
        )
        number, cut = self._finest(viewer, previous)
        if previous is not None and cut.layers == previous._shown.layers:
            return Selection(previous.chunks, number, cut, self)
        return Selection(cut.chunks(), number, cut, self)

    def _finest(self, viewer: Viewer, previous: Selection | None) -> tuple[int, Cut]:
        """Return the finest cut that is not too large, and its rung. A finer one than before needs room to spare."""
        before, number = (None, 0) if previous is None else (previous._shown, previous.coarsened)
        while number and self._cut(self._rungs[number - 1].roomy(), viewer, None) is not None:
            number -= 1
        while (cut := self._cut(self._rungs[number], viewer, before)) is None:
            number += 1
        return number, cut

    def _cut(self, rung: Rung, viewer: Viewer, before: Cut | None) -> Cut | None:
        return self._octree.cut(rung, viewer, before, self._chunks_max)


def _voxels(name: str, point: Point) -> Triple:
    _check(len(point) == 3 and all(map(math.isfinite, point)), name, point, "three finite numbers")
    x, y, z = (math.floor(max(-VIEWER_MAX, min(place, VIEWER_MAX))) for place in point)
    return x, y, z


def _box_of(world: Descriptor, box: tuple[Triple, Triple] | None, widest: int) -> Box:
    """Return the part of a box that chunks of the last level can hold. widest: their width."""
    low, high = box or (world.low, world.high)
    _check(len(low) == len(high) == 3 and all(a < b for a, b in zip(low, high, strict=True)), "box", box, "low < high")
    x, y, z = (max(int(place), -(-least // widest) * widest) for place, least in zip(low, world.low, strict=True))
    ex, ey, ez = (min(int(place), most // widest * widest) for place, most in zip(high, world.high, strict=True))
    return Box((x, y, z), (ex, ey, ez))


def _check(holds: bool, name: str, value: object, expected: str) -> None:
    if not holds:
        raise ValueError(f"{name} is {value}: expected {expected}")
