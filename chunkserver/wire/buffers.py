"""What all formats share about a mesh: whether it can be written, its component types, its bounds."""

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from chunkserver.errors import WireError
from chunkserver.kernel import kernel
from chunkserver.mesh import Mesh, NormalKind, index_type

VERTICES_MAX: Final = 1 << 24
TRIANGLES_MAX: Final = 1 << 25
"""More than ten times what a chunk of 64 cells of white noise has."""
VERTEX_BYTES_MAX: Final = 24
"""Float32 position and normal."""

assert VERTICES_MAX * VERTEX_BYTES_MAX + TRIANGLES_MAX * 12 < 1 << 31, "file lengths fit 32 bits, signed ones too"

COMPONENT_TYPES: Final = {"int8": 5120, "uint16": 5123, "uint32": 5125, "float32": 5126}
"""By the numbers that OpenGL, WebGL and glTF gave them; the native format uses the same."""

_COMPONENT_TYPES: Final = {np.dtype(name): number for name, number in COMPONENT_TYPES.items()}
_POSITIONS: Final = np.dtype(np.uint16)
_NORMALS: Final[dict[NormalKind, tuple[int, np.dtype[Any]]]] = {
    "int8": (4, np.dtype(np.int8)),
    "float32": (3, np.dtype(np.float32)),
}


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
    _check_array("positions", mesh.positions, (vertices, 4), _POSITIONS)
    _check_array("normals", mesh.normals, (vertices, _NORMALS[normals][0]), _NORMALS[normals][1])
    _check_array("triangles", mesh.triangles, (triangles, 3), np.dtype(index_type(vertices)))
    if (last := int(np.maximum.reduce(mesh.triangles, axis=None))) >= vertices:
        raise WireError(f"a triangle names vertex {last} of {vertices}", index=last, vertices=vertices)


def _check_array(name: str, array: NDArray[Any], shape: tuple[int, int], dtype: np.dtype[Any]) -> None:
    if array.shape != shape or array.dtype != dtype or not array.flags.c_contiguous:
        found = f"{array.shape} {array.dtype}"
        raise WireError(f"{name} is {found}; wanted is C-ordered {shape} {dtype}", name=name, found=found)


def component_type(array: NDArray[Any]) -> int:
    """Return the number of the type of an array's components, one of `COMPONENT_TYPES`."""
    return _COMPONENT_TYPES[array.dtype]


def bounds(mesh: Mesh) -> tuple[list[int], list[int]]:
    """Return the lowest and the highest x, y, z of the positions, lattice units. The mesh is not empty."""
    found = np.empty((2, 3), np.uint16)
    measure(mesh.positions.view(np.uint64), found)
    low, high = found.tolist()
    return low, high


@kernel
def measure(positions: NDArray[np.uint64], found: NDArray[np.uint16]) -> None:
    """Write the lowest and the highest x, y, z. positions: (V, 1), V > 0, each x, y, z, w in one. found: (2, 3) out.

    In one pass over whole vertices: NumPy wants one for each end, and a copy by axes, for it is slow along short rows.
    A vertex is read as one number, so that some are worked on at a time.
    """
    most = np.uint32(65535)
    low_x = low_y = low_z = most
    high_x = high_y = high_z = np.uint32(0)
    for vertex in range(np.uint64(positions.shape[0])):
        first, second = np.uint32(positions[vertex, 0]), np.uint32(positions[vertex, 0] >> np.uint64(32))
        x, y, z = first & most, first >> np.uint32(16), second & most
        low_x, low_y, low_z = min(low_x, x), min(low_y, y), min(low_z, z)
        high_x, high_y, high_z = max(high_x, x), max(high_y, y), max(high_z, z)
    found[0, 0], found[0, 1], found[0, 2] = low_x, low_y, low_z
    found[1, 0], found[1, 1], found[1, 2] = high_x, high_y, high_z
