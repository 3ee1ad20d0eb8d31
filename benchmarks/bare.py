"""The least that an ASGI application can do, on our HTTP server: the peer of what is answered out of memory.

Run as `python -m benchmarks.bare FILE`: FILE is a pickle of what `learn` returns.
"""

import pickle
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Final, NamedTuple

import httpx2
from starlette.types import Receive, Scope, Send

from chunkserver.server import listen, serve

ADDED: Final = {b"date", b"server"}
"""Headers that the HTTP server adds to every answer."""


class Answer(NamedTuple):
    """All of one answer."""

    status: int
    headers: list[tuple[bytes, bytes]]
    body: bytes


class Bare:
    """Knows every answer by its path: the first without, the second with a condition."""

    def __init__(self, answers: dict[str, tuple[Answer, Answer]]) -> None:
        self.answers = answers

    async def __call__(self, scope: Scope, _receive: Receive, send: Send) -> None:
        """Answer one request."""
        if scope["type"] != "http":
            return
        known = any(name == b"if-none-match" for name, _ in scope["headers"])
        status, headers, body = self.answers[scope["path"]][known]
        await send({"type": "http.response.start", "status": status, "headers": headers})
        await send({"type": "http.response.body", "body": body})


def learn(client: httpx2.Client, paths: Iterable[str]) -> dict[str, tuple[Answer, Answer]]:
    """Return what the server behind `client` answers: to each path without a condition, and to its own entity tag."""
    ready = Answer(200, [], b"")
    return {"/readyz": (ready, ready)} | {path: (_ask(client, path), _ask(client, path, "*")) for path in paths}


def _ask(client: httpx2.Client, path: str, condition: str = '""') -> Answer:
    answer = client.get(path, headers={"If-None-Match": condition, "Accept-Encoding": "identity"})
    headers = [(name.lower(), value) for name, value in answer.headers.raw if name.lower() not in ADDED]
    return Answer(answer.status_code, headers, answer.content)


if __name__ == "__main__":
    serve(Bare(pickle.loads(Path(sys.argv[1]).read_bytes())), listen("127.0.0.1", 0))
