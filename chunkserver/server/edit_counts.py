"""What is counted of edits. Plain numbers, to be read whenever metrics are asked for."""

from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import NamedTuple

from chunkserver.errors import ChunkError
from chunkserver.server.histogram import Histogram


@dataclass(slots=True)
class EditCounts:
    """Counts from the start of the server on; one event loop owns it.

    written: edits. strokes: of these. stale: chunks that they made stale. log_bytes: that they brought into the log.
    duplicates: edits that had been written before.
    refused: edits that were not written, by the class of the error.
    write_seconds: of an edit that was written, from when it was read until it was durable.
    folded: edits that got into the bricks.
    fold_seconds: of edits that were folded together, from when they were given to the thread until their bricks could
        be read.
    """

    written: int = 0
    strokes: int = 0
    stale: int = 0
    log_bytes: int = 0
    duplicates: int = 0
    refused: Counter[type[ChunkError]] = field(default_factory=Counter)
    write_seconds: Histogram = field(default_factory=Histogram)
    folded: int = 0
    fold_seconds: Histogram = field(default_factory=Histogram)

    @contextmanager
    def refusals(self) -> Iterator[None]:
        """Count the error, if one is raised within: an edit was refused."""
        try:
            yield
        except ChunkError as error:
            self.refused[type(error)] += 1
            raise


class Standing(NamedTuple):
    """How things stand now.

    open: worlds whose edits are in memory. unfolded: edits that are durable and not in the bricks yet.
    bricks: that are there, of the open worlds. slots: of the arena, that have a brick in them. slots_max: of the arena.
    weight: bytes that edits take beside it.
    """

    open: int
    unfolded: int
    bricks: int
    slots: int
    slots_max: int
    weight: int
