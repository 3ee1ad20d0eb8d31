"""The table of formats. A new format is one file and one row here."""

from collections.abc import Callable
from functools import lru_cache
from typing import Final, NamedTuple

from chunkserver.errors import BadParameter
from chunkserver.mesh import Mesh
from chunkserver.wire import gltf, native
from chunkserver.wire.buffers import check_mesh
from chunkserver.wire.coding import CODINGS
from chunkserver.wire.encoding import Encoding, Placement, check_placement
from chunkserver.wire.reading import Findings, examine_gltf, examine_native


class Format(NamedTuple):
    """One way to write a mesh.

    extension: what a URL or a file name ends in, with its dot.
    profiles, frames: the values of `Encoding` that are built; only the default where the field does not apply.
    encode: bytes of a mesh, a placement and an encoding that were checked.
    magic: what every file of it begins with.
    examine: what is in a file that begins so, and what is wrong with it. Raises nothing for what is in it.
    """

    name: str
    extension: str
    media_type: str
    profiles: tuple[str, ...]
    frames: tuple[str, ...]
    encode: Callable[[Mesh, Placement, Encoding], bytes]
    magic: bytes
    examine: Callable[[bytes], Findings]


_ROWS: Final = (
    Format(
        *("mesh", ".mesh", "application/vnd.chunkserver.mesh", tuple(native.PROFILE_CODES), ("world",)),
        *(native.encode, native.MAGIC, examine_native),
    ),
    Format(
        *("glb", ".glb", "model/gltf-binary", ("std",), ("world", "chunk")),
        *(gltf.encode, gltf.MAGIC, examine_gltf),
    ),
)
FORMATS: Final = {row.name: row for row in _ROWS}

ENCODING_DEFAULT: Final = Encoding()
ENCODINGS_KEPT_MAX: Final = 64
"""Encodings that are known to be built: more than there are."""

assert all(ENCODING_DEFAULT.profile in row.profiles and ENCODING_DEFAULT.frame in row.frames for row in _ROWS)


def check_encodable(placement: Placement, encoding: Encoding) -> None:
    """Raise `BadKey` or `BadParameter` that names the value, unless `encode` can write a mesh so, at this place."""
    check_placement(placement)
    _check_encoding(encoding)


@lru_cache(maxsize=ENCODINGS_KEPT_MAX)
def _check_encoding(encoding: Encoding) -> None:
    if encoding.format not in FORMATS:
        raise BadParameter(f"format is {encoding.format!r}; built are {list(FORMATS)}", format=encoding.format)
    if encoding.coding not in CODINGS:
        raise BadParameter(f"coding is {encoding.coding!r}; built are {list(CODINGS)}", coding=encoding.coding)
    row = FORMATS[encoding.format]
    for field, value, built in (("profile", encoding.profile, row.profiles), ("frame", encoding.frame, row.frames)):
        if value not in built:
            message = f"{field} is {value!r}; built for format {row.name!r} are {list(built)}"
            raise BadParameter(message, **{field: value, "format": row.name})


def encode(
    mesh: Mesh, placement: Placement, encoding: Encoding = ENCODING_DEFAULT, *, is_checked: bool = False
) -> bytes:
    """Return the bytes of `mesh` in the format, profile and frame of `encoding`, coded as it says.

    The same input gives the same bytes: without a coding on any machine, with one wherever the coding has the same
    `version`. An empty mesh is no error: it gives a valid file without geometry.

    is_checked: place and encoding have passed `check_encodable`, and the mesh is our own mesher's: neither is looked at
        again.

    Raises `WireError` for a mesh that the format cannot hold (wrong dtypes for the profile, an index without its
    vertex, too many vertices), and what `check_encodable` raises.
    """
    if not is_checked:
        check_encodable(placement, encoding)
        check_mesh(mesh, encoding.normals)
    file = FORMATS[encoding.format].encode(mesh, placement, encoding)
    return CODINGS[encoding.coding].apply(file)
