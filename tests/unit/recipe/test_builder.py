"""Recipes in Python: the same JSON as a tree written by hand, and an error at the line that is wrong."""

import inspect
import operator

import pytest

from chunkserver.errors import BadRecipe
from chunkserver.recipe import builder, canonical, nodes
from chunkserver.recipe.builder import (
    clamp,
    fbm2,
    heightfield,
    maximum,
    minimum,
    remap,
    repeat,
    rotate,
    scale,
    select,
    simplex3,
    smooth_max,
    smooth_min,
    sphere,
    translate,
    warp,
    x,
    y,
    z,
)

BALL = {"op": "sphere", "radius": 3}
X, Y, Z = ({"op": axis} for axis in "xyz")


def binary(op: str, a: object, b: object) -> dict[str, object]:
    return {"op": op, "a": a, "b": b}


@pytest.mark.parametrize(
    ("built", "written"),
    [
        (
            y - fbm2(octaves=5, frequency=0.02) * 24,
            binary("subtract", Y, binary("multiply", {"op": "fbm2", "octaves": 5, "frequency": 0.02}, 24)),
        ),
        (x + 1, binary("add", X, 1)),
        (1 + x, binary("add", 1, X)),
        (1 - x, binary("subtract", 1, X)),
        (2 * x, binary("multiply", 2, X)),
        (x + y * z, binary("add", X, binary("multiply", Y, Z))),
        (-x, binary("multiply", X, -1)),
        (abs(x), {"op": "abs", "a": X}),
        (minimum(x, 2), binary("min", X, 2)),
        (maximum(x, y, z), binary("max", binary("max", X, Y), Z)),
        (smooth_min(x, y, radius=4), {"op": "smooth_min", "a": X, "b": Y, "radius": 4}),
        (smooth_max(x, 0, radius=4), {"op": "smooth_max", "a": X, "b": 0, "radius": 4}),
        (clamp(x, low=-1, high=1), {"op": "clamp", "a": X, "low": -1, "high": 1}),
        (
            select(x, below=y, above=3, at=1, width=2),
            {"op": "select", "by": X, "below": Y, "above": 3, "at": 1, "width": 2},
        ),
        (remap(x, points=[(0, 1), (2, 3)]), {"op": "remap", "a": X, "points": [[0, 1], [2, 3]]}),
        (heightfield(x), {"op": "heightfield", "height": X}),
        (translate(sphere(radius=3), offset=(1, 2, 3)), {"op": "translate", "a": BALL, "offset": [1, 2, 3]}),
        (scale(x, factor=2), {"op": "scale", "a": X, "factor": [2, 2, 2]}),
        (rotate(x, quaternion=(0, 1, 0, 1)), {"op": "rotate", "a": X, "quaternion": [0, 1, 0, 1]}),
        (repeat(x, period=(8, 0, 8)), {"op": "repeat", "a": X, "period": [8, 0, 8]}),
        (warp(x, y=simplex3(frequency=0.1)), {"op": "warp", "a": X, "y": {"op": "simplex3", "frequency": 0.1}}),
    ],
)
def test_what_is_built_is_what_would_be_written(built, written):
    assert isinstance(built, nodes.Node)
    assert canonical(built) == canonical(written)
    assert built.model_dump_json()


def test_there_is_a_name_for_every_node_that_is_no_operator():
    operators = {"add", "subtract", "multiply", "abs", "constant"}
    renamed = {"min": "minimum", "max": "maximum"}
    ops = {op for models in nodes.SECTIONS.values() for model in models for op in model.facts} - operators
    assert {renamed.get(op, op) for op in ops} <= set(dir(builder))


@pytest.mark.parametrize(
    ("build", "path"),
    [
        (lambda: sphere(radius=-1), "radius"),
        (sphere, "radius"),
        (lambda: sphere(radius=1, colour=2), "colour"),
        (lambda: fbm2(octaves=17, frequency=0.1), "octaves"),
        (lambda: clamp(x, low="0", high=1), "low"),
        (lambda: operator.add(x, "1"), "b"),
        (lambda: x * float("nan"), "b"),
        (lambda: warp(x, y=None), "y"),
        (lambda: repeat(x, period=(1, 0, 0)), "period"),
    ],
)
def test_a_wrong_field_is_an_error_at_once(build, path):
    with pytest.raises(BadRecipe) as caught:
        build()
    assert str(caught.value.values["path"]).split(".")[0] == path
    assert len(caught.value.message) < 400


def test_an_unknown_op_is_an_error():
    with pytest.raises(BadRecipe, match="no node 'teapot'"):
        nodes.make("teapot", radius=1)


def test_the_builder_is_what_its_docstring_shows():
    text = inspect.getdoc(builder)
    lines = [line.strip() for line in str(text).splitlines() if line.startswith("    ")]
    exec("\n".join(line.replace("print(", "repr(") for line in lines), {})
