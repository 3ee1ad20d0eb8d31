"""What was changed: strokes become integer deltas, kept in bricks on all levels, which chunks add to their samples."""

from chunkserver.edits.bricks import Bricks
from chunkserver.edits.deltas import Deltas
from chunkserver.edits.edit import Edit
from chunkserver.edits.effect import changed
from chunkserver.edits.headroom import Headroom
from chunkserver.edits.reach import stale

__all__ = ["Bricks", "Deltas", "Edit", "Headroom", "changed", "stale"]
