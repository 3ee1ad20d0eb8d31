"""What a client sends: frames are read, or refused with the code that closes the connection.

Text frames are JSON objects. A binary frame has the JSON of an `edit` and behind it the values of its deltas:

    u32 length of the JSON | JSON | zeros, up to a multiple of 4 | int32 values ...
"""

import base64
import json
import math
import re
from typing import Any, Final, NamedTuple, NoReturn, TypeGuard

from chunkserver.errors import BadRequest
from chunkserver.stream.limits import (
    FRAME_BYTES_MAX,
    LODS_MAX,
    NAME_CHARS_MAX,
    PLACE_MAX,
    REGIONS_MAX,
    REVISION_MAX,
    SEQ_MAX,
)
from chunkserver.stream.regions import Box, Place, Region, Regions

SHOWN_CHARS_MAX: Final = 80
"""Of a value that is named in an error."""
LENGTH_BYTES: Final = 4
VALUE_BYTES: Final = 4
_NAME: Final = re.compile(f"[!-~]{{1,{NAME_CHARS_MAX}}}")
_DECIMAL: Final = re.compile("0|[1-9][0-9]{0,18}")


class BadMessage(BadRequest):
    """A frame that is no message of docs/wire/edit_v1.md."""


class FrameTooLarge(BadMessage):
    """A frame that has more bytes than a frame may have."""


class Hello(NamedTuple):
    """Who is there, what it has seen, and where it looks. resume: a revision of the world of `epoch`; or None."""

    client: str
    epoch: str | None
    resume: int | None
    regions: Regions


class NewEdit(NamedTuple):
    """An edit to be written. strokes: values of JSON that nobody has looked at."""

    seq: int
    strokes: list[Any]


class Subscribe(NamedTuple):
    """Regions to look at too."""

    regions: Regions


class Unsubscribe(NamedTuple):
    """Regions not to look at any more."""

    regions: Regions


Message = Hello | NewEdit | Subscribe | Unsubscribe


def read_message(frame: str | bytes) -> Message:
    """Return the message of a text frame (str) or a binary frame (bytes).

    Raises `FrameTooLarge`; `BadMessage` that names the member and the value.
    """
    size = len(frame) if isinstance(frame, bytes) or frame.isascii() else len(frame.encode())
    if size > FRAME_BYTES_MAX:
        raise FrameTooLarge(f"the frame has {size} bytes; the limit is {FRAME_BYTES_MAX}", bytes=size)
    try:
        return _message(_parsed(frame)) if isinstance(frame, str) else _with_values(frame)
    except RecursionError:  # to show a value takes more of the stack than to read it
        raise BadMessage("the frame is nested too deeply") from None


def _message(found: dict[str, Any]) -> Message:
    match found.get("type"):
        case "hello":
            return Hello(_client(found), _epoch(found), _resume(found), _regions(found))
        case "edit":
            return NewEdit(_seq(found), _strokes(found))
        case "subscribe":
            return Subscribe(_regions(found))
        case "unsubscribe":
            return Unsubscribe(_regions(found))
        case _:
            raise _bad("type", found.get("type"), "hello, edit, subscribe or unsubscribe")


def _parsed(text: str | bytes) -> dict[str, Any]:
    try:
        found = json.loads(text if isinstance(text, str) else text.decode(), parse_constant=_no_constant)
    except ValueError as error:
        raise BadMessage(f"the frame is not JSON: {str(error)[:SHOWN_CHARS_MAX]}") from None
    if not isinstance(found, dict):
        raise _bad("the message", found, "an object")
    return found


def _no_constant(name: str) -> NoReturn:
    raise ValueError(f"{name} is no number of JSON")


def _with_values(frame: bytes) -> NewEdit:
    """Return the edit of a binary frame: each delta without values takes its own from what is behind the JSON."""
    length = int.from_bytes(frame[:LENGTH_BYTES], "little")
    end = LENGTH_BYTES + length
    start = -(-end // VALUE_BYTES) * VALUE_BYTES
    if start > len(frame) or any(frame[end:start]):
        raise BadMessage(f"a binary frame of {len(frame)} bytes has no JSON of {length}, and zeros up to the values")
    message = _message(_parsed(frame[LENGTH_BYTES:end]))
    if not isinstance(message, NewEdit):
        raise BadMessage("a binary frame has an edit")
    values = memoryview(frame)[start:]
    for number, stroke in enumerate(message.strokes):
        if isinstance(stroke, dict) and stroke.get("op") == "delta" and "values" not in stroke:
            count = VALUE_BYTES * _points(f"strokes.{number}.size", stroke.get("size"))
            if count > len(values):
                raise BadMessage(f"strokes.{number} has {count} bytes of values; there are {len(values)} left")
            stroke["values"] = base64.b64encode(values[:count]).decode()
            values = values[count:]
    if values:
        raise BadMessage(f"{len(values)} bytes behind the values of all deltas")
    return message


def _points(path: str, size: object) -> int:
    if not isinstance(size, list) or len(size) != 3 or not all(_is_integer(each, 1, FRAME_BYTES_MAX) for each in size):
        raise _bad(path, size, "three counts of points")
    return math.prod(size)


def _client(found: dict[str, Any]) -> str:
    client = found.get("client")
    if not isinstance(client, str) or not _NAME.fullmatch(client):
        raise _bad("client", client, f"1 to {NAME_CHARS_MAX} visible ASCII characters")
    return client


def _epoch(found: dict[str, Any]) -> str | None:
    epoch = found.get("epoch")
    if epoch is not None and (not isinstance(epoch, str) or not _NAME.fullmatch(epoch)):
        raise _bad("epoch", epoch, "a world's epoch, or null")
    return epoch


def _resume(found: dict[str, Any]) -> int | None:
    resume = found.get("resume")
    if resume is None:
        return None
    if not isinstance(resume, str) or not _DECIMAL.fullmatch(resume) or int(resume) > REVISION_MAX:
        raise _bad("resume", resume, "a revision as a decimal string, or null")
    return int(resume)


def _seq(found: dict[str, Any]) -> int:
    seq = found.get("seq")
    if not _is_integer(seq, 0, SEQ_MAX):
        raise _bad("seq", seq, f"an integer from 0 to {SEQ_MAX}")
    return seq


def _strokes(found: dict[str, Any]) -> list[Any]:
    strokes = found.get("strokes")
    if not isinstance(strokes, list):
        raise _bad("strokes", strokes, "a list of strokes")
    return strokes


def _regions(found: dict[str, Any]) -> Regions:
    regions = found.get("regions")
    if not isinstance(regions, list) or len(regions) > REGIONS_MAX:
        raise _bad("regions", regions, f"a list of at most {REGIONS_MAX} boxes")
    return frozenset(_region(f"regions.{number}", each) for number, each in enumerate(regions))


def _region(path: str, found: object) -> Region:
    if not isinstance(found, dict):
        raise _bad(path, found, "an object with min and max")
    low, high = _place(f"{path}.min", found.get("min")), _place(f"{path}.max", found.get("max"))
    if not all(first <= last for first, last in zip(low, high, strict=True)):
        raise _bad(path, found, "a box whose min is nowhere above its max")
    lod = found.get("lod", LODS_MAX - 1)
    if not _is_integer(lod, 0, LODS_MAX - 1):
        raise _bad(f"{path}.lod", lod, f"an integer from 0 to {LODS_MAX - 1}")
    return Region(Box(low, high), lod)


def _place(path: str, found: object) -> Place:
    if not isinstance(found, list) or len(found) != 3:
        raise _bad(path, found, "a list of three integers")
    x, y, z = found
    if not all(_is_integer(each, -PLACE_MAX, PLACE_MAX) for each in found):
        raise _bad(path, found, f"three integers from {-PLACE_MAX} to {PLACE_MAX}")
    return x, y, z


def _is_integer(value: object, low: int, high: int) -> TypeGuard[int]:
    return isinstance(value, int) and not isinstance(value, bool) and low <= value <= high


def _bad(path: str, value: object, expected: str) -> BadMessage:
    shown = repr(value)[:SHOWN_CHARS_MAX]
    return BadMessage(f"{path} should be {expected}; it is {shown}", path=path, value=shown)
