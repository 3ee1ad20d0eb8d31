import logging
import resource
import socket

import pytest

from chunkserver.server import run
from chunkserver.server.connections import ConnectionLimits

LIMITS = ConnectionLimits(connections_max=100, send_seconds=7.5)
WANTED = LIMITS.connections_max + run.DESCRIPTORS_BESIDE
INFINITY = resource.RLIM_INFINITY


def test_clients_that_are_gone_are_given_up_by_the_operating_system(monkeypatch):
    monkeypatch.setattr(resource, "setrlimit", lambda *_: None)
    with run.listen("127.0.0.1", 0) as listening:
        run._make_room(listening, LIMITS)
        with socket.create_connection(listening.getsockname()):
            accepted, _ = listening.accept()
            with accepted:
                assert accepted.getsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT) == 7500


@pytest.mark.parametrize(
    ("soft", "hard", "becomes"),
    [
        (WANTED, WANTED, None),
        (INFINITY, INFINITY, None),
        (10, INFINITY, WANTED),
        (10, WANTED + 1, WANTED),
        (10, 20, 20),
    ],
)
def test_as_many_descriptors_as_connections_may_need(monkeypatch, caplog, soft, hard, becomes):
    asked = []
    monkeypatch.setattr(resource, "getrlimit", lambda _: (soft, hard))
    monkeypatch.setattr(resource, "setrlimit", lambda _, limits: asked.append(limits))
    with run.listen("127.0.0.1", 0) as listening, caplog.at_level(logging.INFO):
        run._make_room(listening, LIMITS)
    assert asked == ([] if becomes is None else [(becomes, hard)])
    assert (f"{WANTED} are wanted" in caplog.text) == (becomes == 20)
