"""How streams end, and when they go on: told by a server of the test, which closes as it likes."""

import json
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from http import HTTPStatus
from typing import Any

import pytest
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response
from websockets.sync.server import ServerConnection, serve
from websockets.typing import Subprotocol

from chunkserver_client import Client, EditLost, NotAllowed, Problem, Retry, StreamEnded, WorldDescriptor
from tests.client.worlds import world as seed

SECONDS_MAX = 20.0
QUICK = Retry(seconds_max=SECONDS_MAX, backoff_seconds=0.01, backoff_seconds_max=0.02)
KEY = "chunkserver_key"


class Scripted:
    """A server that welcomes everybody and closes with the next of its codes when an edit comes; 0 is an answer.

    hellos: what each connection said first. edits: what it was sent. keys: what it was shown.
    """

    def __init__(self, codes: list[int], status: int = 0) -> None:
        self.hellos: list[dict[str, Any]] = []
        self.edits: list[dict[str, Any]] = []
        self.keys: list[str | None] = []
        self.extensions: list[Any] = []
        self._codes, self._status = codes, status

    def admit(self, connection: ServerConnection, request: Request) -> Response | None:
        self.keys.append(request.headers.get("authorization"))
        return connection.respond(HTTPStatus(self._status), "no\n") if self._status else None

    def speak(self, connection: ServerConnection) -> None:
        self.extensions += connection.protocol.extensions
        with suppress(ConnectionClosed):
            self.hellos.append(json.loads(connection.recv(SECONDS_MAX)))
            limits = {"frame_bytes": 65536, "inflight": 64, "regions": 64}
            welcome = {"type": "welcome", "epoch": "one", "revision": "3", "floor": "0", "last_seq": 7}
            connection.send(json.dumps({**welcome, "limits": limits}))
            self.edits.append(json.loads(connection.recv(SECONDS_MAX)))
            code = self._codes.pop(0)
            if code:
                connection.close(code, "as the test says")
            answer = {"type": "ack", "seq": self.edits[-1]["seq"], "revision": "4", "duplicate": False, "stale": []}
            connection.send(json.dumps(answer))
            connection.recv(SECONDS_MAX)


@contextmanager
def scripted(*codes: int, status: int = 0) -> Iterator[tuple[Scripted, Client, WorldDescriptor]]:
    script = Scripted(list(codes), status)
    server = serve(
        script.speak, "127.0.0.1", 0, subprotocols=[Subprotocol("chunkserver.v1")], process_request=script.admit
    )
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    pristine = seed()
    fields: dict[str, Any] = {name: getattr(pristine, name) for name in pristine.__dataclass_fields__ if name != "kind"}
    more: dict[str, Any] = {
        "id": "w",
        "epoch": "one",
        "revision": 3,
        "created": None,
        "durable": True,
        "answer_seconds": 30.0,
    }
    world = WorldDescriptor(**fields, **more)
    host, port = server.socket.getsockname()
    with Client(f"http://{host}:{port}/", api_key=KEY, retry=QUICK) as client:
        yield script, client, world
    server.shutdown()
    thread.join(SECONDS_MAX)


@pytest.mark.parametrize("code", [1000, 1001, 1011, 1012, 4408])
def test_ends_after_which_it_goes_on(code: int):
    with scripted(code, code, 0) as (script, client, world), client.stream(world, "alice") as alice:
        assert alice.edit([{"op": "carve"}]).result(SECONDS_MAX).revision == 4
        assert [edit["seq"] for edit in script.edits] == [8, 8, 8], "above what this name has used, and unchanged"
        told = [(hello["client"], hello["epoch"], hello["resume"]) for hello in script.hellos]
        assert told == [("alice", None, None), ("alice", "one", "3"), ("alice", "one", "3")]
        assert set(script.keys) == {f"Bearer {KEY}"}
        assert not script.extensions


@pytest.mark.parametrize("code", [1009, 4400, 4401, 4404, 4409, 4412])
def test_ends_that_are_final(code: int):
    with scripted(code) as (script, client, world), client.stream(world, "alice") as alice:
        answer = alice.edit([{"op": "carve"}])
        with pytest.raises(EditLost, match=f"ended with {code}"):
            answer.result(SECONDS_MAX)
        with pytest.raises(StreamEnded, match=f"ended with {code}") as found:
            next(alice)
        assert found.value.code == code
        assert len(script.hellos) == 1


@pytest.mark.parametrize("status", [401, 403, 404, 409, 422])
def test_a_server_that_does_not_let_us_in(status: int):
    with scripted(status=status) as (script, client, world):
        with pytest.raises(StreamEnded, match=f"ended with 4{status}") as found:
            client.stream(world, "alice").__enter__()
        assert isinstance(found.value.__cause__, Problem)
        assert isinstance(found.value.__cause__, NotAllowed) is (status in (401, 403))
        assert len(script.keys) == 1
