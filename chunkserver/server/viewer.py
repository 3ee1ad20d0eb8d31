"""The viewer at `/`: a page that clients/viewer builds and the package ships, with its scripts and styles.

A file under `/assets` has a digest of its content in its name, so it may be kept for ever; the page names them, and is
asked about each time. Each is read and compressed once, when it is first asked for.
"""

import gzip
from functools import cache
from http import HTTPStatus
from pathlib import Path as FilePath
from typing import Annotated, Final

from fastapi import APIRouter, Path, Request, Response
from fastapi.responses import HTMLResponse
from starlette.exceptions import HTTPException

from chunkserver.errors import BadParameter
from chunkserver.server.accept import preferred_coding
from chunkserver.server.chunks import IMMUTABLE, REVALIDATE
from chunkserver.server.etag import body_etag, is_known
from chunkserver.server.openapi import RESOURCE, Responses, header, problem_responses
from chunkserver.server.parameters import IfNoneMatch

FOLDER: Final = FilePath(__file__).parents[1] / "viewer"
"""What `make viewer` writes."""
GZIP_LEVEL: Final = 9
CODINGS: Final = ("gzip", "identity")
POLICY: Final = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data: blob:; connect-src 'self'; "
    "worker-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'self'"
)
"""What the page may do: run its own scripts, and talk to the server that it came from."""

_PAGE: Final = "index.html"
_ASSETS: Final = {path.name: path for path in sorted(FOLDER.glob("assets/*"))}
_MEDIA_TYPES: Final = {".js": "text/javascript", ".css": "text/css", ".html": "text/html"}
_SECURITY: Final = {
    "Content-Security-Policy": POLICY,
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
}
_HEADERS: Final = {
    "ETag": header("Strong: the same tag means the same bytes.", '^"[0-9a-f]+"$'),
    "Cache-Control": header(f"Of the page `{REVALIDATE}`, of what it names `{IMMUTABLE}`."),
    "Content-Security-Policy": header("What the page may do."),
}
_NOT_MODIFIED: Final[Responses] = {304: {"description": "The client has these bytes.", "headers": _HEADERS}}

router: Final = APIRouter(tags=["operations"])


@router.api_route(
    "/",
    methods=RESOURCE,
    summary="The viewer",
    response_class=HTMLResponse,
    responses={
        200: {"description": "A page for people.", "headers": _HEADERS},
        **_NOT_MODIFIED,
        **problem_responses(BadParameter),
    },
)
async def viewer(request: Request, if_none_match: IfNoneMatch = ()) -> Response:
    """A page that shows worlds, and digs in them."""
    return _answer(FOLDER / _PAGE, request, if_none_match, REVALIDATE)


@router.api_route(
    "/assets/{name}",
    methods=RESOURCE,
    summary="A part of the viewer",
    response_class=Response,
    responses={
        200: {"description": "A script, or a style.", "content": {}, "headers": _HEADERS},
        **_NOT_MODIFIED,
        **problem_responses(404, BadParameter),
    },
)
async def asset(
    request: Request,
    name: Annotated[str, Path(description="As the page has it.")],
    if_none_match: IfNoneMatch = (),
) -> Response:
    """What the page at `/` names. There are other names with another version of it."""
    if name not in _ASSETS:
        raise HTTPException(HTTPStatus.NOT_FOUND)
    return _answer(_ASSETS[name], request, if_none_match, IMMUTABLE)


def _answer(path: FilePath, request: Request, if_none_match: tuple[str, ...], cache_control: str) -> Response:
    coding = preferred_coding(request.headers.getlist("accept-encoding"), CODINGS)
    body, tag = _coded(path, coding)
    headers = {"ETag": f'"{tag}"', "Cache-Control": cache_control, "Vary": "Accept-Encoding", **_SECURITY}
    if is_known(if_none_match, tag):
        return Response(status_code=HTTPStatus.NOT_MODIFIED, headers=headers)
    if coding != CODINGS[-1]:
        headers["Content-Encoding"] = coding
    return Response(body, headers=headers, media_type=_MEDIA_TYPES[path.suffix])


@cache
def _coded(path: FilePath, coding: str) -> tuple[bytes, str]:
    """Return the bytes that are sent of a file, and what names them."""
    plain = path.read_bytes()
    body = gzip.compress(plain, GZIP_LEVEL, mtime=0) if coding == "gzip" else plain
    return body, body_etag(body)
