"""Descriptors of worlds that no server has, and what must hold of chunks that are shown together."""

from collections.abc import Iterable, Sequence
from itertools import product
from typing import Final

from chunkserver_client import FittedChunk, Recipe, SeedDescriptor

VOXELS_MAX: Final = 1 << 40
Corner = tuple[int, int, int]


def world(
    lods: int = 12, cells: int = 32, errors: Sequence[float] | None = None, voxel_size: float = 1.0
) -> SeedDescriptor:
    return SeedDescriptor(
        seed=1,
        recipe=Recipe(digest="d", name="plane", parameters={}, expression={}),
        generator="g",
        voxel_size=voxel_size,
        chunk_cells=cells,
        lods=lods,
        low=(-VOXELS_MAX,) * 3,
        high=(VOXELS_MAX,) * 3,
        formats=(),
        meshers=(),
        seams=(),
        coarser=(),
        geometric_errors=None if errors is None else tuple(errors),
    )


Leaf = tuple[int, int, int, int]
STEPS: Final = [(x, y, z) for x, y, z in product((-1, 0, 1), repeat=3) if x or y or z]
FACES: Final = {(-1, 0, 0): 1, (1, 0, 0): 2, (0, -1, 0): 4, (0, 1, 0): 8, (0, 0, -1): 16, (0, 0, 1): 32}


def coarser_leaf(leaves: dict[Leaf, int], key: Leaf, lods: int) -> int:
    """Return the level of the leaf above that a chunk lies in; -1 if there is none."""
    lod, x, y, z = key
    for up in range(1, lods - lod):
        if (lod + up, x >> up, y >> up, z >> up) in leaves:
            return lod + up
    return -1


def assert_fits(chunks: Iterable[FittedChunk], lods: int) -> None:
    """No two overlap; those that touch, also at a corner, differ by one level at most; masks name the coarser ones."""
    rows = list(chunks)
    leaves: dict[Leaf, int] = {chunk[:4]: chunk.coarser for chunk in rows}
    assert len(leaves) == len(rows), "a chunk is there twice"
    for key, coarser in leaves.items():
        assert coarser_leaf(leaves, key, lods) == -1, f"{key} lies in another one"
        lod, x, y, z = key
        mask = 0
        for step in STEPS:
            beside = (lod, x + step[0], y + step[1], z + step[2])
            if beside in leaves or (found := coarser_leaf(leaves, beside, lods)) == -1:
                continue
            assert found == lod + 1, f"{key} touches a chunk of level {found}"
            mask |= FACES.get(step, 0)
        assert coarser == mask, f"{key} has the mask {coarser}, not {mask}"


def volume(chunks: Iterable[FittedChunk], cells: int, box: tuple[Corner, Corner] | None = None) -> int:
    """Return how many voxels the chunks fill; of a box, if there is one."""
    total = 0
    for chunk in chunks:
        side = cells << chunk.lod
        sides = [(side * place, side * (place + 1)) for place in chunk[1:4]]
        if box is not None:
            sides = [(max(a, low), min(b, high)) for (a, b), low, high in zip(sides, *box, strict=True)]
        x, y, z = (max(b - a, 0) for a, b in sides)
        total += x * y * z
    return total
