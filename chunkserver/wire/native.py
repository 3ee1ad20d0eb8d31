"""The native format, version 1. The specification is docs/wire/native-v1.md; this file is one writer of it.

header, 96 bytes | block table, 16 bytes a block | positions | normals | indices
                                                 ^ each block starts, and the file ends, on 16 bytes
"""

import struct
from collections.abc import Callable
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from chunkserver.grid import POSITION_LOW
from chunkserver.mesh import Content, Mesh
from chunkserver.wire.buffers import bounds, component_type
from chunkserver.wire.encoding import Encoding, Placement

MAGIC: Final = b"CHNK"
VERSION: Final = 1
ALIGNMENT: Final = 16
PROFILE_CODES: Final = {"std": 0, "f32": 1}
CONTENT_CODES: Final[dict[Content, int]] = {"air": 0, "rock": 1, "surface": 2}

POSITIONS, NORMALS, INDICES = 1, 2, 3

HEADER: Final = struct.Struct("<4sHH 3qQd IIf H6B I 6H 12x")
BLOCK: Final = struct.Struct("<4H2I")

assert HEADER.size == 96
assert HEADER.size % ALIGNMENT == 0, "the table starts aligned"
assert BLOCK.size == ALIGNMENT, "the first block starts aligned, however many there are"


class Block(NamedTuple):
    """One planar array of the file, C order, little-endian: `components` of its `values` in a row are one element."""

    kind: int
    components: int
    values: NDArray[Any]


def encode(mesh: Mesh, placement: Placement, encoding: Encoding) -> bytes:
    """Return `mesh` in the native format. An empty mesh gives a header without blocks."""
    blocks = [] if mesh.is_empty else _BLOCKS[encoding.profile](mesh, placement)
    offset = HEADER.size + BLOCK.size * len(blocks)
    entries: list[bytes] = []
    body: list[Any] = []
    for kind, components, values in blocks:
        length, stride = values.nbytes, components * values.itemsize
        entries.append(BLOCK.pack(kind, component_type(values), components, stride, offset, length))
        padding = -length % ALIGNMENT
        body += values.data, bytes(padding)
        offset += length + padding
    return b"".join([_header(mesh, placement, encoding, blocks, offset), *entries, *body])


def _header(mesh: Mesh, placement: Placement, encoding: Encoding, blocks: list[Block], file_bytes: int) -> bytes:
    low, high = ([0, 0, 0], [0, 0, 0]) if mesh.is_empty else bounds(mesh)
    return HEADER.pack(
        MAGIC,
        VERSION,
        HEADER.size,
        *placement.key[1:],
        placement.revision,
        placement.voxel_size,
        len(mesh.positions),
        3 * len(mesh.triangles),
        placement.geometric_error,
        placement.cells,
        placement.key.lod,
        PROFILE_CODES[encoding.profile],
        placement.coarser,
        CONTENT_CODES[mesh.content],
        blocks[-1].values.itemsize if blocks else 0,
        len(blocks),
        file_bytes,
        *low,
        *high,
    )


def _blocks_std(mesh: Mesh, _placement: Placement) -> list[Block]:
    return [Block(POSITIONS, 4, mesh.positions), Block(NORMALS, 4, mesh.normals), Block(INDICES, 1, mesh.triangles)]


def _blocks_f32(mesh: Mesh, placement: Placement) -> list[Block]:
    """One rounding to float32, of a float64 product that is itself exact when `voxel_size` is a power of two."""
    metres = np.subtract(mesh.positions[:, :3], POSITION_LOW, dtype=np.float64) * placement.unit
    return [
        Block(POSITIONS, 3, metres.astype(np.float32, order="C")),
        Block(NORMALS, 3, mesh.normals),
        Block(INDICES, 1, mesh.triangles.astype(np.uint32, copy=False)),
    ]


_BLOCKS: Final[dict[str, Callable[[Mesh, Placement], list[Block]]]] = {"std": _blocks_std, "f32": _blocks_f32}
"""By profile. The indices come last."""
