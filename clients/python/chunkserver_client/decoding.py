"""From an answer's bytes to a mesh: one row a format."""

from collections.abc import Callable
from typing import Final

from chunkserver_client.errors import BadChunk
from chunkserver_client.glb import decode_glb
from chunkserver_client.mesh import ChunkMesh
from chunkserver_client.native import decode_native

MESH_MEDIA_TYPE: Final = "application/vnd.chunkserver.mesh"
GLB_MEDIA_TYPE: Final = "model/gltf-binary"

CHUNK_BYTES_MAX: Final = 1 << 30
"""Of one file. The largest that the format can state has 16 million vertices and 33 million triangles: 0.5 GiB."""

_DECODERS: Final[dict[str, Callable[[memoryview], ChunkMesh]]] = {
    MESH_MEDIA_TYPE: decode_native,
    GLB_MEDIA_TYPE: decode_glb,
}


def decode(content: bytes | bytearray | memoryview, media_type: str = MESH_MEDIA_TYPE) -> ChunkMesh:
    """Return the mesh of a chunk's file, as views into `content`: nothing is copied.

    content: a whole file, of the native format or GLB. Whoever hands over a bytearray leaves it alone from then on.
    media_type: an answer's `Content-Type`; parameters behind a semicolon are ignored.

    Every length, offset, type and index is checked, so the arrays can be handed to code that checks nothing. Raises
    `BadChunk` if the bytes are no chunk, truncated or mutated, and for any other media type; never anything else.
    """
    decoder = _DECODERS.get(media_type.partition(";")[0].strip().lower())
    if decoder is None:
        raise BadChunk(f"media type {media_type[:80]!r}: there are {list(_DECODERS)}")
    held = memoryview(content).cast("B")
    if len(held) > CHUNK_BYTES_MAX:
        raise BadChunk(f"{len(held)} bytes: at most {CHUNK_BYTES_MAX}")
    return decoder(held)
