"""Streams of edits over TLS, as a proxy in front of the server ends it: loopback.pem is its key and certificate."""

import asyncio
import dataclasses
import ssl
from collections.abc import Iterator
from pathlib import Path

import pytest

from chunkserver_client import Ack, AsyncClient, Client, Edits, Retry, Unreachable, WorldDescriptor
from tests.client.wires import Wire, wire
from tests.serving import Server, until

PEM = Path(__file__).parent / "loopback.pem"
"""Signed by itself, for 127.0.0.1, until 2126."""
SECONDS_MAX = 20.0
QUICK = Retry(seconds_max=SECONDS_MAX, backoff_seconds=0.02, backoff_seconds_max=0.1)
BALL = [{"op": "carve", "shape": "sphere", "center": [0, 0, 0], "radius": 4.0}]


@pytest.fixture
def line(server: Server) -> Iterator[Wire]:
    ending = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    ending.load_cert_chain(PEM)
    with wire(server.url, ending) as line:
        yield line


@pytest.fixture
def trusting() -> ssl.SSLContext:
    """What takes this certificate, and no other."""
    return ssl.create_default_context(cafile=str(PEM))


@pytest.fixture
def world(server: Server) -> Iterator[WorldDescriptor]:
    with Client(server.url, retry=QUICK) as client:
        yield client.create_world("tls", 7, "plane", chunk_cells=16, lods=2)
        client.delete_world("tls")


def test_edits_go_both_ways_over_tls_and_a_cut_connection_is_made_again(line, trusting, world):
    assert line.url.startswith("https://")
    with (
        Client(line.url, retry=QUICK, tls=trusting) as client,
        client.stream(world, "alice") as alice,
        client.stream(world, "bob") as bob,
    ):
        assert alice.edit(BALL).result(SECONDS_MAX).revision == 1
        assert isinstance(next(bob), Edits)
        line.cut()
        assert alice.edit(BALL).result(SECONDS_MAX).revision == 2
        until(lambda: bob.revision == 2, SECONDS_MAX, "bob has heard of it")


def test_the_same_on_an_event_loop(line, trusting, world):
    async def play() -> None:
        async with AsyncClient(line.url, retry=QUICK, tls=trusting) as client, client.stream(world, "alice") as alice:
            answer = await alice.edit(BALL)
            assert (type(answer), answer.revision) == (Ack, 1)

    asyncio.run(asyncio.wait_for(play(), SECONDS_MAX))


def test_a_certificate_that_is_not_trusted_opens_nothing(line, world):
    patience = dataclasses.replace(QUICK, seconds_max=0.3)
    opened = line.opened
    with Client(line.url, retry=patience) as client, pytest.raises(Unreachable), client.stream(world, "alice"):
        pass
    assert line.opened == opened, "the proxy has seen no request"
