"""From a recipe to its tape at a level: one small writer for each kind of node.

What a level has faded out is not written at all, and what can then no longer show is left out.
"""

import math
from collections.abc import Callable
from functools import lru_cache
from typing import Any, Final, NamedTuple

import numpy as np

from chunkserver.errors import BadRecipe
from chunkserver.field import ops
from chunkserver.field.fusing import fused
from chunkserver.field.intervals import ALL_FINITE, Bounds, bounds
from chunkserver.field.noise.names import noise_name
from chunkserver.field.octaves import write_cellular, write_noise, write_sum
from chunkserver.field.shapes import LENGTHS
from chunkserver.field.tape import NONE, Step, Tape, allocate
from chunkserver.field.writer import Frame, Writer
from chunkserver.grid import LATTICE_MAX
from chunkserver.recipe import WorldRecipe, nodes

FLAT_MAX: Final = 256
"""Recipes, each at a level, kept flat in one process."""
RANDOM_OCTAVE: Final = 1 << 16
"""Names the hash keys of `random`, apart from those of any octave of noise."""

_WORLD: Final = np.array([[[-2.0 * LATTICE_MAX]] * 3, [[2.0 * LATTICE_MAX]] * 3])
"""All that any chunk may sample, apron included, voxels: low and high, (2, 3, 1)."""
EDGE_VOXELS: Final = 1.0
"""How closely the heights are found from which on all is air or rock."""


class Flat(NamedTuple):
    """A recipe at a level: the tape that is run over samples, and the one that keeps every register, for bounds.

    cost: about how many nanoseconds the tape takes a sample, but for what does not depend on y.
    sky: the least height, voxels, from which on all is air, all over the world; ground: the greatest below which all is
    rock. Infinite where that is not known.
    """

    tape: Tape
    kept: Tape
    cost: float
    sky: float
    ground: float


@lru_cache(maxsize=FLAT_MAX)
def flatten(recipe: WorldRecipe, lod: int) -> Flat:
    """Return the tapes of `recipe` at level `lod`.

    Raises `BadRecipe` if a value is not finite somewhere in the world, or if the tape needs too many registers.
    """
    writer = Writer(recipe.seed, lod, WRITERS)
    root = writer.write(recipe.expression, Frame())
    kept = allocate(writer.steps, root, keep=True)
    found = bounds(kept, _WORLD[0], _WORLD[1], any_seed=True)
    if found.failed[0] != ALL_FINITE:
        path = writer.paths[kept.order[found.failed[0]]]
        raise BadRecipe.at(path, "its value, or its point, is not finite all over the world")
    if lod > 0:
        root = visible(writer, _by_place(writer, kept, found), root)
    steps = fused(writer.steps)
    kept = allocate(steps, root, keep=True)
    return Flat(allocate(steps, root), kept, _cost(kept), _edge(kept, 1), -_edge(kept, -1))


def _cost(tape: Tape) -> float:
    return math.fsum(ops.NANOSECONDS[op] for op in tape.code[tape.columns :, ops.CODE].tolist())


def _by_place(writer: Writer, kept: Tape, found: Bounds) -> dict[int, tuple[float, float]]:
    """Return the bounds of each step that is a value."""
    registers = zip(kept.order, kept.code[:, ops.OUT].tolist(), strict=True)
    low, high = found.low[:, 0].tolist(), found.high[:, 0].tolist()
    return {
        place: (low[register], high[register]) for place, register in registers if not writer.steps[place].is_coordinate
    }


def _edge(kept: Tape, up: int) -> float:
    """Return how high all is air from (up = 1), or how deep all is rock below (up = -1): found by halving, rounded out.

    Infinity if that is not so anywhere in the world, or goes by more than noise's range.
    """
    near, far = -2.0 * LATTICE_MAX, 2.0 * LATTICE_MAX
    if not _is_one(kept, up, far):
        return math.inf
    while far - near > EDGE_VOXELS:
        middle = 0.5 * (near + far)
        if _is_one(kept, up, middle):
            far = middle
        else:
            near = middle
    return far


def _is_one(kept: Tape, up: int, from_height: float) -> bool:
    """Whether all of the world above `from_height`, times `up`, is air, or below it rock."""
    low, high = _WORLD[0].copy(), _WORLD[1].copy()
    if up > 0:
        low[1] = from_height
    else:
        high[1] = -from_height
    found = bounds(kept, low, high, any_seed=True)
    if found.failed[0] != ALL_FINITE:
        return False
    return bool(found.low[kept.result, 0] >= 0 if up > 0 else found.high[kept.result, 0] < 0)


def visible(writer: Writer, bounds: dict[int, tuple[float, float]], root: int) -> int:
    """Return the place of the density without operands of `max` that are rock, of `min` that are air, everywhere.

    Only from the root through `max` and `min`: there an operand counts by its sign, and no sign changes. Of the smooth
    ones an operand is left out if it is rock or air by more than their radius.
    """
    step = writer.steps[root]
    if step.op not in (ops.MAX, ops.MIN, ops.SMOOTH_MAX, ops.SMOOTH_MIN):
        return root
    margin = step.numbers[0] if step.numbers else 0.0
    for kept, other in ((step.a, step.b), (step.b, step.a)):
        low, high = bounds[other]
        if high < -margin if step.op in (ops.MAX, ops.SMOOTH_MAX) else low >= margin:
            return visible(writer, bounds, kept)
    if step.numbers:
        return root
    a, b = visible(writer, bounds, step.a), visible(writer, bounds, step.b)
    return writer.put(step._replace(a=a, b=b), writer.paths[root])


def _constant(writer: Writer, node: nodes.Constant, frame: Frame) -> int:
    return writer.constant(node.value, frame)


def _axis(writer: Writer, node: nodes.Axis, frame: Frame) -> int:
    return writer.put(Step(ops.COORDINATE, x=frame.places["xyz".index(node.op)]), frame.path)


_BINARY: Final = {"add": ops.ADD, "subtract": ops.SUBTRACT, "multiply": ops.MULTIPLY, "min": ops.MIN, "max": ops.MAX}


def _binary(writer: Writer, node: nodes.Binary, frame: Frame) -> int:
    a, b = writer.operand(node, "a", frame), writer.operand(node, "b", frame)
    return writer.put(Step(_BINARY[node.op], a, b), frame.path)


def _abs(writer: Writer, node: nodes.Abs, frame: Frame) -> int:
    return writer.put(Step(ops.ABS, writer.operand(node, "a", frame)), frame.path)


def _clamp(writer: Writer, node: nodes.Clamp, frame: Frame) -> int:
    low, high = writer.constant(node.low, frame), writer.constant(node.high, frame)
    raised = writer.put(Step(ops.MAX, writer.operand(node, "a", frame), low), frame.path)
    return writer.put(Step(ops.MIN, raised, high), frame.path)


def _smooth(writer: Writer, node: nodes.Smooth, frame: Frame) -> int:
    a, b = writer.operand(node, "a", frame), writer.operand(node, "b", frame)
    op = ops.SMOOTH_MIN if node.op == "smooth_min" else ops.SMOOTH_MAX
    return writer.put(Step(op, a, b, numbers=(node.radius, 0.25 / node.radius)), frame.path)


def _select(writer: Writer, node: nodes.Select, frame: Frame) -> int:
    by, below, above = (writer.operand(node, name, frame) for name in ("by", "below", "above"))
    slope = 1 / node.width if node.width else 0.0
    numbers = node.at - node.width / 2, node.at + node.width / 2, slope
    return writer.put(Step(ops.SELECT, by, below, above, numbers=numbers), frame.path)


def _remap(writer: Writer, node: nodes.Remap, frame: Frame) -> int:
    numbers = [float(len(node.points))]
    for (start, low), (stop, high) in zip(node.points, (*node.points[1:], (math.inf, 0.0)), strict=True):
        numbers += start, low, high - low, 1 / (stop - start)
    return writer.put(Step(ops.REMAP, writer.operand(node, "a", frame), numbers=tuple(numbers)), frame.path)


def _heightfield(writer: Writer, node: nodes.Heightfield, frame: Frame) -> int:
    height = writer.operand(node, "height", frame)
    return writer.put(Step(ops.HEIGHT, height, x=frame.places[1]), frame.path)


def _plane(writer: Writer, node: nodes.Plane, frame: Frame) -> int:
    unit = _unit(node.normal)
    return _distance(writer, ops.PLANE, frame, 0.0, -math.inf, (*unit, node.offset))


def _unit(vector: tuple[float, ...]) -> tuple[float, ...]:
    """Return the vector of length 1. `math.fsum` is rounded once; `sum` and `math.hypot` differ between Pythons."""
    length = math.sqrt(math.fsum(component * component for component in vector))
    return tuple(component / length for component in vector)


def _shape(writer: Writer, node: nodes.Shape, frame: Frame) -> int:
    depth = node.depth()
    lift = depth * (1 - writer.weight(2 * depth, frame))
    op, own = _SHAPES[type(node)]
    return _distance(writer, op, frame, lift, -depth, own(node))


def _distance(writer: Writer, op: int, frame: Frame, lift: float, least: float, own: tuple[float, ...]) -> int:
    x, y, z = frame.places
    numbers = lift, least, max(map(abs, own[:LENGTHS])), *own
    return writer.put(Step(op, x=x, y=y, z=z, numbers=numbers), frame.path)


def _box(node: nodes.Box) -> tuple[float, ...]:
    return (*node.center, *(extent - node.rounding for extent in node.half_extents), node.rounding)


def _capsule(node: nodes.Capsule) -> tuple[float, ...]:
    along = [b - a for a, b in zip(node.a, node.b, strict=True)]
    square = math.fsum(component * component for component in along)
    return (*node.a, *along, node.radius, 1 / square if square else 0.0)


_SHAPES: Final[dict[type, tuple[int, Callable[[Any], tuple[float, ...]]]]] = {
    nodes.Sphere: (ops.SPHERE, lambda node: (*node.center, node.radius)),
    nodes.Box: (ops.BOX, _box),
    nodes.Capsule: (ops.CAPSULE, _capsule),
    nodes.Torus: (ops.TORUS, lambda node: (*node.center, node.radius, node.tube)),
    nodes.Cylinder: (ops.CYLINDER, lambda node: (*node.center, node.radius, node.half_height)),
}
"""A shape's instruction, and its own numbers as `chunkserver.field.shapes` wants them."""


def _translate(writer: Writer, node: nodes.Translate, frame: Frame) -> int:
    places = [
        _affine(writer, place, 1.0, -offset, frame) for place, offset in zip(frame.places, node.offset, strict=True)
    ]
    return writer.operand(node, "a", frame.moved(places))


def _scale(writer: Writer, node: nodes.Scale, frame: Frame) -> int:
    places = [
        _affine(writer, place, 1 / factor, 0.0, frame) for place, factor in zip(frame.places, node.factor, strict=True)
    ]
    least = min(node.factor)
    inner = writer.operand(node, "a", frame.moved(places, least))
    return writer.put(Step(ops.MULTIPLY, inner, writer.constant(least, frame)), frame.path)


def _rotate(writer: Writer, node: nodes.Rotate, frame: Frame) -> int:
    places = [_turned(writer, row, frame) for row in _inverse(node.quaternion)]
    return writer.operand(node, "a", frame.moved(places))


def _inverse(quaternion: tuple[float, ...]) -> list[tuple[float, float, float]]:
    """Return the rows of the matrix that turns back what the quaternion turns."""
    x, y, z, w = _unit(quaternion)
    return [
        (1 - 2 * (y * y + z * z), 2 * (x * y + z * w), 2 * (x * z - y * w)),
        (2 * (x * y - z * w), 1 - 2 * (x * x + z * z), 2 * (y * z + x * w)),
        (2 * (x * z + y * w), 2 * (y * z - x * w), 1 - 2 * (x * x + y * y)),
    ]


def _turned(writer: Writer, row: tuple[float, float, float], frame: Frame) -> int:
    """Write one turned coordinate. It does not read those that it does not depend on: any other stands in for them."""
    known = next(place for place, share in zip(frame.places, row, strict=True) if share)
    x, y, z = (place if share else known for place, share in zip(frame.places, row, strict=True))
    return writer.put(Step(ops.TURN, x=x, y=y, z=z, numbers=row), frame.path)


def _repeat(writer: Writer, node: nodes.Repeat, frame: Frame) -> int:
    faded = writer.weight(min(filter(None, node.period)), frame)
    if faded == 0.0:
        return writer.constant(node.mean, frame)
    places, cells = list(frame.places), [NONE] * 3
    for axis, period in enumerate(node.period):
        if period:
            step = Step(ops.REPEAT, x=frame.places[axis], numbers=(period, 1 / period))
            places[axis] = writer.put(step, frame.path)
            cells[axis] = writer.put(step._replace(op=ops.CELL), frame.path)
    inner = writer.operand(node, "a", frame.moved(places)._replace(cells=(cells[0], cells[1], cells[2])))
    if faded == 1.0:
        return inner
    kept = writer.put(Step(ops.MULTIPLY, inner, writer.constant(faded, frame)), frame.path)
    return writer.put(Step(ops.ADD, kept, writer.constant(node.mean * (1 - faded), frame)), frame.path)


def _random(writer: Writer, node: nodes.Random, frame: Frame) -> int:
    """Write the hash of the cell. Where nothing is repeated, the cell is 0: no coordinate times zero."""
    origin = writer.put(Step(ops.AFFINE, x=0, numbers=(0.0, 0.0)), frame.path)
    x, y, z = (origin if cell == NONE else cell for cell in frame.cells)
    _, keys = noise_name(writer.seed, node.salt, RANDOM_OCTAVE)
    return writer.put(Step(ops.RANDOM, x=x, y=y, z=z, keys=keys), frame.path)


def _warp(writer: Writer, node: nodes.Warp, frame: Frame) -> int:
    places = list(frame.places)
    for axis, name in enumerate("xyz"):
        if getattr(node, name) != nodes.Constant(value=0.0):
            by = writer.operand(node, name, frame)
            places[axis] = writer.put(Step(ops.WARP, by, x=frame.places[axis]), frame.path)
    return writer.operand(node, "a", frame.moved(places))


def _detail(writer: Writer, node: nodes.Detailed, frame: Frame) -> int:
    return writer.operand(node, "a", frame._replace(scale=frame.scale * node.factor))


def _affine(writer: Writer, place: int, factor: float, offset: float, frame: Frame) -> int:
    if (factor, offset) == (1.0, 0.0):
        return place
    return writer.put(Step(ops.AFFINE, x=place, numbers=(factor, offset + 0.0)), frame.path)


WRITERS: Final[dict[type[nodes.Node], Callable[[Writer, Any, Frame], int]]] = {
    nodes.Constant: _constant,
    nodes.Axis: _axis,
    nodes.Binary: _binary,
    nodes.Abs: _abs,
    nodes.Clamp: _clamp,
    nodes.Smooth: _smooth,
    nodes.Select: _select,
    nodes.Remap: _remap,
    nodes.Heightfield: _heightfield,
    nodes.Plane: _plane,
    **dict.fromkeys(_SHAPES, _shape),
    nodes.Noise: write_noise,
    nodes.Cellular: write_cellular,
    nodes.Sum: write_sum,
    nodes.Translate: _translate,
    nodes.Scale: _scale,
    nodes.Rotate: _rotate,
    nodes.Repeat: _repeat,
    nodes.Random: _random,
    nodes.Warp: _warp,
    nodes.Detailed: _detail,
}
