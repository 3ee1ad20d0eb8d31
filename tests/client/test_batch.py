"""What a batch believes, without sockets."""

import struct

import pytest

from chunkserver_client import BadAnswer, BadRequest, ChunkKey, Recipe, Retry, SeedDescriptor, Unavailable
from chunkserver_client.batch import Batch
from chunkserver_client.cache import AnswerCache
from chunkserver_client.frames import MEDIA_TYPE
from chunkserver_client.questions import ChunkOptions, Fitted, Key, MaskedKey, chunk_request, fitted
from chunkserver_client.steps import Answer
from tests.client.scripted import Script, exchange

WORLD = SeedDescriptor(
    seed=1,
    recipe=Recipe(digest="d", name="plane", parameters={}, expression={}),
    generator="g",
    voxel_size=1.0,
    chunk_cells=32,
    lods=21,
    low=(-1, -1, -1),
    high=(1, 1, 1),
    formats=(),
    meshers=(),
    seams=(),
    coarser=(),
)
KEYS = [ChunkKey(0, 0, y, 0) for y in (7, 8, 9)]
TAG = "0" * 32
END = 0xFFFFFFFF
PROBLEM = b'{"type": "urn:chunkserver:problem:overloaded", "title": "T", "status": 503, "detail": "D"}'


def frame(index: int, status: int = 204, tag: str = TAG, count: int = 0, body: bytes = b"") -> bytes:
    head = struct.pack("<2IH2BIQ32sQ", len(body), index, status, 1, 0, count, 0, tag.encode(), 0)
    return head + body + bytes(-len(body) % 16)


def stream(*frames: bytes) -> Answer:
    return Answer(200, {"content-type": MEDIA_TYPE}, struct.pack("<4s2HQ", b"CHNB", 1, 64, 0) + b"".join(frames))


def run(script: Script, retry: Retry, cache: AnswerCache | None = None) -> None:
    script.run(Batch(exchange(retry, cache), WORLD, [Fitted(key, 0) for key in KEYS], {}, None, "identity").steps())


def kept(tag: str) -> AnswerCache:
    """Return a cache that has the first chunk, out of date."""
    cache = AnswerCache(1 << 20)
    headers = {"etag": f'"{tag}"', "chunk-content": "air", "cache-control": "no-cache"}
    cache.keep(chunk_request(WORLD, KEYS[0], {}), Answer(204, headers, b""))
    return cache


ONCE = Retry(attempts_max=1)
REST = (frame(1), frame(2), frame(END, 200, count=3))


def test_a_304_counts_for_the_tag_that_was_named_alone():
    run(Script([stream(frame(0, 304), *REST)]), ONCE, kept(TAG))
    for cache in (kept("1" * 32), AnswerCache(0)):
        with pytest.raises(BadAnswer, match="not named"):
            run(Script([stream(frame(0, 304), *REST)]), ONCE, cache)


def test_a_batch_that_comes_too_slowly_is_given_up():
    with pytest.raises(BadAnswer, match="too slowly") as raised:
        run(Script([stream(b"x" * 10)]), Retry(attempts_max=1, seconds_max=0.0))
    assert raised.value.__notes__ == ["3 of 3 chunks are missing"]


def test_a_whole_batch_without_the_chunks_is_no_answer():
    script = Script([stream(frame(END, 200)), stream(frame(7), frame(END, 200, count=1))])
    with pytest.raises(BadAnswer, match="are missing in it"):
        run(script, Retry(attempts_max=2, backoff_seconds=0))
    assert len(script.requests) == 2


def test_a_503_of_one_chunk_is_asked_for_again_and_the_others_are_not():
    script = Script([stream(frame(0, 503, "", body=PROBLEM), *REST), stream(frame(0), frame(END, 200, count=1))])
    run(script, Retry(backoff_seconds=0))
    assert b"[[0,0,7,0]]" in script.requests[1].body
    with pytest.raises(Unavailable) as raised:
        run(Script([stream(frame(0, 503, "", body=PROBLEM), *REST)]), ONCE)
    assert raised.value.name == "overloaded"


def test_a_chunk_that_fails_does_not_stop_the_others():
    body = PROBLEM.replace(b"overloaded", b"bad-key")
    script = Script([stream(frame(0, 422, "", body=body), *REST)])
    with pytest.raises(BadRequest) as raised:
        run(script, ONCE)
    assert raised.value.__notes__ == [f"{KEYS[0]}"]
    assert len(script.requests) == 1


def test_frames_of_no_chunk_and_second_frames_are_skipped():
    run(Script([stream(frame(5), frame(0), frame(0), frame(1), frame(2), frame(END, 200, count=5))]), ONCE)


def test_masks_are_told_row_by_row_and_each_is_a_chunk_of_its_own():
    options: ChunkOptions = {"coarser": 5}
    rows: list[Key | MaskedKey] = [(0, 0, 7, 0), (0, 0, 7, 0, 63), (0, 0, 7, 0, 0), (0, 0, 7, 0, 5)]
    asked = list(dict.fromkeys(fitted(row, options) for row in rows))
    assert asked == [Fitted(KEYS[0], 5), Fitted(KEYS[0], 63), Fitted(KEYS[0], 0)]
    cache = AnswerCache(1 << 20)
    script = Script([stream(frame(0), frame(2), frame(1), frame(END, 200, count=3))])
    script.run(Batch(exchange(ONCE, cache), WORLD, asked, options, None, "identity").steps())
    (request,) = script.requests
    assert b'"chunks":[[0,0,7,0,5],[0,0,7,0,63],[0,0,7,0]]' in request.body
    assert "coarser" not in request.url
    own: list[ChunkOptions] = [{"coarser": 5}, {"coarser": 63}, {"coarser": 0}, {}]
    alone = [chunk_request(WORLD, KEYS[0], one) for one in own]
    assert all(cache.find(one) is not None for one in alone)
    assert len({one.url for one in alone}) == 3


@pytest.mark.parametrize("row", [(0, 0, 7), (0, 0, 7, 0, 1, 2)])
def test_a_row_of_another_length_is_refused(row):
    with pytest.raises(ValueError, match="values to unpack"):
        fitted(row, {})
