"""A peer of the stream of edits, for tests: messages as they stand in docs/wire/edit_v1.md, over a real WebSocket."""

import json
import time
from contextlib import ExitStack
from typing import Any, Self

from websockets.sync.client import ClientConnection, connect

SECONDS_MAX = 20.0
SUBPROTOCOL = "chunkserver.v1"
EVERYWHERE = [{"min": [-(1 << 40)] * 3, "max": [1 << 40] * 3}]


class Peer:
    """One connection to a world's stream. It sends `hello` if it has a name."""

    def __init__(self, url: str, client: str | None = "peer", **more: Any) -> None:
        """url: of the world. more: members of `hello`; `query` and `headers` of the request."""
        address = url.replace("http", "ws", 1) + "/stream" + more.pop("query", "")
        headers = more.pop("headers", None)
        opening = connect(
            address,
            subprotocols=more.pop("subprotocols", [SUBPROTOCOL]),
            additional_headers=headers,
            open_timeout=SECONDS_MAX,
            close_timeout=1.0,
            compression=more.pop("compression", None),
            ping_interval=None,  # the server asks; and hypothesis takes amiss what a thread of pings draws at random
        )
        self._ending = ExitStack()
        self.socket: ClientConnection = self._ending.enter_context(opening)
        if client is not None:
            self.send("hello", **{"client": client, "epoch": None, "resume": None, "regions": EVERYWHERE, **more})
            self.welcome = self.receive("welcome")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._ending.close()

    def send(self, kind: str, **members: Any) -> None:
        """Send a message."""
        self.socket.send(json.dumps({"type": kind, **members}))

    def edit(self, seq: int, *strokes: dict[str, Any]) -> dict[str, Any]:
        """Send an edit and return what it is answered."""
        self.send("edit", seq=seq, strokes=strokes)
        return self.receive("ack", "nack")

    def receive(self, *kinds: str) -> dict[str, Any]:
        """Return the next message of one of these kinds. Raises `TimeoutError` if there is none for long."""
        until = time.monotonic() + SECONDS_MAX
        while True:
            message: dict[str, Any] = json.loads(self.socket.recv(timeout=until - time.monotonic()))
            if message["type"] in kinds:
                return message


def ball(x: float = 0.0, y: float = 0.0, z: float = 0.0, op: str = "carve", **more: Any) -> dict[str, Any]:
    """Return a stroke."""
    return {"op": op, "shape": "sphere", "center": [x, y, z], "radius": 4.0, **more}
