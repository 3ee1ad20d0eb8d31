"""What an operator may choose: one frozen value, made by the command line and handed to `create_app`."""

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Final

HOST_DEFAULT: Final = "127.0.0.1"
PORT_DEFAULT: Final = 8000
WORKERS_MAX: Final = 256
CACHE_BYTES_DEFAULT: Final = 256 << 20
"""Room for about 4,000 chunks of 60 KB."""


def cores() -> int:
    """Return how many cores this process may run on: the default number of workers."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


@dataclass(frozen=True, slots=True)
class Settings:
    """How one server runs.

    host, port: where it listens; port 0 takes a free one.
    workers: processes that build chunks.
    cache_bytes: bound on the memory of finished chunks that are kept, bookkeeping included.
    folder: where worlds are kept; None keeps them in memory, as long as the server runs.
    """

    host: str = HOST_DEFAULT
    port: int = PORT_DEFAULT
    workers: int = min(cores(), WORKERS_MAX)
    cache_bytes: int = CACHE_BYTES_DEFAULT
    folder: Path | None = None
