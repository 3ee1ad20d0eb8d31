"""Clients edit and ask while the server is killed: all that they saw could have been done one after the other."""

import signal
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

import numpy as np
import pytest

from chunkserver.edits import Arena, Bricks, Deltas, Edit
from chunkserver.field import Ground
from chunkserver.grid import ChunkKey, ChunkShape
from chunkserver.pipeline import ChunkRequest, Edited, build_chunk
from chunkserver.wire import Encoding
from tests.conftest import SEED
from tests.fault.edit_clients import CELLS, LODS, RECIPE, Clients, digest
from tests.fault.linear import Record, faults
from tests.scale import count
from tests.serving import serving, until

ANSWERS = max(600, count(60_000))
KILLS = max(1, count(20))
REBUILT = max(30, count(2000))
SECONDS_MAX = 60.0 + ANSWERS / 100


def test_what_clients_see_could_have_been_one_after_the_other(tmp_path, rng):
    clients = Clients(SEED)
    with ThreadPoolExecutor(1) as threads:
        run = threads.submit(clients.run)
        try:
            for number in range(KILLS):
                with pytest.raises(AssertionError, match="exit code -9"):
                    live(tmp_path, clients, run, (number + 1) * ANSWERS // (KILLS + 1), signal.SIGKILL)
            live(tmp_path, clients, run, ANSWERS)
        finally:
            clients.over = clients.abandoned = True
    assert list(faults(clients.record)) == []
    covered(clients.record)
    assert rebuilt(clients, rng) > REBUILT / 2


def live(folder: Any, clients: Clients, run: "Future[None]", answers: int, end: signal.Signals | None = None) -> None:
    """Have a server until so many answers have come; then it is killed, or the clients come to their end."""
    with serving(folder / "log", "--workers", "2", "--data", str(folder / "data")) as server:
        clients.url = server.url
        until(lambda: run.done() or clients.done >= answers, SECONDS_MAX, f"{answers} answers")
        assert not run.done(), run.result()
        if end:
            server.stop(end)
        else:
            clients.over = True
            run.result(SECONDS_MAX)


def covered(record: Record) -> None:
    """All kinds of answers have come, from both sides of the kill."""
    assert {each.status for each in record.seen} >= {200, 304}
    assert {(each.pinned is not None, each.kept) for each in record.seen} == {
        (False, False),
        (True, False),
        (True, True),
    }
    assert any(each.min_revision for each in record.seen)
    assert len({each.revision for each in record.seen}) > ANSWERS / 40
    overlapping = sum(
        one.begin < each.end
        for one, each in zip(record.sent[1:], record.sent, strict=False)
        if each.revision is not None
    )
    assert overlapping > len(record.sent) / 4, "edits were under way at once"


def rebuilt(clients: Clients, rng: np.random.Generator) -> int:
    """Make some of the chunks again, of the log alone. Return how many there were."""
    answers = {(each.key, each.revision): each.digest for each in clients.record.seen if each.digest is not None}
    versions = list(answers)
    chosen = [versions[place] for place in rng.permutation(len(versions))[:REBUILT]]
    ground, bricks = Ground(RECIPE), Bricks(LODS, Arena(np.zeros(4096 * 4096, np.int32)))
    for key, revision in sorted(chosen, key=lambda version: version[1]):
        edits = [Edit.of(strokes) for strokes in clients.strokes[bricks.revision : revision]]
        if edits:
            bricks = bricks.apply(edits, revision, lambda box: ground.sample(box.low, box.shape))
        assert answers[key, revision] == built(bricks, key, revision), (key, revision)
    return len(chosen)


def built(bricks: Bricks, key: ChunkKey, revision: int) -> str:
    request = ChunkRequest(RECIPE, key, CELLS, revision=revision, encoding=Encoding())
    chunk = build_chunk(request, edited=Edited(bricks.arena.deltas, Deltas.of(bricks, key, ChunkShape(CELLS), 0)))
    return digest(chunk.content, b"" if chunk.content != "surface" else chunk.body)
