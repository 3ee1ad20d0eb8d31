"""Listeners of a stream that do not listen: the others are told everything, in time, and those are gone soon."""

import asyncio
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, suppress

import httpx2
import pytest
import uvloop

from chunkserver_loadtest.crowd import Crowd
from chunkserver_loadtest.peer import upgrade
from chunkserver_loadtest.target import resolve
from chunkserver_loadtest.tellings import Sent
from tests.fault.sockets import SECONDS_MAX, resident_bytes
from tests.scale import TORTURE
from tests.serving import Server, serving, until

LISTENERS = 400 if TORTURE else 40
NEVER = 100 if TORTURE else 10
EDITS_PER_SECOND = 50
SECONDS = 20.0 if TORTURE else 1.0
"""Of edits without and with those who do not read, where times are compared."""
GONE_SECONDS_MAX = 10.0
RECEIVE_BYTES = 2048
"""That the kernel holds for every second peer which does not read; for the others what it likes."""
MORE_BYTES_MAX = 64 << 20
"""Of the server, over a run: what one peer may have waiting, times those who do not read, is half of it."""
PATH = "/v1/worlds/w"
HELLO = b'{"type":"hello","client":"%b","regions":[{"min":[-999,-999,-999],"max":[999,999,999]}]}'
STOPPED = """
import sys
from tests.fault.test_stream_readers import welcomed
peer = welcomed(int(sys.argv[1]), "stopped")
print("welcome", flush=True)
while peer.recv(4096): pass
"""


@pytest.fixture(scope="module")
def server(tmp_path_factory) -> Iterator[Server]:
    with serving(tmp_path_factory.mktemp("readers") / "log", "--workers", "1") as running:
        world = {"id": "w", "seed": "7", "recipe": "terrain", "chunk_cells": 16, "lods": 3}
        assert httpx2.post(f"{running.url}/v1/worlds", json=world, timeout=SECONDS_MAX).status_code == 201
        yield running


def streams(server: Server) -> int:
    """Return how many connections there are to streams, as the server's metrics have it."""
    return int(metrics(server)["chunkserver_streams"])


def metrics(server: Server) -> dict[str, float]:
    """Return the server's metrics."""
    lines = [line for line in httpx2.get(f"{server.url}/metrics").text.splitlines() if not line.startswith("#")]
    return {name: float(value) for name, value in (line.rsplit(" ", 1) for line in lines)}


def welcomed(port: int, name: str, receive_bytes: int | None = RECEIVE_BYTES) -> socket.socket:
    """Return a peer that is welcome, and has read little more. receive_bytes: that the kernel holds for it."""
    peer = socket.create_connection(("127.0.0.1", port), SECONDS_MAX)
    if receive_bytes is not None:
        peer.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, receive_bytes)
    peer.sendall(upgrade(PATH, "x"))
    read_until(peer, b"\r\n\r\n")
    hello = (HELLO % name.encode()).ljust(126)
    peer.sendall(bytes([0x81, 0x80 | 126]) + len(hello).to_bytes(2, "big") + bytes(4) + hello)
    read_until(peer, b"welcome")
    return peer


def read_until(peer: socket.socket, wanted: bytes) -> None:
    """Read until something has come."""
    found = b""
    while wanted not in found:
        piece = peer.recv(256)
        assert piece, f"the connection ended behind {found!r}"
        found += piece


def port_of(server: Server) -> int:
    """Return where it listens."""
    return int(server.url.rpartition(":")[2])


def stopped(server: Server, stack: ExitStack) -> subprocess.Popen[bytes]:
    """Return a process whose peer is welcome, and which does not run any more: its connection is half open."""
    command = [sys.executable, "-c", STOPPED, str(port_of(server))]
    child = stack.enter_context(subprocess.Popen(command, stdout=subprocess.PIPE))
    stack.callback(child.kill)
    assert child.stdout is not None
    assert child.stdout.readline() == b"welcome\n"
    os.kill(child.pid, signal.SIGSTOP)
    return child


async def dig(crowd: Crowd, editor: str, sent: list[Sent], seconds: float) -> None:
    """Edit at a steady rate, always the same places: what the world itself takes stays as it is."""
    begun = time.perf_counter()
    for number in range(int(seconds * EDITS_PER_SECOND)):
        await asyncio.sleep(max(0.0, begun + number / EDITS_PER_SECOND - time.perf_counter()))
        ball = {"op": "carve", "shape": "sphere", "center": [8.0 * (number % 4), 0.0, 0.0], "radius": 4.0}
        sent.append(crowd.edit(editor, [ball]))


def late(sent: list[Sent]) -> float:
    """Return the seconds from an edit to its last listener that 99 % of them did not exceed."""
    assert all(edit.told == LISTENERS for edit in sent), "every listener has every edit, once"
    return sorted(edit.told_at - edit.sent for edit in sent)[int(0.99 * (len(sent) - 1))]


async def read_slowly(peer: socket.socket) -> None:
    """Read a byte a second."""
    peer.setblocking(False)
    with suppress(OSError):
        while await asyncio.get_running_loop().sock_recv(peer, 1):
            await asyncio.sleep(1.0)


async def scenario(server: Server, stack: ExitStack) -> tuple[float, float]:
    """Return how late listeners were without those who do not read, and with them."""
    crowd = Crowd(resolve(server.url), PATH)
    await crowd.join(["editor"], edit=True)
    await crowd.join([f"listener-{number}" for number in range(LISTENERS)])
    before: list[Sent] = []
    await dig(crowd, "editor", [], 0.2)
    await dig(crowd, "editor", before, SECONDS)
    memory = resident_bytes(server)
    port = port_of(server)
    for number in range(NEVER):
        received = RECEIVE_BYTES if number % 2 else None
        stack.enter_context(await asyncio.to_thread(welcomed, port, f"never-{number}", received))
    slow = stack.enter_context(await asyncio.to_thread(welcomed, port, "slow"))
    await asyncio.to_thread(stopped, server, stack)
    assert await asyncio.to_thread(streams, server) == 1 + LISTENERS + NEVER + 2
    reading, begun = asyncio.ensure_future(read_slowly(slow)), time.perf_counter()
    beside: list[Sent] = []
    while await asyncio.to_thread(streams, server) > 1 + LISTENERS:
        assert time.perf_counter() - begun < GONE_SECONDS_MAX, "who does not read is still there"
        await dig(crowd, "editor", beside, 0.5)
    await crowd.settle(SECONDS_MAX)
    reading.cancel()
    crowd.close()
    assert not crowd.unsettled
    assert (crowd.lost, crowd.skipped) == ({}, 0), "nobody who reads was cut, or told less"
    assert resident_bytes(server) - memory < MORE_BYTES_MAX
    return late(before), late(beside)


def test_who_does_not_read_is_gone_soon_and_disturbs_nobody(server):
    with asyncio.Runner(loop_factory=uvloop.new_event_loop) as runner, ExitStack() as stack:
        without, beside = runner.run(asyncio.wait_for(scenario(server, stack), 4 * SECONDS_MAX + 2 * SECONDS))
    too_slow = metrics(server)['chunkserver_streams_closed_total{code="4408"}']
    assert too_slow == NEVER + 2, "they are counted as what they are, also those that the kernel has given up"
    if TORTURE:
        assert beside < 2 * without
    until(lambda: streams(server) == 0, SECONDS_MAX, "no stream is left")


async def leave_early(server: Server, editor: str) -> None:
    """Edit, and have everybody leave while they are being told."""
    crowd = Crowd(resolve(server.url), PATH)
    await crowd.join([editor], edit=True)
    await crowd.join([f"listener-{number}" for number in range(LISTENERS)])
    await dig(crowd, editor, [], 0.3)
    crowd.close()
    assert not crowd.refused


def test_peers_that_leave_while_they_are_told_are_no_error(server):
    """The fixture finds the server's log clean at the end."""
    with asyncio.Runner(loop_factory=uvloop.new_event_loop) as runner:
        for number in range(3):  # an editor's last edits may be written when it is gone: its next seq is not known
            runner.run(asyncio.wait_for(leave_early(server, f"leaver-{number}"), SECONDS_MAX))
    until(lambda: streams(server) == 0, SECONDS_MAX, "no stream is left")
