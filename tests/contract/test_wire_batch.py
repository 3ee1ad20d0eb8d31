"""docs/wire/batch-v1.md: a decoder made of the page's own tables reads the example, and what the server writes."""

import re
import struct
from collections.abc import Iterator
from http import HTTPStatus
from pathlib import Path
from typing import Any, Final

from chunkserver.server import frames
from chunkserver.wire import CODINGS

PAGE: Final = (Path(__file__).parents[2] / "docs/wire/batch-v1.md").read_text()
LETTERS: Final = {"char": "s", "u8": "B", "u16": "H", "u32": "I", "u64": "Q"}
TAGS: Final = ("0123456789abcdef" * 2, "fedcba9876543210" * 2)

Fields = list[tuple[int, str, str]]


def fields(title: str) -> Fields:
    """Return (offset, struct format, name) of each row of a section's table of fields."""
    (section,) = re.findall(rf"^## {title}\n(.*?)(?=^## |\Z)", PAGE, re.DOTALL | re.MULTILINE)
    rows = re.findall(r"^\| (\d+) \| `(\w+?)(?:\[(\d+)\])?` \| `(\w+)` \|", section, re.MULTILINE)
    return [(int(offset), f"<{count}{LETTERS[kind]}", name) for offset, kind, count, name in rows]


STREAM: Final = fields("Stream header")
FRAME: Final = fields("Frame header")


def read(layout: Fields, stream: bytes, at: int) -> dict[str, Any]:
    return {name: struct.unpack_from(kind, stream, at + offset)[0] for offset, kind, name in layout}


def decode(stream: bytes) -> Iterator[tuple[dict[str, Any], bytes]]:
    """Yield each frame's header and body; the stream is whole."""
    head = read(STREAM, stream, 0)
    assert (head["magic"], head["version"]) == (b"CHNB", 1)
    at, count = 16, 0
    while True:
        found = read(FRAME, stream, at)
        at += head["frame_header_bytes"]
        body = stream[at : at + found["body_bytes"]]
        padded = -(-len(body) // 16) * 16
        assert stream[at + len(body) : at + padded] == bytes(padded - len(body))
        at += padded
        if found["index"] == 4294967295:
            assert (found["count"], at) == (count, len(stream))
            return
        count += 1
        yield found, body


def example() -> bytes:
    (dump,) = re.findall(r"^```hex batch\n(.*?)^```$", PAGE, re.DOTALL | re.MULTILINE)
    return bytes.fromhex("".join(row.split(maxsplit=1)[1] for row in dump.splitlines()))


def test_the_tables_leave_no_gap():
    for layout, size in ((STREAM, 16), (FRAME, 64)):
        end = 0
        for offset, kind, _ in layout:
            assert offset == end
            end += struct.calcsize(kind)
        assert end == size


def test_the_example_is_what_the_page_says_and_what_is_written():
    (air, nothing), (had, no_body) = decode(example())
    assert (air["index"], air["status"], air["content"], nothing) == (0, 204, 1, b"")
    assert (had["index"], had["status"], had["etag"], no_body) == (1, 304, TAGS[1].encode(), b"")
    written = [
        frames.stream_header(0),
        *frames.frame(0, HTTPStatus.NO_CONTENT, content="air", tag=TAGS[0]),
        *frames.frame(1, HTTPStatus.NOT_MODIFIED, tag=TAGS[1]),
        frames.end(2),
    ]
    assert b"".join(written).hex(" ", 16) == example().hex(" ", 16)


def test_whatever_is_written_is_read():
    contents = {1: "air", 2: "rock", 3: "surface"}
    written, expected = [frames.stream_header(7)], list[tuple[int, int, int, int, bytes]]()
    for size in (0, 1, 15, 16, 17, 70_000):
        for coding in CODINGS:
            for number, content in contents.items():
                index, body = len(expected), (bytes(range(256)) * 300)[:size]
                revision = (1 << 63) - 1 - index
                written += frames.frame(
                    index, HTTPStatus.OK, body=body, content=content, coding=coding, revision=revision, tag=TAGS[0]
                )
                expected.append((index, number, list(CODINGS).index(coding), revision, body))
    stream = b"".join([*written, frames.end(len(expected))])
    found = [(head["index"], head["content"], head["coding"], head["revision"], body) for head, body in decode(stream)]
    assert found == expected
    assert read(STREAM, stream, 0)["world_revision"] == 7
    rows = dict(re.findall(r"(\d) (none|gzip|zstd)", PAGE))
    assert [rows[str(number)].replace("none", "identity") for number in range(len(CODINGS))] == list(CODINGS)
