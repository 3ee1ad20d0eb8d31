"""A blocking stream is closed while threads use it, and in a thread of its own."""

import threading
from collections.abc import Iterator
from contextlib import suppress
from itertools import count
from typing import Any

import pytest

from chunkserver_client import Client, EditStream, StreamEnded, WorldDescriptor
from tests.serving import Server, until

SECONDS_MAX = 20.0
IDS = (f"closed-{number}" for number in count())


def ball(x: float = 0.0) -> list[dict[str, Any]]:
    return [{"op": "carve", "shape": "sphere", "center": [x, 0, 0], "radius": 4.0}]


@pytest.fixture
def client(server: Server) -> Iterator[Client]:
    with Client(server.url) as client:
        yield client


@pytest.fixture
def world(client: Client) -> Iterator[WorldDescriptor]:
    world = client.create_world(next(IDS), 7, "plane", chunk_cells=16, lods=2)
    yield world
    client.delete_world(world.id)


def test_whoever_uses_a_stream_while_it_is_closed_comes_to_an_end(client, world):
    before, faults = threading.active_count(), []

    def hear(stream):
        for _ in stream:
            pass

    def send(stream):
        with suppress(StreamEnded):
            for x in range(1000):
                stream.edit(ball(x % 50))

    def looked(stream):
        for _ in range(1000):
            stream.poll()

    def does(what, stream):
        try:
            what(stream)
        except Exception as error:  # noqa: BLE001 - whatever it is, it is told
            faults.append(error)

    for number in range(8):
        stream = client.stream(world, f"alice-{number}").__enter__()
        users = [threading.Thread(target=does, args=(what, stream)) for what in (hear, send, send, looked)]
        closers = [threading.Thread(target=does, args=(EditStream.close, stream)) for _ in range(2)]
        for user in users:
            user.start()
        until(lambda: stream.revision or stream.unanswered, SECONDS_MAX, "edits are sent")  # noqa: B023
        for closer in closers:
            closer.start()
        for thread in (*users, *closers):
            thread.join(SECONDS_MAX)
    assert faults == []
    assert threading.active_count() == before


def test_a_stream_may_be_used_and_closed_where_an_answer_is_heard_of(client, world):
    """There it runs in the stream's own thread."""
    over = threading.Event()
    with client.stream(world, "alice") as alice:

        def told(_):
            alice.edit(ball(9)).add_done_callback(lambda _: alice.close())
            over.set()

        alice.edit(ball()).add_done_callback(told)
        assert over.wait(SECONDS_MAX)
