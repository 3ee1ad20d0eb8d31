"""What is asked, as requests: which path, which query, which headers and body. docs/api.md has the words."""

import json
import operator
import re
import secrets
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final, Literal, NamedTuple, TypedDict
from urllib.parse import quote, urlencode

import numpy as np

from chunkserver_client import frames
from chunkserver_client.coding import Coding
from chunkserver_client.decoding import GLB_MEDIA_TYPE, MESH_MEDIA_TYPE
from chunkserver_client.descriptors import SeedDescriptor, WorldDescriptor
from chunkserver_client.edits import Stroke
from chunkserver_client.mesh import ChunkKey, Profile
from chunkserver_client.steps import Request

Format = Literal["mesh", "glb"]
Frame = Literal["world", "chunk"]
AnyWorld = SeedDescriptor | WorldDescriptor
Key = ChunkKey | tuple[int, int, int, int]
MaskedKey = tuple[int, int, int, int, int]
"""A key, and the chunk's own mask of coarser neighbours: (lod, x, y, z, coarser)."""
RecipeTree = Mapping[str, Any] | float
"""An expression tree, a number, or a built-in recipe with parameters: `{"builtin": "planet", "radius": 500}`."""

JSON: Final = "application/json"
KEY_BYTES: Final = 16
"""Of an edit's key that nobody has chosen."""
MEDIA_TYPES: Final[dict[Format, str]] = {"mesh": MESH_MEDIA_TYPE, "glb": GLB_MEDIA_TYPE}

_EDIT_KEY: Final = re.compile("[!-~]{1,128}")


class ChunkOptions(TypedDict, total=False):
    """How a chunk is asked for. What is left out is the server's default.

    format: "mesh", the native format (default), or "glb".
    profile: of the native format: "std" (default) or "f32".
    frame: of GLB: "world" (default) or "chunk". It only changes the node; the mesh that is decoded is the same.
    mesher: the surface extractor; the descriptor names those that are built.
    seam: how borders between levels are closed: "transitions" (default), "skirts" or "none".
    coarser: mask of the faces whose neighbour is one LOD coarser: -x 1, +x 2, -y 4, +y 8, -z 16, +z 32.
    min_revision: of a world: wait until it has this revision.
    revision: of a world: one that the caller knows, `world.revision` say. A chunk that had not been edited since is
        then used from the cache without asking, also later.
    urgency: 0 (first) to 7; 3 when left out. Who comes first while requests wait.
    """

    format: Format
    profile: Profile
    frame: Frame
    mesher: str
    seam: str
    coarser: int
    min_revision: int
    revision: int
    urgency: int


def chunk_key(key: Key) -> ChunkKey:
    """Return the key; numpy's integers are fine. Raises `TypeError` for what is no integer."""
    lod, x, y, z = map(operator.index, key)
    return ChunkKey(lod, x, y, z)


class Fitted(NamedTuple):
    """One chunk of a batch. coarser: its mask."""

    key: ChunkKey
    coarser: int

    def row(self) -> list[int]:
        """Return what stands for it in the body of a batch."""
        return [*self.key, self.coarser] if self.coarser else [*self.key]


def fitted(key: Key | MaskedKey, options: ChunkOptions) -> Fitted:
    """Return the chunk of a batch; without a mask of its own it has that of `options`. Raises what `chunk_key` does."""
    lod, x, y, z, *own = map(operator.index, key)
    (coarser,) = own or (options.get("coarser", 0),)
    return Fitted(ChunkKey(lod, x, y, z), coarser)


def chunk_request(world: AnyWorld, key: ChunkKey, options: ChunkOptions, method: str = "GET") -> Request:
    """Return the request for one chunk."""
    form = options.get("format", "mesh")
    path = f"{world.path}/chunks/{key.lod}/{key.x}/{key.y}/{key.z}.{form}"
    headers = {"accept": MEDIA_TYPES[form], **_priority(options)}
    return Request(method, path + _query(world, options), headers, cached=method == "GET")


def batch_request(
    world: AnyWorld,
    chunks: Iterable[Fitted],
    options: ChunkOptions,
    *,
    viewer: Sequence[float] | None,
    known: Sequence[str],
    coding: Coding,
) -> Request:
    """Return the request for a batch. known: entity tags, without quotes."""
    rows = [chunk.row() for chunk in chunks]
    body: dict[str, Any] = {"chunks": rows, "format": options.get("format", "mesh"), "coding": coding}
    if viewer is not None:
        body["viewer"] = [float(voxel) for voxel in viewer]
    if known:
        body["known"] = known
    path = f"{world.path}/chunks{_query(world, options | {'coarser': 0})}"  # each row has its own
    return posted(path, body, {"accept": frames.MEDIA_TYPE, "accept-encoding": "identity", **_priority(options)})


def chunk_asked(world: AnyWorld, url: str) -> ChunkKey | None:
    """Return which chunk of a world is asked for by a URL that `chunk_request` has made; None for any other URL."""
    head = f"{world.path}/chunks/"
    if not url.startswith(head):
        return None
    lod, x, y, z = map(int, url.removeprefix(head).partition(".")[0].split("/"))
    return ChunkKey(lod, x, y, z)


def edit_request(world: WorldDescriptor, strokes: Iterable[Stroke], key: str | None) -> Request:
    """Return the request for an edit. Without a key it gets one, so it can be sent again. Raises `ValueError`."""
    name = secrets.token_hex(KEY_BYTES) if key is None else key
    if not _EDIT_KEY.fullmatch(name):
        raise ValueError(f"key is {name!r}: an edit's key has 1 to 128 visible ASCII characters")
    return posted(f"{world.path}/edits", {"strokes": list(strokes)}, {"idempotency-key": name})


def posted(url: str, body: Any, headers: Mapping[str, str] | None = None) -> Request:
    """Return a POST of JSON; numpy's numbers are fine. Raises `ValueError` for NaN or infinity in it."""
    text = json.dumps(body, allow_nan=False, separators=(",", ":"), default=plain).encode()
    return Request("POST", url, {"accept": JSON, "content-type": JSON, **(headers or {})}, text)


def got(*path: str, query: Mapping[str, str] | None = None, cached: bool = False) -> Request:
    """Return a GET of JSON. path: its parts, which are quoted."""
    url = "/" + "/".join(quote(part, safe="") for part in path)
    return Request("GET", url + (f"?{urlencode(query)}" if query else ""), {"accept": JSON}, cached=cached)


def is_immutable(world: AnyWorld, options: ChunkOptions, revision: int) -> bool:
    """Return whether a chunk of `revision` that came for these options is the same for ever."""
    return world.kind == "seed" or revision <= options.get("revision", -1)


def _query(world: AnyWorld, options: ChunkOptions) -> str:
    """Return the query, with its question mark; the tokens of the descriptor are in it where they promise something."""
    query: dict[str, str | int] = {}
    if world.kind == "seed":
        query |= {"recipe": world.recipe.name, "g": world.generator}
    elif "revision" in options:
        query |= {"revision": options["revision"], "g": world.generator, "epoch": world.epoch}
    for name in ("profile", "frame", "mesher", "seam", "coarser", "min_revision"):
        if name in options and (name, options[name]) != ("coarser", 0):  # one URL for a chunk without a mask
            query[name] = options[name]
    return f"?{urlencode(query)}" if query else ""


def plain(value: object) -> Any:
    """Return Python's numbers for numpy's."""
    if isinstance(value, (np.ndarray, np.generic)):
        return value.tolist()
    raise TypeError(f"{type(value).__name__} is no value of JSON: {value!r}")


def _priority(options: ChunkOptions) -> dict[str, str]:
    return {"priority": f"u={options['urgency']}"} if "urgency" in options else {}
