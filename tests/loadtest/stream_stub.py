"""A small stream of edits, as docs/wire/edit_v1.md has it, which lies to its subscribers as a test tells it to."""

import json
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from http import HTTPStatus
from typing import Any, Final

from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response
from websockets.sync.server import ServerConnection, serve

PATH: Final = "/v1/worlds/w"
JOIN_SECONDS_MAX: Final = 10.0
EVERYTHING: Final = [{"lod": 0, "min": [-99, -99, -99], "max": [99, 99, 99]}]
PROBLEM: Final = {"type": "urn:chunkserver:problem:bad-stroke", "title": "no", "status": 422, "detail": "no"}

Message = dict[str, Any]
Lie = Callable[[str, Message], list[Message]]
"""From a client's name and what it was to be told to what it is told instead. A message of type `close` has a code."""


def honest(_client: str, message: Message) -> list[Message]:
    """Tell the truth."""
    return [message]


class Stub:
    """One world. lie: what becomes of each message; refuse: how many upgrades are answered with which status first.

    edits: seq and strokes of each edit that was written, by whom.
    """

    def __init__(self, lie: Lie) -> None:
        self.lie = lie
        self.refuse = (0, HTTPStatus.SERVICE_UNAVAILABLE)
        self.edits: list[tuple[str, int, Any]] = []
        self.open: dict[str, ServerConnection] = {}
        self.url = ""
        self._lock = threading.RLock()

    @property
    def revision(self) -> int:
        """Of the world."""
        return len(self.edits)

    def answer(self, connection: ServerConnection, request: Request) -> Response | None:
        """Answer a request that is no stream; refuse a stream."""
        if not request.path.endswith("/stream"):
            return Response(200, "OK", Headers({"Content-Type": "application/json"}), descriptor(self.revision))
        with self._lock:
            count, status = self.refuse
            self.refuse = max(0, count - 1), status
        return connection.respond(status, "no\n") if count else None

    def handle(self, connection: ServerConnection) -> None:
        """Serve one peer."""
        try:
            hello = json.loads(connection.recv())
            client = hello["client"]
            with self._lock:
                self._welcome(connection, client, hello)
            for frame in connection:
                message = json.loads(frame)
                with self._lock:
                    self._edit(client, message["seq"], message["strokes"])
        except ConnectionClosed:
            pass

    def _welcome(self, connection: ServerConnection, client: str, hello: Message) -> None:
        limits = {"frame_bytes": 65536, "inflight": 4, "regions": 64}
        last = max((seq for name, seq, _ in self.edits if name == client), default=None)
        self.open[client] = connection
        self._tell(client, "welcome", epoch="one", revision=self.revision, floor=0, last_seq=last, limits=limits)
        if hello["resume"] is not None and int(hello["resume"]) < self.revision:
            self._tell_edits(client, int(hello["resume"]))

    def _edit(self, client: str, seq: int, strokes: Any) -> None:
        if strokes == "refuse me":
            self._tell(client, "nack", seq=seq, problem=PROBLEM)
            return
        known = [place for place, edit in enumerate(self.edits, 1) if edit[:2] == (client, seq)]
        if not known:
            self.edits.append((client, seq, strokes))
        revision = known[0] if known else self.revision
        self._tell(client, "ack", seq=seq, revision=revision, duplicate=bool(known), stale=EVERYTHING)
        for other in self.open:
            if "editor" not in other and not known:
                self._tell_edits(other, revision - 1)

    def _tell_edits(self, client: str, after: int) -> None:
        some = [
            {"revision": str(after + 1 + place), "strokes": strokes}
            for place, (_, _, strokes) in enumerate(self.edits[after:])
        ]
        self._tell(client, "edits", after=str(after), revision=self.revision, edits=some, stale=EVERYTHING)

    def _tell(self, client: str, kind: str, **members: Any) -> None:
        if "revision" in members:
            members["revision"] = str(members["revision"])
        try:
            for message in self.lie(client, {"type": kind, **members}):
                if message["type"] == "close":
                    self.open[client].close(message["code"], "as a test has it")
                else:
                    self.open[client].send(json.dumps(message))
        except ConnectionClosed:
            pass


def descriptor(revision: int) -> bytes:
    """Return the descriptor of the world."""
    content = {
        "generator": "stub",
        "revision": str(revision),
        "voxel_size": 1.0,
        "chunk_cells": 32,
        "lods": 3,
        "bounds": {"min": [-(1 << 40)] * 3, "max": [1 << 40] * 3},
        "urls": {"chunk": PATH + "/chunks/{lod}/{x}/{y}/{z}{extension}"},
        "formats": [{"name": "mesh", "extension": ".mesh", "media_type": "application/octet-stream"}],
    }
    return json.dumps(content).encode()


@contextmanager
def streaming(lie: Lie = honest) -> Iterator[Stub]:
    """Yield a server, which ends with the block."""
    stub = Stub(lie)
    with serve(
        *(stub.handle, "127.0.0.1", 0),
        process_request=stub.answer,
        subprotocols=["chunkserver.v1"],  # type: ignore[list-item]
        compression=None,
        close_timeout=0.1,
    ) as server:
        stub.url = f"http://127.0.0.1:{server.socket.getsockname()[1]}"
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        try:
            yield stub
        finally:
            server.shutdown()
            thread.join(JOIN_SECONDS_MAX)
            assert not thread.is_alive()
