"""Whether the client still waits. The framework runs a handler to its end, whoever has left meanwhile."""

import asyncio
from collections.abc import Coroutine
from typing import Any, TypeVar

from starlette.types import Receive

_Result = TypeVar("_Result")


async def while_there(receive: Receive, answer: Coroutine[Any, Any, _Result]) -> _Result | None:
    """Return what `answer` returns; or None once the client has left, and cancel `answer`. Raises what it raises.

    receive: of a request whose body is of no interest.
    """
    answering, leaving = asyncio.create_task(answer), asyncio.create_task(_left(receive))
    try:
        await asyncio.wait((answering, leaving), return_when=asyncio.FIRST_COMPLETED)
        return answering.result() if answering.done() else None
    finally:
        answering.cancel()
        leaving.cancel()


async def _left(receive: Receive) -> None:
    while (await receive())["type"] != "http.disconnect":
        pass
