"""docs/wire/edit_v1.examples.json, as the client reads and writes it; and answers that are none."""

import contextlib
import json
import struct
from typing import Any

import hypothesis
import hypothesis.strategies as st
import pytest

from chunkserver_client import BadAnswer
from chunkserver_client.stream import ChunkRange, Region, messages
from chunkserver_client.stream.messages import (
    Ack,
    Edit,
    Edits,
    Nack,
    Progress,
    Resync,
    Stale,
    Welcome,
    read_message,
)
from tests.client.pages import WIRE

EXAMPLES = json.loads((WIRE / "edit_v1.examples.json").read_text())
CARVE = {"op": "carve", "shape": "sphere", "center": [8, 200, 3], "radius": 6}
NEAR = Region((-64, 0, -64), (64, 256, 64), 3)
RANGES = (ChunkRange(0, (0, 5, -1), (0, 6, 0)), ChunkRange(1, (0, 2, -1), (0, 3, 0)))
VALUES = struct.pack("<8i", 0, 1, -1, 1024, -1024, 2**20, -(2**20), 7)
DELTA = {"op": "delta", "min": [-3, 0, 5], "size": [2, 2, 2]}

READ = {
    "welcome": Welcome("k7Qx2", 45, 12, 7, 64),
    "welcome, first": Welcome("k7Qx2", 9007199254740993, 0, None, 64),
    "ack": Ack(7, 43, False, RANGES),
    "ack, below the floor": Ack(2, 12, True, None),
    "edits": Edits(42, 45, (Edit(44, [CARVE]), Edit(45, None)), RANGES),
    "progress": Progress(45, 1),
    "stale": Stale(RANGES, 60),
    "resync": Resync(50, 80, "k7Qx2"),
}
WRITTEN = {
    "hello": messages.hello("player-1", None, None, [NEAR]),
    "hello again": messages.hello("player-1", "k7Qx2", 42, [NEAR, Region((0, 0, 0), (0, 0, 0))]),
    "edit": messages.edit(7, [CARVE]),
    "edit with bulk deltas": messages.edit(8, [CARVE, {**DELTA, "values": VALUES}]),
    "subscribe": messages.regions_changed(added=True, regions=[Region((100, 0, 0), (200, 64, 64), 0)]),
    "unsubscribe": messages.regions_changed(added=False, regions=[NEAR]),
}


def told(side: str, name: str) -> dict[str, Any]:
    return next(one for one in EXAMPLES[side] if one["name"] == name)


@pytest.mark.parametrize("name", READ)
def test_reads_the_examples(name: str):
    assert read_message(told("server", name)["text"]) == READ[name]


def test_reads_an_example_of_a_refusal():
    found = read_message(told("server", "nack")["text"])
    assert isinstance(found, Nack)
    assert (found.seq, found.problem.name, found.problem.values["path"]) == (9, "bad-stroke", "strokes.0.radius")


@pytest.mark.parametrize("name", WRITTEN)
def test_writes_the_examples(name: str):
    frame, example = WRITTEN[name], told("client", name)
    if isinstance(frame, bytes):
        assert frame == bytes.fromhex(example["binary"])
    else:
        assert _with_lods(json.loads(frame)) == _with_lods(json.loads(example["text"]))


def _with_lods(message: dict[str, Any]) -> dict[str, Any]:
    regions = [{"lod": 20, **region} for region in message.get("regions", ())]
    return {**message, "regions": regions}


def test_every_example_is_looked_at():
    assert {one["name"] for one in EXAMPLES["server"]} == {*READ, "nack"}
    assert {one["name"] for one in EXAMPLES["client"]} == set(WRITTEN)


def test_values_of_either_kind_stay_in_their_order():
    text = {**DELTA, "values": "AAAAAAEAAAD/////AAQAAAD8//8AABAAAADw/wcAAAA="}
    frame = messages.edit(1, [text, {**DELTA, "values": bytes(32)}])
    assert isinstance(frame, bytes)
    assert frame.endswith(VALUES + bytes(32))


def test_an_unknown_type_is_no_message():
    assert read_message('{"type":"weather","rain":true}') is None


@pytest.mark.parametrize(
    "text",
    [
        "no",
        "[]",
        "{}",
        '{"type":"progress","revision":5,"asked":0}',
        '{"type":"progress","revision":"05","asked":0}',
        '{"type":"progress","revision":"5"}',
        '{"type":"stale","chunks":[{"lod":21,"min":[0,0,0],"max":[0,0,0]}],"revision":"1"}',
        '{"type":"stale","chunks":[{"lod":0,"min":[0,0],"max":[0,0,0]}],"revision":"1"}',
        '{"type":"stale","chunks":[{"lod":0,"min":[0,0,0],"max":[0,0,0.5]}],"revision":"1"}',
        '{"type":"nack","seq":1,"problem":{"status":200}}',
        '{"type":"edits","after":"1","revision":"2","edits":[{"revision":"2","strokes":[1]}],"stale":[]}',
    ],
)
def test_what_is_no_message_is_refused(text: str):
    with pytest.raises(BadAnswer):
        read_message(text)


@hypothesis.given(st.sampled_from(EXAMPLES["server"]), st.data())
def test_a_mutated_example_is_read_or_refused(example: dict[str, Any], drawn: st.DataObject):
    text = example["text"]
    at = drawn.draw(st.integers(0, len(text) - 1))
    with contextlib.suppress(BadAnswer):
        read_message(text[:at] + drawn.draw(st.text(max_size=3)) + text[at + 1 :])


def test_an_edit_fits_a_frame():
    size = messages.FRAME_BYTES_MAX // 4
    with pytest.raises(ValueError, match="at most 65536"):
        messages.edit(1, [{**DELTA, "size": [size, 1, 1], "values": bytes(4 * size)}])
    with pytest.raises(ValueError, match="an int32 has 4"):
        messages.edit(1, [{**DELTA, "values": bytes(31)}])
    with pytest.raises(ValueError, match="JSON"):
        messages.edit(1, [{**CARVE, "radius": float("nan")}])


@pytest.mark.parametrize(
    "region",
    [Region((1, 0, 0), (0, 0, 0)), Region((0, 0, 0), (0, 0, 1 << 41)), Region((0, 0, 0), (1, 1, 1), 21)],
)
def test_a_region_that_is_none_is_refused(region: Region):
    with pytest.raises(ValueError, match="Region"):
        messages.hello("a", None, None, [region])
