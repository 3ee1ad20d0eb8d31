"""What all formats share about a mesh: whether it can be written, its index buffer, its component types, its bounds."""

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from chunkserver.errors import WireError
from chunkserver.mesh import Mesh, NormalKind

VERTICES_MAX: Final = 1 << 24
TRIANGLES_MAX: Final = 1 << 25
"""More than ten times what a chunk of 64 cells of white noise has."""
VERTICES_U16_MAX: Final = 65535
"""The most vertices that 16-bit indices are written for. Index 65535, which restarts strips in some graphics
interfaces, then never occurs."""
VERTEX_BYTES_MAX: Final = 24
"""Float32 position and normal."""

assert VERTICES_MAX * VERTEX_BYTES_MAX + TRIANGLES_MAX * 12 < 1 << 31, "file lengths fit 32 bits, signed ones too"

COMPONENT_TYPES: Final = {"int8": 5120, "uint16": 5123, "uint32": 5125, "float32": 5126}
"""By the numbers that OpenGL, WebGL and glTF gave them; the native format uses the same."""

_NORMALS: Final[dict[NormalKind, tuple[int, str]]] = {"int8": (4, "int8"), "float32": (3, "float32")}


def check_mesh(mesh: Mesh, normals: NormalKind) -> None:
    """Raise `WireError` unless `mesh` holds what `Mesh` promises, with `normals` of this kind, within the limits.

    An empty mesh may have normals of either kind: none is written.
    """
    vertices, triangles = len(mesh.positions), len(mesh.triangles)
    if mesh.is_empty:
        if vertices or triangles:
            message = f"a mesh of {mesh.content} has no surface, but {vertices} vertices, {triangles} triangles"
            raise WireError(message, content=mesh.content, vertices=vertices, triangles=triangles)
        return
    if not 0 < vertices <= VERTICES_MAX:
        raise WireError(f"{vertices} vertices; a mesh has 1 to {VERTICES_MAX}", vertices=vertices)
    if not 0 < triangles <= TRIANGLES_MAX:
        raise WireError(f"{triangles} triangles; a mesh has 1 to {TRIANGLES_MAX}", triangles=triangles)
    _check_array("positions", mesh.positions, (vertices, 4), "uint16")
    _check_array("normals", mesh.normals, (vertices, _NORMALS[normals][0]), _NORMALS[normals][1])
    _check_array("triangles", mesh.triangles, (triangles, 3), "uint32")
    if (last := int(mesh.triangles.max())) >= vertices:
        raise WireError(f"a triangle names vertex {last} of {vertices}", index=last, vertices=vertices)


def _check_array(name: str, array: NDArray[Any], shape: tuple[int, int], dtype: str) -> None:
    if array.shape != shape or array.dtype != dtype or not array.flags.c_contiguous:
        found = f"{array.shape} {array.dtype}"
        raise WireError(f"{name} is {found}; wanted is C-ordered {shape} {dtype}", name=name, found=found)


def narrow_indices(mesh: Mesh) -> NDArray[Any]:
    """Return the triangles as (T, 3) little-endian uint16, or uint32 above `VERTICES_U16_MAX` vertices."""
    return mesh.triangles.astype("<u2" if len(mesh.positions) <= VERTICES_U16_MAX else "<u4", copy=False)


def component_type(array: NDArray[Any]) -> int:
    """Return the number of the type of an array's components, one of `COMPONENT_TYPES`."""
    return COMPONENT_TYPES[array.dtype.name]


def bounds(mesh: Mesh) -> tuple[list[int], list[int]]:
    """Return the lowest and the highest x, y, z of the positions, lattice units. The mesh is not empty."""
    columns = np.ascontiguousarray(mesh.positions[:, :3].T)  # long rows: twenty times faster than axis 0 of short ones
    return columns.min(axis=1).tolist(), columns.max(axis=1).tolist()
