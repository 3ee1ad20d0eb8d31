"""The masked faces of a chunk, and how their corners are walked: in samples of both levels, and in numbers of vertices.

Corners are coarse ones, (i, j) along the u and v of `TRANSITION` in cell.py; (0, 0) is at the chunk's low corner.
"""

from functools import cache
from operator import mul
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from chunkserver.grid import FACES
from chunkserver.kernel import inlined
from chunkserver.samples import coarse_box

FRAMES: Final = ((1, 2, 0), (2, 1, 0), (2, 0, 1), (0, 2, 1), (0, 1, 2), (1, 0, 2))
"""For each face the axes of a transition cell's u, v and w. w points into the chunk, and u, v, w are right-handed."""


class Walk(NamedTuple):
    """How a face is walked in something flat. start: of corner (0, 0). u, v: how far on the next corners are."""

    start: int
    u: int
    v: int


class Face(NamedTuple):
    """A masked face.

    fine, coarse, number: its walks in the samples of both levels and in `Seams.numbers`; a step is a coarse cell.
    u, v, w: the axes. far: its own place on w, in cells.
    """

    fine: Walk
    coarse: Walk
    number: Walk
    u: int
    v: int
    w: int
    far: int


@cache
def masked_faces(cells: int, apron: int, mask: int) -> NDArray[np.int64]:
    """Return the masked faces of such a chunk: (faces, 13), the numbers of a `Face`."""
    side, corners, rows = cells + 1 + 2 * apron, cells // 2 + 1, []
    low, (_, nz, nx) = coarse_box(cells, mask)
    # How far on the next one is along x, y and z.
    fine, coarse, number = (1, side * side, side), (1, nx * nz, nx), (corners * corners, corners, 1)
    for face in range(FACES):
        if mask >> face & 1:
            u, v, w = FRAMES[face]
            far = (face & 1) * cells
            first = [-place for place in low]
            first[w] += far // 2
            rows.append(
                [
                    *(apron * (side * side + side + 1) + far * fine[w], 2 * fine[u], 2 * fine[v]),
                    *(sum(map(mul, first, coarse)), coarse[u], coarse[v]),
                    *(far // 2 * number[w], number[u], number[v]),
                    *(u, v, w, far),
                ]
            )
    return np.array(rows, np.int64)


@inlined
def face_at(faces: NDArray[np.int64], place: int) -> Face:
    """Return a row of `masked_faces`."""
    return Face(
        Walk(faces[place, 0], faces[place, 1], faces[place, 2]),
        Walk(faces[place, 3], faces[place, 4], faces[place, 5]),
        Walk(faces[place, 6], faces[place, 7], faces[place, 8]),
        faces[place, 9],
        faces[place, 10],
        faces[place, 11],
        faces[place, 12],
    )


@inlined
def corner_at(walk: Walk, i: int, j: int) -> int:
    """Return where corner (i, j) of a face lies."""
    return walk.start + i * walk.u + j * walk.v
