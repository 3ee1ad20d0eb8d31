"""What networks do to answers, and what becomes of it in the client: the right answer, or one clear error in time."""

import time
from typing import Any

import httpx2
import numpy as np
import pytest

from chunkserver_client import BadAnswer, Retry, Unavailable, Unreachable, decode
from tests.client.chaos import chaos, cut_short, drip, flip, hang_up, junk, none, refuse, reply, stall

PATIENT = Retry(attempts_max=4, seconds_max=20.0, backoff_seconds=0.001)
ONCE = Retry(attempts_max=1, seconds_max=20.0)
LONG = httpx2.Timeout(10.0)
SHORT = httpx2.Timeout(10.0, read=0.5)
"""For what stalls alone: on a busy machine an answer that is right may take so long as well."""
KEY = (0, 0, -1, 0)
KEYS = [(0, x, -1, z) for x in range(3) for z in range(3)]


@pytest.fixture(scope="module")
def expected(server) -> dict[tuple[int, int, int, int], bytes]:
    """The bytes of each chunk, by plain HTTP."""
    url = f"{server.url}/v1/seeds/42/chunks"
    return {key: httpx2.get(f"{url}/{'/'.join(map(str, key))}").content for key in KEYS}


def same(mesh: Any, content: bytes) -> bool:
    """Return whether a mesh is a view of bytes like these."""
    wanted = decode(content)
    return all(
        np.array_equal(getattr(mesh, name), getattr(wanted, name)) for name in ("positions", "normals", "triangles")
    )


def seconds_for(fault: str) -> httpx2.Timeout:
    """Return how long a client waits for bytes when this is what happens to them."""
    return SHORT if fault.startswith("stalls") else LONG


FAULTS = {
    "hangs up": hang_up,
    "cut in the body": cut_short(100),
    "no body": cut_short(0),
    "no HTTP": junk,
    "503": refuse("0"),
    "429": reply("429 Too Many Requests", "Retry-After: 0"),
    "502 with a page": reply("502 Bad Gateway", "Content-Type: text/html", body=b"<html>"),
    "another type": reply("200 OK", "Content-Type: text/html", body=b"<html>welcome to the hotel</html>"),
    "magic flipped": flip(0),
    "key flipped": flip(8, 1),
    "length flipped": flip(70),
    "304 for nothing": reply("304 Not Modified", 'ETag: "0123"'),
    "stalls too long": stall(1.0, after=1000),
}


@pytest.mark.parametrize("name", FAULTS)
def test_a_chunk_comes_whole_after_faults(connect, server, expected, name):
    with chaos(server.url, none, FAULTS[name], FAULTS[name]) as proxy:
        client = connect(proxy.url, retry=PATIENT, coding="identity", timeout=seconds_for(name))
        mesh = client.chunk(client.seed(42), KEY)
        assert same(mesh, expected[KEY])
        assert len(proxy.requests) == 4, "the descriptor, two faults, the chunk"


@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_that_stays_is_one_clear_error(connect, server, name):
    with chaos(server.url, none, FAULTS[name]) as proxy:
        client = connect(proxy.url, retry=ONCE, coding="identity", timeout=seconds_for(name))
        world = client.seed(42)
        with pytest.raises((Unreachable, Unavailable, BadAnswer)):
            client.chunk(world, KEY)


@pytest.mark.parametrize("coding", ["identity", "gzip", "zstd"])
def test_a_stall_and_a_drip_are_waited_for(connect, server, expected, coding):
    with chaos(server.url, none, stall(0.1, after=1000), drip(10_000, 0.01)) as proxy:
        client = connect(proxy.url, coding=coding)
        world = client.seed(42)
        assert same(client.chunk(world, KEY), expected[KEY])
        assert same(client.chunk(world, KEYS[1]), expected[KEYS[1]])
        assert len(proxy.requests) == 3


def test_a_drip_ends_with_the_time_of_the_client(connect, server):
    with chaos(server.url, none, *[drip(1, 0.01)] * 9) as proxy:
        client = connect(proxy.url, retry=Retry(seconds_max=0.5))
        world = client.seed(42)
        began = time.monotonic()
        with pytest.raises(BadAnswer, match="time was up"):
            client.chunk(world, KEY)
        assert time.monotonic() - began < 5


def test_retry_after_is_honoured(connect, server, expected):
    with chaos(server.url, none, refuse("1")) as proxy:
        client = connect(proxy.url, retry=PATIENT)
        world = client.seed(42)
        began = time.monotonic()
        assert same(client.chunk(world, KEY), expected[KEY])
        assert time.monotonic() - began >= 1.0


def test_a_retry_after_beyond_the_time_is_not_waited_for(connect, server):
    with chaos(server.url, none, refuse("3600")) as proxy:
        client = connect(proxy.url, retry=PATIENT)
        world = client.seed(42)
        with pytest.raises(Unavailable) as raised:
            client.chunk(world, KEY)
        assert raised.value.retry_after == 3600
        assert len(proxy.requests) == 2


BATCH_FAULTS = {
    **{name: FAULTS[name] for name in ("hangs up", "no body", "no HTTP", "503", "another type", "stalls too long")},
    "cut in the stream's header": cut_short(10),
    "cut in a frame's header": cut_short(40),
    "cut in a frame": cut_short(100_000),
    "magic flipped": flip(0, magic=b"CHNB"),
    "a frame's length flipped": flip(16 + 3, magic=b"CHNB"),
    "a frame's index flipped": flip(16 + 4, 1, magic=b"CHNB"),
    "a frame's coding flipped": flip(16 + 11, magic=b"CHNB"),
    "a frame's status flipped to 456": flip(16 + 9, 1, magic=b"CHNB"),
    "a chunk's key flipped": flip(16 + 64 + 8, magic=b"CHNB"),
}


@pytest.mark.parametrize("name", BATCH_FAULTS)
def test_a_batch_is_made_whole(connect, server, expected, name):
    with chaos(server.url, none, BATCH_FAULTS[name], BATCH_FAULTS[name]) as proxy:
        client = connect(proxy.url, retry=PATIENT, coding="identity", timeout=seconds_for(name))
        meshes = list(client.chunks(client.seed(42), KEYS))
        assert sorted(mesh.key for mesh in meshes) == KEYS
        assert all(same(mesh, expected[mesh.key]) for mesh in meshes)
        assert len(proxy.requests) == 4


def test_a_batch_whose_end_alone_is_missing_is_whole(connect, server):
    with chaos(server.url, none, flip(0, magic=b"\xff\xff\xff\xff\xc8")) as proxy:
        client = connect(proxy.url, retry=ONCE, coding="identity")
        assert len(list(client.chunks(client.seed(42), KEYS))) == len(KEYS)
        assert len(proxy.requests) == 2


def test_what_came_of_a_batch_is_not_asked_for_again(connect, server):
    with chaos(server.url, none, cut_short(400_000)) as proxy:
        client = connect(proxy.url, retry=PATIENT, coding="identity", cache_bytes=0)
        assert len(list(client.chunks(client.seed(42), KEYS))) == len(KEYS)
        _, first, second = proxy.requests
        lengths = [int(head.partition("content-length: ")[2].partition("\r\n")[0]) for head in (first, second)]
        assert lengths[1] < lengths[0]


def test_a_batch_that_gains_nothing_says_what_is_missing(connect, server):
    with chaos(server.url, none, *[hang_up] * 4) as proxy:
        client = connect(proxy.url, retry=PATIENT)
        world = client.seed(42)
        with pytest.raises(Unreachable) as raised:
            list(client.chunks(world, KEYS))
        assert raised.value.__notes__ == ["9 of 9 chunks are missing"]
        assert raised.value.__cause__ is not None


def test_a_batch_that_gains_something_goes_on(connect, server):
    cuts = [cut_short(200_000)] * 8  # each has one chunk, and a part of another
    with chaos(server.url, none, *cuts) as proxy:
        client = connect(proxy.url, retry=Retry(attempts_max=2, backoff_seconds=0.001), coding="identity")
        assert len(list(client.chunks(client.seed(42), KEYS))) == len(KEYS)
        assert len(proxy.requests) > 3


def test_deleting_is_not_repeated_when_nobody_knows_what_happened(connect, server):
    with chaos(server.url, none, hang_up) as proxy:
        client = connect(proxy.url, retry=PATIENT)
        client.create_world("not-twice", 1, "plane")
        with pytest.raises(Unreachable):
            client.delete_world("not-twice")
        assert len(proxy.requests) == 2
        client.delete_world("not-twice")


def test_creating_is_repeated(connect, server):
    with chaos(server.url, cut_short(10), hang_up) as proxy:
        client = connect(proxy.url, retry=PATIENT)
        created = client.create_world("again", 1, "plane")
        assert created == client.world("again")
        client.delete_world("again")
        assert len(proxy.requests) == 5
