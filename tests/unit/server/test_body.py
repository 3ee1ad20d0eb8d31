import asyncio
import tracemalloc
from contextlib import ExitStack

import pytest
from starlette.requests import Request

from chunkserver.errors import BadRequest, Overloaded
from chunkserver.server import body
from chunkserver.server.body import LARGE_BODIES_MAX, Bodies, json_body
from chunkserver.server.problems import BodyTooLarge, BodyTooSlow, NotJson

JSON = (b"content-type", b"application/json")
SECONDS_MAX = 5.0
LEFT = {"type": "http.disconnect"}


def pieces(*parts, more=False):
    last = len(parts) - 1
    return [
        {"type": "http.request", "body": part, "more_body": more or number < last} for number, part in enumerate(parts)
    ]


def read(messages, *headers, bytes_max=10, is_large=lambda: None):
    """Read a body that arrives as `messages`; return it, and how many of them were taken."""
    left = iter(messages)
    taken = 0

    async def receive():
        nonlocal taken
        message = next(left, None)
        if message is None:
            await asyncio.Event().wait()
        taken += 1
        return message

    request = Request({"type": "http", "method": "POST", "headers": list(headers)}, receive)
    return asyncio.run(asyncio.wait_for(json_body(request, bytes_max, is_large), SECONDS_MAX)), taken


@pytest.mark.parametrize("parts", [(b"",), (b"0123456789",), (b"01234", b"56789"), (b"0", b"", b"123", b"")])
def test_a_body_in_pieces(parts):
    assert read(pieces(*parts), JSON) == (b"".join(parts), len(parts))


@pytest.mark.parametrize(
    "media_type", [b"application/json; charset=utf-8", b"Application/JSON", b" application/json ;a=b"]
)
def test_media_types_that_are_json(media_type):
    assert read(pieces(b"1"), (b"content-type", media_type))[0] == b"1"


@pytest.mark.parametrize("headers", [(), [(b"content-type", b"text/plain")], [(b"content-type", b"application/jsonx")]])
def test_others_are_refused_unread(headers):
    with pytest.raises(NotJson, match="application/json"):
        read([], *headers)


def test_a_length_that_is_announced_is_refused_unread():
    for announced in (b"10", b"0" * 5000 + b"10"):
        assert read(pieces(b"0123456789"), JSON, (b"content-length", announced))[0] == b"0123456789"
    with pytest.raises(BodyTooLarge, match="11 bytes; the limit is 10"):
        read([], JSON, (b"content-length", b"11"))


def test_one_that_is_not_announced_is_refused_once_it_is_too_long():
    with pytest.raises(BodyTooLarge, match="limit is 10"):
        read(pieces(b"01234", b"56789", b"0", more=True), JSON)


def test_no_more_is_held_than_the_limit():
    piece, limit = bytes(1000), 100_000
    endless = ({"type": "http.request", "body": piece, "more_body": True} for _ in range(10_000_000))
    tracemalloc.start()
    try:
        with pytest.raises(BodyTooLarge):
            read(endless, JSON, bytes_max=limit)
        assert tracemalloc.get_traced_memory()[1] < 10 * limit
    finally:
        tracemalloc.stop()


def test_a_body_that_does_not_end_in_time(monkeypatch):
    monkeypatch.setattr(body, "BODY_SECONDS_MAX", 0.01)
    with pytest.raises(BodyTooSlow, match=r"0\.01 s"):
        read(pieces(b"1", more=True), JSON)


def test_a_client_that_leaves():
    with pytest.raises(BadRequest):
        read([*pieces(b"1", more=True), LEFT], JSON)


@pytest.mark.parametrize(("parts", "times"), [((5, 5), 0), ((5, 6), 1), ((11,), 1), ((3, 9, 9, 9), 1)])
def test_it_is_said_once_that_a_body_is_large(monkeypatch, parts, times):
    monkeypatch.setattr(body, "LARGE_BYTES", 10)
    told = []
    assert read(pieces(*map(bytes, parts)), JSON, bytes_max=100, is_large=lambda: told.append(1))[1] == len(parts)
    assert len(told) == times


def test_so_many_large_bodies_are_held_and_no_more():
    bodies = Bodies()
    with ExitStack() as held:
        for _ in range(LARGE_BODIES_MAX):
            held.enter_context(bodies.large())
        with pytest.raises(Overloaded, match="8 bodies of more than"), bodies.large():
            pass
    with bodies.large():
        pass
