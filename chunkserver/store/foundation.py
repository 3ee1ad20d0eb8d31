"""A foundation: named parts that stand for all edits of a world up to a revision. Written and read in steps.

    begin -> part, part, ... -> lay: it is the world's from now on

Each is a short transaction. One that is not the world's, because something came between, is swept away later.
"""

from collections.abc import Iterable, Iterator
from contextlib import closing
from typing import Final, NamedTuple

import apsw

from chunkserver.errors import BadParameter, StoreError
from chunkserver.store.portions import STEP_BYTES_MAX, STEP_ROWS_MAX, portions
from chunkserver.store.sqlite import Database
from chunkserver.store.tail import Tail, tail_of

PART_BYTES_MAX: Final = 1 << 20
"""Of a part: its name and its content."""
REVISION_MAX: Final = (1 << 53) - 1
"""Where a log without edits can begin."""

Part = tuple[bytes, bytes]


class Foundation(NamedTuple):
    """What all edits up to `revision` have made. Revision 0: there is none.

    parts: name and content of each, by name, read from the disk a few at a time. Raises `StoreError` if the foundation
        is not the world's any more, or cannot be read.
    """

    revision: int
    parts: Iterator[Part]


def steps(parts: Iterable[Part]) -> Iterator[list[Part]]:
    """Yield parts, some at once. Raises `BadParameter` for one that is too large."""
    return portions(parts, _checked_size, STEP_ROWS_MAX, STEP_BYTES_MAX)


def begin(connection: apsw.Connection, tail: Tail, revision: int) -> int:
    """Return the number of a new foundation. Raises `BadParameter` if it cannot be of this revision."""
    _floor_under(tail, revision)
    connection.execute("INSERT OR IGNORE INTO unswept (world) VALUES (?)", (tail.world,))
    connection.execute("INSERT INTO foundations (world, revision) VALUES (?, ?)", (tail.world, revision))
    return connection.last_insert_rowid()


def add(connection: apsw.Connection, number: int, parts: list[Part]) -> None:
    """Add parts to a foundation that is not laid yet."""
    rows = ((number, name, content) for name, content in parts)
    connection.executemany("INSERT INTO parts (foundation, name, content) VALUES (?, ?, ?)", rows)


def lay(connection: apsw.Connection, tail: Tail, number: int, revision: int) -> None:
    """Make a foundation the world's, whose floor gets to the revision of the one before.

    Raises `BadParameter` if it cannot be of this revision any more.
    """
    change = "UPDATE logs SET floor = ?, foundation = ? WHERE world = ?"
    connection.execute(change, (_floor_under(tail, revision), number, tail.world))


def read(database: Database, epoch: str) -> Foundation:
    """Return a world's foundation. Raises `WorldGone` or `StoreError`."""
    with database.read() as connection:
        tail = tail_of(connection, epoch)
    return Foundation(tail.founded, _parts(database, epoch, tail.foundation))


def _size(part: Part) -> int:
    name, content = part
    return len(name) + len(content)


def _checked_size(part: Part) -> int:
    size = _size(part)
    if size > PART_BYTES_MAX:
        message = f"part {part[0][:16]!r} of a foundation has {size} bytes; the limit is {PART_BYTES_MAX}"
        raise BadParameter(message, bytes=size)
    return size


def _floor_under(tail: Tail, revision: int) -> int:
    """Return what the floor is when a foundation of `revision` is laid."""
    low, high = (max(1, tail.founded), tail.revision) if tail.revision else (1, REVISION_MAX)
    if not low <= revision <= high:
        message = f"the revision of the foundation is {revision}; it lies in [{low}, {high}]"
        raise BadParameter(message, revision=revision)
    return tail.founded if tail.revision else revision


def _parts(database: Database, epoch: str, number: int | None) -> Iterator[Part]:
    start = b""
    while page := _page(database, epoch, number, start):
        yield from page
        start = page[-1][0] + b"\0"  # the least name behind that one


def _page(database: Database, epoch: str, number: int | None, start: bytes) -> list[Part]:
    """Return the first parts from a name on."""
    query = "SELECT name, content FROM parts WHERE foundation = ? AND name >= ? ORDER BY name LIMIT ?"
    with database.read() as connection:
        if tail_of(connection, epoch).foundation != number:
            raise StoreError("the foundation was replaced while it was read", epoch=epoch)
        with closing(connection.execute(query, (number, start, STEP_ROWS_MAX))) as rows:
            return next(portions(rows, _size, STEP_ROWS_MAX, STEP_BYTES_MAX), [])
