"""A plan's requests and answers are those that a route would make of each URL by itself."""

from dataclasses import fields, replace

import pytest

from chunkserver.errors import BadKey
from chunkserver.grid import ChunkKey
from chunkserver.pipeline import ChunkRequest
from chunkserver.recipe import WorldRecipe, builtin
from chunkserver.server.etag import etag
from chunkserver.server.plan import Plan
from chunkserver.wire import Encoding

TEMPLATE = ChunkRequest(
    WorldRecipe(42, builtin("terrain")),
    ChunkKey(0, 0, 0, 0),
    cells=16,
    voxel_size=0.5,
    seam="none",
    revision=7,
    encoding=Encoding("glb", frame="chunk", coding="zstd"),
)


def plan_of(template=TEMPLATE, **more):
    return Plan.of(template, {"Cache-Control": "no-cache"}, lambda: True, **more)


def test_a_request_differs_in_its_key_alone():
    key = ChunkKey(3, 1, -2, 5)
    assert plan_of().request(key) == replace(TEMPLATE, key=key)
    unlike = {field.name for field in fields(TEMPLATE) if getattr(TEMPLATE, field.name) != field.default}
    assert unlike >= {"cells", "voxel_size", "seam", "revision", "encoding"}, "defaults would hide what is left out"


@pytest.mark.parametrize("epoch", ["", "01ab"])
def test_its_tags_are_those_of_the_requests(epoch):
    plan = plan_of(epoch=epoch)
    keys = [
        ChunkKey(0, 0, 0, 0),
        ChunkKey(1, 0, 0, 0),
        ChunkKey(0, 1, 10, 0),
        ChunkKey(0, 11, 0, 0),
        ChunkKey(0, -1, 0, 0),
    ]
    assert [plan.tag(key) for key in keys] == [etag(replace(TEMPLATE, key=key), epoch) for key in keys]
    assert len({plan.tag(key) for key in keys}) == len(keys)


def test_a_key_outside_is_refused():
    plan = plan_of(lods=5)
    plan.check(ChunkKey(4, 0, 0, 0))
    for key in (ChunkKey(5, 0, 0, 0), ChunkKey(0, 1 << 36, 0, 0)):
        with pytest.raises(BadKey):
            plan.check(key)
