"""The native format, version 1, read field by field: docs/wire/native-v1.md from the reader's side."""

from collections.abc import Iterator
from functools import partial
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from chunkserver.errors import BadRequest
from chunkserver.grid import POSITION_LOW, ChunkKey
from chunkserver.mesh import index_type
from chunkserver.wire import native
from chunkserver.wire.buffers import COMPONENT_TYPES, TRIANGLES_MAX, VERTICES_MAX
from chunkserver.wire.encoding import GEOMETRIC_ERROR_NOT_STATED, Placement, check_placement
from chunkserver.wire.reading.findings import (
    POSITION_MAX,
    Fault,
    Findings,
    Geometry,
    bounds_of,
    geometry_faults,
    number,
    padding_faults,
    shown,
)

HEADER: Final = np.dtype(
    [
        ("magic", "S4"),
        ("version", "<u2"),
        ("header_bytes", "<u2"),
        ("x", "<i8"),
        ("y", "<i8"),
        ("z", "<i8"),
        ("revision", "<u8"),
        ("voxel_size", "<f8"),
        ("vertex_count", "<u4"),
        ("index_count", "<u4"),
        ("geometric_error", "<f4"),
        ("cells", "<u2"),
        ("lod", "u1"),
        ("profile", "u1"),
        ("coarser", "u1"),
        ("content", "u1"),
        ("index_bytes", "u1"),
        ("block_count", "u1"),
        ("file_bytes", "<u4"),
        ("low", "<u2", 3),
        ("high", "<u2", 3),
        ("reserved", "V12"),
    ]
)
ROW: Final = np.dtype(
    [
        ("kind", "<u2"),
        ("component_type", "<u2"),
        ("components", "<u2"),
        ("stride", "<u2"),
        ("offset", "<u4"),
        ("byte_length", "<u4"),
    ]
)
assert HEADER.itemsize == native.HEADER.size
assert ROW.itemsize == native.BLOCK.size

_CONTENTS: Final = {code: name for name, code in native.CONTENT_CODES.items()}
_PROFILES: Final = {code: name for name, code in native.PROFILE_CODES.items()}
_TYPES: Final = {code: np.dtype(name).newbyteorder("<") for name, code in COMPONENT_TYPES.items()}
_NAMES: Final = {native.POSITIONS: "positions", native.NORMALS: "normals", native.INDICES: "indices"}
_LAYOUTS: Final = {
    "std": {native.POSITIONS: ("uint16", 4), native.NORMALS: ("int8", 4)},
    "f32": {native.POSITIONS: ("float32", 3), native.NORMALS: ("float32", 3)},
}
"""What a profile has in its blocks: component, components. Indices follow from the counts."""

_Fields = dict[str, Any]


class _Row(NamedTuple):
    """One row of the block table, and where it stands."""

    at: int
    fields: _Fields

    def fault(self, field: str, expected: object) -> Fault:
        """Return the fault that says what a field should be."""
        return Fault(
            f"byte {self.at + _offset(ROW, field)}", f"{field} of a block is {self.fields[field]}; wanted is {expected}"
        )


def examine(file: bytes) -> Findings:
    """Return what is in `file`, and what is wrong with it. Never raises for what is in it."""
    facts: dict[str, Any] = {"format": "mesh", "bytes": len(file)}
    if len(file) < HEADER.itemsize:
        what = f"the file ends after {len(file)} bytes; a header has {HEADER.itemsize}"
        return Findings(facts, [Fault(f"byte {len(file)}", what)])
    header = _fields(file, HEADER, 0)
    faults = [_fault(name, header, wanted) for name, wanted in _strange(header)]
    if faults:
        return Findings(facts, faults)
    faults += _header_faults(header, len(file))
    facts |= _header_facts(header)
    end = header["header_bytes"] + ROW.itemsize * header["block_count"]
    if end > len(file):
        what = f"the table of {header['block_count']} blocks ends at byte {end}, behind the file's end"
        return Findings(facts, [*faults, Fault(f"byte {len(file)}", what)])
    starts = range(header["header_bytes"], end, ROW.itemsize)
    rows = [_Row(at, _fields(file, ROW, at)) for at in starts]
    facts["blocks"] = [_block_facts(row.fields) for row in rows]
    faults += _table_faults(rows, file, end)
    if faults or not rows:
        return Findings(facts, faults)
    expected = list(_layout_faults(header, rows))
    return Findings(facts, expected or list(_content_faults(header, rows, file)))


def _offset(layout: np.dtype[Any], name: str) -> int:
    assert layout.fields is not None
    return int(layout.fields[name][1])


def _fields(file: bytes, layout: np.dtype[Any], at: int) -> _Fields:
    record = np.frombuffer(file, layout, 1, at)[0]
    return {name: record[name].tolist() for name in layout.names or ()}


def _fault(name: str, header: _Fields, wanted: object) -> Fault:
    return Fault(f"byte {_offset(HEADER, name)}", f"{name} is {shown(header[name])}; wanted is {wanted}")


def _strange(header: _Fields) -> Iterator[tuple[str, object]]:
    """Yield which fields make the file one that is not to be read any further, and what they should be."""
    for name, wanted in (("magic", native.MAGIC), ("version", native.VERSION)):
        if header[name] != wanted:
            yield name, wanted
            return
    if header["header_bytes"] < HEADER.itemsize:
        yield "header_bytes", f"{HEADER.itemsize} or more"
    for name, codes in (("profile", _PROFILES), ("content", _CONTENTS)):
        if header[name] not in codes:
            yield name, " or ".join(f"{code} ({meaning})" for code, meaning in codes.items())


def _placement(header: _Fields) -> Placement:
    key = ChunkKey(*(header[name] for name in ("lod", "x", "y", "z")))
    return Placement(key, *(header[name] for name in ("cells", "voxel_size", "revision", "coarser", "geometric_error")))


def _header_faults(header: _Fields, length: int) -> Iterator[Fault]:
    try:
        check_placement(_placement(header))
    except BadRequest as error:
        yield Fault(f"byte {_offset(HEADER, next(iter(error.values)))}", error.message)
    yield from (_fault(name, header, wanted) for name, wanted in _wrong_numbers(header, length))


def _wrong_numbers(header: _Fields, length: int) -> Iterator[tuple[str, object]]:
    """Yield which numbers cannot be, and what they should be."""
    if header["file_bytes"] != length:
        yield "file_bytes", f"{length}, the length of the file"
    if length % native.ALIGNMENT:
        yield "file_bytes", f"a multiple of {native.ALIGNMENT}"
    if _CONTENTS[header["content"]] != "surface":
        empty = ("vertex_count", "index_count", "index_bytes", "block_count")
        yield from ((name, "0 in an empty chunk") for name in empty if header[name] != 0)
        yield from ((name, "[0, 0, 0] in an empty chunk") for name in ("low", "high") if any(header[name]))
        return
    if not 0 < header["vertex_count"] <= VERTICES_MAX:
        yield "vertex_count", f"1 to {VERTICES_MAX}"
    if not 0 < header["index_count"] <= 3 * TRIANGLES_MAX or header["index_count"] % 3:
        yield "index_count", f"3 to {3 * TRIANGLES_MAX}, three for each triangle"
    if header["index_bytes"] != _index_bytes(header):
        yield "index_bytes", f"{_index_bytes(header)}, for {header['vertex_count']} vertices of this profile"
    if header["block_count"] < len(_NAMES):
        yield "block_count", f"{len(_NAMES)}, or more"


def _index_bytes(header: _Fields) -> int:
    return np.dtype(index_type(header["vertex_count"]) if _PROFILES[header["profile"]] == "std" else np.uint32).itemsize


def _header_facts(header: _Fields) -> dict[str, Any]:
    placement, content = _placement(header), _CONTENTS[header["content"]]
    error = header["geometric_error"]
    return {
        "version": header["version"],
        "key": {name: header[name] for name in ("lod", "x", "y", "z")},
        "cells": header["cells"],
        "voxel_size": number(header["voxel_size"]),
        "revision": str(header["revision"]),
        "coarser": header["coarser"],
        "content": content,
        "profile": _PROFILES[header["profile"]],
        "geometric_error": None if error == GEOMETRIC_ERROR_NOT_STATED else number(error),
        "vertices": header["vertex_count"],
        "triangles": header["index_count"] // 3,
        "bounds": _bounds(placement, header) if content == "surface" else None,
    }


def _bounds(placement: Placement, header: _Fields) -> dict[str, Any] | None:
    try:
        check_placement(placement)
    except BadRequest:
        return None
    return bounds_of(placement, header["low"], header["high"])


def _block_facts(row: _Fields) -> dict[str, Any]:
    component = _TYPES.get(row["component_type"])
    return {
        "name": _NAMES.get(row["kind"], f"kind {row['kind']}"),
        "type": component.name if component else row["component_type"],
        **{name: row[name] for name in ("components", "stride", "offset")},
        "bytes": row["byte_length"],
    }


def _table_faults(rows: list[_Row], file: bytes, end: int) -> Iterator[Fault]:
    """Yield what is wrong with where blocks are, and with what lies between them."""
    for row in rows:
        offset, length = row.fields["offset"], row.fields["byte_length"]
        if offset % native.ALIGNMENT or offset < end:
            yield row.fault("offset", f"a multiple of {native.ALIGNMENT}, {end} or more")
            return
        if offset + length > len(file):
            yield row.fault("byte_length", f"at most {max(len(file) - offset, 0)}: there the file ends")
            return
        yield from _padding_faults(file, end, offset)
        end = offset + length
    yield from _padding_faults(file, end, len(file))


def _padding_faults(file: bytes, begin: int, end: int) -> Iterator[Fault]:
    gap = file[begin:end]
    if len(gap) >= native.ALIGNMENT:
        yield Fault(f"byte {begin}", f"{len(gap)} bytes belong to no block")
    elif any(gap):
        yield Fault(f"byte {begin}", "padding is not zero")


def _layout_faults(header: _Fields, rows: list[_Row]) -> Iterator[Fault]:
    """Yield what is wrong with the kinds of blocks, their types and lengths. Unknown kinds are left alone."""
    kinds = [row.fields["kind"] for row in rows]
    for kind, name in _NAMES.items():
        if kinds.count(kind) != 1:
            yield Fault(f"byte {rows[0].at}", f"there are {kinds.count(kind)} blocks of {name}; wanted is 1")
            return
    layout = {**_LAYOUTS[_PROFILES[header["profile"]]], native.INDICES: (f"uint{8 * header['index_bytes']}", 1)}
    for row in rows:
        if row.fields["kind"] in layout:
            component, components = layout[row.fields["kind"]]
            count = header["index_count"] if row.fields["kind"] == native.INDICES else header["vertex_count"]
            stride = np.dtype(component).itemsize * components
            wanted = {"component_type": COMPONENT_TYPES[component], "components": components, "stride": stride}
            wanted["byte_length"] = count * stride
            yield from (row.fault(name, value) for name, value in wanted.items() if row.fields[name] != value)


def _content_faults(header: _Fields, rows: list[_Row], file: bytes) -> Iterator[Fault]:
    """Yield what is wrong with what stands in the blocks, whose layout is right."""
    known = {row.fields["kind"]: row.fields for row in rows if row.fields["kind"] in _NAMES}
    positions, normals, indices = (_values(known[kind], file) for kind in _NAMES)

    def at(kind: int, row: int) -> str:
        return f"byte {known[kind]['offset'] + row * known[kind]['stride']}"

    lattice, wrong = _lattice(positions, _placement(header))
    if wrong.any():
        place = at(native.POSITIONS, int(np.argmax(wrong)))
        yield Fault(place, f"{np.count_nonzero(wrong)} positions are not on the chunk's lattice")
        return
    if positions.shape[1] == 4:
        yield from padding_faults(positions[:, 3], partial(at, native.POSITIONS))
    for name, found in (("low", lattice.min(axis=0).tolist()), ("high", lattice.max(axis=0).tolist())):
        if header[name] != found:
            yield _fault(name, header, f"{found}, by the positions")
    at_normal, at_index = partial(at, native.NORMALS), partial(at, native.INDICES)
    yield from geometry_faults(Geometry(lattice, normals[:, :3], indices[:, 0], at_normal, at_index))


def _values(block: _Fields, file: bytes) -> NDArray[Any]:
    component = _TYPES[block["component_type"]]
    count = block["byte_length"] // component.itemsize
    return np.frombuffer(file, component, count, block["offset"]).reshape(-1, block["components"])


def _lattice(positions: NDArray[Any], placement: Placement) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Return positions in lattice units, (V, 3), and which of them are none: (V,)."""
    if positions.dtype.kind == "u":
        return positions[:, :3].astype(np.int64), np.zeros(len(positions), np.bool_)
    with np.errstate(over="ignore", invalid="ignore"):
        nearest = np.rint(positions.astype(np.float64) / placement.unit)
        same = (nearest * placement.unit).astype(np.float32) == positions
        inside = (nearest >= -POSITION_LOW) & (nearest <= POSITION_MAX - POSITION_LOW)
    right = (same & inside).all(axis=1)
    return np.where(right[:, None], nearest, 0).astype(np.int64) + POSITION_LOW, ~right
