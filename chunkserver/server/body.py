"""A JSON body, read from the stream: bounded in bytes and in time, so that nobody's body is ever held whole."""

import asyncio
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Final, TypeVar

from fastapi import Request
from pydantic import BaseModel, ValidationError
from starlette.requests import ClientDisconnect

from chunkserver.errors import BadParameter, BadRequest, Overloaded
from chunkserver.server.problems import BodyTooLarge, BodyTooSlow, NotJson

BODY_SECONDS_MAX: Final = 10.0
"""From the first look at the body to its end."""
JSON_MEDIA_TYPE: Final = "application/json"
LARGE_BYTES: Final = 1 << 20
"""A body with more is a large one."""
LARGE_BODIES_MAX: Final = 8
"""Large bodies that are held at once."""

_Model = TypeVar("_Model", bound=BaseModel)


class Bodies:
    """How many large bodies are held."""

    def __init__(self) -> None:
        self._large = 0

    @contextmanager
    def large(self) -> Iterator[None]:
        """Hold a large body within. Raises `Overloaded` if there are enough of them."""
        if self._large >= LARGE_BODIES_MAX:
            message = f"{self._large} bodies of more than {LARGE_BYTES} bytes are being worked on, which is the limit"
            raise Overloaded(message, bodies=self._large)
        self._large += 1
        try:
            yield
        finally:
            self._large -= 1


async def json_body(request: Request, bytes_max: int, is_large: Callable[[], object] = lambda: None) -> bytes:
    """Return the body of `request`, unparsed.

    is_large: called before the body has more than LARGE_BYTES; what it raises is raised.

    Raises `NotJson` if the media type is another one, before anything is read; `BodyTooLarge` as soon as the length
    that is announced, or the bytes that came, are more than `bytes_max`; `BodyTooSlow` after BODY_SECONDS_MAX;
    `BadRequest` if the client leaves before the end, which nobody is there to read.
    """
    media_type = request.headers.get("content-type", "").partition(";")[0].strip().lower()
    if media_type != JSON_MEDIA_TYPE:
        raise NotJson(f"the body's media type is {media_type or 'not given'}; it must be {JSON_MEDIA_TYPE}")
    announced = request.headers.get("content-length", "0")
    if int(announced.lstrip("0") or 0) > bytes_max:  # Python reads no more than 4,300 digits, and zeros are allowed
        raise _too_large(f"has {announced} bytes", bytes_max)
    try:
        async with asyncio.timeout(BODY_SECONDS_MAX):
            return await _read(request, bytes_max, is_large)
    except TimeoutError:
        raise BodyTooSlow(f"the body took longer than {BODY_SECONDS_MAX:g} s", seconds_max=BODY_SECONDS_MAX) from None
    except ClientDisconnect:
        raise BadRequest("the body ended before its end") from None


def parsed(model: type[_Model], body: bytes) -> _Model:
    """Return the JSON `body` as a `model`. Raises `BadParameter` that names the first field that is wrong."""
    try:
        return model.model_validate_json(body)
    except ValidationError as error:
        first = error.errors(include_url=False, include_context=False)[0]
    if not first["loc"]:
        raise BadParameter(f"the body: {first['msg']}")
    name = str(first["loc"][0])
    what = "is not a field of the body" if first["type"] == "extra_forbidden" else first["msg"]
    raise BadParameter(f"{name}: {what}", **({} if first["type"] == "missing" else {name: first["input"]}))


async def _read(request: Request, bytes_max: int, is_large: Callable[[], object]) -> bytes:
    body = bytearray()
    async for piece in request.stream():
        if len(body) + len(piece) > bytes_max:
            raise _too_large("is longer", bytes_max)
        if len(body) <= LARGE_BYTES < len(body) + len(piece):
            is_large()
        body += piece
    return bytes(body)


def _too_large(what: str, bytes_max: int) -> BodyTooLarge:
    return BodyTooLarge(f"the body {what}; the limit is {bytes_max} bytes", bytes_max=bytes_max)
