"""Client of chunkserver: the mesh of any chunk, as numpy arrays.

with Client("http://127.0.0.1:8000") as client:
    mesh = client.chunk(client.seed(42), (0, 0, -1, 0))
"""

from chunkserver_client.async_client import AsyncClient
from chunkserver_client.client import Client
from chunkserver_client.decoding import GLB_MEDIA_TYPE, MESH_MEDIA_TYPE, decode
from chunkserver_client.descriptors import ChunkHead, Descriptor, ListedWorld, Recipe, SeedDescriptor, WorldDescriptor
from chunkserver_client.errors import (
    BadAnswer,
    BadChunk,
    BadRequest,
    ClientError,
    Conflict,
    Gone,
    NotAllowed,
    NotFound,
    Problem,
    Unavailable,
    Unreachable,
)
from chunkserver_client.layers import FittedChunk
from chunkserver_client.levels import LevelOfDetail, Selection
from chunkserver_client.mesh import ChunkKey, ChunkMesh
from chunkserver_client.questions import ChunkOptions
from chunkserver_client.retry import Retry
from chunkserver_client.swaps import Swap, swaps
from chunkserver_client.version import __version__

__all__ = [
    "GLB_MEDIA_TYPE",
    "MESH_MEDIA_TYPE",
    "AsyncClient",
    "BadAnswer",
    "BadChunk",
    "BadRequest",
    "ChunkHead",
    "ChunkKey",
    "ChunkMesh",
    "ChunkOptions",
    "Client",
    "ClientError",
    "Conflict",
    "Descriptor",
    "FittedChunk",
    "Gone",
    "LevelOfDetail",
    "ListedWorld",
    "NotAllowed",
    "NotFound",
    "Problem",
    "Recipe",
    "Retry",
    "SeedDescriptor",
    "Selection",
    "Swap",
    "Unavailable",
    "Unreachable",
    "WorldDescriptor",
    "__version__",
    "decode",
    "swaps",
]
