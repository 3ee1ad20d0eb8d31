"""What the edits of a world have made, in named parts, to be kept: bricks, and which edit reached each chunk last.

    part        name                              content
    brick       "B", its key                      lowest and highest delta; the deltas, packed
    revisions   "R", its level and place          last revision of each chunk of a group, packed

All numbers are little-endian, those of names big-endian: sorted by name, neighbours along z are neighbours.
"""

import struct
from collections.abc import Iterable, Iterator, Mapping
from typing import Final, NamedTuple

import numpy as np

from chunkserver.edits.arena import Arena, Brick
from chunkserver.edits.bricks import Bricks
from chunkserver.edits.keys import Key
from chunkserver.edits.packing import packed, unpack
from chunkserver.edits.reached import GROUP_CHUNKS, Group, Reached
from chunkserver.errors import StoreError

_NAME: Final = struct.Struct(">cB3q")
_BRICK: Final = b"B"
_REVISIONS: Final = b"R"
_BOUNDS: Final = struct.Struct("<2i")


class Change(NamedTuple):
    """What edits up to `revision` have changed since another revision; or all that they have made.

    since: that other revision; None for all. revisions: of groups of chunks, as `Reached.get` returns them.
    """

    since: int | None
    revision: int
    bricks: Mapping[Key, Brick | None]
    revisions: Mapping[Group, bytes]

    def parts(self) -> Iterator[tuple[bytes, bytes]]:
        """Yield names and contents of the parts that are new or other ones. May run in any thread."""
        for key, brick in self.bricks.items():
            if brick is not None:
                yield _NAME.pack(_BRICK, *key), _BOUNDS.pack(brick.low, brick.high) + brick.packed
        for group, revisions in self.revisions.items():
            yield _NAME.pack(_REVISIONS, *group), packed(np.frombuffer(revisions, np.int64))

    def gone(self) -> Iterator[bytes]:
        """Yield the names of parts that are there no more."""
        return (_NAME.pack(_BRICK, *key) for key, brick in self.bricks.items() if brick is None)


def restored(parts: Iterable[tuple[bytes, bytes]], revision: int, lods: int, arena: Arena) -> tuple[Bricks, Reached]:
    """Return what all parts of a revision were made of. The bricks take no slots yet.

    Raises `StoreError` for what is no part.
    """
    bricks: dict[Key, Brick] = {}
    reached = Reached()
    for name, content in parts:
        try:
            kind, *place = _NAME.unpack(name)
            key: Key = (place[0], place[1], place[2], place[3])
            if kind == _BRICK:
                low, high = _BOUNDS.unpack_from(content)
                bricks[key] = Brick.kept(arena, low, high, content[_BOUNDS.size :])
                continue
        except struct.error as error:
            raise StoreError(f"what was kept of edits has a part that is none: {error}") from None
        if kind != _REVISIONS:
            raise StoreError(f"what was kept of edits has a part of kind {kind!r}")
        revisions = np.empty(GROUP_CHUNKS, np.int64)
        unpack(content, revisions)
        reached.put(key, revisions.tobytes())
    return Bricks.kept(bricks, revision, lods, arena), reached
