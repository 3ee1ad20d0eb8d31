"""The log of the simulation answers as the real one does."""

import random
from contextlib import closing

import numpy as np

from chunkserver.errors import ChunkError
from chunkserver.store import Draft, Store
from tests.scale import count
from tests.sim.log import Log, Outcome, Strokes
from tests.sim.terrain import told
from tests.unit.store.edits import swept
from tests.unit.store.worlds import world

RUNS = count(3000)
STEPS = 40


def append(store: Store, epoch: str, client: str, seq: int, strokes: Strokes) -> tuple[int, bool, bool] | None:
    """Append an edit; return its revision, whether it is a duplicate, whether it is known what it made stale."""
    body = told(strokes)
    [found] = store.log.append([Draft(epoch=epoch, digest=body, strokes=body, stale=b"[]", client=client, seq=seq)])
    return None if isinstance(found, ChunkError) else (found.revision, found.duplicate, bool(found.stale))


def test_it_answers_as_the_real_log_does(rng: np.random.Generator):
    for number in range(RUNS):
        seed = int(rng.integers(1 << 32))
        with closing(Store(None)) as store:
            one = world(f"w{number}")
            store.catalogue.create(one)
            check(store, one.epoch, random.Random(seed), seed)


def check(store: Store, epoch: str, rng: random.Random, seed: int) -> None:
    """Assert that both logs say the same of random edits, seqs and foundations."""
    log, laid = Log(epoch), 0
    for step in range(STEPS):
        if log.revision and rng.random() < 0.1:
            revision = rng.randint(max(laid, 1), log.revision)
            store.log.lay(epoch, revision, [])
            swept(store.log)
            log.floor, laid = laid, revision
        client, seq = rng.choice(("a", "b")), rng.randint(0, 3 + step // 2)
        strokes = [{"op": "dig", "at": rng.choice((0, 0, 0, 1))}]
        found = log.append(client, seq, strokes)
        expected = (found.revision, found.duplicate, found.strokes is not None) if isinstance(found, Outcome) else None
        assert append(store, epoch, client, seq, strokes) == expected, f"seed {seed}, step {step}"
        assert (store.log.revision(epoch), store.log.floor(epoch)) == (log.revision, log.floor)
        assert store.log.mark(epoch, client) == log.mark(client)
