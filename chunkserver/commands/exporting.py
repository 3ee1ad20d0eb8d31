"""A welded box of chunks as the bytes of a file, through trimesh. Takes seconds to import: loaded when it is needed."""

import math
from collections.abc import Callable
from typing import Any, Final, NamedTuple

import numpy as np
import trimesh
from numpy.typing import NDArray

from chunkserver.commands.welding import Welded

OBJ_HEADER: Final = "written by chunkserver"
DIGITS_MIN: Final = 6
"""Decimals of an OBJ, at least: what a float32 normal has."""


class Placed(NamedTuple):
    """Where a box is, and where its file's origin shall be.

    unit: metres per lattice unit. corner: of the box, metres. in_world: whether positions count from the world's
    origin; else from the box's corner.
    """

    unit: float
    corner: tuple[float, float, float]
    in_world: bool


class Exported(NamedTuple):
    """The bytes of a file, and by how many metres its positions are off at most, through the numbers of its format."""

    body: bytes
    error: float


def export(welded: Welded, placed: Placed, form: str) -> Exported:
    """Return the bytes of a box of chunks. form: "glb", "ply", "obj" or "stl". Normals are kept, but for STL."""
    metres = welded.points.astype(np.float64) * placed.unit
    in_node = placed.in_world and form == "glb"
    if placed.in_world and not in_node:
        metres += placed.corner
    mesh = trimesh.Trimesh(
        metres, welded.triangles, vertex_normals=welded.normals, process=False, validate=False, metadata={}
    )
    if form == "obj":
        digits = _digits(placed.unit)
        exact = math.frexp(placed.unit)[0] == 0.5
        return Exported(_obj(mesh, digits), 0.0 if exact else 0.5 * 10.0**-digits + _float64_error(metres))
    return Exported(_WRITERS[form](mesh, placed.corner if in_node else None), _error(metres))


def _error(metres: NDArray[np.float64]) -> float:
    return float(abs(metres.astype(np.float32) - metres).max())


def _float64_error(metres: NDArray[np.float64]) -> float:
    """Return what a product, a corner and their sum are off by at most: half a step of the largest number each."""
    return 1.5 * float(np.spacing(abs(metres).max()))


def _digits(unit: float) -> int:
    """Return how many decimals hold a position: all of them, if `unit` is a power of two. Normals have as many."""
    return max(DIGITS_MIN, math.ceil(-math.log2(unit)))


def _obj(mesh: Any, digits: int) -> bytes:
    text = mesh.export(file_type="obj", include_normals=True, include_texture=False, digits=digits, header=OBJ_HEADER)
    return str(text).encode()


def _glb(mesh: Any, translation: tuple[float, float, float] | None) -> bytes:
    """The node has the place, as float64: the positions stay as exact as they are next to the box."""
    matrix = np.eye(4)
    matrix[:3, 3] = translation or (0, 0, 0)
    scene: Any = trimesh.Scene()
    scene.add_geometry(mesh, node_name="chunks", geom_name="chunks", transform=matrix)
    return bytes(scene.export(file_type="glb", include_normals=True))


def _ply(mesh: Any, _: object) -> bytes:
    return bytes(mesh.export(file_type="ply", vertex_normal=True, include_attributes=False))


def _stl(mesh: Any, _: object) -> bytes:
    return bytes(mesh.export(file_type="stl"))


_WRITERS: Final[dict[str, Callable[[Any, Any], bytes]]] = {"glb": _glb, "ply": _ply, "stl": _stl}
