"""Client of chunkserver: the mesh of any chunk, as numpy arrays.

with Client("http://127.0.0.1:8000") as client:
    mesh = client.chunk(client.seed(42), (0, 0, -1, 0))
"""

from chunkserver_client.async_client import AsyncClient
from chunkserver_client.blocking_stream import EditStream
from chunkserver_client.client import Client
from chunkserver_client.decoding import GLB_MEDIA_TYPE, MESH_MEDIA_TYPE, decode
from chunkserver_client.descriptors import ChunkHead, Descriptor, ListedWorld, Recipe, SeedDescriptor, WorldDescriptor
from chunkserver_client.edit_stream import AsyncEditStream
from chunkserver_client.edits import ChunkRange, LoggedEdit, Stroke, WrittenEdit, delta_stroke
from chunkserver_client.errors import (
    BadAnswer,
    BadChunk,
    BadRequest,
    ClientError,
    Conflict,
    EditLost,
    Gone,
    NotAllowed,
    NotFound,
    Problem,
    StreamEnded,
    Unavailable,
    Unreachable,
)
from chunkserver_client.layers import FittedChunk
from chunkserver_client.levels import LevelOfDetail, Selection
from chunkserver_client.mesh import ChunkKey, ChunkMesh
from chunkserver_client.questions import ChunkOptions
from chunkserver_client.retry import Retry
from chunkserver_client.stream import (
    Ack,
    Edit,
    Edits,
    Nack,
    Progress,
    Refresh,
    Region,
    Resync,
    Skipped,
    Stale,
    StartOver,
)
from chunkserver_client.swaps import Swap, redraws, swaps
from chunkserver_client.version import __version__

__all__ = [
    "GLB_MEDIA_TYPE",
    "MESH_MEDIA_TYPE",
    "Ack",
    "AsyncClient",
    "AsyncEditStream",
    "BadAnswer",
    "BadChunk",
    "BadRequest",
    "ChunkHead",
    "ChunkKey",
    "ChunkMesh",
    "ChunkOptions",
    "ChunkRange",
    "Client",
    "ClientError",
    "Conflict",
    "Descriptor",
    "Edit",
    "EditLost",
    "EditStream",
    "Edits",
    "FittedChunk",
    "Gone",
    "LevelOfDetail",
    "ListedWorld",
    "LoggedEdit",
    "Nack",
    "NotAllowed",
    "NotFound",
    "Problem",
    "Progress",
    "Recipe",
    "Refresh",
    "Region",
    "Resync",
    "Retry",
    "SeedDescriptor",
    "Selection",
    "Skipped",
    "Stale",
    "StartOver",
    "StreamEnded",
    "Stroke",
    "Swap",
    "Unavailable",
    "Unreachable",
    "WorldDescriptor",
    "WrittenEdit",
    "__version__",
    "decode",
    "delta_stroke",
    "redraws",
    "swaps",
]
