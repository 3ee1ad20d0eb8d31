"""The nodes that a recipe is made of, as a user writes them in JSON: one union of all models, and those with operands.

A recipe is an expression tree. Each node is an object with an `op`; a bare number stands for a constant node. Every
node is a density (or a height, or a weight) per point: a scalar that is negative in rock and positive in air. Lengths
are in voxels, frequencies in lattice cells of the noise per voxel. Nothing in a recipe is ever run as code.
"""

import itertools
from typing import Annotated, Any, ClassVar, Final, Literal, Self

from pydantic import AfterValidator, BeforeValidator, FailFast, Field, model_validator

from chunkserver.recipe.node import (
    LENGTH_MIN,
    Detail,
    Factor,
    Facts,
    Length,
    LengthOrZero,
    Node,
    Number,
    Point,
    Salt,
    make,
)
from chunkserver.recipe.noises import Cellular, Noise, Sum
from chunkserver.recipe.shapes import Box, Capsule, Cylinder, Plane, Shape, Sphere, Torus

__all__ = ["Box", "Capsule", "Cellular", "Cylinder", "Noise", "Plane", "Shape", "Sphere", "Sum", "Torus"]
__all__ += ["Abs", "Axis", "Binary", "Clamp", "Constant", "Detailed", "Expression", "Heightfield", "Node", "Random"]
__all__ += ["Remap", "Repeat", "Rotate", "Scale", "Select", "Smooth", "Translate", "Warp", "make"]

KNOTS_MAX: Final = 32
PERIOD_MIN: Final = 4.0
QUATERNION_MIN: Final = 2.0**-20


class Constant(Node):
    """The same value everywhere. A bare number means the same."""

    facts: ClassVar = {"constant": Facts("value", "value", 0.1)}
    op: Literal["constant"] = "constant"
    value: Number


class Axis(Node):
    """One coordinate of the point, in voxels, rounded to float32: exact up to 2^24 voxels, coarser beyond.

    Arithmetic on it inherits that. Shapes, `heightfield` and noise do not: they start from the float64 coordinates.
    """

    facts: ClassVar = {axis: Facts(axis, "any", 0.3) for axis in "xyz"}
    op: Literal["x", "y", "z"]


class Binary(Node):
    """Two densities, point by point. `max` cuts (air wins), `min` joins (rock wins)."""

    facts: ClassVar = {
        "add": Facts("a + b", "sum of the bounds", 0.3),
        "subtract": Facts("a - b", "difference of the bounds", 0.3),
        "multiply": Facts("a · b", "product of the bounds", 0.3),
        "min": Facts("min(a, b)", "the lower bounds", 0.3),
        "max": Facts("max(a, b)", "the higher bounds", 0.3),
    }
    op: Literal["add", "subtract", "multiply", "min", "max"]
    a: "Expression"
    b: "Expression"


class Abs(Node):
    """Magnitude of a density: a sheet where its surface was. Subtract from it to give the sheet a thickness."""

    facts: ClassVar = {"abs": Facts("|a|", "≥ 0", 0.3)}
    op: Literal["abs"] = "abs"
    a: "Expression"


class Clamp(Node):
    """A density held between two numbers."""

    facts: ClassVar = {"clamp": Facts("min(max(a, low), high)", "[low, high]", 0.6)}
    op: Literal["clamp"] = "clamp"
    a: "Expression"
    low: Number
    high: Number

    @model_validator(mode="after")
    def _check_order(self) -> Self:
        if self.low > self.high:
            raise ValueError("low should be at most high")
        return self


_ROUNDED: Final = "h² / (4 radius), where h = max(radius - |a - b|, 0)"


class Smooth(Node):
    """`min` or `max` with the crease where both are equal rounded off, over `radius` voxels of difference.

    A shape that a level has lost is still 0 at its heart: joined by `smooth_min`, a little rock is left there.
    """

    facts: ClassVar = {
        "smooth_min": Facts(f"min(a, b) - {_ROUNDED}", "min's, less radius / 4", 0.6),
        "smooth_max": Facts(f"max(a, b) + {_ROUNDED}", "max's, plus radius / 4", 0.6),
    }
    op: Literal["smooth_min", "smooth_max"]
    a: "Expression"
    b: "Expression"
    radius: Length


class Select(Node):
    """One density where another is below a threshold, a second one above it; blended over `width` around it."""

    facts: ClassVar = {
        "select": Facts(
            "below + s (above - below), where s = t² (3 - 2 t), t = clamp((by - at) / width + 1/2, 0, 1)",
            "both",
            0.9,
        )
    }
    op: Literal["select"] = "select"
    by: "Expression"
    below: "Expression"
    above: "Expression"
    at: Number = 0.0
    width: LengthOrZero = 0.0


def _rising(points: tuple[tuple[float, float], ...]) -> tuple[tuple[float, float], ...]:
    if any(right[0] - left[0] < LENGTH_MIN for left, right in itertools.pairwise(points)):
        raise ValueError("the first numbers of the points should rise, by at least 2**-20")
    return points


class Remap(Node):
    """A piecewise linear curve through `points` (from, to); flat before the first and after the last of them."""

    facts: ClassVar = {"remap": Facts("curve(a)", "between the lowest and the highest point", 0.3, per="point")}
    op: Literal["remap"] = "remap"
    a: "Expression"
    points: Annotated[
        tuple[tuple[Number, Number], ...],
        FailFast(),
        Field(min_length=2, max_length=KNOTS_MAX),
        AfterValidator(_rising),
    ]

    def cost(self) -> float:
        """Return the cost of all pieces, ns a sample."""
        return self.facts[self.op].cost * len(self.points)


class Heightfield(Node):
    """How far the point is above the height that another node gives: ground. Worked out in float64, rounded once."""

    facts: ClassVar = {"heightfield": Facts("y - height", "any", 0.4)}
    op: Literal["heightfield"] = "heightfield"
    height: "Expression"


class Translate(Node):
    """A subtree moved by `offset`."""

    facts: ClassVar = {"translate": Facts("a(p - offset)", "a's", 1.0)}
    op: Literal["translate"] = "translate"
    a: "Expression"
    offset: Point


def _number_is_each(value: Any) -> Any:
    if isinstance(value, int | float) and not isinstance(value, bool):
        return (value,) * 3
    return value


class Scale(Node):
    """A subtree `factor` times as large around the origin: a number, or one for each axis.

    The density is multiplied by the smallest of them, so that it stays in voxels and never promises more than the
    distance to the surface.
    """

    facts: ClassVar = {"scale": Facts("min(factor) · a(p / factor)", "min(factor) times a's", 1.3)}
    op: Literal["scale"] = "scale"
    a: "Expression"
    factor: Annotated[tuple[Factor, Factor, Factor], BeforeValidator(_number_is_each)]


class Rotate(Node):
    """A subtree turned around the origin by a quaternion (x, y, z, w) of any length."""

    facts: ClassVar = {"rotate": Facts("a(q⁻¹ p q)", "a's", 2.0)}
    op: Literal["rotate"] = "rotate"
    a: "Expression"
    quaternion: tuple[Number, Number, Number, Number]

    @model_validator(mode="after")
    def _check_length(self) -> Self:
        if max(map(abs, self.quaternion)) < QUATERNION_MIN:
            raise ValueError("the quaternion should have a component of at least 2**-20")
        return self


def _some_period(period: tuple[float, float, float]) -> tuple[float, float, float]:
    if not any(period) or any(0 < length < PERIOD_MIN for length in period):
        raise ValueError(f"each period should be 0 or at least {PERIOD_MIN} voxels, and one of them not 0")
    return period


class Repeat(Node):
    """The cell of a subtree around the origin, again and again: every `period` voxels along each axis, 0 for never.

    What reaches beyond its cell is cut off there. `random` tells the cells apart. `mean` is what the whole node fades
    to at coarse levels: 1 is air.
    """

    facts: ClassVar = {
        "repeat": Facts(
            "a(p - period · round(p / period))", "a's within one cell", 2.5, "the smallest period; `mean` is left"
        )
    }
    op: Literal["repeat"] = "repeat"
    a: "Expression"
    period: Annotated[tuple[LengthOrZero, LengthOrZero, LengthOrZero], AfterValidator(_some_period)] = Field(
        description=f"Each 0 or at least {PERIOD_MIN:g}, not all 0"
    )
    mean: Number = 1.0


class Random(Node):
    """A number that is random for each cell of the innermost `repeat` around it, and the same all over that cell.

    Outer repetitions do not count, and outside any it is one number for the whole world of a seed.
    """

    facts: ClassVar = {"random": Facts("hash of the cell, the seed and the salt", "[-1, 1]", 2.5)}
    op: Literal["random"] = "random"
    salt: Salt = 0


class Warp(Node):
    """A subtree looked up at points that are moved by three other nodes, in voxels: domain warp.

    Levels of detail take its features for the size that they have before; `detail` says how much a warp squeezes them.
    """

    facts: ClassVar = {"warp": Facts("a(p + (x, y, z))", "a's", 0.9)}
    op: Literal["warp"] = "warp"
    a: "Expression"
    x: "Expression" = Constant(value=0.0)
    y: "Expression" = Constant(value=0.0)
    z: "Expression" = Constant(value=0.0)


class Detailed(Node):
    """A subtree whose features are taken for `factor` times their size where levels of detail fade them.

    2 keeps each feature one level longer, 1/2 drops it one level sooner. At the root it is the recipe's own parameter.
    """

    facts: ClassVar = {"detail": Facts("a", "a's", 0.0)}
    op: Literal["detail"] = "detail"
    a: "Expression"
    factor: Detail


def _number_is_constant(value: Any) -> Any:
    if isinstance(value, int | float) and not isinstance(value, bool):
        return {"op": "constant", "value": value}
    return value


_LEAVES = Constant | Axis | Random | Sphere | Box | Capsule | Torus | Cylinder | Plane | Noise | Cellular | Sum
_ARITHMETIC = Binary | Abs | Clamp | Smooth | Select | Remap | Heightfield
_PLACES = Translate | Scale | Rotate | Repeat | Warp | Detailed
Expression = Annotated[
    Annotated[_LEAVES | _ARITHMETIC | _PLACES, Field(discriminator="op")],
    BeforeValidator(_number_is_constant),
]
"""Any node, or a number."""

SECTIONS: Final[dict[str, tuple[type[Node], ...]]] = {
    "Numbers and coordinates": (Constant, Axis, Random),
    "Ground and shapes": (Heightfield, Plane, Sphere, Box, Capsule, Torus, Cylinder),
    "Arithmetic": (Binary, Smooth, Abs, Clamp, Select, Remap),
    "Noise": (Noise, Cellular, Sum),
    "Where a subtree is": (Translate, Scale, Rotate, Repeat, Warp, Detailed),
}
"""Every model, as docs/recipes/nodes.md shows them."""

for _model in itertools.chain.from_iterable(SECTIONS.values()):
    _model.model_rebuild()
