"""The chunks of a picture: which, and their meshes as a client gets them, out of the bytes that the server sends."""

from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from itertools import product
from typing import Final

from chunkserver.grid import ChunkKey, ChunkShape
from chunkserver.pipeline import ChunkRequest, build_chunk
from chunkserver.recipe import WorldRecipe
from chunkserver_client import ChunkMesh, decode

SHAPE: Final = ChunkShape()
CHUNKS_MAX: Final = 4096
"""Chunks of one picture, empty ones included."""
THREADS: Final = 2

Corner = tuple[int, int, int]


def box(lod: int, low: Corner, high: Corner) -> tuple[ChunkKey, ...]:
    """Return the chunks of one level from corner `low` to corner `high`, in chunks of that level; `high` is outside."""
    return tuple(ChunkKey(lod, *place) for place in product(*map(range, low, high)))


def rings(lods: Sequence[int], reach: int, floor: int, ceiling: int) -> tuple[ChunkKey, ...]:
    """Return levels around the origin, each twice as wide as the one before and without what that one covers.

    lods: one after the other, finest first. reach: chunks from the origin to the rim of a level's square, even.
    floor, ceiling: voxels, heights between which chunks are wanted.
    """
    keys: list[ChunkKey] = []
    for lod in lods:
        side = SHAPE.cells << lod
        square = box(lod, (-reach, floor // side, -reach), (reach, -(-ceiling // side), reach))
        inner = reach // 2 if lod > lods[0] else 0
        keys += [key for key in square if not (-inner <= key.x < inner and -inner <= key.z < inner)]
    return tuple(keys)


def served(recipe: WorldRecipe, keys: Iterable[ChunkKey]) -> list[ChunkMesh]:
    """Return the meshes of the chunks that have a surface, decoded.

    Raises `ValueError` for more than CHUNKS_MAX chunks.
    """
    wanted = list(keys)
    if len(wanted) > CHUNKS_MAX:
        raise ValueError(f"{len(wanted)} chunks: a picture has at most {CHUNKS_MAX}")
    with ThreadPoolExecutor(THREADS) as pool:  # threads: kernels let go of the interpreter's lock
        chunks = pool.map(lambda key: build_chunk(ChunkRequest(recipe, key)), wanted)
        return [decode(chunk.body) for chunk in chunks if chunk.content == "surface"]
