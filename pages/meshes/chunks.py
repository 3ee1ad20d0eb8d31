"""The chunks of a picture: which, and their meshes as a client gets them, out of the bytes that the server sends."""

from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from itertools import product
from typing import Final, Literal

from chunkserver.grid import ChunkKey, ChunkShape, coarser_mask
from chunkserver.pipeline import ChunkRequest, build_chunk
from chunkserver.recipe import WorldRecipe
from chunkserver_client import ChunkMesh, decode

SHAPE: Final = ChunkShape()
CHUNKS_MAX: Final = 4096
"""Chunks of one picture, empty ones included."""
THREADS: Final = 2

Corner = tuple[int, int, int]
Seam = Literal["transitions", "skirts", "none"]


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


def around(eye: Corner, lods: Sequence[int], reach: int) -> tuple[ChunkKey, ...]:
    """Return chunks of several levels that fill a cube around the origin, finer ones nearer to `eye`.

    A chunk is split if it is less far from the eye, on its farthest axis, than it is wide. So two that touch are one
    row of `lods` apart at most: what touches a piece of a split chunk of width w is within 2 w of the eye.

    eye: voxels. lods: levels, finest first. reach: chunks of the coarsest level from the origin to each face.
    """
    keys = box(lods[-1], (-reach,) * 3, (reach,) * 3)
    for finer, lod in zip(lods[-2::-1], lods[:0:-1], strict=True):
        split = {key for key in keys if key.lod == lod and _away(key, eye) < SHAPE.cells << lod}
        times = 1 << lod - finer
        pieces = [box(finer, _scaled(key, times, 0), _scaled(key, times, 1)) for key in keys if key in split]
        keys = tuple(key for key in keys if key not in split) + tuple(piece for each in pieces for piece in each)
    return keys


def _away(key: ChunkKey, eye: Corner) -> int:
    """Return how far the chunk is from the eye on the axis on which it is farthest, voxels; 0 if it is there."""
    side = SHAPE.cells << key.lod
    lows = [at * side - place for at, place in zip(key[1:], eye, strict=True)]
    return max(0, *(max(low, -low - side) for low in lows))


def _scaled(key: ChunkKey, times: int, on: int) -> Corner:
    return (key.x + on) * times, (key.y + on) * times, (key.z + on) * times


def served(recipe: WorldRecipe, keys: Iterable[ChunkKey], seam: Seam = "transitions") -> list[ChunkMesh]:
    """Return the meshes of the chunks that have a surface, decoded.

    With transitions each has the mask of its coarser neighbours among `keys`, which may touch where they are one level
    apart. Raises `ValueError` for more than CHUNKS_MAX chunks.
    """
    wanted = list(keys)
    if len(wanted) > CHUNKS_MAX:
        raise ValueError(f"{len(wanted)} chunks: a picture has at most {CHUNKS_MAX}")
    shown = set(wanted) if seam == "transitions" else set()
    requests = [ChunkRequest(recipe, key, coarser=coarser_mask(key, shown), seam=seam) for key in wanted]
    with ThreadPoolExecutor(THREADS) as pool:  # threads: kernels let go of the interpreter's lock
        return [decode(chunk.body) for chunk in pool.map(build_chunk, requests) if chunk.content == "surface"]
