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
    waiting = asyncio.current_task()
    assert waiting is not None
    left = False

    async def watch() -> None:
        nonlocal left
        while (await receive())["type"] != "http.disconnect":
            pass
        left = True
        waiting.cancel()

    watching = asyncio.create_task(watch())
    try:
        return await answer
    except asyncio.CancelledError:
        if not left:
            raise
        waiting.uncancel()
        return None
    finally:
        watching.cancel()  # it cannot cancel us any more, even if the client has left in this very moment
