"""What was changed: strokes become integer deltas, kept in bricks on all levels, which chunks add to their samples."""

from chunkserver.edits.arena import Arena
from chunkserver.edits.bricks import Bricks
from chunkserver.edits.deltas import Deltas
from chunkserver.edits.edit import Edit
from chunkserver.edits.history import History, Taken

__all__ = ["Arena", "Bricks", "Deltas", "Edit", "History", "Taken"]
