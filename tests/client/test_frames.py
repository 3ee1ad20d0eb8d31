"""docs/wire/batch-v1.md, decoded, in pieces of any size; mutated streams are refused, or give frames."""

import struct

import hypothesis.strategies as st
import pytest
from hypothesis import given

from chunkserver_client import BadAnswer
from chunkserver_client.frames import Frame, FrameReader
from tests.client.pages import BATCH, hexdump

EXAMPLE = hexdump(BATCH, "batch")
TAGS = ("0123456789abcdef" * 2, "fedcba9876543210" * 2)
FRAMES = [Frame(0, 204, "air", "identity", 0, TAGS[0], b""), Frame(1, 304, None, "identity", 0, TAGS[1], b"")]


def with_body(body: bytes, coding: int = 0) -> bytes:
    """Return a stream of one frame."""
    frame = struct.pack("<2IH2BIQ32sQ", len(body), 0, 200, 3, coding, 0, 7, TAGS[0].encode(), 0)
    end = struct.pack("<2IH2BIQ32sQ", 0, 0xFFFFFFFF, 200, 0, 0, 1, 0, b"", 0)
    return EXAMPLE[:16] + frame + body + bytes(-len(body) % 16) + end


def read(stream: bytes, size: int, bytes_max: int = 1 << 20) -> tuple[list[Frame], bool]:
    """Return the frames of a stream that comes in pieces, and whether it was whole."""
    reader = FrameReader(bytes_max)
    found = [frame for at in range(0, len(stream), size) for frame in reader.feed(stream[at : at + size])]
    return found, reader.is_done


@pytest.mark.parametrize("size", [1, 7, 16, 64, 1000])
def test_the_example(size: int):
    assert read(EXAMPLE, size) == (FRAMES, True)


@pytest.mark.parametrize("size", [1, 15, 16, 17, 1000])
@pytest.mark.parametrize("length", [0, 1, 15, 16, 17, 5000])
def test_a_body(size: int, length: int):
    body = bytes(range(256)) * 20
    ((frame,), done) = read(with_body(body[:length], 2), size)
    assert (frame.body, frame.revision, frame.content, frame.coding, done) == (
        body[:length],
        7,
        "surface",
        "zstd",
        True,
    )


def test_a_longer_frame_header_is_skipped():
    stream = bytearray(EXAMPLE[:16])
    stream[6:8] = struct.pack("<H", 80)
    for start in (16, 80, 144):
        stream += EXAMPLE[start : start + 64] + b"?" * 16
    assert read(bytes(stream), 9) == (FRAMES, True)


@pytest.mark.parametrize("length", range(0, len(EXAMPLE), 5))
def test_a_stream_that_is_cut_is_not_done(length: int):
    frames, done = read(EXAMPLE[:length], 1000)
    assert frames == FRAMES[: len(frames)]
    assert not done


@pytest.mark.parametrize(
    ("at", "word"),
    [
        (0, b"CHNK"),
        (4, b"\x02"),
        (6, b"\x30"),
        (6, b"\x48"),
        (6, b"\xf0\xff"),
        (26, b"\x04"),
        (27, b"\x03"),
        (39, b"\xff"),
        (40, b"\xff"),
        (16, b"\xff\xff\xff\x7f"),
        (156, b"\x01"),
    ],
)
def test_what_is_wrong_is_refused(at: int, word: bytes):
    with pytest.raises(BadAnswer):
        read(EXAMPLE[:at] + word + EXAMPLE[at + len(word) :], 1000)


def test_what_follows_the_end_is_refused():
    with pytest.raises(BadAnswer, match="follow"):
        read(EXAMPLE + b"x", 1000)


@given(st.lists(st.tuples(st.integers(0, len(EXAMPLE) - 1), st.integers(1, 255)), max_size=4), st.integers(1, 300))
def test_flips(flips: list[tuple[int, int]], size: int):
    stream = bytearray(EXAMPLE)
    for at, mask in flips:
        stream[at] ^= mask
    try:
        frames, _ = read(bytes(stream), size, 1 << 16)
    except BadAnswer:
        return
    assert len(frames) <= 3, "the end frame may have become one of them"
