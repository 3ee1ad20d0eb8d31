"""Batches: every chunk once, as a request for it alone is answered, nearest first."""

import asyncio
import struct
from typing import Any, NamedTuple

import pytest
from fastapi import Request

from chunkserver.errors import Overloaded, WorkerLost
from chunkserver.grid import ChunkKey
from chunkserver.pipeline import Chunk, ChunkRequest
from chunkserver.recipe import WorldRecipe, builtin
from chunkserver.server import Settings, create_app
from chunkserver.server.batch import CHUNKS_MAX, IN_FLIGHT_MAX, MEDIA_TYPE, Batch, _Work
from chunkserver.server.plan import Plan
from tests.unit.server.stub import StubPool, client_of

SEEDS, WORLDS = "/v1/seeds/42/chunks", "/v1/worlds/w/chunks"
END = 0xFFFFFFFF


class Terrain(StubPool):
    """The chunks at y = 1 are air."""

    async def build(self, request, begun, **rank):
        await super().build(request, begun, **rank)
        return Chunk("air", b"") if request.key.y == 1 else Chunk("surface", repr(request.key).encode())


class Frame(NamedTuple):
    """One frame, as the page says."""

    place: int
    status: int
    content: int
    coding: int
    total: int
    revision: int
    tag: str
    body: bytes


def frames_of(stream: bytes) -> list[Frame]:
    magic, version, frame_bytes, _ = struct.unpack_from("<4sHHQ", stream)
    assert (magic, version) == (b"CHNB", 1)
    at, found = 16, []
    while at < len(stream):
        length, index, status, content, coding, count, revision, tag = struct.unpack_from("<IIHBBIQ32s", stream, at)
        body = stream[at + frame_bytes : at + frame_bytes + length]
        assert len(body) == length
        at += frame_bytes + -(-length // 16) * 16
        found.append(Frame(index, status, content, coding, count, revision, tag.rstrip(b"\0").decode(), body))
    assert at == len(stream)
    return found


@pytest.fixture
def pool():
    return Terrain()


@pytest.fixture
def client(pool):
    with client_of(pool) as client:
        client.post("/v1/worlds", json={"id": "w", "seed": 42, "recipe": "terrain", "lods": 5}).raise_for_status()
        pool.built.clear()
        pool.ranks.clear()
        yield client


def post(client, url=SEEDS, headers=None, **body):
    answer = client.post(url, json=body, headers=headers or {})
    assert answer.status_code == 200, answer.text
    assert (answer.headers["content-type"], answer.headers["cache-control"]) == (MEDIA_TYPE, "no-store")
    *frames, end = frames_of(answer.content)
    assert (end.place, end.status, end.total) == (END, 200, len(frames))
    assert sorted(frame.place for frame in frames) == list(range(len(body["chunks"])))
    return frames


@pytest.mark.parametrize("place", [SEEDS, WORLDS])
@pytest.mark.parametrize("name", ["mesh", "glb"])
def test_each_chunk_is_what_a_request_for_it_alone_gets(client, pool, place, name):
    chunks = [[0, 0, 0, 0], [0, 5, 1, -3], [2, -1, 0, 7]]
    for _ in range(2):
        for frame in post(client, place, chunks=chunks, format=name):
            alone = client.get(f"{place}/{'/'.join(map(str, chunks[frame.place]))}.{name}")
            assert (frame.status, frame.body) == (alone.status_code, alone.content)
            assert alone.headers["etag"] == f'"{frame.tag}"'
            assert ("", "air", "rock", "surface")[frame.content] == alone.headers["chunk-content"]
            assert frame.revision == int(alone.headers.get("chunk-revision", 0))
    assert len(pool.built) == len(chunks), "each was built once"


def test_the_query_is_that_of_a_chunk(client, pool):
    post(client, f"{SEEDS}?recipe=hills&profile=f32&seam=none", chunks=[[0, 0, 0, 0]], coding="gzip")
    (built,) = pool.built
    assert (built.seam, built.encoding.profile, built.encoding.coding) == ("none", "f32", "gzip")
    for query in ("recipe=nonsense", "g=00", "frame=chunk", "nonsense=1", "seam=walls", "coarser=64"):
        answer = client.post(f"{SEEDS}?{query}", json={"chunks": [[0, 0, 0, 0]]})
        assert answer.status_code in (410, 422)
        assert query.partition("=")[0] in answer.json()


def test_the_mask_of_the_query_counts_for_chunks_without_one(client, pool):
    post(client, f"{SEEDS}?coarser=5", chunks=[[0, 0, 0, 0], [19, 0, 0, 0], [0, 0, 0, 0, 9], [20, 0, 0, 0, 0]])
    assert [built.coarser for built in pool.built] == [5, 5, 9, 0]
    answer = client.post(f"{SEEDS}?coarser=5", json={"chunks": [[0, 0, 0, 0], [20, 0, 0, 0]]})
    assert (answer.status_code, answer.json()["index"], answer.json()["coarser"]) == (422, 1, 5)
    assert answer.json()["detail"] == "chunks[1]: coarser is 5; nothing is coarser than lod 20 in this world"


@pytest.mark.parametrize("place", [SEEDS, WORLDS])
def test_each_chunk_may_have_a_mask_of_its_own(client, pool, place):
    chunks = [[0, 0, 0, 0, mask] for mask in range(64)] + [[1, 3, 0, -2], [1, 3, 0, -2, 0], [1, 3, 0, -2, 33]]
    frames = post(client, place, chunks=chunks)
    assert [(*built.key, built.coarser) for built in pool.built] == [tuple(chunk) for chunk in chunks if len(chunk) > 4]
    for frame in frames:
        *key, mask = (*chunks[frame.place], 0)[:5]
        alone = client.get(f"{place}/{'/'.join(map(str, key))}.mesh?coarser={mask}")
        assert (frame.status, frame.body) == (alone.status_code, alone.content)
        assert alone.headers["etag"] == f'"{frame.tag}"'
    assert len(pool.built) == 66, "each was built once"
    tags = [frame.tag for frame in frames]
    assert {frame.status for frame in post(client, place, chunks=chunks, known=tags)} == {304}


@pytest.mark.parametrize(
    ("query", "chunk", "detail"),
    [
        ("", [0, 0, 0, 0, 64], "coarser is 64; it lies in [0, 63]"),
        ("", [0, 0, 0, 0, -1], "coarser is -1; it lies in [0, 63]"),
        ("", [20, 0, 0, 0, 7], "coarser is 7; nothing is coarser than lod 20 in this world"),
        ("?seam=skirts", [0, 0, 0, 0, 7], "coarser is 7; it needs seam=transitions, and seam is 'skirts'"),
        ("?seam=none", [0, 0, 0, 0, 7], "coarser is 7; it needs seam=transitions, and seam is 'none'"),
    ],
)
def test_a_mask_that_cannot_be_is_refused_as_a_whole(client, pool, query, chunk, detail):
    answer = client.post(f"{SEEDS}{query}", json={"chunks": [[0, 0, 0, 0], [0, 0, 0, 0, 0], chunk]})
    assert (answer.status_code, answer.json()["index"], answer.json()["coarser"]) == (422, 2, chunk[4])
    assert answer.json()["detail"] == f"chunks[2]: {detail}"
    assert not pool.built


def test_nearest_first_and_the_coarser_of_two_that_are_as_near(client, pool):
    chunks = [[0, 9, 0, 0], [0, 0, 0, 0], [0, -3, 0, 0], [3, 0, 0, 0], [0, 2, 0, 0]]
    frames = post(client, chunks=chunks, viewer=[1.0, 2.0, 3.0])
    order = [[request.key.lod, request.key.x, 0, 0] for request in pool.built]
    assert order == [[3, 0, 0, 0], [0, 0, 0, 0], [0, 2, 0, 0], [0, -3, 0, 0], [0, 9, 0, 0]]
    assert [chunks[frame.place] for frame in frames] == order
    assert [rank[0] for rank in pool.ranks] == [3] * 5
    assert [round(rank[1], 3) for rank in pool.ranks] == [
        0,
        0,
        round(63 / 32, 3),
        round(65 / 32, 3),
        round(287 / 32, 3),
    ]


def test_without_a_viewer_as_listed_and_as_urgent_as_asked(client, pool):
    chunks = [[0, 9, 0, 0], [3, 0, 0, 0], [0, 2, 0, 0]]
    post(client, chunks=chunks, headers={"Priority": "u=6"})
    assert [[*request.key] for request in pool.built] == chunks
    assert pool.ranks == [(6, 0.0)] * 3


def test_what_the_client_has_is_not_sent_again(client, pool):
    chunks = [[0, 0, 0, 0], [0, 1, 0, 0]]
    first = {frame.place: frame for frame in post(client, chunks=chunks)}
    known = {frame.place: frame for frame in post(client, chunks=chunks, known=[first[1].tag, "nonsense"])}
    assert known[0] == first[0]
    assert (known[1].status, known[1].tag, known[1].body) == (304, first[1].tag, b"")
    assert len(pool.built) == 2


def test_a_batch_of_the_largest_size_and_a_chunk_twice(client, pool):
    chunks = [[0, number // 2, 0, 0] for number in range(CHUNKS_MAX)]
    post(client, chunks=chunks)
    assert len(pool.built) == CHUNKS_MAX // 2


def test_a_chunk_that_fails_is_told_in_its_frame(client, pool):
    post(client, chunks=[[0, 1, 0, 0]])
    pool.error = WorkerLost("twice", losses=2)
    frames = {frame.place: frame for frame in post(client, chunks=[[0, 0, 0, 0], [0, 1, 0, 0]])}
    assert (frames[0].status, frames[1].status) == (503, 200)
    assert b"urn:chunkserver:problem:worker-lost" in frames[0].body
    assert frames[0].tag == ""


def test_while_the_queue_is_full_a_batch_waits():
    class Full(Terrain):
        """Refuses every other job, and says beforehand that it would for the first few times that it is asked."""

        asked = refused = 0

        def refuses(self, _urgency, _lod):
            self.asked += 1
            return self.asked < 3

        async def build(self, request, begun, **rank):
            self.refused += 1
            if self.refused % 2:
                raise Overloaded("too many")
            return await super().build(request, begun, **rank)

    full = Full()
    with client_of(full) as client:
        frames = post(client, chunks=[[0, number, 0, 0] for number in range(3 * IN_FLIGHT_MAX)])
    assert {frame.status for frame in frames} == {200}
    assert full.refused > 3 * IN_FLIGHT_MAX == len(full.built)


@pytest.mark.parametrize(
    ("body", "name"),
    [
        ({}, "chunks"),
        ({"chunks": []}, "chunks"),
        ({"chunks": [[0, 0, 0, 0]] * (CHUNKS_MAX + 1)}, "chunks"),
        ({"chunks": [[0, 0, 0]]}, "chunks"),
        ({"chunks": [[0, 0, 0, 0, 0, 0]]}, "chunks"),
        ({"chunks": [[0, 0, 0, 0, "1"]]}, "chunks"),
        ({"chunks": [[0, 0, 0, "0"]]}, "chunks"),
        ({"chunks": [[0, 0, 0, 0.5]]}, "chunks"),
        ({"chunks": [[0, 0, 0, True]]}, "chunks"),
        ({"chunks": [[0, 0, 0, 0], [21, 0, 0, 0]]}, "lod"),
        ({"chunks": [[0, 1 << 40, 0, 0]]}, "x"),
        ({"chunks": [[0, 0, 0, 0]], "viewer": [0, 0]}, "viewer"),
        ({"chunks": [[0, 0, 0, 0]], "known": ["x"] * (CHUNKS_MAX + 1)}, "known"),
        ({"chunks": [[0, 0, 0, 0]], "format": "obj"}, "format"),
        ({"chunks": [[0, 0, 0, 0]], "coding": "br"}, "coding"),
        ({"chunks": [[0, 0, 0, 0]], "nonsense": 1}, "nonsense"),
    ],
)
@pytest.mark.parametrize("place", [SEEDS, WORLDS])
def test_what_cannot_be_answered_is_refused_as_a_whole(client, pool, place, body, name):
    answer = client.post(place, json=body)
    assert answer.status_code == 422
    assert name in answer.json()["detail"]
    assert not pool.built


def test_a_number_that_json_does_not_have(client):
    body = '{"chunks": [[0, 0, 0, 0]], "viewer": [0, 0, NaN]}'
    answer = client.post(SEEDS, content=body, headers={"Content-Type": "application/json"})
    assert answer.status_code == 422


def test_other_refusals(client):
    body: dict[str, Any] = {"chunks": [[0, 0, 0, 0]]}
    assert client.post("/v1/worlds/nobody/chunks", json=body).status_code == 404
    assert client.post(f"{WORLDS}?revision=1", json=body).status_code == 404
    assert client.post(f"{WORLDS}?epoch=00", json=body).status_code == 410
    assert client.post(WORLDS, json={"chunks": [[5, 0, 0, 0]]}).json()["index"] == 0
    assert client.post(SEEDS, content="x").status_code == 415
    assert client.post(SEEDS, json=body | {"known": ["x" * (1 << 17)]}).status_code == 413
    assert client.get(SEEDS).status_code == 405


def test_no_more_are_in_flight_than_allowed():
    class Slow(StubPool):
        most = 0
        now = 0

        async def build(self, request, begun, **rank):
            self.now += 1
            self.most = max(self.most, self.now)
            for _ in range(3):
                await asyncio.sleep(0)
            self.now -= 1
            return await super().build(request, begun, **rank)

    slow = Slow()
    with client_of(slow) as client:
        post(client, chunks=[[0, number, 0, 0] for number in range(3 * IN_FLIGHT_MAX)])
    assert slow.most == IN_FLIGHT_MAX


def test_a_batch_that_is_closed_half_way_leaves_the_queue_once():
    async def scenario():
        never, asked = asyncio.get_running_loop().create_future(), []

        class Never(StubPool):
            async def build(self, request, begun, **rank):
                asked.append((request, begun, rank))
                return await asyncio.shield(never)

        service = create_app(Settings(workers=1), Never()).state.service
        template = ChunkRequest(WorldRecipe(1, builtin("plane")), ChunkKey(0, 0, 0, 0))
        plan = Plan.of(template, lambda _: {}, lambda: True)
        batch = Batch(chunks=[[0, x, 0, 0] for x in range(100)])
        work = _Work(service, plan, batch, Request({"type": "http", "headers": []}))
        frames = work.frames(0)
        assert (await anext(frames))[:4] == b"CHNB"
        waiting = asyncio.ensure_future(anext(frames))
        while len(asked) < IN_FLIGHT_MAX:
            await asyncio.sleep(0)
        joined = service.cache.get_or_build(plan.current(ChunkKey(0, 1, 0, 0)).tag, Never().build)
        other = asyncio.ensure_future(joined)
        await asyncio.sleep(0)
        waiting.cancel()
        with pytest.raises(asyncio.CancelledError):
            await waiting
        await asyncio.sleep(0)
        (left,) = service.cache._building.values()
        assert (left.waiters, other.done()) == (1, False)
        never.set_result(Chunk("surface", b"late"))
        assert (await other).body == b"late"
        assert (left.waiters, len(asked)) == (0, IN_FLIGHT_MAX)

    asyncio.run(scenario())
