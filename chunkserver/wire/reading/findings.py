"""What a reader says of a file, and what it asks of the geometry in it, whatever the format."""

import math
from collections.abc import Callable, Iterator
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from chunkserver.grid import POSITION_HIGH, POSITION_LOW
from chunkserver.mesh import POSITION_W
from chunkserver.wire.encoding import Placement

SHOWN_CHARACTERS_MAX: Final = 60
"""Of a value that is repeated in a fault."""
NORMAL_ERROR_MAX: Final = {"i": 0.007, "f": 1e-5}
"""By how much the length of a normal may differ from 1, by the kind of its components: bytes, floats."""
POSITION_MAX: Final = 65535
BLOCK: Final = 1 << 14
"""Triangles that are looked at at once."""

_CHUNK_UNITS: Final = POSITION_HIGH - POSITION_LOW

At = Callable[[int], str]
"""Says where the n-th element of an array stands in the file."""


class Fault(NamedTuple):
    """One thing that is not as docs/wire has it.

    where: "byte 48", or the path in a GLB's JSON: "$.accessors[0].count".
    what: what stands there, and what should.
    """

    where: str
    what: str


class Findings(NamedTuple):
    """What was found. facts: plain JSON values, as many as could be read. faults: none, if the file is right."""

    facts: dict[str, Any]
    faults: list[Fault]


class Geometry(NamedTuple):
    """The arrays of a file, as they stand in it, and where.

    lattice: (V, 3) int64, lattice units.
    normals: (V, 3) signed bytes, or float32.
    indices: (3 T,) unsigned.
    at_normal, at_index: say where one of them stands.
    """

    lattice: NDArray[np.int64]
    normals: NDArray[Any]
    indices: NDArray[Any]
    at_normal: At
    at_index: At


def shown(value: object) -> str:
    """Return a value for a message: short, however long it is."""
    text = repr(value)
    return text if len(text) <= SHOWN_CHARACTERS_MAX else f"{text[:SHOWN_CHARACTERS_MAX]}..."


def number(value: float) -> float | str:
    """Return a float as JSON can have it: NaN and infinity as text."""
    return value if math.isfinite(value) else str(value)


def metres(placement: Placement, lattice: list[int]) -> list[float]:
    """Return where a position is in the world, metres: rounded at most once."""
    axes = zip(placement.key[1:], lattice, strict=True)
    return [placement.unit * (_CHUNK_UNITS * chunk + position - POSITION_LOW) for chunk, position in axes]


def bounds_of(placement: Placement, low: list[int], high: list[int]) -> dict[str, Any]:
    """Return the facts about a box of lattice positions."""
    return {
        "lattice": {"low": low, "high": high},
        "metres": {"low": metres(placement, low), "high": metres(placement, high)},
    }


def geometry_faults(geometry: Geometry) -> Iterator[Fault]:
    """Yield what is wrong with normals and triangles: one fault for each kind, which names the first place."""
    kind = geometry.normals.dtype.kind
    with np.errstate(over="ignore", invalid="ignore"):
        directions = geometry.normals.astype(np.float64) / (127 if kind == "i" else 1)
        off = ~(abs(np.sqrt((directions**2).sum(axis=1)) - 1) <= NORMAL_ERROR_MAX[kind])
    yield from _first(off, geometry.at_normal, "of {} normals the length is not 1")
    outside = geometry.indices >= len(geometry.lattice)
    yield from _first(outside, geometry.at_index, f"{{}} indices name no vertex: there are {len(geometry.lattice)}")
    if not outside.any() and len(geometry.indices) % 3 == 0:
        flat = _has_no_area(geometry.lattice, geometry.indices.reshape(-1, 3))
        yield from _first(flat, lambda row: geometry.at_index(3 * row), "{} triangles have no area")


def padding_faults(fourths: NDArray[np.uint16], at: At) -> Iterator[Fault]:
    """Yield what is wrong with the fourth component of positions."""
    yield from _first(fourths != POSITION_W, at, f"of {{}} positions the fourth component is not {POSITION_W}")


def _first(wrong: NDArray[np.bool_], at: At, what: str) -> Iterator[Fault]:
    count = int(np.count_nonzero(wrong))
    if count:
        yield Fault(at(int(np.argmax(wrong))), what.format(count))


def _has_no_area(lattice: NDArray[np.int64], triangles: NDArray[Any]) -> NDArray[np.bool_]:
    """Return which triangles have equal corners or corners on a line.

    Exact: differences stay below 2^17 and products below 2^34, which float64 holds. In blocks that fit the cache.
    """
    columns = lattice.T.astype(np.float64, order="C")
    flat = np.empty(len(triangles), np.bool_)
    for begin in range(0, len(triangles), BLOCK):
        a, b, c = (columns[:, corner] for corner in triangles[begin : begin + BLOCK].T)
        (ux, uy, uz), (vx, vy, vz) = b - a, c - a
        flat[begin : begin + BLOCK] = (uy * vz == uz * vy) & (uz * vx == ux * vz) & (ux * vy == uy * vx)
    return flat
