"""What the server sends: text frames of JSON, written as bytes."""

import json
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from chunkserver.stream.edit import HEAD_BYTES_MAX, StreamEdit, length
from chunkserver.stream.limits import FRAME_BYTES_MAX, LIMITS
from chunkserver.stream.ranges import Range, written


def welcome(epoch: str, revision: int, floor: int, last_seq: int | None) -> bytes:
    """Return the answer to `hello`."""
    message = {"type": "welcome", "epoch": epoch, "revision": str(revision), "floor": str(floor)}
    return json.dumps({**message, "last_seq": last_seq, "limits": LIMITS}, separators=(",", ":")).encode()


def ack(seq: int, revision: int, ranges: Iterable[Range] | None, *, duplicate: bool) -> bytes:
    """Return the answer to an edit that is durable. ranges: None if it is not known any more what it made stale."""
    told = b"null" if ranges is None else b"[%b]" % b",".join(map(written, ranges))
    again = b"true" if duplicate else b"false"
    return b'{"type":"ack","seq":%d,"revision":"%d","duplicate":%b,"stale":%b}' % (seq, revision, again, told)


def nack(seq: int, problem: Mapping[str, Any]) -> bytes:
    """Return the answer to an edit that is not written. problem: the members of RFC 9457."""
    return json.dumps({"type": "nack", "seq": seq, "problem": problem}, separators=(",", ":")).encode()


def progress(revision: int, asked: int) -> bytes:
    """Return the message that everything up to `revision` was sent. asked: how many requests for regions are obeyed."""
    return b'{"type":"progress","revision":"%d","asked":%d}' % (revision, asked)


def stale(ranges: Iterable[Range], revision: int) -> bytes:
    """Return the message that stands for edits that are not sent."""
    return b'{"type":"stale","chunks":[%b],"revision":"%d"}' % (b",".join(map(written, ranges)), revision)


def resync(floor: int, revision: int, epoch: str) -> bytes:
    """Return the message that edits were missed, and nobody says which."""
    message = {"type": "resync", "floor": str(floor), "revision": str(revision), "epoch": epoch}
    return json.dumps(message, separators=(",", ":")).encode()


def edits(after: int, some: Sequence[StreamEdit], revision: int) -> list[tuple[bytes, int]]:
    """Return the messages of edits that lie in (after, revision], each with the revision that it leads to.

    some: at least one. None of them is divided between two messages, and no message is longer than a frame may be.
    """
    found, parts = [], _parts(some)
    for number, part in enumerate(parts, start=1):
        last = revision if number == len(parts) else part[-1].revision
        pieces = dict.fromkeys(piece for edit in part for piece in edit.pieces)
        head = b'{"type":"edits","after":"%d","revision":"%d","edits":[' % (after, last)
        items = b",".join(edit.item for edit in part)
        found.append((b'%b%b],"stale":[%b]}' % (head, items, b",".join(pieces)), last))
        after = last
    return found


def _parts(some: Sequence[StreamEdit]) -> list[list[StreamEdit]]:
    """Return edits in parts for which a message has room."""
    parts: list[list[StreamEdit]] = [[]]
    room = FRAME_BYTES_MAX - HEAD_BYTES_MAX
    for edit in some:
        weight = len(edit.item) + 1 + length(edit.pieces)
        if weight > room and parts[-1]:
            parts.append([])
            room = FRAME_BYTES_MAX - HEAD_BYTES_MAX
        parts[-1].append(edit)
        room -= weight
    return parts
