"""Eight players dig in one place while connections are cut and the server is killed: in the end all have one world.

What is compared: which edits each player knows, by revision; the server's log; and each chunk's bytes as the players
fetched them, as the server has them after one more restart, and as the log is worked out anew in this process.
"""

import hashlib
import signal
import threading
from collections.abc import Iterator
from concurrent.futures import Future
from contextlib import ExitStack, contextmanager
from itertools import product
from pathlib import Path
from typing import Any

import httpx2
import numpy as np

from chunkserver.edits import Arena, Bricks, Edit
from chunkserver.field import Ground
from chunkserver.grid import ChunkKey
from chunkserver_client import (
    Ack,
    Client,
    Edits,
    EditStream,
    LoggedEdit,
    Refresh,
    Resync,
    Retry,
    Skipped,
    Stale,
    WorldDescriptor,
)
from chunkserver_client import ChunkKey as ClientKey
from tests.client.wires import Wire, wire
from tests.contract.test_http_edits import CELLS, LODS, RECIPE, body
from tests.scale import TORTURE, count
from tests.serving import Server, serving, until
from tests.strokes import random_stroke

PLAYERS = 8
EDITS = count(1000)
"""Of a player."""
CUTS = 4
"""Of all connections, by each server's life."""
SECONDS_MAX = 30.0 + EDITS
QUICK = Retry(attempts_max=100, seconds_max=SECONDS_MAX, backoff_seconds=0.02, backoff_seconds_max=0.2)
SPREAD = 10.0
"""Voxels: all dig so near to each other."""
SLOTS = 4096
KEYS = [ChunkKey(lod, *at) for lod in range(2) for at in product((-1, 0), repeat=3)]
NEWS_SECONDS = 0.2

Body = dict[ClientKey, bytes]


class Player:
    """One player: digs when told to, hears of all others, and fetches what it shows.

    told: each edit of others, by revision. times: how often edits were told. gaps: events that left edits out.
    """

    def __init__(self, line: Wire, client: Client, world: WorldDescriptor, name: str, rng: np.random.Generator) -> None:
        self.stream: EditStream = client.stream(world, name)
        self.sent: list[tuple[list[dict[str, Any]], Future[Ack]]] = []
        self.told: dict[int, Any] = {}
        self.times = 0
        self.gaps: list[Any] = []
        self.shown: Body = {}
        self.failed = 0
        self._line, self._world, self._rng = line, world, rng
        self._ends = threading.Event()
        self._thread = threading.Thread(target=self._look_on)

    def __enter__(self) -> "Player":
        self.stream.__enter__()
        self.stream.show(*(ClientKey(*key) for key in KEYS))
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ends.set()
        self._thread.join(SECONDS_MAX)
        self.stream.close()
        assert not self._thread.is_alive()

    def dig(self, edits: int) -> None:
        for _ in range(edits):
            strokes = [self._stroke() for _ in range(self._rng.integers(1, 4))]
            self.sent.append((strokes, self.stream.edit(strokes)))

    def known(self) -> dict[int, Edit]:
        """Return all edits that it knows, by revision: those of others, and its own."""
        own = {answer.result(SECONDS_MAX).revision: strokes for strokes, answer in self.sent}
        assert len(own) == len(self.sent)
        assert own.keys().isdisjoint(self.told)
        return {revision: Edit.of(list(strokes)) for revision, strokes in (self.told | own).items()}

    def has_all(self, revision: int) -> bool:
        return self.stream.revision >= revision and self.stream.are_chunks_current

    def _stroke(self) -> dict[str, Any]:
        middle = tuple(float(at) for at in self._rng.uniform(-SPREAD, SPREAD, 3) * (1.0, 0.4, 1.0))
        return random_stroke(self._rng, middle, float(self._rng.uniform(2.0, 4.0)))

    def _look_on(self) -> None:
        with httpx2.Client(timeout=SECONDS_MAX) as http:
            while not self._ends.wait(NEWS_SECONDS):
                for event in self.stream.poll():
                    if isinstance(event, Edits):
                        self.told |= {edit.revision: edit.strokes for edit in event.edits}
                        self.times += len(event.edits)
                    elif isinstance(event, Refresh):
                        self._fetch(http, event)
                    elif isinstance(event, Stale | Resync | Skipped):
                        self.gaps.append(event)

    def _fetch(self, http: httpx2.Client, refresh: Refresh) -> None:
        try:
            fresh = bodies(http, self._line.url, self._world, refresh.keys, refresh.revision)
        except httpx2.HTTPError:
            self.failed += 1
            self.stream.failed(refresh)
        else:
            self.shown |= fresh
            self.stream.shown(refresh)


def bodies(http: httpx2.Client, url: str, world: WorldDescriptor, keys: Any, revision: int = 0) -> Body:
    """Return what the server answers for each chunk, as of a revision or a later one."""
    found = {}
    for key in keys:
        path = f"{url}{world.path}/chunks/{'/'.join(map(str, key))}.mesh"
        answer = http.get(path, params={"min_revision": str(revision)}).raise_for_status()
        found[ClientKey(*key)] = answer.content
    return found


def replayed(log: list[LoggedEdit]) -> Body:
    """Return each chunk's bytes as the edits of a log make them, worked out here, all at once."""
    ground = Ground(RECIPE)
    bricks = Bricks(LODS, Arena(np.zeros((SLOTS, 4096), np.int32)))
    edits = [Edit.of(list(edit.strokes)) for edit in log]
    bricks = bricks.apply(edits, len(log), lambda box: ground.sample(box.low, box.shape))
    return {ClientKey(*key): body(bricks, key, changed(key, log)) for key in KEYS}


def changed(key: ChunkKey, log: list[LoggedEdit]) -> int:
    """Return the last revision at which a chunk was stale."""
    return max((edit.revision for edit in log if any(each.holds(ClientKey(*key)) for each in edit.stale)), default=0)


def digests(found: Body) -> dict[ClientKey, str]:
    return {key: hashlib.sha256(content).hexdigest() for key, content in sorted(found.items())}


@contextmanager
def life(log: Path, line: Wire, *options: str) -> Iterator[Server]:
    """Run a server behind the wire, and kill it at the end."""
    try:
        with serving(log, *options) as server:
            line.target = server.url
            yield server
            line.target = None
            server.stop(signal.SIGKILL)
    except AssertionError as error:
        if "exit code -9" not in str(error):
            raise


def play(players: list[Player], line: Wire, edits: int) -> None:
    """Have all dig, and cut their connections meanwhile; return when the first half of that is acknowledged."""
    for part in np.array_split(range(edits), CUTS):
        for player in players:
            player.dig(len(part))
        players[0].sent[-1][1].result(SECONDS_MAX)
        line.cut()
    for player in players:
        player.sent[len(player.sent) // 2][1].result(SECONDS_MAX)


def test_all_players_the_server_and_the_log_have_one_world(tmp_path, rng):
    options = "--workers", "1", "--data", str(tmp_path / "data")
    revision = PLAYERS * EDITS
    with wire(None) as line, Client(line.url, retry=QUICK) as client, ExitStack() as stack:
        with life(tmp_path / "first", line, *options):
            world = client.create_world("w", RECIPE.seed, "terrain", chunk_cells=CELLS, lods=LODS)
            players = [Player(line, client, world, f"player-{number}", rng.spawn(1)[0]) for number in range(PLAYERS)]
            for player in players:
                stack.enter_context(player)
            play(players, line, EDITS // 2)
        with life(tmp_path / "second", line, *options):
            play(players, line, EDITS - EDITS // 2)
            until(lambda: all(player.has_all(revision) for player in players), SECONDS_MAX, "all players have all")
            log = list(client.edits(world))
            stack.close()
        with serving(tmp_path / "third", *options) as third, httpx2.Client(timeout=SECONDS_MAX) as http:
            after = digests(bodies(http, third.url, world, KEYS))
    wanted = {edit.revision: Edit.of(list(edit.strokes)) for edit in log}
    assert list(wanted) == list(range(1, revision + 1)), "nothing is lost, and nothing is doubled"
    assert line.opened > PLAYERS * 2
    cold = digests(replayed(log))
    assert after == cold
    assert len(set(cold.values())) > len(KEYS) // 3
    for player in players:
        known = player.known()
        assert player.times == len(player.told), "no edit is told twice"
        assert known == {revision: wanted[revision] for revision in known}
        assert len(known) == len(wanted) or (TORTURE and player.gaps), "who fetches for long may have edits left out"
        assert digests(player.shown) == cold
