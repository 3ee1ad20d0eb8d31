"""docs/wire/glb.md, decoded; and each way in which a GLB can be wrong, refused."""

import copy
from typing import Any

import numpy as np
import pytest

from chunkserver_client import GLB_MEDIA_TYPE, BadChunk, decode
from tests.client.gltf import empty_glb, glb, scene
from tests.client.pages import NATIVE, hexdump


@pytest.mark.parametrize("frame", ["world", "chunk"])
def test_a_glb_is_the_mesh_of_the_native_example(frame: str):
    file = glb(scene(frame))
    mesh, wanted = decode(file, GLB_MEDIA_TYPE), decode(hexdump(NATIVE, "std"))
    for name in ("key", "cells", "voxel_size", "content", "revision", "coarser", "profile", "low", "high"):
        assert getattr(mesh, name) == getattr(wanted, name)
    for name in ("positions", "normals", "triangles"):
        found = getattr(mesh, name)
        assert found.tolist() == getattr(wanted, name).tolist()
        assert np.shares_memory(found, np.frombuffer(file, np.uint8))
        assert not found.flags.writeable
    assert mesh.positions_in_metres().tolist() == wanted.positions_in_metres().tolist()


def test_an_empty_glb():
    mesh = decode(empty_glb(), GLB_MEDIA_TYPE)
    assert (mesh.content, mesh.key, mesh.revision, len(mesh.positions)) == ("rock", (2, -3, 0, 5), 7, 0)


HUGE = 10**400
WRONG: list[tuple[str, Any]] = [
    ("nodes.0.extras.lod", "21"),
    ("nodes.0.extras.lod", "02"),
    ("nodes.0.extras.lod", 2),
    ("nodes.0.extras.x", str(2**40)),
    ("nodes.0.extras.x", "-4"),
    ("nodes.0.extras.cells", 33),
    ("nodes.0.extras.cells", True),
    ("nodes.0.extras.voxel_size", 0),
    ("nodes.0.extras.voxel_size", HUGE),
    ("nodes.0.extras.revision", "-1"),
    ("nodes.0.extras.coarser", 64),
    ("nodes.0.extras.content", "lava"),
    ("nodes.0.extras.content", "air"),
    ("nodes.0.extras", None),
    ("nodes.0.mesh", None),
    ("nodes.0.mesh", 1),
    ("nodes.0.scale", [1, 1, 1]),
    ("nodes.0.translation", [0, 0]),
    ("nodes.0.translation.1", 1),
    ("nodes", []),
    ("meshes.0.primitives.0.mode", 5),
    ("meshes.0.primitives.0.indices", -1),
    ("meshes.0.primitives.0.indices", 1),
    ("accessors.0.sparse", {}),
    ("accessors.0.componentType", 5126),
    ("accessors.0.type", "VEC2"),
    ("accessors.0.normalized", True),
    ("accessors.1.normalized", False),
    ("accessors.0.count", 5),
    ("accessors.0.count", -1),
    ("accessors.0.count", HUGE),
    ("accessors.0.byteOffset", 1 << 31),
    ("accessors.0.min", [1, 2]),
    ("accessors.0.min", [65535, 0, 0]),
    ("accessors.2.count", 5),
    ("bufferViews.0.byteOffset", 60),
    ("bufferViews.0.byteOffset", -8),
    ("bufferViews.0.byteLength", 1 << 40),
    ("bufferViews.0.byteStride", 4),
    ("bufferViews.2.byteStride", 4),
    ("bufferViews.2.byteOffset", 0),
    ("bufferViews.2.byteLength", 20),
    ("bufferViews.2.buffer", 1),
    ("extensionsRequired", ["KHR_mesh_quantization", "KHR_draco_mesh_compression"]),
    ("extensionsRequired", None),
]


@pytest.mark.parametrize(("path", "value"), WRONG)
def test_what_is_wrong_is_refused(path: str, value: Any):
    tree = copy.deepcopy(scene())
    *way, last = [int(name) if name.isdecimal() else name for name in path.split(".")]
    holder: Any = tree
    for name in way:
        holder = holder[name]
    holder[last] = value
    with pytest.raises(BadChunk) as raised:
        decode(glb(tree), GLB_MEDIA_TYPE)
    assert len(str(raised.value)) < 400


@pytest.mark.parametrize("text", ["[" * 60_000, "{", "NaN", "1e999", '"\\ud800"', "1" * 5000, "", "\xff"])
def test_a_text_that_is_no_scene_is_refused(text: str):
    whole = glb({})
    head = text.encode("latin-1")
    head += b" " * (-len(head) % 4)
    file = whole[:8] + (20 + len(head)).to_bytes(4, "little") + len(head).to_bytes(4, "little") + b"JSON" + head
    with pytest.raises(BadChunk):
        decode(file, GLB_MEDIA_TYPE)
