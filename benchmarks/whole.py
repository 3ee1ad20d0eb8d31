"""Milliseconds per chunk, from its key to its bytes: all that happens for one chunk, in one thread.

Ours is `build_chunk` in the native format: 35^3 samples, normals that agree with the neighbours', positions, normals
and indices as small integers behind a header. The peer is what pip offers for the job, put together as one would:

- `max(y - fbm * 24, (simplex - threshold) * 6)` with pyfastnoiselite's Perlin, 5 octaves, and its OpenSimplex2, on the
  33^3 corners in float32, the columns' part once per chunk;
- skimage's lewiner for mesh and normals; their float32 and int32 as they are, one after the other, as bytes.

Its noise is not ours, so its caves are other ones. Its threshold is 0.65 instead of 0.6: then as much of the rock is
open, and it has about as many triangles.
"""

from collections.abc import Callable, Iterator
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from skimage.measure import marching_cubes

from benchmarks.measure import MS, Figure, Line, Scale, beside_first, in_turns, timed
from benchmarks.peer_noise import FAST_NOISE, fast_noise, has_fast_noise
from benchmarks.scenes import SCENES, SHAPE, prepare, triangles
from chunkserver.grid import ChunkKey
from chunkserver.pipeline import build_chunk

SCENE: Final = "terrain underground"
PEER: Final = f"{FAST_NOISE} + skimage"
THRESHOLD: Final = np.float32(0.65)

_STEPS: Final = np.indices((SHAPE.corners,) * 3, np.float32).reshape(3, -1)
"""y, z, x of each corner from the chunk's low one: (3, n)."""


class Piece(NamedTuple):
    """A chunk of the peer's: how many triangles it has, and the bytes of vertices, normals and triangles."""

    triangles: int
    body: bytes


def run(scale: Scale) -> Iterator[Line]:
    """Yield one line: milliseconds per chunk. Without the peer our own figure stands alone."""
    chunks = prepare(SCENES[SCENE], scale.chunks)
    keys = [chunk.request.key for chunk in chunks]
    counts = [Figure("triangles", "a chunk", (triangles(chunks),))]
    candidates = {"chunkserver": timed(lambda chunk: build_chunk(chunk.request), chunks, MS)}
    if has_fast_noise():
        build = peer()
        candidates[PEER] = timed(build, keys, MS)
        counts.append(
            Figure("triangles of the peer", "a chunk", (sum(build(key).triangles for key in keys) / len(keys),))
        )
    yield Line(SCENE, (*counts, *beside_first(in_turns(candidates, scale.rounds), "ms")))


def peer() -> Callable[[ChunkKey], Piece]:
    """Return how the peer builds the chunk of a key."""
    field = peer_field()

    def build(key: ChunkKey) -> Piece:
        vertices, faces, normals, _ = marching_cubes(field(key), 0.0)  # type: ignore[no-untyped-call]
        return Piece(len(faces), vertices.tobytes() + normals.tobytes() + faces.tobytes())

    return build


def peer_field() -> Callable[[ChunkKey], NDArray[np.float32]]:
    """Return how the peer samples a chunk: key -> (33, 33, 33) float32, axes (y, z, x), the corners alone."""
    ground, caves = fast_noise("Perlin", 0.02, octaves=5), fast_noise("OpenSimplex2", 0.05)
    side = SHAPE.corners

    def field(key: ChunkKey) -> NDArray[np.float32]:
        x, y, z = key.low_corner(SHAPE.cells)
        points = _STEPS + np.array([[y], [z], [x]], np.float32)
        height = ground(points[1:, : side * side]) * np.float32(24)
        cave = (caves(points) - THRESHOLD) * np.float32(6)
        level = points[0].reshape(side, side * side)
        density: NDArray[np.float32] = np.maximum(level - height, cave.reshape(side, side * side))
        return density.reshape(side, side, side)

    return field
