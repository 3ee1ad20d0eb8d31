"""From the answer to a request for a chunk to its mesh."""

from collections.abc import Mapping

from chunkserver_client.decoding import decode
from chunkserver_client.descriptors import ChunkHead
from chunkserver_client.errors import BadAnswer, BadChunk
from chunkserver_client.exchange import checked
from chunkserver_client.mesh import REVISION_MAX, ChunkMesh, Content, Place, empty_mesh
from chunkserver_client.steps import Answer

NUMBER_DIGITS_MAX = 20


def mesh_of(answer: Answer, place: Place) -> ChunkMesh:
    """Return the mesh of an answer; a 204 is an empty one. Raises `Problem`, and `BadAnswer` for another chunk's."""
    if checked(answer, 200, 204).status == 204:
        return empty_mesh(place, _empty(answer), number_of(answer.headers, "chunk-revision"))
    mesh = decode(answer.content, answer.headers.get("content-type", ""))
    if mesh.place != place:
        raise BadChunk(f"it is {mesh.place}: asked for was {place}")
    return mesh


def head_of_chunk(answer: Answer) -> ChunkHead:
    """Return what an answer to HEAD says."""
    headers = checked(answer, 200, 204).headers
    return ChunkHead(
        headers.get("etag", "").strip('"'),
        headers.get("chunk-content", ""),
        number_of(headers, "content-length"),
        number_of(headers, "chunk-revision"),
    )


def number_of(headers: Mapping[str, str], name: str) -> int:
    """Return the number that a header has; 0 if it is not there. Raises `BadAnswer` for what is no number."""
    text = headers.get(name, "0")
    if not (text.isascii() and text.isdecimal() and len(text) <= NUMBER_DIGITS_MAX and int(text) <= REVISION_MAX):
        raise BadAnswer(f"{name} is {text[:NUMBER_DIGITS_MAX]!r}: a number below 2^63")
    return int(text)


def _empty(answer: Answer) -> Content:
    content = answer.headers.get("chunk-content", "")
    if content == "air":
        return "air"
    if content == "rock":
        return "rock"
    raise BadAnswer(f"an empty chunk is {content[:NUMBER_DIGITS_MAX]!r}: air or rock")
