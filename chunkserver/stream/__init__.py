"""Who is told of which edits, in which order: the stream of edits, without sockets, clock or log.

docs/wire/edit_v1.md is the protocol. `Stream` is one world, `Connection` one peer; `Journal` is what they ask of a log.
"""

from chunkserver.stream import closing, limits
from chunkserver.stream.connection import Connection, Journal
from chunkserver.stream.edit import StreamEdit
from chunkserver.stream.stream import Stream

__all__ = ["Connection", "Journal", "Stream", "StreamEdit", "closing", "limits"]
