"""Edits to write to a log and to read, in two worlds."""

from chunkserver.errors import ChunkError
from chunkserver.store import Draft, EditLog, Outcome, Store
from tests.unit.store.worlds import world

A, B = world("a"), world("b")
SWEEPS_MAX = 10_000


def draft(body=b"x", epoch=A.epoch, **names):
    return Draft(epoch=epoch, digest=b"digest of " + body, strokes=body, stale=b"stale of " + body, **names)


def written(kept: EditLog, *drafts: Draft) -> list[Outcome]:
    outcomes = kept.append(drafts)
    assert not [one for one in outcomes if isinstance(one, ChunkError)]
    return [one for one in outcomes if isinstance(one, Outcome)]


def refusal(kept: EditLog, one: Draft) -> ChunkError:
    before = kept.revision(A.epoch)
    (outcome,) = kept.append([one])
    assert isinstance(outcome, ChunkError)
    assert kept.revision(A.epoch) == before
    return outcome


def bodies(kept: EditLog, epoch=A.epoch, after=0, limit=100):
    return [(edit.revision, edit.strokes) for edit in kept.read(epoch, after, limit)]


def swept(kept: EditLog) -> int:
    """Sweep until nothing is left to do. Return how many steps that took."""
    for steps in range(SWEEPS_MAX):
        if not kept.sweep():
            return steps
    raise AssertionError("sweeping does not end")


def foundation(kept: EditLog, epoch: str = A.epoch) -> tuple[int, dict[bytes, bytes]]:
    revision, parts = kept.foundation(epoch)
    return revision, dict(parts)


def rows(store: Store) -> dict[str, int]:
    """How many rows each table has that hangs on a world."""
    tables = ("logs", "edits", "clients", "keys", "foundations", "parts", "unswept")
    with store._database.read() as connection:
        return {table: connection.execute(f"SELECT count(*) FROM {table}").get for table in tables}
