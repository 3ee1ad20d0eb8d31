import dataclasses
from typing import Any

import pytest

from chunkserver.grid import ChunkKey
from chunkserver.pipeline import ChunkRequest
from chunkserver.recipe import WorldRecipe, builtin
from chunkserver.server import etag as module
from chunkserver.server.etag import etag, is_known
from chunkserver.wire import Encoding

REQUEST = ChunkRequest(WorldRecipe(42, builtin("terrain")), ChunkKey(0, 0, 0, 0))
OTHERS: dict[str, list[Any]] = {
    "recipe": [WorldRecipe(43, builtin("terrain")), WorldRecipe(42, builtin("hills"))],
    "key": [ChunkKey(1, 0, 0, 0), ChunkKey(0, 1, 0, 0), ChunkKey(0, 0, 1, 0), ChunkKey(0, 0, 0, 1)],
    "cells": [64],
    "voxel_size": [0.5],
    "mesher": ["another"],
    "coarser": [1],
    "seam": ["none"],
    "revision": [1],
    "encoding": [Encoding("glb"), Encoding(profile="f32"), Encoding("glb", frame="chunk")],
}


def test_every_field_of_a_request_makes_another_tag():
    assert set(OTHERS) == {field.name for field in dataclasses.fields(ChunkRequest)}
    requests = [REQUEST] + [dataclasses.replace(REQUEST, **{name: value}) for name in OTHERS for value in OTHERS[name]]
    assert len({etag(request) for request in requests}) == len(requests)


def test_equal_requests_have_one_tag():
    assert etag(REQUEST) == etag(dataclasses.replace(REQUEST))


def test_a_long_recipe_is_not_written_out():
    class Source(str):
        __slots__ = ()

        def __repr__(self):
            raise AssertionError("64 KB for every request")

    written = dataclasses.replace(REQUEST, recipe=WorldRecipe(42, Source(REQUEST.recipe.source)))
    assert etag(written) == etag(REQUEST)


def test_an_epoch_makes_another_tag():
    assert len({etag(REQUEST), etag(REQUEST, "01ab"), etag(REQUEST, "23cd")}) == 3
    assert etag(REQUEST) == etag(REQUEST, "")


def test_another_generator_makes_another_tag(monkeypatch):
    before = etag(REQUEST)
    monkeypatch.setattr(module, "generator", lambda _recipe: "another")
    assert etag(REQUEST) != before


@pytest.mark.parametrize(
    ("fields", "known"),
    [
        ([], False),
        (['"abc"'], True),
        (['W/"abc"'], True),
        (['"x", W/"y" , "abc"'], True),
        (['"x"', '"abc"'], True),
        (["*"], True),
        ([" * "], True),
        (['"x, *"'], False),
        (["abc"], False),
        (['"abcd"', '"ab"', '""'], False),
    ],
)
def test_if_none_match(fields, known):
    assert is_known(fields, "abc") == known
