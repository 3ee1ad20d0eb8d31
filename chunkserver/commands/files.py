"""Files that commands read and write: read only so far, written as a whole or not at all. A fault is one line."""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO, Final

from chunkserver.commands.saying import end

PIPE: Final = "-"
"""Instead of a file's name: stdin, or stdout."""


def read(name: str, bytes_max: int) -> bytes:
    """Return what a file holds, or what is piped in: no more than `bytes_max` bytes of it."""
    with _readable(name) as file:
        return file.read(bytes_max)


def lines(name: str, bytes_max: int) -> Iterator[tuple[int, bytes]]:
    """Yield the lines of a file, or of what is piped in, with their numbers, 1 for the first; blank ones are left out.

    Ends the command at one with more than `bytes_max` bytes.
    """
    with _readable(name) as file:
        number = 0
        while line := file.readline(bytes_max + 1):
            number += 1
            if len(line) > bytes_max:
                end(f"{name}, line {number} has more than {bytes_max:,} bytes")
            if line.strip():
                yield number, line


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
    """Write a file: beside it first, then in its place. However that ends, what was there before is whole, or it is."""
    with written(name) as file:
        file.write(body)


@contextmanager
def written(name: str) -> Iterator[BinaryIO]:
    """Write a file piece by piece: beside it first, then in its place, when the block has ended well.

    A link stays, and so does what is no file: nothing can take the place of a device or a named pipe.
    """
    if name == PIPE:
        yield sys.stdout.buffer
        sys.stdout.buffer.flush()
        return
    try:
        if Path(name).exists() and not Path(name).is_file():
            with Path(name).open("wb") as file:
                yield file
        else:
            with _replacing(Path(name).resolve()) as file:
                yield file
    except OSError as error:
        end(f"{name} cannot be written: {error.strerror}")


@contextmanager
def _replacing(path: Path) -> Iterator[BinaryIO]:
    beside = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        with _new(beside) as file:
            yield file
        beside.replace(path)
    finally:
        beside.unlink(missing_ok=True)


@contextmanager
def _readable(name: str) -> Iterator[BinaryIO]:
    try:
        if name == PIPE:
            yield sys.stdin.buffer
        else:
            with Path(name).open("rb") as file:
                yield file
    except OSError as error:
        end(f"{name} cannot be read: {error.strerror}")


def _new(path: Path) -> BinaryIO:
    return path.open("xb")
