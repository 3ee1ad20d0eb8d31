"""Memory that processes share. It has no name: it is gone with them, however they end. Needs Linux.

Slot     the server and one worker     a finished body, on its way from the one to the other
arena    the server and all workers    the bricks of all worlds' edits; workers only read it
"""

import mmap
import os
from typing import Final

import numpy as np
from numpy.typing import NDArray

from chunkserver.errors import WireError

BODY_BYTES_MAX: Final = 1 << 27
"""A chunk of 64 cells, all of them active, in the widest profile is about a third of this."""
SLOT_BYTES: Final = 1 << 20
"""Of each worker, kept; a longer body makes the slot larger, until it is taken."""

NO_ARENA: Final = np.empty(0, np.int32)


def slot_memory() -> int:
    """Return the descriptor of new memory for a `Slot`. Raises OSError if there is none to be had."""
    descriptor = os.memfd_create("chunkserver-slot")
    os.ftruncate(descriptor, SLOT_BYTES)
    return descriptor


class Slot:
    """Memory that the server shares with one worker. It has no name: it is gone with the two, however they end.

    A body is put into it on one side, then taken out of it on the other: the pipe says when, and how long it is.
    """

    def __init__(self, descriptor: int) -> None:
        """Map what `slot_memory` made. The descriptor is not needed any more then."""
        self._memory = mmap.mmap(descriptor, SLOT_BYTES)

    def put(self, body: bytes) -> None:
        """Write `body`. Raises `WireError` if it has more than `BODY_BYTES_MAX` bytes."""
        if len(body) > BODY_BYTES_MAX:
            message = f"a body has {len(body)} bytes; the limit is {BODY_BYTES_MAX}"
            raise WireError(message, bytes=len(body), bytes_max=BODY_BYTES_MAX)
        if len(body) > SLOT_BYTES:
            self._memory.resize(len(body))
        self._memory[: len(body)] = body

    def take(self, length: int) -> bytes:
        """Return a copy of the `length` bytes that were put, and give back all memory beyond `SLOT_BYTES`."""
        if length <= SLOT_BYTES:
            return self._memory[:length]
        self._memory.resize(length)
        body = self._memory[:length]
        self._memory.resize(SLOT_BYTES)  # the other side has more mapped, and touches it only once it has grown again
        return body

    def close(self) -> None:
        """Let go of it."""
        self._memory.close()


def arena_memory(size: int) -> int:
    """Return the descriptor of new memory of `size` bytes, zeros, for an arena. What is not written to takes no room.

    Raises OSError if there is none to be had.
    """
    descriptor = os.memfd_create("chunkserver-arena")
    os.ftruncate(descriptor, size)
    return descriptor


def mapped(descriptor: int, *, writable: bool) -> NDArray[np.int32]:
    """Return what `arena_memory` made as an array: (n,) int32. The descriptor is not needed any more then."""
    access = mmap.PROT_READ | mmap.PROT_WRITE if writable else mmap.PROT_READ
    return np.frombuffer(mmap.mmap(descriptor, 0, prot=access), np.int32)
