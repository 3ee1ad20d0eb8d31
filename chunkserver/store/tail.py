"""Where a world's log ends."""

from dataclasses import dataclass

import apsw

from chunkserver.errors import WorldGone


@dataclass(slots=True)
class Tail:
    """The end of a world's log, and its counters.

    world: its number. floor: edits up to here cannot be read. foundation: the number of its foundation, None if there
    is none; founded: the revision of that, or 0. clients, keys: how many it knows. revision: of its last edit.
    """

    world: int
    floor: int
    foundation: int | None
    founded: int
    clients: int
    keys: int
    revision: int


def tail_of(connection: apsw.Connection, epoch: str) -> Tail:
    """Return the end of a world's log. Raises `WorldGone`."""
    query = "SELECT world, floor, foundation, founded, clients, keys, revision FROM tails WHERE epoch = ?"
    for row in connection.execute(query, (epoch,)):
        return Tail(*row)
    raise WorldGone(f"no world of epoch {epoch!r} is kept here", epoch=epoch)


def mark_of(connection: apsw.Connection, world: int, client: str) -> int | None:
    """Return the highest seq of a client, None if it has none."""
    query = (
        "SELECT max(seq) FROM (SELECT max(seq) AS seq FROM edits WHERE world = :world AND client = :client"
        " UNION ALL SELECT seq FROM clients WHERE world = :world AND client = :client)"
    )
    mark: int | None = connection.execute(query, {"world": world, "client": client}).get
    return mark
