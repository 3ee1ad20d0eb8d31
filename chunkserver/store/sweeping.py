"""What nothing refers to any more is deleted a little at a time; what is to be remembered of it is, in the same step.

    parts      of a foundation that is not the world's
    edits      up to the floor: each client's last seq and the answers to keys stay
    the rest   of a world that was deleted

A world stands in `unswept` as long as there may be some.
"""

from operator import itemgetter
from typing import Any, Final, NamedTuple

import apsw

from chunkserver.store.portions import STEP_BYTES_MAX, STEP_ROWS_MAX, portions


class _Kind(NamedTuple):
    """Rows of a table that belong to an owner, in the order of a key. size: SQL for the bytes of one, roughly."""

    table: str
    owner: str
    key: str
    size: str


_PARTS: Final = _Kind("parts", "foundation", "name", "length(content)")
_EDITS: Final = _Kind("edits", "world", "revision", "length(strokes) + length(stale)")
_KEYS: Final = _Kind("keys", "world", "revision", "coalesce(length(stale), 0)")
_CLIENTS: Final = _Kind("clients", "world", "client", "0")


def sweep(connection: apsw.Connection, spared: int | None) -> bool:
    """Take one step. Return False if there was nothing to do.

    spared: number of a world that is left alone.
    """
    world = connection.execute("SELECT min(world) FROM unswept WHERE world IS NOT ?", (spared,)).get
    if world is None:
        return False
    kept = connection.execute("SELECT floor, foundation FROM logs WHERE world = ?", (world,)).get
    if not (_sweep_kept(connection, world, *kept) if kept else _sweep_gone(connection, world)):
        connection.execute("DELETE FROM unswept WHERE world = ?", (world,))
    return True


def _sweep_kept(connection: apsw.Connection, world: int, floor: int, foundation: int | None) -> bool:
    if _sweep_foundation(connection, world, foundation):
        return True
    last = _end_of_step(connection, _EDITS, world, floor)
    if last is not None:
        _remember(connection, world, last)
    return _delete(connection, _EDITS, world, last)


def _sweep_gone(connection: apsw.Connection, world: int) -> bool:
    if _sweep_foundation(connection, world, None):
        return True
    kinds = (_EDITS, _KEYS, _CLIENTS)
    return any(_delete(connection, kind, world, _end_of_step(connection, kind, world)) for kind in kinds)


def _sweep_foundation(connection: apsw.Connection, world: int, kept: int | None) -> bool:
    """Delete parts of a foundation of a world that is not `kept`; when it has none, itself."""
    query = "SELECT min(number) FROM foundations WHERE world = ? AND number IS NOT ?"
    number = connection.execute(query, (world, kept)).get
    if number is None:
        return False
    if not _delete(connection, _PARTS, number, _end_of_step(connection, _PARTS, number)):
        connection.execute("DELETE FROM foundations WHERE number = ?", (number,))
    return True


def _remember(connection: apsw.Connection, world: int, last: int) -> None:
    """Keep of the edits up to `last` what is to outlive them."""
    query = (
        "SELECT client, seq, revision FROM edits WHERE world = ? AND revision <= ? AND client IS NOT NULL"
        " ORDER BY revision"
    )
    marks = {client: (seq, revision) for client, seq, revision in connection.execute(query, (world, last))}
    rows = [(*mark, world, client) for client, mark in marks.items()]
    connection.executemany("UPDATE clients SET seq = ?, revision = ? WHERE world = ? AND client = ?", rows)
    answer = "SELECT stale FROM edits WHERE edits.world = keys.world AND edits.revision = keys.revision"
    first = "SELECT min(revision) FROM edits WHERE world = :world"
    change = f"UPDATE keys SET stale = ({answer}) WHERE world = :world AND revision BETWEEN ({first}) AND :last"
    connection.execute(change, {"world": world, "last": last})


def _end_of_step(connection: apsw.Connection, kind: _Kind, owner: int, most: int | None = None) -> Any:
    """Return the key of the last row that one step deletes, `most` at most; None if there is no row."""
    within = "" if most is None else f"AND {kind.key} <= :most"
    query = (
        f"SELECT {kind.key}, {kind.size} FROM {kind.table} WHERE {kind.owner} = :owner {within}"
        f" ORDER BY {kind.key} LIMIT :rows"
    )
    rows: list[Any] = connection.execute(query, {"owner": owner, "most": most, "rows": STEP_ROWS_MAX}).fetchall()
    step = next(portions(rows, itemgetter(1), STEP_ROWS_MAX, STEP_BYTES_MAX), [])
    return step[-1][0] if step else None


def _delete(connection: apsw.Connection, kind: _Kind, owner: int, last: object) -> bool:
    """Delete rows up to the one whose key is `last`. Return whether there were any."""
    if last is None:
        return False
    change = f"DELETE FROM {kind.table} WHERE {kind.owner} = ? AND {kind.key} <= ?"  # one bound: SQLite would use one
    connection.execute(change, (owner, last))
    return True
