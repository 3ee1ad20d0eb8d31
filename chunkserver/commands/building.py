"""The chunks of a box, built on all cores: kernels let go of the interpreter's lock, so threads are enough."""

from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Final, NamedTuple

from chunkserver.commands.saying import end, with_bar
from chunkserver.grid import ChunkKey
from chunkserver.mesh import Content, Mesh
from chunkserver.pipeline import ChunkRequest, build_mesh
from chunkserver.worker import cores

TRIANGLES_MAX: Final = 1 << 23
"""Of a box. Welded and written they take about 2 GB of memory."""


class Built(NamedTuple):
    """The chunks of a box.

    surfaces: those that have one, in the order of their keys. contents: how many there are of each content.
    """

    surfaces: list[tuple[ChunkKey, Mesh]]
    contents: Counter[Content]


def build(template: ChunkRequest, keys: Sequence[ChunkKey]) -> Built:
    """Return the chunks at `keys`, all else as in `template`. Ends the command if they have too many triangles."""
    pool = ThreadPoolExecutor(cores())
    built, triangles = Built([], Counter()), 0
    try:
        meshes = pool.map(lambda key: build_mesh(replace(template, key=key)), keys)
        for key, mesh in with_bar("chunks", zip(keys, meshes, strict=True), len(keys)):
            built.contents[mesh.content] += 1
            triangles += len(mesh.triangles)
            if triangles > TRIANGLES_MAX:
                end(f"the box has more than {TRIANGLES_MAX:,} triangles: take a smaller one, or a higher --lod")
            if not mesh.is_empty:
                built.surfaces.append((key, mesh))
    finally:
        pool.shutdown(cancel_futures=True)
    return built
