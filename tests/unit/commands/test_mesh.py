"""Meshes in files: closed, exact, and nothing there if it failed."""

import io
import json
import math
import os
from itertools import product

import manifold3d
import numpy as np
import pytest
import trimesh

from chunkserver.commands import building, mesh, welding
from chunkserver.commands.exporting import Placed, export
from chunkserver.grid import ChunkKey
from chunkserver.mesh import Mesh, as_indices
from chunkserver.pipeline import ChunkRequest, build_chunk
from chunkserver.recipe import WorldRecipe, builtin
from chunkserver.wire import Encoding
from tests.surfaces import weld, world_points
from tests.unit.commands.typed import refused, run
from tests.worlds import box_of_chunks

RADIUS = 20.0
SPHERE = WorldRecipe(0, builtin("sphere", radius=RADIUS))
SPHERE_BOX = ("--box", -2, -2, -2, 1, 1, 1, "--cells", 16)
FORMS = ("glb", "ply", "obj", "stl")


def written(file, *arguments):
    """Return what the command says as JSON of the file that it wrote."""
    ended = run("mesh", file, *arguments, "--json")
    assert (ended.exit_code, ended.stderr) == (0, ""), ended.output
    told = json.loads(ended.stdout)
    assert told["bytes"] == file.stat().st_size
    return told


@pytest.fixture
def ball_json(tmp_path_factory):
    """A recipe in a file: the ball of `SPHERE`."""
    file = tmp_path_factory.mktemp("recipe") / "ball.json"
    file.write_text(SPHERE.source)
    return file


def read(file):
    """Return a file as trimesh reads it, each node in its place; an STL's equal corners are one vertex."""
    whole = trimesh.load_scene(file, process=False).to_mesh()
    if file.suffix != ".stl":
        return whole
    points, place = np.unique(whole.vertices, axis=0, return_inverse=True)
    return trimesh.Trimesh(points, place.reshape(-1)[whole.faces], process=False)


def longest():
    """Boxes of as many chunks as there may be, in a row along each axis."""
    return [tuple(welding.CHUNKS_MAX if axis == along else 1 for axis in range(3)) for along in range(3)]


def rows(points):
    return {tuple(point) for point in np.asarray(points).tolist()}


@pytest.fixture(scope="module")
def ball():
    """The sphere's chunks, welded by the tests' own weld: points in voxels, triangles."""
    surface = weld(box_of_chunks(SPHERE, 0, (-2, -2, -2), (2, 2, 2), 16))
    return world_points(surface, 0, 16), surface


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("frame", ["box", "world"])
def test_a_ball_is_closed_and_where_it_should_be(tmp_path, ball, ball_json, form, frame):
    points, surface = ball
    told = written(tmp_path / f"ball.{form}", "--recipe", ball_json, *SPHERE_BOX, "--frame", frame)
    found = read(tmp_path / f"ball.{form}")
    origin = np.array(told["origin"])
    assert told["origin"] == ([-32, -32, -32] if frame == "box" else [0, 0, 0])
    assert (told["vertices"], told["triangles"]) == (len(points), len(surface.triangles))
    assert (len(found.vertices), len(found.faces)) == (told["vertices"], told["triangles"])
    assert told["chunks"] == {"air": 32, "rock": 0, "surface": 32}
    assert told["position_error"] == 0
    assert rows(found.vertices + origin) == rows(points)
    assert found.is_watertight
    assert found.is_winding_consistent
    closed = manifold3d.Manifold(manifold3d.Mesh(found.vertices.astype(np.float32), found.faces.astype(np.uint32)))
    assert closed.status() == manifold3d.Error.NoError
    assert closed.volume() == pytest.approx(4 / 3 * math.pi * RADIUS**3, rel=3e-3)


@pytest.mark.parametrize("voxel_size", [1, 4096])
@pytest.mark.parametrize("form", ["glb", "ply", "obj"])
def test_normals_are_those_of_the_field(tmp_path, ball_json, form, voxel_size):
    written(tmp_path / f"ball.{form}", "--recipe", ball_json, *SPHERE_BOX, "--voxel-size", voxel_size)
    (found,) = trimesh.load_scene(tmp_path / f"ball.{form}", process=False).geometry.values()
    keys = [ChunkKey(0, *place) for place in product(range(-2, 2), repeat=3)]
    built = building.build(ChunkRequest(SPHERE, keys[0], cells=16, encoding=Encoding(profile="f32")), keys)
    normal_at: dict[tuple[float, ...], np.ndarray] = {}
    for key, surface in built.surfaces:
        points = (surface.positions[:, :3] + 32768 * (np.array(key[1:]) + 2) - 16384) * (voxel_size * 16 / 32768)
        normal_at |= dict(zip(map(tuple, points.tolist()), surface.normals, strict=True))
    expected = np.array([normal_at[tuple(point)] for point in found.vertices.tolist()])
    assert len(found.vertex_normals) == len(expected) > 1000
    assert abs(found.vertex_normals - expected).max() < 2e-6
    faces = trimesh.Trimesh(found.vertices, found.faces, process=False).vertex_normals
    assert abs(faces - expected).max() > 2e-3, "what a reader would make of the triangles is another thing"


@pytest.mark.parametrize("form", FORMS)
def test_far_from_the_origin_a_box_keeps_every_bit(tmp_path, form):
    """A million chunks out, float32 is metres coarse: in the box's frame nothing shows of that."""
    file = tmp_path / f"far.{form}"
    options = ("--recipe", "hills", "--box", 1 << 20, -1, -(1 << 20), 1 << 20, 0, 1 - (1 << 20))
    told = written(file, *options, "--frame", "box")
    assert told["position_error"] == 0
    assert told["origin"] == [32 << 20, -32, -(32 << 20)]
    found = read(file)
    low = (1 << 20, -1, -(1 << 20))
    chunks = box_of_chunks(WorldRecipe(0, builtin("hills")), 0, low, (low[0] + 1, 1, low[2] + 2))
    expected = weld(chunks).points * (32 / 32768)
    assert rows(found.vertices) == rows(expected)


def test_the_worlds_frame_says_what_it_costs(tmp_path):
    options = ("--recipe", "hills", "--box", 1 << 20, 0, 0, 1 << 20, 0, 1, "--frame", "world")
    told = written(tmp_path / "far.ply", *options)
    assert 0 < told["position_error"] <= 2
    assert "--frame box" in run("mesh", tmp_path / "far.ply", *options).stdout
    for exact in ("far.obj", "far.glb"):
        assert written(tmp_path / exact, *options)["position_error"] == 0
    told = written(tmp_path / "tenths.obj", *options, "--voxel-size", 0.1)
    assert np.spacing(0.1 * (32 << 20)) < told["position_error"] < 1e-8, "an OBJ has the digits, a float64 has not"
    bounds = [read(tmp_path / f"far.{form}").bounds.tolist() for form in ("obj", "glb")]
    assert bounds[0] == bounds[1]
    assert bounds[0][0][0] >= 32 << 20


@pytest.mark.parametrize("voxel_size", [0.1, 2.0**-20, 3e5])
@pytest.mark.parametrize("form", FORMS)
def test_any_voxel_size(tmp_path, ball_json, form, voxel_size):
    told = written(tmp_path / f"a.{form}", "--recipe", ball_json, *SPHERE_BOX, "--voxel-size", voxel_size)
    unit = voxel_size * 16 / 32768
    assert told["position_error"] < unit / 100
    found = read(tmp_path / f"a.{form}")
    assert len(found.vertices) == told["vertices"]
    assert found.volume == pytest.approx(4 / 3 * math.pi * (RADIUS * voxel_size) ** 3, rel=3e-3)


KEYS = [(0, 0, -1, 0), (2, -1, 0, 1)]
WIRE = [
    ("mesh", (), Encoding()),
    ("mesh", ("--profile", "f32"), Encoding(profile="f32")),
    ("glb", (), Encoding("glb")),
    ("glb", ("--frame", "box"), Encoding("glb", frame="chunk")),
]


@pytest.mark.parametrize(("form", "options", "encoding"), WIRE)
@pytest.mark.parametrize("key", KEYS)
def test_one_chunk_is_what_is_built(tmp_path, form, options, encoding, key):
    world = ("--recipe", "terrain", "--seed", -7, "--lod", key[0], "--cells", 16, "--voxel-size", 0.5)
    file = tmp_path / f"chunk.{form}"
    told = written(file, *world, "--chunk", *key[1:], *options)
    recipe = WorldRecipe(-7, builtin("terrain"))
    request = ChunkRequest(recipe, ChunkKey(*key), cells=16, voxel_size=0.5, encoding=encoding)
    assert file.read_bytes() == build_chunk(request).body
    assert (told["seed"], told["recipe"], told["low"], told["high"]) == ("-7", recipe.digest, [*key[1:]], [*key[1:]])
    ended = run("inspect", file, "--json")
    facts = json.loads(ended.stdout)
    assert (facts["faults"], facts["vertices"], facts["triangles"]) == ([], told["vertices"], told["triangles"])


def test_a_box_of_one_chunk_is_that_chunk(tmp_path):
    written(tmp_path / "chunk.mesh", "--chunk", 0, -1, 0)
    written(tmp_path / "box.mesh", "--box", 0, -1, 0, 0, -1, 0)
    assert (tmp_path / "chunk.mesh").read_bytes() == (tmp_path / "box.mesh").read_bytes()


def test_the_same_command_writes_the_same_bytes(tmp_path):
    for form in FORMS:
        files = [tmp_path / f"{name}.{form}" for name in "ab"]
        for file in files:
            written(file, "--box", 0, -1, 0, 1, 0, 1, "--cells", 16)
        assert files[0].read_bytes() == files[1].read_bytes(), form


def test_a_file_can_go_to_stdout(tmp_path):
    written(tmp_path / "chunk.glb", "--chunk", 0, 0, 0)
    ended = run("mesh", "-", "--format", "glb", "--chunk", 0, 0, 0)
    assert ended.exit_code == 0
    assert ended.stdout_bytes == (tmp_path / "chunk.glb").read_bytes()
    assert ended.stderr.startswith("-: 1 chunk, ")


def test_a_recipe_from_a_file_or_from_stdin(tmp_path):
    tree = {"op": "sphere", "radius": 20}
    (tmp_path / "ball.json").write_text(json.dumps(tree))
    written(tmp_path / "a.mesh", "--recipe", tmp_path / "ball.json", "--chunk", 0, 0, 0)
    ended = run("mesh", tmp_path / "b.mesh", "--recipe", "-", "--chunk", 0, 0, 0, piped=json.dumps(tree))
    assert ended.exit_code == 0
    assert (tmp_path / "a.mesh").read_bytes() == (tmp_path / "b.mesh").read_bytes()


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--chunk", 0, 500, 0), "1 chunk: 1 air"),
        (("--chunk", 0, -500, 0, "--recipe", "hills"), "1 chunk: 1 rock"),
        (("--box", 0, -500, 0, 0, -499, 0, "--recipe", "hills"), "2 chunks: 2 rock"),
    ],
)
@pytest.mark.parametrize("form", ["glb", "ply"])
def test_where_there_is_no_surface_nothing_is_written(tmp_path, form, options, said):
    file = tmp_path / f"empty.{form}"
    assert said in refused(1, "mesh", file, *options)
    assert list(tmp_path.iterdir()) == []


REFUSED = [
    (("a.xyz", "--chunk", 0, 0, 0), "'a.xyz' ends in none of .glb"),
    (("a", "--chunk", 0, 0, 0), "'a' ends in none of .glb"),
    (("a.glb",), "either --chunk X Y Z, or --box"),
    (("a.glb", "--chunk", 0, 0, 0, "--box", 0, 0, 0, 0, 0, 0), "either --chunk X Y Z, or --box"),
    (("a.glb", "--box", 0, 0, 0, 0, -1, 0), "from (0, 0, 0) to (0, -1, 0)"),
    (("a.glb", "--box", 0, 0, 0, 31, 31, 32), "32 x 32 x 33 chunks: 33,792, and at most 32,768"),
    (("a.glb", "--box", 0, 0, 0, 1 << 34, 1 << 34, 1 << 34), "at most 32,768"),
    (("a.glb", "--box", (1 << 35) - 1, 0, 0, 1 << 35, 0, 0), f"x is {1 << 35}"),
    (("a.glb", "--chunk", 0, 0, -(1 << 40)), f"z is {-(1 << 40)}"),
    (("a.glb", "--chunk", 0, 0, 0, "--lod", 21), "lod is 21"),
    (("a.glb", "--chunk", 0, 0, 0, "--cells", 33), "cells is 33"),
    (("a.glb", "--chunk", 0, 0, 0, "--voxel-size", 0), "voxel_size is 0.0"),
    (("a.glb", "--chunk", 0, 0, 0, "--seed", 1 << 63), f"seed is {1 << 63}"),
    (("a.glb", "--chunk", 0, 0, 0, "--recipe", "terain"), "'terain'"),
    (("a.mesh", "--box", 0, 0, 0, 0, 0, 1), "a .mesh holds one chunk"),
    (("a.glb", "--chunk", 0, 0, 0, "--profile", "f32"), "--profile f32 does not apply to .glb"),
    (("a.mesh", "--chunk", 0, 0, 0, "--frame", "box"), "--frame box does not apply to .mesh"),
    (("-", "--chunk", 0, 0, 0), "'-' ends in none"),
    (("-", "--format", "glb", "--chunk", 0, 0, 0, "--json"), "--json"),
]


@pytest.mark.parametrize(("arguments", "said"), REFUSED)
def test_what_cannot_be_is_refused_before_anything_is_built(tmp_path, monkeypatch, arguments, said):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(mesh, "make_ready", None)
    assert said in refused(2, "mesh", *arguments)
    assert list(tmp_path.iterdir()) == []


def test_where_it_cannot_be_written_is_known_before_anything_is_built(tmp_path, monkeypatch):
    monkeypatch.setattr(mesh, "make_ready", None)
    (tmp_path / "folder.glb").mkdir()
    assert "there is no folder" in refused(1, "mesh", tmp_path / "none" / "a.glb", "--chunk", 0, 0, 0)
    assert "it is a folder" in refused(1, "mesh", tmp_path / "folder.glb", "--chunk", 0, 0, 0)
    assert "File name too long" in refused(1, "mesh", tmp_path / f"{'x' * 300}.glb", "--chunk", 0, 0, 0)


def test_too_many_triangles_end_it_and_leave_what_was_there(tmp_path, ball_json, monkeypatch):
    monkeypatch.setattr(building, "TRIANGLES_MAX", 5000)
    file = tmp_path / "a.glb"
    file.write_bytes(b"before")
    assert "more than 5,000 triangles" in refused(1, "mesh", file, "--recipe", ball_json, *SPHERE_BOX)
    assert file.read_bytes() == b"before"
    assert list(tmp_path.iterdir()) == [file]


def test_a_disk_that_is_full_leaves_what_was_there(tmp_path, monkeypatch):
    class Full(io.FileIO):
        def write(self, body):
            super().write(body[:10])
            raise OSError(28, "No space left on device")

    file = tmp_path / "a.glb"
    file.write_bytes(b"before")
    monkeypatch.setattr("chunkserver.commands.files._new", lambda path: Full(path, "x"))
    assert refused(1, "mesh", file, "--chunk", 0, 0, 0).endswith("cannot be written: No space left on device")
    assert file.read_bytes() == b"before"
    assert list(tmp_path.iterdir()) == [file]


def test_a_named_pipe_is_written_to_and_stays(tmp_path):
    """As a device does, that only root could lose: /dev/null."""
    pipe = tmp_path / "pipe.glb"
    os.mkfifo(pipe)
    reader = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)  # so that no writer waits for one
    try:
        ended = run("mesh", pipe, "--chunk", 0, 0, 0)
        assert ended.exit_code == 0, ended.output
        assert os.read(reader, 1 << 16).startswith(b"glTF")
    finally:
        os.close(reader)
    assert pipe.is_fifo()


def test_a_link_stays_and_what_it_names_is_replaced(tmp_path):
    link, file = tmp_path / "link.glb", tmp_path / "a.glb"
    link.symlink_to(file)
    written(link, "--chunk", 0, 0, 0)
    assert link.is_symlink()
    assert not file.is_symlink()


def test_a_file_is_replaced_as_a_whole(tmp_path):
    """Whoever has the old one open goes on reading the old one."""
    file, old = tmp_path / "a.glb", tmp_path / "old.glb"
    file.write_bytes(b"before")
    old.hardlink_to(file)
    written(file, "--chunk", 0, 0, 0)
    assert old.read_bytes() == b"before"
    assert {path.name for path in tmp_path.iterdir()} == {"a.glb", "old.glb"}


@pytest.mark.parametrize("sides", [(4, 1, 1), (1, 4, 1), (1, 1, 4), (2, 3, 4), (32, 32, 32), *longest()])
def test_positions_are_the_same_if_all_three_coordinates_are(sides, rng):
    """Points that are one step apart on one axis, and any number of half chunks on another, are two points."""
    high = ChunkKey(0, *(side - 1 for side in sides))
    steps = np.array(list(product((0, 1), (0, 1), (0, 1), range(0, 49153 - 16384, 16384))))
    positions = np.full((3 * len(steps), 4), 65535, np.uint16)
    for axis in range(3):
        rows_of_axis = positions[axis * len(steps) : (axis + 1) * len(steps)]
        rows_of_axis[:, :3] = 16384 + steps[:, :3]
        rows_of_axis[:, axis] = 16384 + steps[:, 3]
    triangles = as_indices(np.arange(len(positions), dtype=np.uint32).reshape(-1, 3), len(positions))
    normals = np.zeros((len(positions), 3), np.float32)
    made = Mesh("surface", positions, normals, triangles)
    keys = {ChunkKey(0, 0, 0, 0), high} | {ChunkKey(0, *place) for place in rng.integers(0, sides, (40, 3)).tolist()}
    welded = welding.weld([(key, made) for key in keys], ChunkKey(0, 0, 0, 0), high)
    expected = {
        tuple(point)
        for key in keys
        for point in (positions[:, :3].astype(int) - 16384 + 32768 * np.array(key[1:])).tolist()
    }
    assert len(welded.points) == len(expected)
    assert rows(welded.points) == expected


def test_the_longest_formats_of_a_lattice_unit():
    """Every position that a chunk can have is written to the digit, for any power of two."""
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 32767]])
    welded = welding.Welded(points, np.tile(np.array([0, 1, 0], np.float32), (3, 1)), np.array([[0, 2, 1]]))
    for exponent in range(-31, 31, 6):
        unit = 2.0**exponent
        body, error = export(welded, Placed(unit, (0.0, 0.0, 0.0), False), "obj")
        assert error == 0
        lines = [line.split()[1:] for line in body.decode().splitlines() if line.startswith("v ")]
        assert [[float(number) for number in line] for line in lines] == (points * unit).tolist()


def test_every_chunk_of_the_box_is_asked_for_once():
    keys = [ChunkKey(1, *place) for place in product(range(3), repeat=3)]
    built = building.build(ChunkRequest(SPHERE, keys[0], encoding=Encoding(profile="f32")), keys)
    assert sum(built.contents.values()) == 27
    assert [key for key, _ in built.surfaces] == [key for key in keys if key in dict(built.surfaces)]
