"""What every node of a recipe shares: the numbers that may stand in it, what is written about it, arithmetic on it.

Numbers are numbers: no string, no boolean is taken for one, and -0.0 is read as 0.0.
"""

from collections.abc import Iterator
from typing import Annotated, Any, ClassVar, Final, NamedTuple

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError

from chunkserver.errors import BadRecipe
from chunkserver.recipe.refusals import bad_recipe

MAGNITUDE_MAX: Final = float(1 << 40)
"""Largest magnitude of any number in a recipe: the extent of the world."""
FREQUENCY_MIN: Final = 2.0**-40
FREQUENCY_MAX: Final = 1.0
"""At most one noise cell a voxel: beyond it neighbouring samples have nothing to do with each other."""
LENGTH_MIN: Final = 2.0**-20
FACTOR_MAX: Final = float(1 << 20)
OCTAVES_MAX: Final = 16
RATIO_MAX: Final = 8.0
GAIN_MIN: Final = 2.0**-10
"""Each octave has at least about a thousandth of the amplitude of the one before. Late octaves of so small a gain add
nothing that float32 could hold."""
DETAIL_MAX: Final = 16.0


def _without_negative_zero(value: float) -> float:
    return value + 0.0


Number = Annotated[
    float,
    Field(strict=True, ge=-MAGNITUDE_MAX, le=MAGNITUDE_MAX, allow_inf_nan=False),
    AfterValidator(_without_negative_zero),
]
Length = Annotated[float, Field(strict=True, ge=LENGTH_MIN, le=MAGNITUDE_MAX, allow_inf_nan=False)]
LengthOrZero = Annotated[
    float, Field(strict=True, ge=0, le=MAGNITUDE_MAX, allow_inf_nan=False), AfterValidator(_without_negative_zero)
]
Factor = Annotated[float, Field(strict=True, ge=1 / FACTOR_MAX, le=FACTOR_MAX, allow_inf_nan=False)]
Fraction = Annotated[float, Field(strict=True, ge=0, le=1, allow_inf_nan=False), AfterValidator(_without_negative_zero)]
Detail = Annotated[float, Field(strict=True, ge=1 / DETAIL_MAX, le=DETAIL_MAX, allow_inf_nan=False)]
Frequency = Annotated[float, Field(strict=True, ge=FREQUENCY_MIN, le=FREQUENCY_MAX, allow_inf_nan=False)]
Ratio = Annotated[float, Field(strict=True, ge=1.0, le=RATIO_MAX, allow_inf_nan=False)]
Gain = Annotated[float, Field(strict=True, ge=GAIN_MIN, le=1.0, allow_inf_nan=False)]
Octaves = Annotated[int, Field(strict=True, ge=1, le=OCTAVES_MAX)]
Salt = Annotated[int, Field(strict=True, ge=0, lt=1 << 32)]
Point = tuple[Number, Number, Number]


class Facts(NamedTuple):
    """What the page of nodes says about an op, beside the text and the fields of its model.

    formula: its value at a point p = (x, y, z).
    bound: where its value lies.
    cost: ns a sample on the machine of docs/performance.md: what the limit on a recipe's cost counts.
    feature: the size in voxels by which levels of detail fade it, and what is left then; empty if it does not fade.
    per: what the cost is of, if it is not the whole node.
    """

    formula: str
    bound: str
    cost: float
    feature: str = ""
    per: str = ""


class Node(BaseModel):
    """What all nodes share: frozen, hashable, no field that is not known, and arithmetic that makes new nodes.

    `a + b`, `a - b`, `a * b`, `-a` and `abs(a)` are the nodes of those names; either side may be a number.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    op: str
    facts: ClassVar[dict[str, Facts]] = {}

    def children(self) -> Iterator[tuple[str, "Node"]]:
        """Yield the name and the node of each operand."""
        for name in type(self).model_fields:
            value = getattr(self, name)
            if isinstance(value, Node):
                yield name, value

    def cost(self) -> float:
        """Return the cost of this node without its operands, ns a sample."""
        return self.facts[self.op].cost

    @classmethod
    def __pydantic_init_subclass__(cls, **_: Any) -> None:
        """Make the model known to `make` under each of its ops."""
        _MODELS.update(dict.fromkeys(cls.facts, cls))

    def __add__(self, other: "Node | float") -> "Node":
        """Return the sum."""
        return make("add", a=self, b=other)

    def __radd__(self, other: float) -> "Node":
        """Return the sum."""
        return make("add", a=other, b=self)

    def __sub__(self, other: "Node | float") -> "Node":
        """Return the difference."""
        return make("subtract", a=self, b=other)

    def __rsub__(self, other: float) -> "Node":
        """Return the difference."""
        return make("subtract", a=other, b=self)

    def __mul__(self, other: "Node | float") -> "Node":
        """Return the product."""
        return make("multiply", a=self, b=other)

    def __rmul__(self, other: float) -> "Node":
        """Return the product."""
        return make("multiply", a=other, b=self)

    def __neg__(self) -> "Node":
        """Return what is rock where this is air."""
        return make("multiply", a=self, b=-1.0)

    def __abs__(self) -> "Node":
        """Return the magnitude."""
        return make("abs", a=self)


_MODELS: Final[dict[str, type[Node]]] = {}


def make(op: str, /, **fields: Any) -> Node:
    """Return the node `op` with these fields. Raises `BadRecipe` that names the bad field, or for an unknown op."""
    if op not in _MODELS:
        raise BadRecipe(f"there is no node {op!r}; there are {sorted(_MODELS)}", op=op)
    try:
        return _MODELS[op](op=op, **fields)
    except ValidationError as error:
        raise bad_recipe(error, fields) from None
