"""Calls without sockets: a driver that answers each step from a script, and a clock that only pauses move."""

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

from chunkserver_client.cache import AnswerCache
from chunkserver_client.exchange import Exchange
from chunkserver_client.retry import Retry
from chunkserver_client.steps import Answer, Deliver, Open, Pause, Read, Request, Steps


@dataclass
class Script:
    """Drives calls. answers: what each request gets: an answer, or an error of the connection.

    requests, pauses: what came of it.
    """

    answers: list[Answer | Exception]
    requests: list[Request] = field(default_factory=list)
    pauses: list[float] = field(default_factory=list)

    def run(self, steps: Steps[Any]) -> Any:
        """Return the value of a call; what it delivers is dropped."""
        reply: Any = None
        lost: Exception | None = None
        body = b""
        while True:
            try:
                step = steps.send(reply) if lost is None else steps.throw(lost)
            except StopIteration as end:
                return end.value
            reply = lost = None
            if isinstance(step, Open):
                self.requests.append(step.request)
                answer = self.answers.pop(0)
                if isinstance(answer, Exception):
                    lost = answer
                else:
                    reply, body = answer, answer.content
            elif isinstance(step, Read):
                reply, body = body, b""
            elif isinstance(step, Pause):
                self.pauses.append(step.seconds)
            else:
                assert isinstance(step, Deliver)


def json_answer(status: int = 200, body: bytes = b"{}", **headers: str) -> Answer:
    """Return an answer of JSON; underscores in the names of headers are hyphens."""
    named = {name.replace("_", "-"): value for name, value in headers.items()}
    return Answer(status, {"content-type": "application/json", **named}, body)


def exchange(retry: Retry | None = None, cache: AnswerCache | None = None) -> Exchange:
    """Return an exchange with a cache of its own."""
    return Exchange(retry or Retry(), cache or AnswerCache(1 << 20), 10.0)


def urls(requests: Iterable[Request]) -> list[str]:
    """Return which URLs were asked for."""
    return [request.url for request in requests]
