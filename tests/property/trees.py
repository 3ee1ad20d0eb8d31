"""Random recipes over all nodes, as a user would write them, and random places to look at them."""

from collections.abc import Callable
from typing import Any

import hypothesis.strategies as st
from hypothesis.strategies import SearchStrategy

from chunkserver.grid import ChunkKey
from tests.worlds import total

Tree = Any
Trees = SearchStrategy[Tree]


def node(op: str, **fields: SearchStrategy[Any]) -> Trees:
    return st.fixed_dictionaries({"op": st.just(op), **fields})


numbers = st.floats(-1e4, 1e4, allow_nan=False)
points = st.tuples(numbers, numbers, numbers)
normals = points.filter(lambda normal: max(map(abs, normal)) > 0.01)
lengths = st.floats(0.1, 1e4)
frequencies = st.floats(2**-10, 1.0)
salts = st.integers(0, 3)
factors = st.floats(2**-6, 2**6)
quaternions = st.tuples(*[st.floats(-1, 1)] * 4).filter(lambda parts: max(map(abs, parts)) > 0.01)
periods = st.tuples(*[st.just(0.0) | st.floats(4, 1e3)] * 3).filter(any)
knots = st.lists(st.tuples(st.integers(-100, 100), numbers), min_size=2, max_size=6, unique_by=lambda knot: knot[0])
curves = knots.map(lambda drawn: [(at / 7, to) for at, to in sorted(drawn)])


def box() -> Trees:
    sizes = st.tuples(lengths, lengths, lengths)
    return st.builds(
        lambda center, size, share: {
            "op": "box",
            "center": center,
            "half_extents": size,
            "rounding": share * min(size),
        },
        points,
        sizes,
        st.floats(0, 1),
    )


def octaves(op: str) -> Trees:
    """Return sums whose last octave is not too fine."""
    return st.builds(
        lambda finest, lacunarity, octaves, **fields: {
            "op": op,
            "frequency": finest / lacunarity ** (octaves - 1) * 0.999,
            "lacunarity": lacunarity,
            "octaves": octaves,
            **fields,
        },
        frequencies,
        st.floats(1.0, 8.0),
        st.integers(1, 3),
        gain=st.floats(0.01, 1.0),
        noise=st.sampled_from(["gradient", "value", "simplex"]),
        salt=salts,
    )


def cellular(op: str) -> Trees:
    returns = st.sampled_from(["distance", "edge", "value"])
    return node(op, frequency=frequencies, salt=salts, jitter=st.floats(0, 1), returns=returns)


def both(*families: str) -> list[str]:
    return [family + dimensions for family in families for dimensions in "23"]


LEAVES: dict[str, Trees] = {
    "constant": numbers,
    **{axis: node(axis) for axis in "xyz"},
    "random": node("random", salt=salts),
    "plane": node("plane", normal=normals, offset=numbers),
    "sphere": node("sphere", center=points, radius=lengths),
    "box": box(),
    "capsule": node("capsule", a=points, b=points, radius=lengths),
    "torus": node("torus", center=points, radius=lengths, tube=lengths),
    "cylinder": node("cylinder", center=points, radius=lengths, half_height=lengths),
    **{op: node(op, frequency=frequencies, salt=salts) for op in both("gradient", "value", "simplex")},
    **{op: cellular(op) for op in both("cellular")},
    **{op: octaves(op) for op in both("fbm", "ridged", "billow")},
}
leaves = st.one_of(*LEAVES.values())


def _clamp(below: Trees) -> Trees:
    ends = st.tuples(numbers, numbers)
    return st.builds(lambda a, ends: {"op": "clamp", "a": a, "low": min(ends), "high": max(ends)}, below, ends)


def _two(op: str, **fields: SearchStrategy[Any]) -> Callable[[Trees], Trees]:
    return lambda below: node(op, a=below, b=below, **fields)


def _one(op: str, **fields: SearchStrategy[Any]) -> Callable[[Trees], Trees]:
    return lambda below: node(op, a=below, **fields)


INNER: dict[str, Callable[[Trees], Trees]] = {
    **{op: _two(op) for op in ("add", "subtract", "multiply", "min", "max")},
    **{op: _two(op, radius=lengths) for op in ("smooth_min", "smooth_max")},
    "abs": _one("abs"),
    "clamp": _clamp,
    "select": lambda below: node(
        "select", by=below, below=below, above=below, at=numbers, width=st.just(0.0) | lengths
    ),
    "remap": _one("remap", points=curves),
    "heightfield": lambda below: node("heightfield", height=below),
    "translate": _one("translate", offset=points),
    "scale": _one("scale", factor=factors | st.tuples(factors, factors, factors)),
    "rotate": _one("rotate", quaternion=quaternions),
    "repeat": _one("repeat", period=periods, mean=numbers),
    "warp": lambda below: node("warp", a=below, x=below, y=below, z=below) | node("warp", a=below, y=below),
    "detail": _one("detail", factor=st.floats(1 / 16, 16)),
}


def recipes(leaves_max: int) -> Trees:
    return st.recursive(
        leaves, lambda below: st.one_of(*(make(below) for make in INNER.values())), max_leaves=leaves_max
    )


trees = recipes(8)
large_trees = st.lists(recipes(40), min_size=8, max_size=24).map(total)


def trees_of(op: str) -> Trees:
    """Return recipes whose root is the node `op`, over leaves."""
    return LEAVES[op] if op in LEAVES else INNER[op](leaves)


seeds = st.integers(-(2**63), 2**63 - 1)
keys = st.builds(ChunkKey, st.integers(0, 6), *[st.integers(-3, 3) | st.integers(-(2**29), 2**29)] * 3)
"""Of chunks of 16 cells, near and far."""
