"""The messages of docs/wire/edit_v1.md: those of the server are read, those of the client written."""

import base64
import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, Final, NamedTuple

from chunkserver_client.edits import ChunkRange
from chunkserver_client.errors import Problem, problem
from chunkserver_client.json_tree import Json
from chunkserver_client.mesh import REVISION_MAX
from chunkserver_client.questions import plain
from chunkserver_client.stream.places import Region, read_ranges

FRAME_BYTES_MAX: Final = 1 << 16
REGIONS_MAX: Final = 64
"""Of a connection."""
SEQ_MAX: Final = (1 << 53) - 1
STATUS_MIN: Final = 400
STATUS_MAX: Final = 599

Stroke = Mapping[str, Any]
"""As docs/edits/strokes.md has it. A delta's `values` may be bytes, little-endian int32: they are sent as they are."""


class Welcome(NamedTuple):
    """The server knows who is there. inflight: how many edits may wait for their answers."""

    epoch: str
    revision: int
    floor: int
    last_seq: int | None
    inflight: int


class Ack(NamedTuple):
    """An edit is durable. stale: the chunks that it may have changed; None if the server does not know any more."""

    seq: int
    revision: int
    duplicate: bool
    stale: tuple[ChunkRange, ...] | None


class Nack(NamedTuple):
    """An edit was refused: nothing of it was written."""

    seq: int
    problem: Problem


class Edit(NamedTuple):
    """Somebody else's edit. strokes: None if they are too large for the stream; the log has them."""

    revision: int
    strokes: Sequence[Stroke] | None


class Edits(NamedTuple):
    """All edits of others in (after, revision] that are in the regions, and the chunks that they may have changed."""

    after: int
    revision: int
    edits: tuple[Edit, ...]
    stale: tuple[ChunkRange, ...]


class Progress(NamedTuple):
    """Everything up to a revision was told. asked: how many requests for other regions are in force."""

    revision: int
    asked: int


class Stale(NamedTuple):
    """Edits up to a revision were left out: these chunks may have changed."""

    stale: tuple[ChunkRange, ...]
    revision: int


class Resync(NamedTuple):
    """Edits up to a revision were missed: every chunk may have changed."""

    floor: int
    revision: int
    epoch: str


Message = Welcome | Ack | Nack | Edits | Progress | Stale | Resync


def read_message(frame: str | bytes) -> Message | None:
    """Return a message of the server; None if it is of a type that is not known here. Raises `BadAnswer`."""
    found = Json.parse(frame.encode() if isinstance(frame, str) else frame)
    read = _READERS.get(found["type"].text())
    return None if read is None else read(found)


def hello(client: str, epoch: str | None, resume: int | None, regions: Iterable[Region]) -> str:
    """Return the message that opens a connection."""
    told = None if resume is None else str(resume)
    return _text(type="hello", client=client, epoch=epoch, resume=told, regions=_written(regions))


def edit(seq: int, strokes: Sequence[Stroke]) -> str | bytes:
    """Return the message of an edit: binary if a delta has its values as bytes.

    Raises `ValueError` if it is too long for a frame, or values are no int32.
    """
    if any(isinstance(stroke.get("values"), bytes) for stroke in strokes):
        frame: str | bytes = _with_values(seq, strokes)
    else:
        frame = _text(type="edit", seq=seq, strokes=strokes)
    if len(frame) > FRAME_BYTES_MAX:
        raise ValueError(f"the edit has {len(frame)} bytes; on a stream it has at most {FRAME_BYTES_MAX}")
    return frame


def regions_changed(*, added: bool, regions: Iterable[Region]) -> str:
    """Return the message that adds regions, or takes them away."""
    return _text(type="subscribe" if added else "unsubscribe", regions=_written(regions))


def _with_values(seq: int, strokes: Sequence[Stroke]) -> bytes:
    values, rest = [], []
    for stroke in strokes:
        found = stroke.get("values")
        if isinstance(found, str):
            found = base64.b64decode(found)
        if isinstance(found, bytes):
            if len(found) % 4:
                raise ValueError(f"the values have {len(found)} bytes: an int32 has 4")
            values.append(found)
        rest.append({name: value for name, value in stroke.items() if name != "values"})
    head = _text(type="edit", seq=seq, strokes=rest).encode()
    return len(head).to_bytes(4, "little") + head + bytes(-len(head) % 4) + b"".join(values)


def _text(**members: Any) -> str:
    return json.dumps(members, separators=(",", ":"), allow_nan=False, default=plain)


def _written(regions: Iterable[Region]) -> list[Mapping[str, Any]]:
    return [region.check().written() for region in regions]


def _revision(found: Json) -> int:
    return found.decimal(0, REVISION_MAX)


def _seq(found: Json) -> int:
    return found.integer(0, SEQ_MAX)


def _welcome(found: Json) -> Welcome:
    last = found.get("last_seq")
    inflight = found["limits"]["inflight"].integer(1, SEQ_MAX)
    seq = None if last is None else _seq(last)
    return Welcome(found["epoch"].text(), _revision(found["revision"]), _revision(found["floor"]), seq, inflight)


def _ack(found: Json) -> Ack:
    stale = found.get("stale")
    ranges = None if stale is None else read_ranges(stale)
    return Ack(_seq(found["seq"]), _revision(found["revision"]), found["duplicate"].boolean(), ranges)


def _nack(found: Json) -> Nack:
    members = found["problem"].members()
    status = found["problem"]["status"].integer(STATUS_MIN, STATUS_MAX)
    return Nack(_seq(found["seq"]), problem(status, members))


def _edits(found: Json) -> Edits:
    some = tuple(_edit(each) for each in found["edits"])
    return Edits(_revision(found["after"]), _revision(found["revision"]), some, read_ranges(found["stale"]))


def _edit(found: Json) -> Edit:
    strokes = found.get("strokes")
    return Edit(_revision(found["revision"]), None if strokes is None else [each.members() for each in strokes])


def _progress(found: Json) -> Progress:
    return Progress(_revision(found["revision"]), found["asked"].integer(0, SEQ_MAX))


def _stale(found: Json) -> Stale:
    return Stale(read_ranges(found["chunks"]), _revision(found["revision"]))


def _resync(found: Json) -> Resync:
    return Resync(_revision(found["floor"]), _revision(found["revision"]), found["epoch"].text())


_READERS: Final[dict[str, Callable[[Json], Message]]] = {
    "welcome": _welcome,
    "ack": _ack,
    "nack": _nack,
    "edits": _edits,
    "progress": _progress,
    "stale": _stale,
    "resync": _resync,
}
