"""Others are served while a thousand connections dribble their heads, and while large bodies come in.

One client, one thread: between its own requests, of which each is timed, it plays the others. So what is measured is
what the server makes of them, and not how threads of the test share a core.
"""

import socket
import sys
import time

import numpy as np
import pytest

from tests.fault.sockets import WAITING, connected_to, read_answer, resident_bytes
from tests.scale import TORTURE, count
from tests.serving import serving

REQUESTS = count(40_000)
ROUNDS = 5
BODY_BYTES = 200 << 20
PIECE = bytes(1 << 16)
CHUNK = b"GET /v1/seeds/1/chunks/0/0/0/0 HTTP/1.1\r\nHost: x\r\n"
LIVE = b"GET /livez HTTP/1.1\r\nHost: x\r\n"
P99_SLACK_SECONDS = 0.002 if TORTURE else 0.1
"""Of a machine that does other things too. The long run is the one that wants a quiet machine; in the short one others
must not wait for the flood."""
GROWTH_BYTES_MAX = 64 << 20


class SlowHeads:
    """A thousand connections; each step sends one byte of one of them."""

    count = 1000
    sent_min = REQUESTS

    def __init__(self, server):
        self.server = server
        self.connections = [self.begin() for _ in range(self.count)]
        self.steps = 0
        self.sent = 0

    def begin(self):
        connection = connected_to(self.server)
        connection.sendall(CHUNK + b"a: ")
        return connection

    def send(self, connection):
        return connection.send(b"b")

    def step(self):
        number = self.steps % self.count
        self.steps += 1
        try:
            self.sent += self.send(self.connections[number])
        except BlockingIOError:
            pass  # the operating system holds as much as it likes to
        except OSError:
            self.connections[number].close()
            self.connections[number] = self.begin()

    def end(self):
        for connection in self.connections:
            connection.close()


class LargeBodies(SlowHeads):
    """Bodies of 200 MB, to a resource that wants none; each step sends 64 KB more of one of them."""

    count = 8
    sent_min = REQUESTS * len(PIECE)

    def begin(self):
        connection = connected_to(self.server)
        connection.sendall(LIVE + b"Content-Length: %d\r\n\r\n" % BODY_BYTES)
        connection.setblocking(False)
        return connection

    def send(self, connection):
        return connection.send(PIECE)


def p99(server, step):
    """The 99th percentile of a request's seconds: the median of ROUNDS, for a busy machine spoils one or two."""
    return float(np.median([np.quantile(seconds_of_requests(server, step), 0.99) for _ in range(ROUNDS)]))


def seconds_of_requests(server, step):
    """How long each request of a round took, of one connection that stays open."""
    taken = np.empty(REQUESTS)
    with connected_to(server) as connection:
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        for number in range(REQUESTS):
            step()
            began = time.perf_counter()
            connection.sendall(CHUNK + b"\r\n")
            assert read_answer(connection).body == b"built"
            taken[number] = time.perf_counter() - began
    return taken


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    folder = tmp_path_factory.mktemp("flood")
    (folder / "released").touch()
    with serving(folder / "log", str(folder / "released"), program=WAITING) as running:
        yield running


@pytest.mark.parametrize("kind", [SlowHeads, LargeBodies])
def test_others_hardly_notice(server, kind):
    alone = p99(server, lambda: None)
    before = resident_bytes(server)
    others = kind(server)
    among = p99(server, others.step)
    growth = resident_bytes(server) - before
    others.end()
    alone_again = p99(server, lambda: None)
    figures = (
        f"{kind.__name__}: p99 {among * 1e6:.0f} us, without them {alone * 1e6:.0f} and {alone_again * 1e6:.0f} us; "
        f"{others.sent} bytes sent; the server grew by {growth >> 10} KB"
    )
    sys.stderr.write(f"{figures}\n")
    assert among < 2 * max(alone, alone_again) + P99_SLACK_SECONDS, figures
    assert growth < GROWTH_BYTES_MAX, figures
    assert others.sent > kind.sent_min, figures
