"""Clients that HTTP libraries cannot play: they say what they like, as slowly as they like, and need not listen."""

import json
import select
import socket
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import NamedTuple

SECONDS_MAX = 20.0
"""How long any of these tests waits for anything."""
WAITING = ("-m", "tests.contract.waiting_server")


class Answer(NamedTuple):
    status: int
    headers: dict[str, str]
    body: bytes
    behind: bytes
    """What came after it: nothing, unless more than one answer was read."""

    @property
    def problem(self) -> str:
        return str(json.loads(self.body)["type"]).rpartition(":")[2]


def connected_to(server):
    """A connection."""
    host, port = server.url.removeprefix("http://").split(":")
    return socket.create_connection((host, int(port)), timeout=SECONDS_MAX)


@contextmanager
def connection_to(server, first=b""):
    """A connection that has sent `first`; closed at the end."""
    with connected_to(server) as connection:
        connection.sendall(first)
        yield connection


def says_within(connection, seconds):
    """Whether the server says something, or closes, within a time."""
    return bool(select.select([connection], [], [], seconds)[0])


def rest_of(connection):
    """Everything until the server closes."""
    received = b""
    while piece := connection.recv(1 << 16):
        received += piece
    return received


def parsed(received):
    """The first of the answers that were received."""
    head, _, rest = received.partition(b"\r\n\r\n")
    first, *fields = head.decode("latin-1").split("\r\n")
    headers = dict(field.lower().split(": ", 1) for field in fields)
    length = int(headers.get("content-length", 0))
    return Answer(int(first.split()[1]), headers, rest[:length], rest[length:])


def read_answer(connection):
    """One answer, of a connection that may stay open."""
    received = b""
    while b"\r\n\r\n" not in received or len(parsed(received).body) < int(
        parsed(received).headers.get("content-length", 0)
    ):
        piece = connection.recv(1 << 16)
        assert piece, f"the connection ended behind {received!r}"
        received += piece
    return parsed(received)


def last_words(server, *pieces):
    """What the server answers to pieces before it closes the connection."""
    with connection_to(server) as connection:
        for piece in pieces:
            connection.sendall(piece)
        return parsed(rest_of(connection))


def sockets_of(server):
    """How many sockets the server has open: those of its connections, and a few of its own."""
    found = 0
    for path in Path(f"/proc/{server.child.pid}/fd").iterdir():
        with suppress(FileNotFoundError):  # closed meanwhile
            found += str(path.readlink()).startswith("socket:")
    return found


def resident_bytes(server):
    """The memory of the server."""
    lines = Path(f"/proc/{server.child.pid}/status").read_text().splitlines()
    return next(int(line.split()[1]) * 1024 for line in lines if line.startswith("VmRSS:"))
