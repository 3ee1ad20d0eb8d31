"""In front of the application: answers what was answered before, and chunks that differ from one in coordinates alone.

    request -> known, and does it hold? -> its head, and the body out of the cache, or a 304
                  | no
                  v
               is a plan known?         -> the cache, the workers, or a refusal while too many wait
                  | no
                  v
               application, which parses, validates and refuses; what it answers well is learned

Here nothing is decided that the application has not decided about a request of the same kind. So what is served most
costs no parsing, and a server with more requests than it can answer refuses the rest for next to nothing.
"""

from typing import Final

from fastapi import Request
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from chunkserver.errors import BadRequest, ChunkError, Overloaded
from chunkserver.server.accept import urgency
from chunkserver.server.answers import asked
from chunkserver.server.chunks import reply
from chunkserver.server.plan import Reply
from chunkserver.server.problems import refusal
from chunkserver.server.service import Service

METHODS: Final = frozenset(("GET", "HEAD"))


class Front:
    """ASGI: answers what `service` knows how to, and hands on everything else. `Answers` counts what it answers."""

    def __init__(self, app: ASGIApp, service: Service) -> None:
        self._app = app
        self._service = service
        self._answers = service.answers
        overloaded = Overloaded("too many requests are waiting for a worker")
        self._overloaded = _refusal({"type": "http", "headers": ()}, overloaded)  # ready: it is for when time is short

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request, or let the application do it."""
        if scope["type"] == "http" and scope["method"] in METHODS:
            known = self._answers.find(scope) or await self._planned(scope, receive)
            if known is not None:
                await send(known[0])
                await send({"type": "http.response.body", "body": known[1]})
                return
        await self._app(scope, receive, send)

    async def _planned(self, scope: Scope, receive: Receive) -> tuple[Message, bytes] | None:
        """Return the answer to a request of a known kind. What a plan cannot answer, the application refuses."""
        wanted = asked(scope)
        found = wanted and self._answers.plan(wanted)
        if not (wanted and found):
            return None
        plan, key = found
        try:
            plan.check(key)
        except BadRequest:
            return None
        self._answers.built += 1
        version = plan.current(key)
        urgent = urgency(dict(scope["headers"]).get(b"priority"))
        service, known = self._service, wanted.knows(version.tag)
        if service.pool.refuses(urgent, key.lod) and not (known or service.cache.at_hand(version.tag)):
            self._answers.refused += 1
            return self._answers.start(wanted.origin, self._overloaded), self._overloaded.body
        try:
            made = await reply(service, plan, version, known, receive, urgent)
        except ChunkError as error:
            self._answers.refused += isinstance(error, Overloaded)
            made = _refusal(scope, error)
        else:
            self._answers.keep(wanted, plan, made)
        return self._answers.start(wanted.origin, made), made.body


def _refusal(scope: Scope, error: ChunkError) -> Reply:
    response = refusal(Request(scope), error)
    return Reply(response.status_code, tuple(response.raw_headers), bytes(response.body))
