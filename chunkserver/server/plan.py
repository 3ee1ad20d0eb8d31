"""What requests for chunks have in common that differ in the chunk's coordinates alone.

A plan is made by a route, from a URL that it has parsed and found good. It then answers for every chunk beside that
one, as long as it `holds`: nothing has to be looked at again but the coordinates, and which edit of the chunk is its
last by now.
"""

from collections.abc import Awaitable, Callable, Mapping
from dataclasses import dataclass, fields, replace
from functools import partial
from http import HTTPStatus
from typing import Any, Final, NamedTuple, Protocol

from chunkserver.edits import Bricks
from chunkserver.grid import LOD_MAX, ChunkKey, check_key
from chunkserver.pipeline import Chunk, ChunkRequest, check_request
from chunkserver.server.etag import tags
from chunkserver.wire import FORMATS, Encoding

VARY: Final = "Accept, Accept-Encoding"
_VARY: Final = b"vary", VARY.encode()
WITHOUT_BODY: Final = Encoding().format
"""The format in which an empty chunk is a 204. In the others it is a file without geometry."""
IDENTITY: Final = Encoding().coding

Headers = tuple[tuple[bytes, bytes], ...]
Build = Callable[[Callable[[], None]], Awaitable[Chunk]]
"""Builds one chunk; see `cache.Build`."""
GetBricks = Callable[[ChunkKey, int], Awaitable[tuple[int, Bricks]]]


class Builds(Protocol):
    """What is wanted of a `Pool`."""

    def build(
        self,
        request: ChunkRequest,
        begun: Callable[[], None],
        *,
        urgency: int,
        distance: float,
        bricks: Bricks | None = None,
    ) -> Awaitable[Chunk]:
        """Build one chunk."""


class Version(NamedTuple):
    """A chunk as one of its edits has left it.

    revision: of its own last edit, 0 if it is pristine.
    tag: the entity tag of the answer, without its quotes; also the cache's key.
    """

    key: ChunkKey
    revision: int
    tag: str


class Reply(NamedTuple):
    """All of one answer, as ASGI takes it. version: what it shows; None of a refusal."""

    status: int
    headers: Headers
    body: bytes
    version: Version | None = None


def _never_edited(_: ChunkKey) -> int:
    return 0


def _ageless() -> int:
    return 0


@dataclass(frozen=True, slots=True)
class Plan:
    """How all chunks are answered for that a kind of request can name.

    template: a request for one of them, pristine.
    others: its fields between key and revision.
    tag: returns the entity tag of a chunk at a revision, without its quotes.
    headers: returns those of an answer, given the chunk's revision: besides `ETag` and what tells of a body.
    holds: whether the same request would be answered in this way now.
    age: of what else an answer tells: one made at another age may not be given again as it is.
    last_edit: returns the revision of a chunk's own last edit.
    bricks: returns the bricks for a chunk, as `Editing.bricks` does; None if no chunk is ever edited.
    epoch: of the world, if they are chunks of one.
    lods: how many LODs there are.
    """

    template: ChunkRequest
    others: tuple[Any, ...]
    tag: Callable[[ChunkKey, int], str]
    headers: Callable[[int], Headers]
    holds: Callable[[], bool]
    age: Callable[[], int]
    last_edit: Callable[[ChunkKey], int]
    bricks: GetBricks | None
    epoch: str
    lods: int

    @classmethod
    def of(
        cls,
        template: ChunkRequest,
        headers: Callable[[int], Mapping[str, str]],
        holds: Callable[[], bool],
        age: Callable[[], int] = _ageless,
        last_edit: Callable[[ChunkKey], int] = _never_edited,
        bricks: GetBricks | None = None,
        epoch: str = "",
        lods: int = LOD_MAX + 1,
    ) -> "Plan":
        """Return the plan for chunks like `template`.

        headers: returns those besides `ETag`, `Vary` and what tells of a body.
        """
        told = partial(_raw, headers)
        others, tag = _others(template), tags(template, epoch)
        return cls(template, others, tag, told, holds, age, last_edit, bricks, epoch, lods)

    def fitted(self, coarser: int) -> "Plan":
        """Return the plan for the same chunks with another mask of coarser neighbours.

        Raises `BadParameter` if that is not built.
        """
        template = replace(self.template, coarser=coarser)
        check_request(template)
        return replace(self, template=template, others=_others(template), tag=tags(template, self.epoch))

    def check(self, key: ChunkKey) -> None:
        """Raise `BadKey` if there is no such chunk, `BadParameter` if it cannot have a coarser neighbour."""
        check_key(key, self.template.cells, self.lods, self.template.coarser)

    def current(self, key: ChunkKey) -> Version:
        """Return the chunk `key`, which was checked, as its last edit has left it."""
        revision = self.last_edit(key)
        return Version(key, revision, self.tag(key, revision))

    def is_current(self, version: Version) -> bool:
        """Return whether `current` returns `version` by now."""
        return version.revision == self.last_edit(version.key)

    def shown(self, asked: Version, chunk: Chunk) -> Version:
        """Return the version that `chunk` is, built for `asked`: a later one, if it was edited meanwhile."""
        if chunk.revision == asked.revision:
            return asked
        return Version(asked.key, chunk.revision, self.tag(asked.key, chunk.revision))

    def tag_shown(self, asked: Version, chunk: Chunk) -> str:
        """Return the tag of what `shown` returns."""
        return self.shown(asked, chunk).tag

    def request(self, version: Version) -> ChunkRequest:
        """Return the request for a version of a chunk."""
        template = self.template
        values: tuple[Any, ...] = template.recipe, version.key, *self.others, version.revision, template.encoding
        return ChunkRequest(*values)  # a fifth of what `replace` takes

    def build(self, pool: Builds, version: Version, urgency: int, distance: float = 0.0) -> Build:
        """Return what builds a version of a chunk, or a later one if it is edited meanwhile. See `Pool.build`."""
        if self.bricks is None or not version.revision:
            return partial(pool.build, self.request(version), urgency=urgency, distance=distance)
        return partial(self._build_edited, self.bricks, pool, version, urgency, distance)

    async def _build_edited(
        self,
        bricks: GetBricks,
        pool: Builds,
        version: Version,
        urgency: int,
        distance: float,
        begun: Callable[[], None],
    ) -> Chunk:
        revision, found = await bricks(version.key, version.revision)
        request = self.request(version._replace(revision=revision))
        return await pool.build(request, begun, urgency=urgency, distance=distance, bricks=found)

    def not_modified(self, version: Version) -> Reply:
        """Return the answer to a client that has the bytes of `version`."""
        return Reply(HTTPStatus.NOT_MODIFIED, self._told(version), b"", version)

    def _told(self, version: Version) -> Headers:
        return ((b"etag", b'"%b"' % version.tag.encode()), *self.headers(version.revision))

    def status(self, chunk: Chunk) -> HTTPStatus:
        """Return the status of the answer that is `chunk`."""
        empty = chunk.content != "surface" and self.template.encoding.format == WITHOUT_BODY
        return HTTPStatus.NO_CONTENT if empty else HTTPStatus.OK

    def found(self, asked: Version, chunk: Chunk) -> Reply:
        """Return the answer that is `chunk`, which was found or built for `asked`."""
        version = self.shown(asked, chunk)
        told = (*self._told(version), (b"chunk-content", chunk.content.encode()))
        if self.status(chunk) == HTTPStatus.NO_CONTENT:
            return Reply(HTTPStatus.NO_CONTENT, told, b"", version)
        encoding = self.template.encoding
        coding = () if encoding.coding == IDENTITY else ((b"content-encoding", encoding.coding.encode()),)
        length = (b"content-length", b"%d" % len(chunk.body))
        media_type = (b"content-type", FORMATS[encoding.format].media_type.encode())
        return Reply(HTTPStatus.OK, (*told, length, media_type, *coding), chunk.body, version)


def _others(template: ChunkRequest) -> tuple[Any, ...]:
    recipe, key, *others, revision, encoding = (field.name for field in fields(template))
    assert (recipe, key, revision, encoding) == ("recipe", "key", "revision", "encoding")
    return tuple(getattr(template, name) for name in others)


def _raw(headers: Callable[[int], Mapping[str, str]], revision: int) -> Headers:
    told = headers(revision).items()
    return (_VARY, *((name.lower().encode(), value.encode("latin-1")) for name, value in told))
