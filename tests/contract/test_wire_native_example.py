"""The page docs/wire/native-v1.md against itself, and then `encode` against the page.

The decoder below is a stranger's: it knows what the page says and nothing of `chunkserver.wire`. Even the fields come
from the page's own tables.
"""

import json
import re
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import numpy as np
import pytest

from chunkserver.grid import ChunkKey
from chunkserver.mesh import EMPTY, Mesh
from chunkserver.wire import Encoding, Placement, encode

PAGE: Final = (Path(__file__).parents[2] / "docs/wire/native-v1.md").read_text()
EXAMPLES: Final = ("std", "f32", "empty")
LETTERS: Final = {"char": "s", "u8": "B", "u16": "H", "u32": "I", "u64": "Q", "i64": "q", "f32": "f", "f64": "d"}
DTYPES: Final = {5120: "<i1", 5123: "<u2", 5125: "<u4", 5126: "<f4"}

Fields = list[tuple[int, str, str]]


def fenced(language: str, name: str) -> str:
    """Return the one block of the page that is fenced as ```language name."""
    (block,) = re.findall(rf"^```{language} {name}\n(.*?)^```$", PAGE, re.DOTALL | re.MULTILINE)
    return str(block)


def section(title: str) -> str:
    """Return the part of the page below `title`, up to the next heading of whatever level."""
    (found,) = re.findall(rf"^#+ {title}\n(.*?)(?=^#+ |\Z)", PAGE, re.DOTALL | re.MULTILINE)
    return str(found)


def example(name: str) -> bytes:
    """Return the bytes of a hex dump; each row's offset is checked."""
    file = b""
    for row in fenced("hex", name).splitlines():
        offset, digits = row.split(maxsplit=1)
        assert int(offset, 16) == len(file)
        file += bytes.fromhex(digits)
    return file


def fields(title: str) -> Fields:
    """Return (offset, struct format, name) of each row of a section's table of fields."""
    rows = re.findall(r"^\| (\d+) \| `(\w+?)(?:\[(\d+)\])?` \| `(\w+)` \|", section(title), re.MULTILINE)
    return [(int(offset), f"<{count}{LETTERS[kind]}", name) for offset, kind, count, name in rows]


HEADER: Final = fields("Header")
BLOCK: Final = fields("Block table")


def record(table: Fields, file: bytes, start: int) -> dict[str, Any]:
    values = ((name, struct.unpack_from(form, file, start + offset)) for offset, form, name in table)
    return {name: value[0] if len(value) == 1 else list(value) for name, value in values}


def decode(file: bytes) -> dict[str, Any]:
    """Return the header's fields, and a list for each block. Padding must be zero."""
    chunk = record(HEADER, file, 0)
    assert (chunk["magic"], chunk["version"], chunk["reserved"]) == (b"CHNK", 1, [0] * 12)
    assert chunk["file_bytes"] == len(file)
    end = chunk["header_bytes"] + 16 * chunk["block_count"]
    for row in range(chunk["block_count"]):
        block = record(BLOCK, file, chunk["header_bytes"] + 16 * row)
        offset, byte_length = block["offset"], block["byte_length"]
        assert offset % 16 == 0
        assert not any(file[end:offset])
        end = offset + byte_length
        values = np.frombuffer(file[offset:end], DTYPES[block["component_type"]]).reshape(-1, block["components"])
        assert values.strides[0] == block["stride"]
        chunk[{1: "positions", 2: "normals", 3: "indices"}[block["kind"]]] = values
    assert not any(file[end:])
    if chunk["block_count"]:
        assert len(chunk["positions"]) == len(chunk["normals"]) == chunk["vertex_count"]
        assert len(chunk["indices"]) == chunk["index_count"]
        assert chunk["indices"].itemsize == chunk["index_bytes"]
        chunk["indices"] = chunk["indices"][:, 0]
    return chunk


def metres(chunk: dict[str, Any]) -> list[list[float]]:
    """Return where the vertices are in the world, by the formula of the page's section on that."""
    unit = chunk["voxel_size"] * 2 ** chunk["lod"] * chunk["cells"] / 32768
    corner = [32768 * chunk[axis] for axis in "xyz"]
    if chunk["profile"] == 0:
        return [[unit * (k + int(p) - 16384) for k, p in zip(corner, v, strict=False)] for v in chunk["positions"]]
    return [[unit * k + float(p) for k, p in zip(corner, v, strict=True)] for v in chunk["positions"]]


@pytest.mark.parametrize(("table", "size"), [(HEADER, 96), (BLOCK, 16)])
def test_tables_name_every_byte_once(table: Fields, size: int):
    end = 0
    for offset, form, _name in table:
        assert offset == end
        end += struct.calcsize(form)
    assert end == size


@pytest.mark.parametrize("name", EXAMPLES)
def test_examples_decode_to_what_the_page_says(name: str):
    stated = json.loads(fenced("json", name))
    chunk = decode(example(name))
    chunk["metres"] = metres(chunk) if "positions" in chunk else None
    for field, value in stated.items():
        found = chunk[field].tolist() if isinstance(chunk[field], np.ndarray) else chunk[field]
        assert found == (pytest.approx(np.array(value), rel=1e-7) if field == "normals" else value), field
    assert ("positions" in chunk) == ("positions" in stated)


@pytest.mark.parametrize("name", ["std", "f32"])
def test_explained_bytes_are_those_of_the_dump(name: str):
    file = example(name)
    rows = re.findall(r"^\| ([0-9a-f]{4}) \| `([0-9a-f ]+)` \|", section(name), re.MULTILINE)
    explained: dict[int, None] = {}
    for offset, digits in rows:
        run = bytes.fromhex(digits)
        assert file[int(offset, 16) :].startswith(run), offset
        explained |= dict.fromkeys(range(int(offset, 16), int(offset, 16) + len(run)))
    if name == "std":
        assert list(explained) == list(range(len(file))), "every byte is explained, in order"
    else:
        differ = {at for at, byte in enumerate(file[:144]) if byte != example("std")[at]}
        assert differ
        assert differ <= set(explained), "whatever differs from the first example is explained"


PLACEMENT: Final = Placement(ChunkKey(2, -3, 0, 5), 32, 0.5, revision=7, geometric_error=0.75)
POSITIONS: Final = [[16384, 20992, 16384], [17408, 20736, 16384], [16384, 20992, 17408], [17408, 20736, 17408]]
TRIANGLES: Final = np.array([[0, 2, 1], [1, 2, 3]], np.uint16)


def quad(normals: np.ndarray) -> Mesh:
    positions = np.full((4, 4), 65535, np.uint16)
    positions[:, :3] = POSITIONS
    return Mesh("surface", positions, normals, TRIANGLES)


SLOPE: Final = np.array([1, 4, 0]) / np.sqrt(17)
WRITTEN: Final[dict[str, Callable[[], bytes]]] = {
    "std": lambda: encode(quad(np.array([[31, 123, 0, 0]] * 4, np.int8)), PLACEMENT, Encoding()),
    "f32": lambda: encode(quad(np.array([SLOPE] * 4, np.float32)), PLACEMENT, Encoding(profile="f32")),
    "empty": lambda: encode(EMPTY["rock"], PLACEMENT, Encoding()),
}


@pytest.mark.parametrize("name", EXAMPLES)
def test_encode_writes_the_examples(name: str):
    assert WRITTEN[name]() == example(name)


@pytest.mark.parametrize("name", ["std", "f32"])
def test_front_faces_and_normals_of_the_example_look_into_the_air(name: str):
    chunk = decode(example(name))
    points = np.array(metres(chunk))
    for a, b, c in chunk["indices"].reshape(-1, 3):
        face = np.cross(points[b] - points[a], points[c] - points[a])
        assert face / np.linalg.norm(face) == pytest.approx(SLOPE)
    normals = chunk["normals"][:, :3] / (127 if name == "std" else 1)
    assert normals == pytest.approx(np.array([SLOPE] * 4), abs=0.5 / 127 if name == "std" else 1e-7)
