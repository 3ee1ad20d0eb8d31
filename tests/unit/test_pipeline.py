"""From a request to bytes: what is refused, what the bytes depend on, and what the generator token names."""

import math
import pickle
from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest

from chunkserver import pipeline
from chunkserver.errors import BadKey, BadParameter, BadRecipe, DeadlinePassed
from chunkserver.field import sample
from chunkserver.geometric_error import geometric_error
from chunkserver.grid import LOD_MAX, ChunkKey, ChunkShape
from chunkserver.mesher import extract
from chunkserver.pipeline import STAGES, ChunkRequest, build_chunk, build_mesh, check_request, generator
from chunkserver.recipe import WorldRecipe, builtin, canonical
from chunkserver.wire import FORMATS, Encoding, Placement, encode
from tests.worlds import crowded

TERRAIN = WorldRecipe(7, builtin("terrain"))
REQUEST = ChunkRequest(TERRAIN, ChunkKey(0, 0, -1, 0))

WRONG = [
    ("cells", 24, "cells is 24"),
    ("key", ChunkKey(21, 0, 0, 0), "lod is 21"),
    ("key", ChunkKey(-1, 0, 0, 0), "lod is -1"),
    ("key", ChunkKey(0, 1 << 35, 0, 0), f"x is {1 << 35}"),
    ("key", ChunkKey(0, 0, -(1 << 35) - 1, 0), f"y is {-(1 << 35) - 1}"),
    ("key", ChunkKey(20, 0, 0, 1 << 15), f"z is {1 << 15}"),
    ("mesher", "dual", "mesher is 'dual'"),
    ("seam", "walls", "seam is 'walls'"),
    ("coarser", -1, "coarser is -1"),
    ("coarser", 64, "coarser is 64"),
    ("voxel_size", 0.0, "voxel_size is 0.0"),
    ("voxel_size", -1.0, "voxel_size is -1.0"),
    ("voxel_size", math.nan, "voxel_size is nan"),
    ("voxel_size", 1e9, "voxel_size is 1000000000.0"),
    ("revision", -1, "revision is -1"),
    ("revision", 1 << 63, f"revision is {1 << 63}"),
    ("encoding", Encoding("obj"), "format is 'obj'"),
    ("encoding", Encoding("mesh", "godot4"), "profile is 'godot4'"),
]


@pytest.mark.parametrize(("field", "value", "named"), WRONG)
def test_a_bad_value_is_named_before_anything_is_built(field, value, named, monkeypatch):
    request = replace(REQUEST, **{field: value})
    monkeypatch.setattr(pipeline, "sample", None)
    for refuse in (check_request, build_chunk):
        with pytest.raises(BadKey if field == "key" else BadParameter, match=named) as refused:
            refuse(request)
        assert refused.value.values


@pytest.mark.parametrize("seam", ["none", "skirts"])
def test_a_mask_needs_transitions(seam):
    with pytest.raises(BadParameter, match=f"coarser is 4; it needs seam=transitions, and seam is '{seam}'") as refused:
        check_request(replace(REQUEST, coarser=4, seam=seam))
    assert refused.value.values == {"coarser": 4, "seam": seam}


def test_nothing_is_coarser_than_the_last_level():
    for lod in range(LOD_MAX):
        check_request(replace(REQUEST, key=ChunkKey(lod, 0, -1, 0), coarser=63))
    last = replace(REQUEST, key=ChunkKey(LOD_MAX, 0, -1, 0))
    check_request(last)
    with pytest.raises(BadParameter, match="coarser is 1; nothing is coarser than lod 20") as refused:
        check_request(replace(last, coarser=1))
    assert refused.value.values == {"coarser": 1}


def test_a_recipe_of_too_many_registers_is_refused_when_it_is_built():
    """As the docstrings say: by `build_chunk`, not by `check_request`."""
    request = replace(REQUEST, recipe=WorldRecipe(7, canonical(crowded())))
    check_request(request)
    with pytest.raises(BadRecipe, match="registers"):
        build_chunk(request)


def test_what_is_right_is_left_alone():
    check_request(REQUEST)
    limit = 1 << 35
    for key in (ChunkKey(0, -limit, -limit, -limit), ChunkKey(0, limit - 1, limit - 1, limit - 1)):
        check_request(replace(REQUEST, key=key))


@pytest.mark.parametrize("cells", [16, 32, 64])
def test_bytes_are_those_of_the_three_steps(cells):
    key, f32 = ChunkKey(1, 3, -1, 0), Encoding(profile="f32")
    mesh = extract(sample(TERRAIN, key, ChunkShape(cells, 1)), normals="float32")
    chunk = build_chunk(ChunkRequest(TERRAIN, key, cells, voxel_size=0.5, revision=9, encoding=f32))
    assert chunk.content == mesh.content == "surface"
    assert chunk.body == encode(
        mesh, Placement(key, cells, 0.5, 9, geometric_error=geometric_error(TERRAIN, 1) / 2), f32
    )


def placed(request: ChunkRequest) -> Placement:
    return Placement(request.key, 32, 1.0, geometric_error=geometric_error(request.recipe, request.key.lod))


def test_defaults_are_a_native_chunk_of_32_cells_of_a_metre():
    mesh = extract(sample(TERRAIN, REQUEST.key, ChunkShape(32, 1)))
    assert build_chunk(REQUEST).body == encode(mesh, placed(REQUEST))


ENCODINGS = [Encoding(), Encoding(profile="f32"), Encoding("glb"), Encoding("glb", frame="chunk")]


@pytest.mark.parametrize("encoding", ENCODINGS)
@pytest.mark.parametrize("cells", [16, 32, 64])
def test_the_same_request_gives_the_same_bytes(cells, encoding):
    request = replace(REQUEST, cells=cells, encoding=encoding)
    copy = pickle.loads(pickle.dumps(request))
    assert copy == request
    assert hash(copy) == hash(request)
    assert build_chunk(copy) == build_chunk(request)


def test_a_pickle_keeps_every_field():
    full = ChunkRequest(TERRAIN, REQUEST.key, 16, 0.5, "m", 3, "s", 9, Encoding("f", "p", "r", "c"))
    assert all(getattr(full, field.name) != getattr(REQUEST, field.name) for field in fields(full)[2:])
    assert pickle.loads(pickle.dumps(full)) == full


@pytest.mark.parametrize(("y", "stages"), [(-1, STAGES), (9, ("field", "encode"))])
def test_each_stage_is_told_of_when_it_begins(y, stages):
    told: list[str] = []
    assert build_chunk(replace(REQUEST, key=ChunkKey(0, 0, y, 0)), told.append).body
    assert tuple(told) == stages


@pytest.mark.parametrize("last", STAGES)
def test_who_is_told_of_a_stage_may_end_the_build(last):
    told: list[str] = []

    def stage(name: str) -> None:
        told.append(name)
        if name == last:
            raise DeadlinePassed("too late")

    with pytest.raises(DeadlinePassed):
        build_chunk(REQUEST, stage)
    assert told[-1] == last


OTHER: dict[str, Any] = {
    "recipe": replace(TERRAIN, seed=8),
    "key": ChunkKey(0, 1, -1, 0),
    "cells": 16,
    "voxel_size": 2.0,
    "coarser": 5,
    "seam": "skirts",
    "revision": 1,
    "encoding": Encoding("glb"),
}
"""Another value of each field of a request that changes its bytes."""

ONE_VALUE = {"mesher"}
"""Fields of which one value is built."""


@pytest.mark.parametrize("field", OTHER)
def test_bytes_depend_on_each_field(field):
    assert build_chunk(replace(REQUEST, **{field: OTHER[field]})).body != build_chunk(REQUEST).body


def test_no_field_of_a_request_is_forgotten_here():
    assert {field.name for field in fields(ChunkRequest)} == OTHER.keys() | ONE_VALUE


@pytest.mark.parametrize(("y", "content"), [(-1, "surface"), (9, "air")])
def test_a_chunk_says_its_error_in_metres(y, content):
    request = replace(REQUEST, key=ChunkKey(1, 0, y, 0), voxel_size=0.25)
    metres = geometric_error(TERRAIN, 1) / 4
    for encoding in (Encoding(), Encoding("glb")):
        chunk = build_chunk(replace(request, encoding=encoding))
        assert chunk.content == content
        assert FORMATS[encoding.format].examine(chunk.body).facts["geometric_error"] == metres


def test_transitions_change_nothing_while_no_neighbour_is_coarser():
    assert build_chunk(replace(REQUEST, seam="none")) == build_chunk(REQUEST)


def test_a_chunk_with_a_mask_is_that_of_the_three_steps():
    request = replace(REQUEST, key=ChunkKey(2, 0, -1, 0), coarser=9)
    mesh = extract(sample(TERRAIN, request.key, ChunkShape(32, 1), 9))
    assert build_chunk(request).body == encode(mesh, placed(request)._replace(coarser=9), Encoding())


@pytest.mark.parametrize("mask", [1, 6, 63])
def test_an_empty_chunk_has_nothing_to_close(mask):
    world = WorldRecipe(7, builtin("hills"))
    chunks = [build_chunk(ChunkRequest(world, ChunkKey(0, 0, y, 0), coarser=mask)) for y in (9, -9)]
    assert [chunk.content for chunk in chunks] == ["air", "rock"]


def test_rock_beside_air_of_the_next_level_has_a_surface():
    """A ball that is gone from LOD 1 on: all rock, and fitted to a neighbour that is all air."""
    ball = {"op": "detail", "a": {"op": "sphere", "radius": 64}, "factor": 1 / 16}
    request = ChunkRequest(WorldRecipe(7, canonical(ball)), ChunkKey(0, 1, 1, 1), 16)
    assert build_chunk(request).content == "rock"
    assert build_chunk(replace(request, coarser=1)).content == "surface"


@pytest.mark.parametrize("lod", [0, 2])
@pytest.mark.parametrize("name", ["floating-islands", "city"])
def test_worlds_of_thin_parts_have_skirts_too(name, lod):
    recipe, surfaces = WorldRecipe(7, builtin(name)), 0
    for y in range(-2, 3):
        request = ChunkRequest(recipe, ChunkKey(lod, 0, y, 0), seam="none")
        plain, skirted = build_mesh(request), build_mesh(replace(request, seam="skirts"))
        assert skirted.content == plain.content
        assert np.array_equal(skirted.positions[: len(plain.positions)], plain.positions)
        assert np.array_equal(skirted.normals[: len(plain.normals)], plain.normals)
        assert np.array_equal(skirted.triangles[: len(plain.triangles)], plain.triangles)
        surfaces += len(skirted.triangles) > len(plain.triangles) > 0
    assert surfaces > 0


@pytest.mark.parametrize("encoding", ENCODINGS)
@pytest.mark.parametrize(("y", "content"), [(9, "air"), (-9, "rock")])
def test_an_empty_chunk_is_no_error(y, content, encoding):
    world = WorldRecipe(7, builtin("hills"))
    chunk = build_chunk(ChunkRequest(world, ChunkKey(0, 0, y, 0), encoding=encoding))
    assert chunk.content == content
    assert isinstance(chunk.body, bytes)


def test_the_generator_names_the_recipe_and_the_sources_but_no_seed(monkeypatch):
    token = generator(TERRAIN)
    assert len(token) == 16
    assert int(token, 16) >= 0
    assert token == generator(replace(TERRAIN, seed=-3))
    assert token != generator(WorldRecipe(7, builtin("hills")))
    assert token != generator(WorldRecipe(7, builtin("terrain", relief=25.0)))
    monkeypatch.setattr(pipeline, "SOURCES_DIGEST", "other sources")
    assert token != generator(TERRAIN)
