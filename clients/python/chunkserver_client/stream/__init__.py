"""The stream of edits, seen from a game: a session as a state machine, without a socket, and what it tells the game.

`Session` is what to read first. It follows docs/wire/edit_v1.md.
"""

from chunkserver_client.edits import ChunkRange
from chunkserver_client.stream.chunks import Refresh
from chunkserver_client.stream.inbox import Inbox, Skipped
from chunkserver_client.stream.messages import Ack, Edit, Edits, Nack, Progress, Resync, Stale
from chunkserver_client.stream.places import Region
from chunkserver_client.stream.session import Ended, Event, Session, StartOver

__all__ = [
    "Ack",
    "ChunkRange",
    "Edit",
    "Edits",
    "Ended",
    "Event",
    "Inbox",
    "Nack",
    "Progress",
    "Refresh",
    "Region",
    "Resync",
    "Session",
    "Skipped",
    "Stale",
    "StartOver",
]
