"""What an answer must be: not its status alone, but the chunk that was asked for, whole, and the same each time."""

import bisect
import random
import sys
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

from chunkserver_client import BadChunk, decode
from chunkserver_loadtest.exchange import Answer, Exchange, Key, Request
from chunkserver_loadtest.frames import BadFrames, Frame, frames
from chunkserver_loadtest.world import World

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

KINDS: Final = {
    "no-connection": "a connection could not be opened for it",
    "closed": "the connection ended before the answer began",
    "cut": "the connection ended in the middle of the answer",
    "timeout": "the answer was not complete in time",
    "malformed-http": "what came is not HTTP",
    "extra-bytes": "more bytes came than the answer says that it has",
    "too-large": "the answer is larger than any can be",
    "refused": "503 or 429, with Retry-After and a problem",
    "bad-refusal": "503 or 429 without Retry-After, or without a problem",
    "wrong-status": "another status than 200, 204 and 304, or one that this answer cannot have",
    "uninvited-304": "304, but no tag was sent",
    "no-tag": "no strong entity tag",
    "other-tag": "another entity tag than the same URL had before, or than was sent",
    "other-bytes": "other bytes than before, under the same entity tag",
    "wrong-type": "another media type than was asked for",
    "bad-coding": "a content coding that was not asked for, or that cannot be undone",
    "bad-chunk": "the body is no chunk: truncated, mutated, of another version",
    "other-chunk": "the body is another chunk than the one that was asked for",
    "wrong-header": "Chunk-Content or Chunk-Revision do not fit the body",
    "bad-batch": "the stream of a batch is malformed, cut, or lacks chunks",
    "nack": "an edit was refused",
    "no-welcome": "a peer of a storm did not come back, or was refused for good",
    "peer-lost": "the server ended a connection of a peer that reads",
    "malformed-message": "what came on a stream is no message",
    "disordered": "a subscriber was told edits twice, out of order, or with a gap",
    "edit-missed": "a subscriber was told of later edits, and never of this one",
    "edit-late": "a subscriber was not told of an edit in time, nor of later ones",
    "edit-strange": "a subscriber was told of an edit that nobody was answered for",
    "edit-changed": "an edit was told otherwise than it was sent",
    "edit-doubled": "the world has more edits than were sent",
    "edit-lost": "the world has fewer edits than were acknowledged",
}
"""Every kind of failure, and what it means."""

REFUSALS: Final = (429, 503)
EMPTY: Final = ("air", "rock")
KNOWN_MAX: Final = 65_536
"""URLs whose first answer is remembered. Of those beyond, every answer is looked at in full, as a first one."""
CHUNK_BYTES_MAX: Final = 1 << 26
"""Of a file, its coding undone."""


class Fault(Exception):
    """What is wrong with an answer. kind: one of KINDS."""

    def __init__(self, kind: str, detail: str) -> None:
        super().__init__(kind, detail)
        self.kind = kind
        self.detail = detail


@dataclass(frozen=True, slots=True)
class _First:
    """What the first answer of a URL was."""

    tag: str
    status: int
    digest: int


@dataclass(frozen=True, slots=True)
class Part:
    """A chunk of a batch: its status, and when it had come."""

    status: str
    arrived: float


class Checker:
    """Looks at answers. The first of each URL is decoded; of later ones a share is compared with it, by digest.

    share: of the answers after the first whose bodies are looked at; their heads always are.
    decoded, compared: how many bodies were looked at.
    """

    def __init__(self, world: World, share: float = 1.0, seed: int = 0) -> None:
        self.decoded = 0
        self.compared = 0
        self._world = world
        self._share = share
        self._random = random.Random(seed)
        self._known: dict[tuple[str, str], _First] = {}

    def check(self, request: Request, answer: Answer) -> None:
        """Raise Fault if this is not the chunk that was asked for."""
        if answer.status in REFUSALS:
            raise _refusal(answer)
        tag = answer.text(b"etag")
        if answer.status == 304:
            _check_304(request, tag)
            return
        if answer.status not in (200, 204):
            raise Fault("wrong-status", f"{answer.status}: {answer.body[:200]!r}")
        if not (tag.startswith('"') and tag.endswith('"') and len(tag) > 2):
            raise Fault("no-tag", f"{answer.status} with the entity tag {tag!r}")
        coding = answer.text(b"content-encoding")
        if coding and coding != request.coding:
            raise Fault("bad-coding", f"{coding}, asked for {request.coding or 'none'}")
        first = self._known.get((request.path, request.coding))
        if first is None:
            self._check_first(request, answer, coding)
            if len(self._known) < KNOWN_MAX:
                self._known[request.path, request.coding] = _First(tag, answer.status, hash(answer.body))
        else:
            self._check_again(first, answer, tag)

    def check_batch(self, exchange: Exchange) -> Iterator[Part]:
        """Yield each chunk of a batch that is one of those asked for. Raises Fault at the first that is not."""
        request, answer = exchange.request, exchange.answer
        assert answer is not None
        if answer.status in REFUSALS:
            raise _refusal(answer)
        if answer.status != 200:
            raise Fault("wrong-status", f"{answer.status}: {answer.body[:200]!r}")
        missing, arrivals = set(range(len(request.keys))), exchange.arrivals
        try:
            for frame in frames(answer.body):
                if frame.number not in missing:
                    raise Fault("bad-batch", f"the frame of chunk {frame.number} was not asked for, or comes again")
                missing.discard(frame.number)
                yield Part(str(frame.status), arrivals[bisect.bisect_left(arrivals, (frame.ends,))][1])
                self._check_frame(request.keys[frame.number], frame)
        except BadFrames as error:
            raise Fault("bad-batch", str(error)) from None
        if missing:
            raise Fault("bad-batch", f"{len(missing)} of {len(request.keys)} chunks did not come")

    def _check_frame(self, key: Key, frame: Frame) -> None:
        if frame.status in REFUSALS:
            raise Fault("refused", f"{key} in a batch: {frame.body[:200]!r}")
        if frame.status not in (200, 204):
            raise Fault("wrong-status", f"{frame.status} for {key} in a batch: {frame.body[:200]!r}")
        if not frame.etag:
            raise Fault("no-tag", f"{key} in a batch")
        self._check_file(key, frame.status, frame.body, frame.coding, frame.content, str(frame.revision))

    def _check_first(self, request: Request, answer: Answer, coding: str) -> None:
        media_type = answer.text(b"content-type")
        if answer.status == 200 and media_type != self._world.media_type:
            raise Fault("wrong-type", f"{media_type!r}, not {self._world.media_type}")
        content, revision = answer.text(b"chunk-content"), answer.text(b"chunk-revision")
        self._check_file(request.keys[0], answer.status, answer.body, coding, content, revision)

    def _check_file(self, key: Key, status: int, body: bytes, coding: str, content: str, revision: str) -> None:
        """Check one chunk's file. content, revision: as a header says; no revision is no statement."""
        world = self._world
        if status == 204:
            if content not in EMPTY:
                raise Fault("wrong-header", f"204 with Chunk-Content {content!r}")
            return
        self.decoded += 1
        try:
            mesh = decode(_plain(body, coding), world.media_type)
        except BadChunk as error:
            raise Fault("bad-chunk", str(error)) from None
        if (tuple(mesh.key), mesh.cells, mesh.voxel_size) != (key, world.cells, world.voxel_size):
            raise Fault("other-chunk", f"{mesh.key} of {mesh.cells} cells of {mesh.voxel_size} m, not {key}")
        if mesh.content != content:
            raise Fault("wrong-header", f"Chunk-Content {content!r}, but the file says {mesh.content!r}")
        if revision and revision != str(mesh.revision):
            raise Fault("wrong-header", f"Chunk-Revision {revision}, but the file says {mesh.revision}")

    def _check_again(self, first: _First, answer: Answer, tag: str) -> None:
        if tag != first.tag:
            raise Fault("other-tag", f"{tag}, before {first.tag}")
        if answer.status != first.status:
            raise Fault("wrong-status", f"{answer.status}, before {first.status}, with the same tag {tag}")
        if self._share >= 1.0 or self._random.random() < self._share:
            self.compared += 1
            if hash(answer.body) != first.digest:
                raise Fault("other-bytes", f"{len(answer.body)} bytes with the tag {tag}")


def _check_304(request: Request, tag: str) -> None:
    if not request.etag:
        raise Fault("uninvited-304", f"304 with the tag {tag}")
    if tag != request.etag:
        raise Fault("other-tag", f"304 with the tag {tag}, asked with {request.etag}")


def _refusal(answer: Answer) -> Fault:
    is_problem = answer.text(b"content-type").startswith("application/problem+json")
    well = is_problem and answer.text(b"retry-after")
    return Fault("refused" if well else "bad-refusal", f"{answer.status}: {answer.body[:200]!r}")


def _plain(body: bytes, coding: str) -> bytes:
    """Return the bytes without their content coding. Raises Fault if it is cut or another one, or they are too many."""
    if coding not in ("gzip", "zstd"):
        return body
    undoing = zlib.decompressobj(wbits=31) if coding == "gzip" else zstd.ZstdDecompressor()
    try:
        content = undoing.decompress(body, CHUNK_BYTES_MAX + 1)
    except (zlib.error, zstd.ZstdError, EOFError) as error:
        raise Fault("bad-coding", f"{coding}: {error}") from None
    if len(content) > CHUNK_BYTES_MAX:
        raise Fault("too-large", f"more than {CHUNK_BYTES_MAX} bytes, its coding undone")
    if not undoing.eof or undoing.unused_data:
        raise Fault(
            "bad-coding", f"{coding}: {len(body)} bytes are {'more than' if undoing.eof else 'a part of'} a file"
        )
    return content
