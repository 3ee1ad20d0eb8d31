"""Edits over HTTP, asked of the real server: every chunk is as its edits have left it, also after restarts."""

import base64
import signal
import time
from concurrent.futures import ThreadPoolExecutor
from itertools import product
from typing import Any

import httpx2
import numpy as np
import pytest

from chunkserver.edits import Arena, Bricks, Deltas, Edit
from chunkserver.field import Ground
from chunkserver.grid import ChunkKey, ChunkShape
from chunkserver.pipeline import ChunkRequest, Edited, build_chunk
from chunkserver.recipe import WorldRecipe, builtin
from chunkserver.wire import Encoding
from tests.serving import serving

SECONDS_MAX = 60.0
JSON = {"Content-Type": "application/json"}
CELLS, LODS = 16, 3
RECIPE = WorldRecipe(7, builtin("terrain"))
WORLD = {"id": "w", "seed": "7", "recipe": "terrain", "chunk_cells": CELLS, "lods": LODS}
KEYS = [ChunkKey(lod, *at) for lod in range(LODS) for at in product((-2 if lod < 2 else -1, 0), (-1, 0), (-1, 0, 1))]


def ball(op: str, x: float, y: float, z: float, radius: float = 5.0, **more: Any) -> dict[str, Any]:
    return {"op": op, "shape": "sphere", "center": [x, y, z], "radius": radius, **more}


STROKES = [
    [ball("carve", 0, -2, 0)],
    [ball("fill", 9, 3, -6), ball("add", -5, 0, 4, strength=2.5)],
    [ball("smooth", 2, -2, 2, strength=0.7)],
    [ball("carve", -9, -6, -9, 3.0), ball("flatten", 8, 0, 8, point=[8, -1, 8], normal=[0, 2, 0], strength=1)],
]


class World:
    """The world `w` of a running server."""

    def __init__(self, server) -> None:
        self.url = f"{server.url}/v1/worlds/w"
        self.http = httpx2.Client(timeout=SECONDS_MAX)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.http.close()

    def edit(self, strokes, key=None):
        headers = {} if key is None else {"Idempotency-Key": key}
        return self.http.post(f"{self.url}/edits", json={"strokes": strokes}, headers=headers)

    def chunk(self, key, query="", **headers):
        return self.http.get(f"{self.url}/chunks/{'/'.join(map(str, key))}.mesh{query}", headers=headers)

    def told(self):
        return self.http.get(self.url).json()


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    with serving(tmp_path_factory.mktemp("server") / "log", "--workers", "2") as running:
        yield running


@pytest.fixture
def world(server):
    httpx2.post(f"{server.url}/v1/worlds", json=WORLD, timeout=SECONDS_MAX).raise_for_status()
    with World(server) as world:
        yield world
    httpx2.delete(f"{server.url}/v1/worlds/w", timeout=SECONDS_MAX).raise_for_status()


def folded(edits) -> list[Bricks]:
    """Return the bricks of a world after each of its edits, worked out here."""
    ground = Ground(RECIPE)
    history = [Bricks(LODS, Arena(np.zeros(4096 * 4096, np.int32)))]
    for revision, strokes in enumerate(edits, 1):
        field = lambda box: ground.sample(box.low, box.shape)  # noqa: E731
        history.append(history[-1].apply([Edit.of(strokes)], revision, field))
    return history


def body(bricks, key, revision, coarser=0) -> bytes:
    """Return the bytes of a chunk, built here."""
    request = ChunkRequest(RECIPE, key, CELLS, coarser=coarser, revision=revision, encoding=Encoding())
    chunk = build_chunk(request, edited=Edited(bricks.arena.deltas, Deltas.of(bricks, key, ChunkShape(CELLS), coarser)))
    return b"" if chunk.content != "surface" else chunk.body


def within(stale, key) -> bool:
    return any(
        each["lod"] == key.lod
        and all(low <= at <= high for low, at, high in zip(each["min"], key[1:], each["max"], strict=True))
        for each in stale
    )


def test_what_is_far_from_any_surface_can_be_edited(world):
    """Deltas are beyond 2^24 there, and are added by another way."""
    strokes = [ball("fill", 3, 60_000, 4, 6.0)]
    assert world.edit(strokes).status_code == 200
    bricks, found = folded([strokes])[-1], 0
    for lod in range(LODS):
        y = 60_000 // (CELLS << lod)
        for key in [ChunkKey(lod, x, y, z) for x in (-1, 0) for z in (-1, 0)]:
            chunk = world.chunk(key)
            assert chunk.status_code in (200, 204), chunk.text
            assert chunk.content == body(bricks, key, 1)
            found += chunk.status_code == 200
    assert found > LODS


def test_raw_boxes_of_any_size_that_is_allowed_can_be_posted(world):
    """As JSON one of the largest has 1.4 MB, and an edit has 8 MiB."""
    values = base64.b64encode(bytes([1, 0, 0, 0]) * 64**3).decode()
    box = {"op": "delta", "min": [0, 0, 0], "size": [64, 64, 64], "values": values}
    assert world.edit([box]).status_code == 200
    assert world.edit([box] * 5).json()["revision"] == "2"
    answer = world.edit([box] * 6)
    assert (answer.status_code, answer.json()["bytes_max"]) == (413, 8 << 20)
    begun = time.perf_counter()
    answer = world.http.post(f"{world.url}/edits", content=b'{"strokes":[%b[]]}' % (b"[]," * 2_700_000), headers=JSON)
    assert (answer.status_code, answer.json()["punctuation"]) == (422, 5_400_003)
    assert time.perf_counter() - begun < 2.0, "the event loop is not kept"
    keys = [("Idempotency-Key", "a"), ("Idempotency-Key", "b")]
    answer = world.http.post(f"{world.url}/edits", json={"strokes": STROKES[0]}, headers=keys)
    assert (answer.status_code, answer.json()["detail"]) == (422, "Idempotency-Key is there 2 times; an edit has one")


def test_every_chunk_is_as_its_edits_have_left_it(world):
    history, last = folded(STROKES), dict.fromkeys(KEYS, 0)
    tags = {key: world.chunk(key).headers["etag"] for key in KEYS}
    stayed = 0
    for revision, strokes in enumerate(STROKES, 1):
        answer = world.edit(strokes)
        assert (answer.status_code, answer.json()["revision"]) == (200, str(revision))
        assert answer.json()["duplicate"] is False
        for key in KEYS:
            is_stale = within(answer.json()["stale"], key)
            last[key] = revision if is_stale else last[key]
            stayed += not is_stale
            for _ in range(2):
                chunk = world.chunk(key, **{"If-None-Match": tags[key]})
                assert chunk.headers["chunk-revision"] == str(last[key])
                assert chunk.headers["world-revision"] == str(revision)
                assert chunk.status_code == (304 if chunk.headers["etag"] == tags[key] else chunk.status_code)
                assert (chunk.headers["etag"] == tags[key]) is (chunk.status_code == 304)
                if not is_stale:
                    assert chunk.status_code == 304
                elif chunk.status_code != 304:
                    assert chunk.content == body(history[revision], key, revision)
                    tags[key] = chunk.headers["etag"]
            assert world.chunk(key).content == body(history[revision], key, last[key])
    assert stayed > 5
    assert world.told()["revision"] == str(len(STROKES))
    for mask in (1, 42, 63):
        for key in KEYS[:16]:
            chunk = world.chunk(key, f"?coarser={mask}")
            assert chunk.content == body(history[-1], key, last[key], mask)


def test_a_batch_has_the_edits_too(world):
    world.edit(STROKES[0]).raise_for_status()
    asked = {"chunks": [[*key] for key in KEYS]}
    stream = world.http.post(f"{world.url}/chunks", json=asked).content
    expected = folded(STROKES[:1])[-1]
    for key in KEYS:
        alone = world.chunk(key)
        if alone.content:
            assert alone.content == body(expected, key, int(alone.headers["chunk-revision"]))
            assert alone.content in stream
    assert int.from_bytes(stream[8:16], "little") == 1


def test_the_same_key_writes_once(world):
    first = world.edit(STROKES[0], "dig-1")
    again = world.edit(STROKES[0], "dig-1")
    assert again.json() == first.json() | {"duplicate": True}
    other = world.edit(STROKES[1], "dig-1")
    assert (other.status_code, other.json()["type"]) == (422, "urn:chunkserver:problem:bad-parameter")
    assert world.edit(STROKES[0]).json()["revision"] == "2", "without a key it is another edit"
    for key in ("", "x" * 129, "a b", "\xe9"):
        named = {"Idempotency-Key": key.encode("latin-1")}
        answer = world.http.post(f"{world.url}/edits", json={"strokes": STROKES[0]}, headers=named)
        assert answer.status_code == 422
    assert world.told()["revision"] == "2"


@pytest.mark.parametrize(
    ("strokes", "path"),
    [
        ([], "strokes"),
        ([ball("carve", 0, 0, 0, radius=-1)], "strokes.0.radius"),
        ([ball("carve", 0, 0, 0), ball("melt", 0, 0, 0)], "strokes.1.op"),
        ([ball("carve", 1e300, 0, 0)], "strokes.0.center.0"),
    ],
)
def test_a_bad_stroke_is_named_and_nothing_is_written(world, strokes, path):
    answer = world.edit(strokes)
    assert (answer.status_code, answer.json()["type"]) == (422, "urn:chunkserver:problem:bad-stroke")
    assert answer.json()["path"] == path
    assert world.told()["revision"] == "0"


def test_the_log_gives_the_edits_back(world):
    answers = [world.edit(strokes).json() for strokes in STROKES]
    read = world.http.get(f"{world.url}/edits", params={"after": 1, "limit": 2}).json()
    assert read["revision"] == "4"
    assert [edit["revision"] for edit in read["edits"]] == ["2", "3"]
    assert [edit["stale"] for edit in read["edits"]] == [answer["stale"] for answer in answers[1:3]]
    assert [Edit.of(edit["strokes"]) for edit in read["edits"]] == [Edit.of(strokes) for strokes in STROKES[1:3]]
    assert world.http.get(f"{world.url}/edits", params={"after": 9}).json()["edits"] == []
    assert world.http.get(f"{world.url}/edits", params={"limit": 0}).status_code == 422
    assert world.http.get(f"{world.url}/edits", params={"limit": 1001}).status_code == 422


def test_what_cannot_change_anything_makes_nothing_stale(world):
    answer = world.edit([ball("carve", 0, 300, 0)])
    assert (answer.json()["revision"], answer.json()["stale"]) == ("1", [])


def test_immutable_answers_and_those_that_wait(world):
    told, key = world.told(), ChunkKey(0, 0, -1, 0)
    tokens = f"g={told['generator']}&epoch={told['epoch']}"
    world.edit(STROKES[0]).raise_for_status()
    old = world.chunk(key, f"?revision=0&{tokens}")
    assert (old.headers["cache-control"], old.headers["chunk-revision"]) == ("no-store", "1")
    kept = world.chunk(key, f"?revision=1&{tokens}")
    assert "immutable" in kept.headers["cache-control"]
    assert kept.content == old.content
    assert world.chunk(key, f"?revision=2&{tokens}").status_code == 404
    with ThreadPoolExecutor(1) as later:
        waiting = later.submit(world.chunk, key, "?min_revision=2")
        world.edit(STROKES[2]).raise_for_status()
        assert waiting.result().headers["world-revision"] == "2"


def test_no_answer_is_older_than_what_was_acknowledged_before_it(world):
    """Four clients dig in the same place, and ask for what they have dug."""
    keys = [ChunkKey(lod, *at) for lod in (0, 1) for at in product((-1, 0), repeat=3)]

    def dig(client: int) -> list[tuple[ChunkKey, bytes, int, int]]:
        seen = []
        for number in range(6):
            answer = world.edit([ball("add", client - 2, -2, number - 3, 4.0, strength=(-1) ** client * 0.5)])
            assert answer.status_code == 200
            revision = int(answer.json()["revision"])
            for key in keys[number % 4 :: 4]:
                chunk = world.chunk(key)
                told = int(chunk.headers["chunk-revision"]), int(chunk.headers["world-revision"])
                assert told[1] >= revision
                assert told[0] >= revision or not within(answer.json()["stale"], key)
                seen.append((key, chunk.content, *told))
        return seen

    with ThreadPoolExecutor(4) as pool:
        seen = [each for found in pool.map(dig, range(4)) for each in found]
    log = world.http.get(f"{world.url}/edits", params={"limit": 1000}).json()["edits"]
    assert [edit["revision"] for edit in log] == [str(revision) for revision in range(1, 25)]
    history = folded([edit["strokes"] for edit in log])
    for key, content, revision, _ in seen:
        assert content == body(history[revision], key, revision)


@pytest.mark.parametrize("end", [signal.SIGTERM, signal.SIGKILL])
def test_what_was_acknowledged_is_there_after_a_restart(tmp_path, end):
    options = "--workers", "1", "--data", str(tmp_path / "data")
    acknowledged: list[Any] = []

    def first() -> dict[ChunkKey, Any]:
        with serving(tmp_path / "log1", *options) as server:
            httpx2.post(f"{server.url}/v1/worlds", json=WORLD, timeout=SECONDS_MAX).raise_for_status()
            with World(server) as world:
                acknowledged.extend(world.edit(strokes, f"key{n}").json() for n, strokes in enumerate(STROKES))
                found = {key: world.chunk(key) for key in KEYS}
            if end == signal.SIGKILL:
                server.stop(end)
            return found

    if end == signal.SIGKILL:
        with pytest.raises(AssertionError, match="exit code -9"):
            first()
        before = {}
    else:
        before = first()
    with serving(tmp_path / "log2", *options) as server, World(server) as world:
        history = folded(STROKES)
        assert world.told()["revision"] == str(len(STROKES))
        for key in KEYS:
            chunk = world.chunk(key)
            assert chunk.content == body(history[-1], key, int(chunk.headers["chunk-revision"]))
            if before:
                assert (chunk.headers["etag"], chunk.content) == (before[key].headers["etag"], before[key].content)
        again = world.edit(STROKES[1], "key1").json()
        assert again == acknowledged[1] | {"duplicate": True}
        assert world.edit(STROKES[0]).json()["revision"] == str(len(STROKES) + 1)
