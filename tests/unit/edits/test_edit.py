"""Edits are read, refused with the path and the value, and written down so that they are read again, equal."""

import base64
import json

import numpy as np
import pytest

from chunkserver.edits import Edit
from chunkserver.edits.edit import EDIT_BRICKS_MAX, EDIT_SAMPLES_MAX, SOURCE_BYTES_MAX, STROKE_SAMPLES_MAX, STROKES_MAX
from chunkserver.edits.strokes import DELTA_SAMPLES_MAX, POSITION_MAX, SIZE_MAX, STRENGTH_MAX, UNITS_MAX
from chunkserver.errors import BadStroke
from tests.strokes import OPS, SHAPES, op_of, random_stroke, shape_of

BALL = {"op": "carve", "shape": "sphere", "center": [1.0, 2.0, 3.0], "radius": 6.0}
CUBE = {"op": "fill", "shape": "box", "center": [1.0, 2.0, 3.0], "half_extents": [2.0, 3.0, 4.0]}
FLAT = BALL | {"op": "flatten", "point": [0, 0, 0], "normal": [0, 1, 0], "strength": 0.5}
SOFT = BALL | {"op": "add", "strength": 1.0}


def raw(values, size) -> dict[str, object]:
    coded = base64.b64encode(np.array(values, "<i4").tobytes()).decode()
    return {"op": "delta", "min": [0, 0, 0], "size": list(size), "values": coded}


NAN, INFINITE = float("nan"), float("inf")
REFUSED = {
    "nan": (BALL | {"radius": NAN}, "radius", "nan"),
    "infinity": (BALL | {"center": [0.0, INFINITE, 0.0]}, "center.1", "inf"),
    "a boolean": (BALL | {"radius": True}, "radius", "True"),
    "a string": (BALL | {"radius": "6"}, "radius", "'6'"),
    "no radius": ({name: value for name, value in BALL.items() if name != "radius"}, "radius", "carve"),
    "another field": (BALL | {"strength": 1.0}, "strength", "1.0"),
    "an integer beyond floats": (BALL | {"radius": 10**400}, "radius", "1000"),
    "no op": ({"shape": "sphere"}, "op", "None"),
    "an unknown op": (BALL | {"op": "dig"}, "op", "'dig'"),
    "an op that is no text": (BALL | {"op": ["carve"]}, "op", "['carve']"),
    "an unknown shape": (BALL | {"shape": "cone"}, "shape", "'cone'"),
    "a shape that is no text": (BALL | {"shape": {}}, "shape", "{}"),
    "a stroke that is none": (7, "", "7"),
    "too small": (BALL | {"radius": 0.01}, "radius", "0.01"),
    "too large": (BALL | {"radius": 2 * SIZE_MAX}, "radius", "2048.0"),
    "negative": (CUBE | {"half_extents": [1.0, -1.0, 1.0]}, "half_extents.1", "-1.0"),
    "too far": (BALL | {"center": [0.0, 0.0, POSITION_MAX + 1]}, "center.2", str(POSITION_MAX + 1)),
    "four coordinates": (BALL | {"center": [0.0, 0.0, 0.0, 0.0]}, "center", "0.0"),
    "no rotation": (CUBE | {"rotation": [0.0, 0.0, 0.0, 0.0]}, "", "rotation"),
    "no normal": (FLAT | {"normal": [0.0, 1e-9, 0.0]}, "", "normal"),
    "too strong": (SOFT | {"strength": 1.5 * STRENGTH_MAX}, "strength", "1536.0"),
    "smoother than the mean": (BALL | {"op": "smooth", "strength": 1.5}, "strength", "1.5"),
    "over too many samples": (BALL | {"radius": 64.0}, "", str(257**3)),
    "no base64": (raw([1], [1, 1, 1]) | {"values": "?"}, "", "base64"),
    "text that is not ASCII": (raw([1], [1, 1, 1]) | {"values": "ß"}, "", "base64"),
    "too few values": (raw([1], [1, 2, 1]), "", "2 int32"),
    "a value too large": (raw([-UNITS_MAX - 1], [1, 1, 1]), "", str(UNITS_MAX + 1)),
    "a fraction of a voxel": (raw([1], [1, 1, 1]) | {"min": [0.5, 0, 0]}, "min.0", "0.5"),
    "no size": (raw([], [0, 1, 1]), "size.0", "0"),
    "a size too large": (raw([1], [DELTA_SAMPLES_MAX, 2, 1]), "", str(DELTA_SAMPLES_MAX)),
    "out of the world": (raw([1, 1], [2, 1, 1]) | {"min": [int(POSITION_MAX), 0, 0]}, "", "limit on positions"),
}


@pytest.mark.parametrize("what", REFUSED)
def test_what_is_refused_is_named(what):
    stroke, path, said = REFUSED[what]
    with pytest.raises(BadStroke) as refused:
        Edit.of([BALL, stroke])
    assert refused.value.values["path"] == f"strokes.1.{path}".rstrip(".")
    assert said in str(refused.value)
    assert "it is ''" not in str(refused.value), "a whole stroke is not printed"
    assert len(str(refused.value)) < 300


@pytest.mark.parametrize("strokes", [None, {}, "[]", [], [BALL] * (STROKES_MAX + 1)])
def test_an_edit_has_strokes(strokes):
    with pytest.raises(BadStroke, match="1 to 1000 strokes"):
        Edit.of(strokes)


def test_an_edit_has_only_so_many_samples():
    large = BALL | {"op": "add", "strength": 1.0, "radius": 80.0}
    most = EDIT_SAMPLES_MAX // 161**3
    assert STROKE_SAMPLES_MAX >= 161**3
    Edit.of([large] * most)
    with pytest.raises(BadStroke, match=str(161**3 * (most + 1))):
        Edit.of([large] * (most + 1))


def test_an_edit_has_only_so_many_bricks():
    """What is thin has few samples and many bricks."""
    rod = {"op": "smooth", "strength": 1, "shape": "capsule", "a": [0, 0, 0], "b": [60_000, 0, 0], "radius": 1.0}
    Edit.of([rod])
    with pytest.raises(BadStroke, match=str(EDIT_BRICKS_MAX)):
        Edit.of([rod] * 3)


@pytest.mark.parametrize("source", [b"", b"[", b"[{}", b"\xff", b"[" * 100_000, b"[1" + b"0" * 5000 + b"]"])
def test_a_source_is_json(source):
    with pytest.raises(BadStroke):
        Edit.read(source)


def test_a_source_is_only_so_long():
    with pytest.raises(BadStroke, match=str(SOURCE_BYTES_MAX)):
        Edit.read(b" " * (SOURCE_BYTES_MAX + 1))


def test_a_source_is_read_again(rng):
    strokes = [random_stroke(rng, (5.0, -7.0, 9.0), 4.0) for _ in range(200)]
    edit = Edit.of(strokes)
    again = Edit.read(edit.source)
    assert again == edit
    assert again.strokes == edit.strokes
    plain = json.loads(edit.source)
    assert Edit.of(plain).source == edit.source
    assert json.dumps(plain, sort_keys=True, separators=(",", ":")).encode() == edit.source


def test_equal_edits_have_equal_sources():
    whole = {"radius": 6, "center": [1, 2, -0.0], "shape": "sphere", "op": "carve"}
    assert Edit.of([whole]) == Edit.of([BALL | {"center": [1.0, 2.0, 0.0]}])
    assert Edit.of([CUBE]) == Edit.of([CUBE | {"rotation": [0, 0, 0, 1]}])
    assert Edit.of([CUBE]) != Edit.of([CUBE | {"rotation": [0, 0, 0, 2]}]), "as it was sent"


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("op", OPS)
def test_every_op_takes_every_shape(op, shape, rng):
    stroke = op_of(rng, op, (0, 0, 0)) | shape_of(rng, shape, (0, 0, 0), 4.0)
    read = Edit.of([stroke]).strokes[0]
    assert json.loads(json.dumps(read.model_dump())) == stroke
