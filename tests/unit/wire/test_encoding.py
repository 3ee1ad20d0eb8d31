from typing import Any

import pytest

from chunkserver.errors import BadKey, BadParameter
from chunkserver.grid import ChunkKey
from chunkserver.mesh import EMPTY
from chunkserver.wire import FORMATS, Encoding, Placement, check_encodable, encode
from tests.unit.wire.meshes import PLACEMENT, strip

BUILT = [
    Encoding(row.name, profile, frame) for row in FORMATS.values() for profile in row.profiles for frame in row.frames
]


def test_the_default_is_the_first_row():
    assert Encoding() == Encoding("mesh", "std", "world") == BUILT[0]


def test_rows():
    rows = {row.name: (row.extension, row.media_type) for row in FORMATS.values()}
    assert rows == {"mesh": (".mesh", "application/vnd.chunkserver.mesh"), "glb": (".glb", "model/gltf-binary")}
    assert list(FORMATS) == list(rows)


def test_what_is_built():
    assert {*BUILT} == {
        Encoding("mesh", "std", "world"),
        Encoding("mesh", "f32", "world"),
        Encoding("glb", "std", "world"),
        Encoding("glb", "std", "chunk"),
    }
    for encoding in BUILT:
        check_encodable(PLACEMENT, encoding)


def test_normals_follow_the_profile():
    assert [encoding.normals for encoding in BUILT] == ["int8", "float32", "int8", "int8"]


@pytest.mark.parametrize(
    ("encoding", "field", "built"),
    [
        (Encoding("ply"), "format", "['mesh', 'glb']"),
        (Encoding("mesh", "godot4"), "profile", "['std', 'f32']"),
        (Encoding("mesh", "f32", "chunk"), "frame", "['world']"),
        (Encoding("glb", "f32"), "profile", "['std']"),
        (Encoding("glb", frame="tile"), "frame", "['world', 'chunk']"),
    ],
)
def test_what_is_not_built_is_named(encoding: Encoding, field: str, built: str):
    with pytest.raises(BadParameter) as caught:
        check_encodable(PLACEMENT, encoding)
    assert caught.value.message.startswith(f"{field} is {getattr(encoding, field)!r}")
    assert caught.value.message.endswith(built)
    assert caught.value.values[field] == getattr(encoding, field)


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("cells", 24),
        ("voxel_size", 0.0),
        ("voxel_size", float("nan")),
        ("voxel_size", float("inf")),
        ("voxel_size", 2.0**-20 * 0.99),
        ("voxel_size", 2.0**20 * 1.01),
        ("revision", -1),
        ("revision", 2**63),
        ("coarser", -1),
        ("coarser", 64),
        ("geometric_error", -0.5),
        ("geometric_error", 2.0**61),
        ("geometric_error", float("nan")),
    ],
)
def test_a_placement_that_does_not_fit_is_named(field: str, value: Any):
    placement = PLACEMENT._replace(**{field: value})
    for encoding in BUILT:
        with pytest.raises(BadParameter, match=f"^{field} is "):
            check_encodable(placement, encoding)
        with pytest.raises(BadParameter, match=f"^{field} is "):
            encode(EMPTY["air"], placement, encoding)


def test_a_key_outside_the_world():
    with pytest.raises(BadKey, match=r"^x is "):
        encode(EMPTY["air"], PLACEMENT._replace(key=ChunkKey(0, 2**35, 0, 0)))


def test_nothing_is_coarser_than_the_last_level():
    with pytest.raises(BadParameter, match="coarser is 1; nothing is coarser than lod 20"):
        check_encodable(PLACEMENT._replace(key=ChunkKey(20, 0, 0, 0), coarser=1), Encoding())


def test_limits_of_a_placement_are_inside():
    check_encodable(Placement(ChunkKey(20, -(2**15), 0, 2**15 - 1), 32, 2.0**20, 2**63 - 1, 0), Encoding())
    check_encodable(Placement(ChunkKey(19, -(2**16), 0, 2**16 - 1), 32, 2.0**20, 2**63 - 1, 63), Encoding())
    check_encodable(Placement(ChunkKey(0, -(2**36), 0, 2**36 - 1), 16, 2.0**-20, 0, 0), Encoding())
    for error in (-1.0, 0.0, 2.0**60):
        check_encodable(PLACEMENT._replace(geometric_error=error), Encoding())


@pytest.mark.parametrize("encoding", BUILT)
def test_the_same_input_gives_the_same_bytes(encoding: Encoding):
    first, second = strip(50, encoding.normals), strip(50, encoding.normals)
    assert encode(first, PLACEMENT, encoding) == encode(second, PLACEMENT, encoding)
    assert encode(first, PLACEMENT._replace(voxel_size=1.0), encoding) == encode(
        first, PLACEMENT._replace(voxel_size=1), encoding
    )


@pytest.mark.parametrize("encoding", BUILT)
def test_each_field_of_the_placement_shows(encoding: Encoding):
    mesh = strip(5, encoding.normals)
    variants = [
        PLACEMENT,
        PLACEMENT._replace(key=ChunkKey(3, -3, 0, 5)),
        PLACEMENT._replace(key=ChunkKey(2, -4, 0, 5)),
        PLACEMENT._replace(key=ChunkKey(2, -3, 1, 5)),
        PLACEMENT._replace(key=ChunkKey(2, -3, 0, 6)),
        PLACEMENT._replace(cells=16),
        PLACEMENT._replace(voxel_size=1.0),
        PLACEMENT._replace(revision=8),
        PLACEMENT._replace(coarser=4),
        PLACEMENT._replace(geometric_error=0.75),
    ]
    assert len({encode(mesh, placement, encoding) for placement in variants}) == len(variants)
