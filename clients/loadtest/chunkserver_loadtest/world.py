"""The world that is put under load, as its descriptor tells it: which URLs there are, and what an answer must be."""

import http.client
import json
import secrets
import ssl
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import Any, Final
from urllib.parse import parse_qs, quote, urlsplit

from chunkserver_loadtest.errors import BadTarget
from chunkserver_loadtest.exchange import Key, Request
from chunkserver_loadtest.target import Target

DESCRIPTOR_BYTES_MAX: Final = 1 << 20
DESCRIPTOR_SECONDS_MAX: Final = 60.0
"""A server that still compiles answers late."""
NAME_BYTES: Final = 4
TAKEN: Final = (http.HTTPStatus.OK, http.HTTPStatus.CREATED, http.HTTPStatus.NO_CONTENT)


@dataclass(frozen=True)
class World:
    """One world in one format.

    chunk_url: a template with lod, x, y, z and extension. batch_path: where batches are asked for.
    cells: a side of a chunk. voxel_size: metres. low, high: bounds in voxels.
    """

    path: str
    generator: str
    chunk_url: str
    extension: str
    format: str
    media_type: str
    cells: int
    voxel_size: float
    lods: int
    low: tuple[int, int, int]
    high: tuple[int, int, int]

    def has(self, key: Key) -> bool:
        """Tell whether there is such a chunk."""
        lod, *place = key
        side = self.cells << lod
        inside = zip(place, self.low, self.high, strict=True)
        return 0 <= lod < self.lods and all(low <= at * side and (at + 1) * side <= high for at, low, high in inside)

    def request(self, key: Key, kind: str, coding: str, urgency: int | None = None) -> Request:
        """Return the request for a chunk."""
        lod, x, y, z = key
        path = self.chunk_url.format(lod=lod, x=x, y=y, z=z, extension=self.extension)
        return Request(path, kind, (key,), urgency=urgency, coding=coding)

    def batch(self, keys: tuple[Key, ...], viewer: tuple[float, float, float], coding: str, urgency: int) -> Request:
        """Return the request for a batch, seen from `viewer`, in voxels."""
        path, _, query = self.chunk_url.partition("/{lod}")
        query = query.partition("?")[2]
        body = {"chunks": keys, "viewer": [round(at) for at in viewer], "format": self.format, "coding": coding}
        content = json.dumps(body, separators=(",", ":")).encode()
        return Request(f"{path}?{query}" if query else path, "batch", keys, urgency=urgency, body=content)


def world_path(world: str | None, seed: int, recipe: str) -> str:
    """Return the path of the descriptor of a world, or without one of a seed and a recipe."""
    return f"/v1/worlds/{quote(world, safe='')}" if world else f"/v1/seeds/{seed}?recipe={quote(recipe, safe='')}"


def describe(target: Target, path: str, file_format: str, fields: Mapping[str, str]) -> World:
    """Return the world whose descriptor is at `path`, in a format. fields: header fields, for a key.

    Raises BadTarget if there is none, or if it is not as docs/api.md says.
    """
    descriptor = _ask(target, "GET", path, fields)
    try:
        known = {one["name"]: one for one in descriptor["formats"]}
        if file_format not in known:
            raise BadTarget(f"{path} has no format {file_format!r}: there are {', '.join(known)}")
        low, high = (tuple(map(int, descriptor["bounds"][end])) for end in ("min", "max"))
        return World(
            path=path,
            generator=str(descriptor["generator"]),
            chunk_url=str(descriptor["urls"]["chunk"]),
            extension=str(known[file_format]["extension"]),
            format=file_format,
            media_type=str(known[file_format]["media_type"]),
            cells=int(descriptor["chunk_cells"]),
            voxel_size=float(descriptor["voxel_size"]),
            lods=int(descriptor["lods"]),
            low=(low[0], low[1], low[2]),
            high=(high[0], high[1], high[2]),
        )
    except (KeyError, TypeError, ValueError, IndexError) as error:
        raise BadTarget(f"{path} is no descriptor of a world: {error!r}") from None


@contextmanager
def own_world(target: Target, path: str, fields: Mapping[str, str]) -> Iterator[tuple[str, bool]]:
    """Yield the path of a world that may be edited, and whether nobody else knows of it.

    It is the one at `path`, or if that is a seed's a new one of its seed and recipe, which is deleted at the end.
    """
    parts = urlsplit(path)
    prefix, _, seed = parts.path.rpartition("/")
    if prefix != "/v1/seeds":
        yield path, False
        return
    name = f"load-{secrets.token_hex(NAME_BYTES)}"
    content = {"id": name, "seed": seed, "recipe": parse_qs(parts.query)["recipe"][0]}
    _ask(target, "POST", "/v1/worlds", fields, content)
    path = f"/v1/worlds/{name}"
    try:
        yield path, True
    finally:
        with suppress(BadTarget):  # of a server that has gone away more has been said
            _ask(target, "DELETE", path, fields)


def revision(target: Target, path: str, fields: Mapping[str, str]) -> int:
    """Return how many edits a world has taken. Raises BadTarget if it does not say."""
    descriptor = _ask(target, "GET", path, fields)
    try:
        return int(descriptor["revision"])
    except (KeyError, TypeError, ValueError) as error:
        raise BadTarget(f"{path} is no descriptor of a world: {error!r}") from None


def _ask(
    target: Target, method: str, path: str, fields: Mapping[str, str], content: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    """Return what a request is answered with; nothing if that has no body. Raises BadTarget if it is refused."""
    connection = _connection(target)
    body = None if content is None else json.dumps(content)
    headers = {**fields, "Host": target.authority} | ({"Content-Type": "application/json"} if body else {})
    try:
        connection.request(method, path, body, headers)
        answer = connection.getresponse()
        found = answer.read(DESCRIPTOR_BYTES_MAX)
        if answer.status not in TAKEN:
            raise BadTarget(f"{method} {path} is answered with {answer.status}: {found[:300].decode(errors='replace')}")
        answered: dict[str, Any] = json.loads(found or b"{}")
    except (OSError, http.client.HTTPException, ValueError) as error:
        raise BadTarget(f"no answer to {method} {target.authority}{path}: {error}") from None
    finally:
        connection.close()
    return answered


def _connection(target: Target) -> http.client.HTTPConnection:
    if target.tls is None:
        return http.client.HTTPConnection(target.address, target.port, timeout=DESCRIPTOR_SECONDS_MAX)
    return _Named(target.address, target.port, target.name, target.tls)


class _Named(http.client.HTTPSConnection):
    """To an address, under the name that its certificate has."""

    def __init__(self, address: str, port: int, name: str, tls: ssl.SSLContext) -> None:
        super().__init__(address, port, timeout=DESCRIPTOR_SECONDS_MAX, context=tls)
        self._name, self._tls = name, tls

    def connect(self) -> None:
        """Connect, and check the certificate."""
        http.client.HTTPConnection.connect(self)
        self.sock = self._tls.wrap_socket(self.sock, server_hostname=self._name)
