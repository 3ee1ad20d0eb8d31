"""The mesh of one chunk, in the wire's own types: nothing is encoded twice.

Positions are integers on the chunk's vertex lattice: `position = units_per_cell * cell_unit + 16384`, so that the same
world point has the same exact position from whichever chunk, worker or format it comes.

    0        16384                       49152      65535
    |  margin  |  low face ... high face   |  margin  |
"""

from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

Content = Literal["air", "rock", "surface"]
NormalKind = Literal["int8", "float32"]

POSITION_W: Final = 65535
"""The fourth component of every position: padding that keeps a vertex on 8 bytes and reads as 1.0 when normalised."""


VERTICES_U16_MAX: Final = 65535
"""The most vertices that 16-bit indices are used for. Index 65535, which restarts strips in some graphics interfaces,
then never occurs."""


def index_type(vertices: int) -> type[np.uint16 | np.uint32]:
    """Return the type of the indices of a mesh with so many vertices: uint16 up to `VERTICES_U16_MAX`, then uint32."""
    return np.uint16 if vertices <= VERTICES_U16_MAX else np.uint32


def as_indices(triangles: NDArray[np.uint32], vertices: int) -> NDArray[np.uint16] | NDArray[np.uint32]:
    """Return a copy of `triangles` in the type that a mesh with so many vertices has them in."""
    return triangles.astype(np.uint16) if index_type(vertices) is np.uint16 else triangles.copy()


@dataclass(frozen=True, slots=True)
class Mesh:
    """An indexed triangle mesh of one chunk.

    content: "surface", or "air" or "rock" for a chunk that the surface does not cross (then all arrays are empty).
    positions: (V, 4) uint16, C order, lattice units, chunk frame (x, y, z, 65535).
    normals: (V, 4) int8, round(127 * unit normal), fourth 0 - or (V, 3) float32, unit length. Both point into the air.
    triangles: (T, 3) `index_type`, C order, counter-clockwise seen from the air.
    """

    content: Content
    positions: NDArray[np.uint16]
    normals: NDArray[np.int8] | NDArray[np.float32]
    triangles: NDArray[np.uint16] | NDArray[np.uint32]

    @property
    def is_empty(self) -> bool:
        """Whether the surface does not cross the chunk."""
        return self.content != "surface"


def _empty(content: Content) -> Mesh:
    return Mesh(
        content,
        positions=np.empty((0, 4), np.uint16),
        normals=np.empty((0, 4), np.int8),
        triangles=np.empty((0, 3), np.uint16),
    )


EMPTY: Final[dict[Content, Mesh]] = {"air": _empty("air"), "rock": _empty("rock")}
"""The two meshes without a surface. Empty is a value, not an error."""
