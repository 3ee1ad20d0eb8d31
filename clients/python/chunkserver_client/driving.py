"""Two drivers for one kind of call: with blocking sockets, and on the event loop of asyncio.

`advance` takes steps until the call delivers something or returns.
"""

import asyncio
import time
from collections.abc import AsyncIterator, Iterator
from dataclasses import dataclass
from typing import Any, Generic

import httpx2

from chunkserver_client.steps import LOST, Deliver, Head, Open, Pause, Read, Request, Step, Steps, Value


@dataclass(frozen=True, slots=True)
class Returned(Generic[Value]):
    """The call is over, and this is its value."""

    value: Value


class _Call(Generic[Value]):
    """A call under way. The reply to its last step, or what was lost, is held until the next is asked for."""

    def __init__(self, steps: Steps[Value]) -> None:
        self._steps = steps
        self._reply: Any = None
        self._lost: Exception | None = None

    def next(self) -> Step | Returned[Value]:
        """Return the call's next step, or its value."""
        reply, lost = self._reply, self._lost
        self._reply = self._lost = None
        try:
            return self._steps.send(reply) if lost is None else self._steps.throw(lost)
        except StopIteration as end:
            return Returned(end.value)

    def reply(self, value: Any) -> None:
        """Answer the step."""
        self._reply = value

    def lose(self, error: Exception) -> None:
        """Answer the step by an error."""
        self._lost = error


class BlockingCall(_Call[Value]):
    """A call that is driven by blocking."""

    def __init__(self, http: httpx2.Client, steps: Steps[Value]) -> None:
        super().__init__(steps)
        self._http = http
        self._response: httpx2.Response | None = None
        self._pieces: Iterator[bytes] = iter(())

    def advance(self) -> Deliver | Returned[Value]:
        """Go on to the next value."""
        while True:
            step = self.next()
            if isinstance(step, (Deliver, Returned)):
                return step
            try:
                self.reply(self._take(step))
            except LOST as error:
                self.lose(error)

    def finish(self) -> Value:
        """Go on to the end, of a call that delivers nothing on its way."""
        step = self.advance()
        assert isinstance(step, Returned)
        return step.value

    def close(self) -> None:
        """End the call where it is."""
        self._steps.close()
        self._leave()

    def _take(self, step: Open | Read | Pause) -> Head | bytes | None:
        if isinstance(step, Read):
            return next(self._pieces, b"")
        self._leave()
        if isinstance(step, Pause):
            time.sleep(step.seconds)
            return None
        self._response = self._http.send(http_request(self._http, step), stream=True)
        self._pieces = self._response.iter_raw()
        return head(self._response)

    def _leave(self) -> None:
        if self._response is not None:
            self._response.close()
            self._response = None


class AsyncCall(_Call[Value]):
    """A call that is driven on the event loop."""

    def __init__(self, http: httpx2.AsyncClient, steps: Steps[Value]) -> None:
        super().__init__(steps)
        self._http = http
        self._response: httpx2.Response | None = None
        self._pieces: AsyncIterator[bytes]

    async def advance(self) -> Deliver | Returned[Value]:
        """Go on to the next value."""
        while True:
            step = self.next()
            if isinstance(step, (Deliver, Returned)):
                return step
            try:
                self.reply(await self._take(step))
            except LOST as error:
                self.lose(error)

    async def finish(self) -> Value:
        """Go on to the end, of a call that delivers nothing on its way."""
        step = await self.advance()
        assert isinstance(step, Returned)
        return step.value

    async def close(self) -> None:
        """End the call where it is."""
        self._steps.close()
        await self._leave()

    async def _take(self, step: Open | Read | Pause) -> Head | bytes | None:
        if isinstance(step, Read):
            return await anext(self._pieces, b"")
        await self._leave()
        if isinstance(step, Pause):
            await asyncio.sleep(step.seconds)
            return None
        self._response = await self._http.send(http_request(self._http, step), stream=True)
        self._pieces = self._response.aiter_raw()
        return head(self._response)

    async def _leave(self) -> None:
        if self._response is not None:
            await self._response.aclose()
            self._response = None


def http_request(http: httpx2.Client | httpx2.AsyncClient, step: Open) -> httpx2.Request:
    """Return httpx2's request."""
    request: Request = step.request
    timeout = {**http.timeout.as_dict(), "read": step.timeout_seconds}
    return http.build_request(
        request.method,
        request.url,
        headers=dict(request.headers),
        content=request.body or None,
        extensions={"timeout": timeout},
    )


def head(response: httpx2.Response) -> Head:
    """Return status and headers."""
    return Head(response.status_code, dict(response.headers))
