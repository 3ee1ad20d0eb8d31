"""A server of a test that ends while it is connected to leaves no socket behind."""

import gc
import socket
import sys
from contextlib import ExitStack
from typing import Any

import pytest

from tests.loadtest.stub import OK, answering


def test_connections_that_come_at_the_end_are_closed(monkeypatch: pytest.MonkeyPatch):
    left: list[Any] = []
    with monkeypatch.context() as patched:
        patched.setattr(sys, "unraisablehook", left.append)
        for _ in range(10):
            with ExitStack() as peers, answering(OK) as server:
                port = int(server.url.rsplit(":", 1)[1])
                for _ in range(3):
                    peer = peers.enter_context(socket.socket())
                    peer.setblocking(False)
                    peer.connect_ex(("127.0.0.1", port))
        gc.collect()
    assert left == []
