import gzip
import struct
import subprocess
import sys
import zlib
from collections.abc import Callable
from itertools import product

import pytest

from chunkserver.errors import BadParameter
from chunkserver.grid import ChunkKey
from chunkserver.mesh import EMPTY, Mesh
from chunkserver.recipe import WorldRecipe, builtin
from chunkserver.wire import CODINGS, FORMATS, Encoding, check_encodable, encode
from tests.unit.wire.meshes import PLACEMENT, strip
from tests.worlds import chunk_mesh

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

TERRAIN = chunk_mesh(WorldRecipe(42, builtin("terrain")), ChunkKey(0, 0, -1, 0))
MESHES = {"terrain": TERRAIN, "small": strip(5), "air": EMPTY["air"], "rock": EMPTY["rock"]}
DECODERS: dict[str, Callable[[bytes], bytes]] = {"identity": bytes, "gzip": gzip.decompress, "zstd": zstd.decompress}

named_meshes = pytest.mark.parametrize("mesh", MESHES.values(), ids=MESHES)
formats = pytest.mark.parametrize("format_name", FORMATS)


def gunzip_of_node(body: bytes) -> bytes:
    """Another zlib than Python's, and another reader of gzip's header and trailer."""
    script = 'process.stdout.write(require("zlib").gunzipSync(require("fs").readFileSync(0)))'
    return subprocess.run(["node", "-e", script], input=body, capture_output=True, check=True).stdout


def test_rows():
    assert {name: row.version for name, row in CODINGS.items()} == {
        "identity": "",
        "gzip": f"zlib {zlib.ZLIB_RUNTIME_VERSION}",
        "zstd": f"zstd {zstd.zstd_version}",
    }
    assert [row.name for row in CODINGS.values()] == list(CODINGS)


@named_meshes
@formats
@pytest.mark.parametrize("coding", CODINGS)
def test_decodes_to_the_file(coding: str, format_name: str, mesh: Mesh):
    encoding = Encoding(format_name, coding=coding)
    file = encode(mesh, PLACEMENT, Encoding(format_name))
    coded = encode(mesh, PLACEMENT, encoding)
    assert DECODERS[coding](coded) == file
    assert encode(mesh, PLACEMENT, encoding) == coded
    if mesh is TERRAIN and coding != "identity":
        assert len(coded) < 0.8 * len(file)


@formats
def test_gzip_by_another_reader(format_name: str):
    file = encode(TERRAIN, PLACEMENT, Encoding(format_name))
    assert gunzip_of_node(encode(TERRAIN, PLACEMENT, Encoding(format_name, coding="gzip"))) == file


@named_meshes
def test_gzip_says_nothing_of_time_and_system(mesh: Mesh):
    coded = encode(mesh, PLACEMENT, Encoding(coding="gzip"))
    assert coded[:10] == bytes([0x1F, 0x8B, 8, 0, 0, 0, 0, 0, 4, 255])  # RFC 1952, section 2.3


@named_meshes
@formats
def test_zstd_says_the_size_of_its_content(format_name: str, mesh: Mesh):
    """RFC 8878, section 3.1.1: one segment, no dictionary, no checksum, the size of the content in 1, 2 or 4 bytes."""
    file = encode(mesh, PLACEMENT, Encoding(format_name))
    coded = encode(mesh, PLACEMENT, Encoding(format_name, coding="zstd"))
    magic, descriptor = struct.unpack_from("<IB", coded)
    assert magic == 0xFD2FB528
    assert descriptor & 0b00111111 == 0b00100000
    code, offset = [("<B", 0), ("<H", 256), ("<I", 0)][descriptor >> 6]
    assert struct.unpack_from(code, coded, 5)[0] + offset == len(file)
    assert zstd.get_frame_size(coded) == len(coded)


def test_what_is_not_built_is_named():
    for coding, format_name in product(("br", "GZIP", ""), FORMATS):
        encoding = Encoding(format_name, coding=coding)
        with pytest.raises(BadParameter, match=r"^coding is '.*'; built are \['identity', 'gzip', 'zstd'\]$") as caught:
            check_encodable(PLACEMENT, encoding)
        assert caught.value.values == {"coding": coding}
        with pytest.raises(BadParameter):
            encode(strip(5), PLACEMENT, encoding)
