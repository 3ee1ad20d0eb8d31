"""A plan's requests and answers are those that a route would make of each URL by itself."""

from dataclasses import fields, replace

import pytest

from chunkserver.errors import BadKey
from chunkserver.grid import ChunkKey
from chunkserver.pipeline import Chunk, ChunkRequest
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
    encoding=Encoding("glb", frame="chunk", coding="zstd"),
)


def plan_of(template=TEMPLATE, **more):
    return Plan.of(template, lambda revision: {"Chunk-Revision": str(revision)}, lambda: True, **more)


def last_edit(key):
    """Only the chunks at y = 1 are edited."""
    return 7 if key.y == 1 else 0


def test_a_request_differs_in_its_key_and_revision_alone():
    plan = plan_of(last_edit=last_edit)
    for key, revision in ((ChunkKey(3, 1, -2, 5), 0), (ChunkKey(3, 1, 1, 5), 7)):
        assert plan.request(plan.current(key)) == replace(TEMPLATE, key=key, revision=revision)
    unlike = {field.name for field in fields(TEMPLATE) if getattr(TEMPLATE, field.name) != field.default}
    assert unlike >= {"cells", "voxel_size", "seam", "encoding"}, "defaults would hide what is left out"


@pytest.mark.parametrize("epoch", ["", "01ab"])
def test_its_tags_are_those_of_the_requests(epoch):
    plan = plan_of(epoch=epoch, last_edit=last_edit)
    keys = [
        ChunkKey(0, 0, 0, 0),
        ChunkKey(1, 0, 0, 0),
        ChunkKey(0, 1, 10, 0),
        ChunkKey(0, 11, 0, 0),
        ChunkKey(0, -1, 0, 0),
        ChunkKey(0, 0, 1, 0),
    ]
    versions = [plan.current(key) for key in keys]
    assert [version.tag for version in versions] == [etag(plan.request(version), epoch) for version in versions]
    assert len({version.tag for version in versions}) == len(keys)
    assert plan.current(keys[-1]).tag != plan_of(epoch=epoch).current(keys[-1]).tag


def test_an_edit_changes_the_headers_of_its_chunks_alone():
    plan = plan_of(last_edit=last_edit)
    for key, revision in ((ChunkKey(0, 0, 0, 0), b"0"), (ChunkKey(0, 0, 1, 0), b"7")):
        version = plan.current(key)
        for reply in (plan.not_modified(version), plan.found(version, Chunk("surface", b"x", version.revision))):
            assert dict(reply.headers)[b"chunk-revision"] == revision
            assert dict(reply.headers)[b"etag"] == b'"%b"' % version.tag.encode()
            assert reply.version == version


def test_a_key_outside_is_refused():
    plan = plan_of(lods=5)
    plan.check(ChunkKey(4, 0, 0, 0))
    for key in (ChunkKey(5, 0, 0, 0), ChunkKey(0, 1 << 36, 0, 0)):
        with pytest.raises(BadKey):
            plan.check(key)


def test_a_chunk_that_was_edited_while_it_was_built_is_answered_as_what_it_is():
    plan = plan_of(last_edit=last_edit)
    asked = plan.current(ChunkKey(0, 0, 1, 0))
    later = asked._replace(revision=9, tag=etag(plan.request(asked._replace(revision=9))))
    assert plan.shown(asked, Chunk("surface", b"x", 7)) is asked
    assert plan.tag_shown(asked, Chunk("surface", b"x", 9)) == later.tag
    reply = plan.found(asked, Chunk("surface", b"x", 9))
    assert reply.version == later
    assert dict(reply.headers)[b"chunk-revision"] == b"9"
