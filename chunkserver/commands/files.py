"""Files that commands read and write: read only so far, written as a whole or not at all. A fault is one line."""

import os
import sys
from pathlib import Path
from typing import Final

from chunkserver.commands.saying import end

PIPE: Final = "-"
"""Instead of a file's name: stdin, or stdout."""


def read(name: str, bytes_max: int) -> bytes:
    """Return what a file holds, or what is piped in: no more than `bytes_max` bytes of it."""
    try:
        if name == PIPE:
            return sys.stdin.buffer.read(bytes_max)
        with Path(name).open("rb") as file:
            return file.read(bytes_max)
    except OSError as error:
        end(f"{name} cannot be read: {error.strerror}")


def check_writable(name: str) -> None:
    """End, if it can be known beforehand that nothing can be written there."""
    if name == PIPE:
        return
    path = Path(name)
    try:
        if path.is_dir():
            end(f"{name} cannot be written: it is a folder")
        if not path.absolute().parent.is_dir():
            end(f"{name} cannot be written: there is no folder {path.parent}")
    except OSError as error:
        end(f"{name} cannot be written: {error.strerror}")


def write(name: str, body: bytes) -> None:
    """Write a file: beside it first, then in its place. However that ends, what was there before is whole, or it is.

    A link stays, and so does what is no file: nothing can take the place of a device or a named pipe.
    """
    if name == PIPE:
        sys.stdout.buffer.write(body)
        sys.stdout.buffer.flush()
        return
    try:
        if Path(name).exists() and not Path(name).is_file():
            Path(name).write_bytes(body)
            return
        path = Path(name).resolve()
        beside = path.with_name(f".{path.name}.{os.getpid()}.part")
        try:
            _fill(beside, body)
            beside.replace(path)
        finally:
            beside.unlink(missing_ok=True)
    except OSError as error:
        end(f"{name} cannot be written: {error.strerror}")


def _fill(path: Path, body: bytes) -> None:
    with path.open("xb") as file:
        file.write(body)
