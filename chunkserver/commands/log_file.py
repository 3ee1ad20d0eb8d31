"""A world and the log of its edits as one file, a JSON object a line: docs/edits/log-file.md.

    {"chunkserver_log": 1, ...}                 what the world is
    {"part": ..., "content": ...}               of its foundation, if it has one
    {"revision": ..., "strokes": [...], ...}    an edit
    {"end": ...}                                how many there were, and the digest of all lines before

What is read is not believed before the end was.
"""

import base64
import hashlib
import json
import math
from collections.abc import Callable, Iterator
from typing import Any, Final, NamedTuple, NoReturn

from chunkserver.edits import Edit
from chunkserver.errors import BadParameter, BadRequest
from chunkserver.grid import LATTICE_MAX
from chunkserver.recipe import WorldRecipe, canonical
from chunkserver.world import World

VERSION: Final = 1
LINE_BYTES_MAX: Final = 17 << 20
"""The largest edit that a log has, and its names."""
CHUNKS_MAX: Final = 1 << 22
"""That one edit has made stale: more than it can."""
DIGEST_BYTES: Final = 16
REVISION_MAX: Final = (1 << 53) - 1
SEED_MAX: Final = 1 << 63
SHOWN_MAX: Final = 80
"""Characters of a value that an error names."""

Part = tuple[bytes, bytes]
"""Of a foundation: its name and its content."""

_WORLD: Final[dict[str, type]] = {
    "id": str,
    "seed": str,
    "recipe": dict,
    "recipe_name": str,
    "voxel_size": float,
    "lods": int,
    "chunk_cells": int,
    "generator": str,
    "created": str,
}


class Header(NamedTuple):
    """What the first line says.

    world: with the generator, the epoch and the revision that it had.
    foundation: the revision that the parts stand for, behind which the edits begin. 0: there is none.
    migrated: up to which revision edits were made in another generator's terrain, and told what was stale there.
    """

    world: World
    foundation: int
    migrated: int = 0


class Line(NamedTuple):
    """An edit. strokes: its source. stale: what it made stale, as JSON. sender: client and seq, or nothing."""

    revision: int
    strokes: bytes
    stale: bytes
    sender: tuple[str, int] | None = None


class LogWriter:
    """Writes such a file, with `write`. Every part comes before every edit."""

    def __init__(self, header: Header, write: Callable[[bytes], object]) -> None:
        self._write = write
        self._digest = hashlib.blake2b(digest_size=DIGEST_BYTES)
        self.parts = self.edits = 0
        world = header.world
        described = {
            **{name: getattr(world, name) for name in _WORLD if name not in ("seed", "recipe")},
            "seed": str(world.recipe.seed),
            "recipe": json.loads(world.recipe.source),
        }
        revisions = {"revision": world.revision, "foundation": header.foundation, "migrated": header.migrated}
        state = {name: str(revision) for name, revision in revisions.items()}
        self._line(_json({"chunkserver_log": VERSION, "world": described, "epoch": world.epoch, **state}))

    def part(self, part: Part) -> None:
        """Write a part of the foundation."""
        name, content = (base64.b64encode(piece).decode() for piece in part)
        self._line(_json({"part": name, "content": content}))
        self.parts += 1

    def edit(self, line: Line) -> None:
        """Write an edit: what is JSON already, as it stands."""
        sender = b""
        if line.sender is not None:
            sender = b'"client":%b,"seq":%d,' % (_json(line.sender[0]), line.sender[1])
        self._line(b'{"revision":"%d",%b"strokes":%b,"stale":%b}' % (line.revision, sender, line.strokes, line.stale))
        self.edits += 1

    def end(self) -> None:
        """Write the last line."""
        found = {"parts": self.parts, "edits": self.edits, "digest": self._digest.hexdigest()}
        self._line(_json({"end": found}))

    def _line(self, text: bytes) -> None:
        line = text + b"\n"
        self._digest.update(line)
        self._write(line)


class LogReader:
    """Reads such a file: `header`, then all `parts()`, then all `edits()`, and then it was whole.

    name: of the file, for errors. lines: numbered. Each of the three raises `BadParameter` that names the line.
    """

    def __init__(self, name: str, lines: Iterator[tuple[int, bytes]]) -> None:
        self._name, self._lines = name, lines
        self._digest = hashlib.blake2b(digest_size=DIGEST_BYTES)
        self._before = self._digest.hexdigest()
        self._number = 0
        self._parts = self._edits = 0
        self._next: dict[str, Any] = {}
        self._advance()
        try:
            self.header = _header(self._next)
        except (BadRequest, ValueError, KeyError, TypeError, RecursionError) as error:
            said = error.message if isinstance(error, BadRequest) else f"{type(error).__name__} {error}"
            self._refuse(f"this is no world of a log: {said}")
        self._advance()

    def parts(self) -> Iterator[Part]:
        """Yield the parts of the foundation."""
        while "part" in self._next:
            try:
                part = (base64.b64decode(self._next[name], validate=True) for name in ("part", "content"))
                name, content = part
            except (ValueError, KeyError, TypeError) as error:
                self._refuse(f"this is no part of a foundation: {error}")
            yield name, content
            self._parts += 1
            self._advance()
        if bool(self._parts) is not bool(self.header.foundation):
            self._refuse(f"the foundation is {self.header.foundation}, and {self._parts} parts are before this")

    def edits(self) -> Iterator[tuple[Edit, bytes]]:
        """Yield the edits in their order, each with what it made stale, as JSON."""
        revision = self.header.foundation
        while "end" not in self._next:
            revision += 1
            if self._next.get("revision") != str(revision):
                self._refuse(f"revision is {self._shown('revision')}; the next one is {revision}")
            try:
                edit = Edit.of(self._next.get("strokes"))
            except BadRequest as error:
                self._refuse(error.message)
            yield edit, self._stale()
            self._edits += 1
            self._advance()
        found = {"parts": self._parts, "edits": self._edits, "digest": self._before}
        if self._next != {"end": found} or revision != self.header.world.revision:
            self._refuse(f"the file is not what was written: up to here it has {found}, revision {revision}")
        for number, _ in self._lines:
            self._number = number
            self._refuse("the file goes on behind its end")

    def _stale(self) -> bytes:
        """Return the chunks that an edit made stale, when they can be some."""
        found, lods = self._next.get("stale"), self.header.world.lods
        if not isinstance(found, list) or sum(_chunks(each, lods) for each in found) > CHUNKS_MAX:
            self._refuse(f"stale is {self._shown('stale')}, which no edit makes stale")
        return _json(found)

    def _advance(self) -> None:
        """Read the next line."""
        self._before = self._digest.hexdigest()
        self._number, text = next(self._lines, (self._number + 1, b""))
        self._digest.update(text)
        try:
            found = json.loads(text)
        except (ValueError, RecursionError):
            found = None
        if not isinstance(found, dict):
            self._refuse("the file ends before its end" if not text.endswith(b"\n") else "this is no JSON object")
        self._next = found

    def _shown(self, name: str) -> str:
        return repr(self._next.get(name))[:SHOWN_MAX]

    def _refuse(self, why: str) -> NoReturn:
        raise BadParameter(f"{self._name}, line {self._number}: {why}")


def _header(line: dict[str, Any]) -> Header:
    """Return what the first line says. Raises `BadRequest`, ValueError, KeyError or TypeError."""
    if line.get("chunkserver_log") != VERSION:
        raise ValueError(f"chunkserver_log is {line.get('chunkserver_log')!r}; this version reads {VERSION}")
    told = line["world"]
    for name, kind in _WORLD.items():
        if type(told[name]) is not kind and not (kind is float and type(told[name]) is int):
            raise TypeError(f"{name} is {told[name]!r}"[:SHOWN_MAX])
    recipe = WorldRecipe(_decimal(told["seed"], SEED_MAX), canonical(told["recipe"]))
    named = {name: told[name] for name in ("id", "recipe_name", "lods", "chunk_cells", "generator", "created")}
    revision, foundation = (_decimal(line[name], REVISION_MAX) for name in ("revision", "foundation"))
    migrated = _decimal(line.get("migrated", "0"), REVISION_MAX)
    if not (0 <= foundation <= revision and 0 <= migrated <= revision):
        raise ValueError(f"foundation is {foundation}, migrated {migrated}, and revision {revision}")
    size, epoch = float(told["voxel_size"]), str(line["epoch"])
    world = World(recipe=recipe, voxel_size=size, epoch=epoch, revision=revision, **named)
    return Header(world, foundation, migrated)


def _decimal(text: object, highest: int) -> int:
    if not isinstance(text, str) or len(text) > len(str(highest)) + 1 or str(int(text)) != text:
        raise ValueError(f"{str(text)[:SHOWN_MAX]!r} is no decimal number up to {highest}")
    return int(text)


def _chunks(each: object, lods: int) -> int:
    """Return how many chunks a range has; more than there may be, if it is none."""
    try:
        lod, low, high = each["lod"], each["min"], each["max"]  # type: ignore[index]
        sides = [last - first + 1 for first, last in zip(low, high, strict=True)]
        known = lod in range(lods) and len(sides) == 3 and min(sides) > 0
        known = known and all(type(at) is int and abs(at) <= LATTICE_MAX for at in (lod, *low, *high))
        return math.prod(sides) if known else CHUNKS_MAX + 1
    except (KeyError, TypeError, ValueError):
        return CHUNKS_MAX + 1


def _json(value: object) -> bytes:
    return json.dumps(value, separators=(",", ":"), allow_nan=False).encode()
