"""Client of chunkserver: the mesh of any chunk, as numpy arrays."""

from chunkserver_client.decoding import GLB_MEDIA_TYPE, MESH_MEDIA_TYPE, decode
from chunkserver_client.errors import BadAnswer, BadChunk, ClientError
from chunkserver_client.mesh import ChunkKey, ChunkMesh

__all__ = [
    "GLB_MEDIA_TYPE",
    "MESH_MEDIA_TYPE",
    "BadAnswer",
    "BadChunk",
    "ChunkKey",
    "ChunkMesh",
    "ClientError",
    "decode",
]
__version__ = "0.1.0"
