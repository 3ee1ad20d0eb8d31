"""What a stranger may send to exhaust a server: refused at once, with little memory."""

import json
import time
import tracemalloc

import pytest

from chunkserver.errors import BadRecipe
from chunkserver.recipe import canonical
from tests.worlds import total

SECONDS_MAX = 0.05
"""What is promised, on an idle core. Tests share theirs: SLOWER times as long is no failure."""
SLOWER = 10
BYTES_MAX = 10 << 20

Y = {"op": "y"}


def deep(levels: int, tree: object = Y) -> object:
    for _ in range(levels):
        tree = {"op": "abs", "a": tree}
    return tree


def cyclic() -> object:
    tree: dict[str, object] = {"op": "add", "b": 1}
    tree["a"] = tree
    return tree


def remap(points: object) -> dict[str, object]:
    return {"op": "remap", "a": Y, "points": points}


NAN, INFINITY = float("nan"), float("inf")

BOMBS = {
    "a million nodes": total([Y] * 10**6),
    "100,000 levels": deep(10**5),
    "a tree in itself": cyclic(),
    "a million values": [[0] * 1000] * 1000,
    "a million fields": {"op": "y", **{f"k{n}": 0 for n in range(10**6)}},
    "a billion octaves": {"op": "fbm2", "frequency": 1e-9, "octaves": 10**9},
    "octaves of 30 digits": {"op": "fbm2", "frequency": 1e-9, "octaves": 10**30},
    "a salt of 30 digits": {"op": "simplex3", "frequency": 0.1, "salt": 10**30},
    "an integer of 309 digits": {"op": "add", "a": 10**308, "b": 1},
    "an integer of 100,000 digits": 10**100_000,
    "an integer of 5,000 digits in a field": {"op": "constant", "value": 10**5000},
    "NaN": {"op": "constant", "value": NAN},
    "NaN in a point": {"op": "sphere", "radius": 1, "center": [0, NAN, 0]},
    "Infinity": {"op": "sphere", "radius": INFINITY},
    "a huge scale": {"op": "scale", "a": Y, "factor": [1e300] * 3},
    "a tiny scale": {"op": "scale", "a": Y, "factor": 1e-300},
    "a million knots": remap([[n, 0] for n in range(10**6)]),
    "thousands of wrong nodes": total([{"op": "q"}] * 500),
    "thousands of wrong numbers": total([{"op": "box", "center": ["x"] * 3, "half_extents": ["x"] * 3}] * 500),
    "thousands of wrong knots": total([remap([["x", "x"]] * 25)] * 100),
    "thousands of wrong fields": total([{"op": "sphere", **dict.fromkeys("abcdefghijklmn", 0)}] * 300),
    "bytes: NaN": b'{"op":"constant","value":NaN}',
    "bytes: Infinity": b'{"op":"sphere","radius":-Infinity}',
    "bytes: 1e999": b'{"op":"sphere","radius":1e999}',
    "bytes: brackets": b"[" * 60_000,
    "bytes: levels": b'{"op":"abs","a":' * 4_000,
    "bytes: digits": b"9" * 60_000,
    "bytes: values": b"[" + b"0," * 30_000 + b"0]",
    "bytes: knots": json.dumps(remap([[n, 0] for n in range(5_000)])).encode(),
    "bytes: a million nodes": json.dumps(total([Y] * 10**5)).encode(),
    "bytes: spaces": b" " * 10**7,
}


@pytest.mark.parametrize("bomb", BOMBS.values(), ids=BOMBS)
def test_a_bomb_is_refused_at_once(bomb):
    began = time.process_time()
    with pytest.raises(BadRecipe) as caught:
        canonical(bomb)
    seconds = time.process_time() - began
    tracemalloc.start()
    with pytest.raises(BadRecipe):
        canonical(bomb)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert seconds < SLOWER * SECONDS_MAX
    assert peak < BYTES_MAX
    assert len(caught.value.message) + len(str(caught.value.values)) < 2000
