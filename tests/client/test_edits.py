"""Edits through either client: written once whatever the network does, read back, and seen in the chunks."""

import base64
import json
import secrets
from typing import Any

import numpy as np
import pytest

from chunkserver_client import (
    BadAnswer,
    BadRequest,
    ChunkKey,
    ChunkRange,
    FittedChunk,
    Problem,
    Retry,
    delta_stroke,
    redraws,
)
from chunkserver_client.edits import read_log, read_written
from chunkserver_client.json_tree import Json
from tests.client.chaos import chaos, cut_short, hang_up, refuse

NEAR, FAR = (0, 0, -1, 0), (0, 40, -1, 40)
PATIENT = Retry(attempts_max=4, seconds_max=20.0, backoff_seconds=0.001)


def ball(x: float, y: float, z: float, radius: float = 5.0) -> dict[str, Any]:
    return {"op": "carve", "shape": "sphere", "center": [x, y, z], "radius": radius}


@pytest.fixture
def world(client):
    """A plane of its own for a test."""
    name = f"w{secrets.token_hex(8)}"
    yield client.create_world(name, 1, "plane", lods=3, chunk_cells=16)
    client.delete_world(name)


def test_what_is_dug_is_seen(client, world):
    before = client.chunk(world, NEAR)
    written = client.edit(world, [ball(4, 0, 4), ball(8, -3, 4)])
    assert (written.revision, written.duplicate) == (1, False)
    assert any(chunks.holds(ChunkKey(*NEAR)) for chunks in written.stale)
    assert {chunks.lod for chunks in written.stale} == {0, 1, 2}
    assert not any(chunks.holds(ChunkKey(*FAR)) for chunks in written.stale)
    after = client.chunk(world, NEAR, min_revision=written.revision)
    assert (before.revision, after.revision, client.chunk(world, FAR).revision) == (0, 1, 0)
    assert after.positions[:, 1].min() < before.positions[:, 1].min()
    assert client.world(world.id).revision == 1


def test_an_edit_with_a_key_is_written_once(client, world):
    first = client.edit(world, [ball(0, 0, 0)], key="dig-1")
    again = client.edit(world, [ball(0, 0, 0)], key="dig-1")
    assert (again.revision, again.stale, again.duplicate) == (first.revision, first.stale, True)
    with pytest.raises(BadRequest) as raised:
        client.edit(world, [ball(9, 0, 0)], key="dig-1")
    assert raised.value.name == "bad-parameter"
    assert client.edit(world, [ball(0, 0, 0)]).revision == 2, "without a key each call is an edit of its own"


@pytest.mark.parametrize("fault", [cut_short(0), cut_short(10), hang_up, refuse("0")])
def test_an_answer_that_is_lost_writes_nothing_twice(connect, server, client, world, fault):
    with chaos(server.url, fault, fault) as proxy:
        written = connect(proxy.url, retry=PATIENT).edit(world, [ball(0, 0, 0)])
        assert len(proxy.requests) == 3
        assert len({request.lower().partition("idempotency-key: ")[2][:32] for request in proxy.requests}) == 1
    assert written.revision == client.world(world.id).revision == 1


@pytest.mark.parametrize("key", ["", "a b", "é", "x" * 129, "a\n"])
def test_a_key_that_cannot_be_is_refused_here(client, world, key):
    with pytest.raises(ValueError, match="key is"):
        client.edit(world, [ball(0, 0, 0)], key=key)


def test_a_stroke_that_is_refused_is_named(client, world):
    with pytest.raises(BadRequest) as raised:
        client.edit(world, [ball(0, 0, 0), ball(0, 0, 0, radius=-1)])
    assert (raised.value.name, raised.value.values["path"]) == ("bad-stroke", "strokes.1.radius")
    with pytest.raises(ValueError, match="JSON"):
        client.edit(world, [ball(float("nan"), 0, 0)])
    with pytest.raises(TypeError, match="set"):
        client.edit(world, [{"op": {1}}])
    assert client.world(world.id).revision == 0


def test_the_log_is_read_in_parts(client, world, monkeypatch):
    monkeypatch.setattr("chunkserver_client.calls.EDITS_PER_PAGE", 2)
    written = [client.edit(world, [ball(20 * x, 0, 0)]) for x in range(5)]
    log = list(client.edits(world))
    assert [edit.revision for edit in log] == [1, 2, 3, 4, 5]
    assert [edit.stale for edit in log] == [edit.stale for edit in written]
    assert [edit.strokes[0]["center"][0] for edit in log] == [0, 20, 40, 60, 80]
    assert [edit.revision for edit in client.edits(world, 3)] == [4, 5]
    assert [edit.revision for edit in client.edits(world, 1, limit=3)] == [2, 3, 4]
    assert list(client.edits(world, 5)) == list(client.edits(world, 99)) == list(client.edits(world, limit=0)) == []


def test_an_edit_drops_what_it_made_stale_from_the_cache_and_no_more(connect, server, world):
    with chaos(server.url) as proxy:
        digger, watcher = connect(proxy.url), connect(proxy.url)

        def revisions(client: Any) -> tuple[int, int, int]:
            """Return those of two chunks, asked for as of before the edits, and how often the server was asked."""
            before = len(proxy.requests)
            found = [client.chunk(world, key, revision=0).revision for key in (NEAR, FAR)]
            return found[0], found[1], len(proxy.requests) - before

        assert [revisions(digger), revisions(watcher)] == [(0, 0, 2)] * 2
        assert [revisions(digger), revisions(watcher)] == [(0, 0, 0)] * 2
        digger.edit(world, [ball(0, 0, 0)])
        assert revisions(digger) == (1, 0, 1)
        assert revisions(watcher) == (0, 0, 0), "it does not know of the edit"
        assert [edit.revision for edit in watcher.edits(world)] == [1]
        assert revisions(watcher) == (1, 0, 1)
        current = digger.chunk(world, NEAR, revision=1)
        list(digger.edits(world))
        count = len(proxy.requests)
        assert digger.chunk(world, NEAR, revision=1).revision == current.revision == 1
        assert len(proxy.requests) == count, "an edit that a chunk has already does not drop it"


def test_numbers_of_numpy_are_strokes(client, world):
    center, radius = np.array([3, 0, 4], np.float32), np.float32(5)
    client.edit(world, [{"op": "carve", "shape": "sphere", "center": center, "radius": radius}])
    (logged,) = client.edits(world)
    assert (logged.strokes[0]["center"], logged.strokes[0]["radius"]) == ([3, 0, 4], 5)


def test_a_box_of_integers(client, world):
    values = np.arange(-30, 30).reshape(3, 4, 5)
    stroke = delta_stroke((7, -8, 9), values)
    assert (stroke["min"], stroke["size"]) == ([7, -8, 9], [5, 3, 4])
    assert np.array_equal(np.frombuffer(base64.b64decode(stroke["values"]), "<i4"), np.arange(-30, 30))
    client.edit(world, [stroke])
    (logged,) = client.edits(world)
    assert dict(logged.strokes[0]) == stroke


@pytest.mark.parametrize(
    "values",
    [np.zeros((2, 2), int), np.zeros((1, 1, 1)), np.zeros((0, 1, 1), int), np.full((1, 1, 1), (1 << 20) + 1)],
)
def test_a_box_that_cannot_be_is_refused(values):
    with pytest.raises(ValueError, match="values"):
        delta_stroke((0, 0, 0), values)


def test_the_last_values_that_a_box_may_have():
    for value in (-(1 << 20), 1 << 20):
        stroke = delta_stroke((0, 0, 0), np.full((1, 1, 1), value))
        assert np.frombuffer(base64.b64decode(stroke["values"]), "<i4") == value


def test_a_world_that_is_gone_takes_no_edits(client):
    gone = client.create_world("gone", 1, "plane")
    client.delete_world("gone")
    for call in (lambda: client.edit(gone, [ball(0, 0, 0)]), lambda: list(client.edits(gone))):
        with pytest.raises(Problem) as raised:
            call()
        assert raised.value.name == "unknown-world"


RANGE = {"lod": 0, "min": [0, 0, 0], "max": [1, 1, 1]}


def logged(*revisions: str, stale: Any = ()) -> list[dict[str, Any]]:
    return [{"revision": revision, "strokes": [{}], "stale": list(stale)} for revision in revisions]


@pytest.mark.parametrize(
    ("edits", "after", "where"),
    [
        (logged("2"), 0, r"edits\.0\.revision"),
        (logged("1", "3"), 0, r"edits\.1\.revision"),
        (logged("1", "1"), 0, r"edits\.1\.revision"),
        ([], 8, r"\$\.edits: expected edits from 9 to 9"),
        (logged("1", stale=[RANGE | {"max": [1, -1, 1]}]), 0, r"stale\.0: .*low end"),
        (logged("1", stale=[RANGE | {"lod": 21}]), 0, r"stale\.0\.lod"),
        (logged("1", stale=[RANGE | {"min": [0, 1.5, 0]}]), 0, r"stale\.0\.min\.1"),
        ([{"revision": "1", "strokes": [3], "stale": []}], 0, r"strokes\.0"),
    ],
)
def test_a_log_that_is_none_is_not_believed(edits, after, where):
    with pytest.raises(BadAnswer, match=where):
        read_log(Json.parse(json.dumps({"edits": edits, "revision": "9"}).encode()), after)


@pytest.mark.parametrize("answer", [{"revision": "0"}, {"revision": 1}, {"duplicate": 0}, {"stale": {}}])
def test_an_answer_that_is_none_is_not_believed(answer):
    whole = {"revision": "1", "duplicate": False, "stale": [RANGE]}
    assert read_written(Json(whole)).stale == (ChunkRange(0, (0, 0, 0), (1, 1, 1)),)
    with pytest.raises(BadAnswer, match=next(iter(answer))):
        read_written(Json(whole | answer))


def test_what_is_drawn_anew_comes_in_groups_that_do_not_touch():
    drawn = {FittedChunk(0, x, 0, 0, 0) for x in range(10)} | {FittedChunk(1, 5, 0, 0, 0), FittedChunk(1, 40, 0, 0, 0)}
    stale = [
        ChunkRange(0, (1, 0, 0), (2, 0, 0)),
        ChunkRange(0, (8, 0, 0), (20, 5, 5)),
        ChunkRange(1, (4, 0, 0), (6, 0, 0)),
    ]
    groups = redraws(drawn, stale)
    assert sorted(sorted(chunk[:2] for chunk in group) for group in groups) == [
        [(0, 1), (0, 2)],
        [(0, 8), (0, 9), (1, 5)],
    ]
    assert redraws(drawn, []) == redraws(set(), stale) == []
