"""What requests for chunks have in common that differ in the chunk's coordinates alone.

A plan is made by a route, from a URL that it has parsed and found good. It then answers for every chunk beside that
one, as long as it `holds`: nothing but the coordinates has to be looked at again.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace
from http import HTTPStatus
from typing import Any, Final, NamedTuple

from chunkserver.grid import LOD_MAX, ChunkKey, check_key
from chunkserver.pipeline import Chunk, ChunkRequest, check_request
from chunkserver.server.etag import tags
from chunkserver.wire import FORMATS, Encoding

VARY: Final = "Accept, Accept-Encoding"
WITHOUT_BODY: Final = Encoding().format
"""The format in which an empty chunk is a 204. In the others it is a file without geometry."""
IDENTITY: Final = Encoding().coding

Headers = tuple[tuple[bytes, bytes], ...]


class Reply(NamedTuple):
    """All of one answer, as ASGI takes it."""

    status: int
    headers: Headers
    body: bytes


@dataclass(frozen=True, slots=True)
class Plan:
    """How all chunks are answered for that a kind of request can name.

    template: a request for one of them.
    tag: returns the entity tag of a chunk, without its quotes; also the cache's key.
    others: its fields behind recipe and key.
    headers: of every answer.
    holds: whether the same request would be answered alike now.
    epoch: of the world, if they are chunks of one.
    lods: how many LODs there are.
    """

    template: ChunkRequest
    others: tuple[Any, ...]
    tag: Callable[[ChunkKey], str]
    headers: Headers
    holds: Callable[[], bool]
    epoch: str
    lods: int

    @classmethod
    def of(
        cls,
        template: ChunkRequest,
        headers: Mapping[str, str],
        holds: Callable[[], bool],
        epoch: str = "",
        lods: int = LOD_MAX + 1,
    ) -> "Plan":
        """Return the plan for chunks like `template`.

        headers: those besides `ETag`, `Vary` and what tells of a body.
        """
        all_headers = {"Vary": VARY, **headers}
        return cls(template, _others(template), tags(template, epoch), _raw(all_headers), holds, epoch, lods)

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

    def request(self, key: ChunkKey) -> ChunkRequest:
        """Return the request for the chunk `key`, which was checked."""
        return ChunkRequest(self.template.recipe, key, *self.others)  # a fifth of what `replace` takes

    def not_modified(self, tag: str) -> Reply:
        """Return the answer to a client that has the bytes named `tag`."""
        return Reply(HTTPStatus.NOT_MODIFIED, ((b"etag", b'"%b"' % tag.encode()), *self.headers), b"")

    def status(self, chunk: Chunk) -> HTTPStatus:
        """Return the status of the answer that is `chunk`."""
        empty = chunk.content != "surface" and self.template.encoding.format == WITHOUT_BODY
        return HTTPStatus.NO_CONTENT if empty else HTTPStatus.OK

    def found(self, tag: str, chunk: Chunk) -> Reply:
        """Return the answer that is `chunk`, whose bytes are named `tag`."""
        told = (
            (b"etag", b'"%b"' % tag.encode()),
            *self.headers,
            (b"chunk-content", chunk.content.encode()),
        )
        if self.status(chunk) == HTTPStatus.NO_CONTENT:
            return Reply(HTTPStatus.NO_CONTENT, told, b"")
        encoding = self.template.encoding
        coding = () if encoding.coding == IDENTITY else ((b"content-encoding", encoding.coding.encode()),)
        length = (b"content-length", b"%d" % len(chunk.body))
        media_type = (b"content-type", FORMATS[encoding.format].media_type.encode())
        return Reply(HTTPStatus.OK, (*told, length, media_type, *coding), chunk.body)


def _others(template: ChunkRequest) -> tuple[Any, ...]:
    first, second, *others = (field.name for field in fields(template))
    assert (first, second) == ("recipe", "key")
    return tuple(getattr(template, name) for name in others)


def _raw(headers: Mapping[str, str]) -> Headers:
    return tuple((name.lower().encode(), value.encode("latin-1")) for name, value in headers.items())
