"""docs/wire/edit_v1.examples.json, as the server reads and writes it; and frames that nobody thought of."""

import contextlib
import json
from pathlib import Path
from typing import Any

import hypothesis
import hypothesis.strategies as st
import pytest

from chunkserver.stream import answers, limits
from chunkserver.stream.messages import (
    BadMessage,
    FrameTooLarge,
    Hello,
    NewEdit,
    Subscribe,
    Unsubscribe,
    read_message,
)
from chunkserver.stream.ranges import Range, read_ranges
from chunkserver.stream.regions import Box, Region
from tests.unit.stream.worlds import edit_of

EXAMPLES = json.loads((Path(__file__).parents[3] / "docs/wire/edit_v1.examples.json").read_text())
CARVE = {"op": "carve", "shape": "sphere", "center": [8, 200, 3], "radius": 6}
VALUES = "AAAAAAEAAAD/////AAQAAAD8//8AABAAAADw/wcAAAA="
NEAR = Region(Box((-64, 0, -64), (64, 256, 64)), 3)
STALE = b'[{"lod":0,"min":[0,5,-1],"max":[0,6,0]},{"lod":1,"min":[0,2,-1],"max":[0,3,0]}]'
RANGES = (Range(0, Box((0, 5, -1), (0, 6, 0))), Range(1, Box((0, 2, -1), (0, 3, 0))))

READ = {
    "hello": Hello("player-1", None, None, frozenset({NEAR})),
    "hello again": Hello("player-1", "k7Qx2", 42, frozenset({NEAR, Region(Box((0, 0, 0), (0, 0, 0)), 20)})),
    "edit": NewEdit(7, [CARVE]),
    "edit with bulk deltas": NewEdit(
        8, [CARVE, {"op": "delta", "min": [-3, 0, 5], "size": [2, 2, 2], "values": VALUES}]
    ),
    "subscribe": Subscribe(frozenset({Region(Box((100, 0, 0), (200, 64, 64)), 0)})),
    "unsubscribe": Unsubscribe(frozenset({NEAR})),
}
WRITTEN = {
    "welcome": answers.welcome("k7Qx2", 45, 12, 7),
    "welcome, first": answers.welcome("k7Qx2", 9007199254740993, 0, None),
    "ack": answers.ack(7, 43, RANGES, duplicate=False),
    "ack, below the floor": answers.ack(2, 12, None, duplicate=True),
    "progress": answers.progress(45, 1),
    "stale": answers.stale(RANGES, 60),
    "resync": answers.resync(50, 80, "k7Qx2"),
}


def frame_of(example: dict[str, Any]) -> str | bytes:
    return example["text"] if "text" in example else bytes.fromhex(example["binary"])


def example(name: str) -> dict[str, Any]:
    return next(one for one in EXAMPLES["server"] if one["name"] == name)


@pytest.mark.parametrize("example", EXAMPLES["client"], ids=lambda one: one["name"])
def test_reads_the_examples(example: dict[str, Any]):
    assert read_message(frame_of(example)) == READ[example["name"]]
    if "same_as" in example:
        assert read_message(example["same_as"]) == READ[example["name"]]


@pytest.mark.parametrize("name", WRITTEN)
def test_writes_the_examples(name: str):
    assert json.loads(WRITTEN[name]) == json.loads(example(name)["text"])


def test_writes_an_example_of_edits():
    some = [edit_of(44, json.dumps([CARVE]).encode(), STALE), edit_of(45, b"[" + b" " * limits.FRAME_BYTES_MAX, STALE)]
    [(message, revision)] = answers.edits(42, some, 45)
    assert json.loads(message) == json.loads(example("edits")["text"])
    assert revision == 45


def test_writes_an_example_of_a_refusal():
    text = example("nack")["text"]
    assert json.loads(answers.nack(9, json.loads(text)["problem"])) == json.loads(text)


def test_every_example_is_looked_at():
    assert {one["name"] for one in EXAMPLES["client"]} == set(READ)
    assert {one["name"] for one in EXAMPLES["server"]} == {*WRITTEN, "edits", "nack"}


@pytest.mark.parametrize("example", EXAMPLES["refused"], ids=lambda one: one["why"])
def test_refuses_the_bad_examples(example: dict[str, Any]):
    with pytest.raises(BadMessage):
        read_message(frame_of(example))


def test_a_frame_is_bounded_in_bytes():
    frame = '{"type":"subscribe","regions":[],"":"%s"}'
    room = limits.FRAME_BYTES_MAX - len(frame % "")
    for filler in ("x" * room, "é" * (room // 2)):
        assert read_message(frame % filler) == Subscribe(frozenset())
        with pytest.raises(FrameTooLarge, match=str(limits.FRAME_BYTES_MAX)):
            read_message(frame % (filler + "é"))
    with pytest.raises(FrameTooLarge):
        read_message(bytes(limits.FRAME_BYTES_MAX + 1))


def test_what_is_nested_too_deep_is_refused():
    with pytest.raises(BadMessage):
        read_message('{"type":"edit","seq":1,"strokes":' + "[" * 30_000)


@hypothesis.given(st.one_of(st.text(max_size=200), st.binary(max_size=200)))
def test_any_frame_is_read_or_refused(frame: str | bytes):
    with contextlib.suppress(BadMessage):
        read_message(frame)


@hypothesis.given(st.sampled_from(EXAMPLES["client"]), st.data())
def test_a_mutated_example_is_read_or_refused(example: dict[str, Any], drawn: st.DataObject):
    frame = frame_of(example)
    at = drawn.draw(st.integers(0, len(frame) - 1))
    if isinstance(frame, bytes):
        mutated: str | bytes = frame[:at] + drawn.draw(st.binary(max_size=4)) + frame[at + 1 :]
    else:
        mutated = frame[:at] + drawn.draw(st.text(max_size=3)) + frame[at + 1 :]
    try:
        message = read_message(mutated)
    except BadMessage:
        return
    assert type(message) in (Hello, NewEdit, Subscribe, Unsubscribe)


def test_ranges_are_read_as_they_are_told():
    assert read_ranges(STALE) == RANGES
    assert read_ranges(b"") == ()
