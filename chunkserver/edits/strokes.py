"""What a user may send: strokes, each an op with a shape, and their limits. `docs/edits/strokes.md` has the formulas.

OPS and SHAPES are the one table: each pair of them is a kind of stroke, with the fields of both. A delta has no shape.
"""

import base64
import binascii
import math
from typing import Annotated, Any, Final, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, create_model, model_validator

from chunkserver.edits.boxes import Box
from chunkserver.grid import LATTICE_MAX

UNITS_PER_VOXEL: Final = 1024
"""Deltas are integers: so many to a voxel of density."""
DELTA_MAX: Final = 1 << 30
"""No delta passes it: two of them still fit an int32."""
FIELD_MAX: Final = 1 << 16
"""Voxels: the field of LOD 0 is clamped to this."""

SIZE_MIN: Final = 1 / 16
SIZE_MAX: Final = 1024.0
"""Voxels: of a radius or a half extent."""
MARGIN_MIN: Final = 4.0
"""Voxels. Carve and fill reach this far around the box of their shape, or its radius if that is more."""
STRENGTH_MAX: Final = 1024.0
"""Voxels, of `add`."""
UNITS_MAX: Final = 1 << 20
"""What one stroke adds to a delta at most: `add`, `delta`."""
POSITION_MAX: Final = float(LATTICE_MAX - (1 << 12))
"""Voxels. All that a stroke changes lies within LATTICE_MAX."""
DELTA_SAMPLES_MAX: Final = 1 << 18
"""In one `delta`: 64 a side."""
VECTOR_MIN: Final = 2.0**-10
"""Of a normal's or a rotation's largest component: below it a direction is not known well."""
VECTOR_MAX: Final = 2.0**10

assert STRENGTH_MAX * UNITS_PER_VOXEL == UNITS_MAX
assert 3**0.5 * SIZE_MAX + max(MARGIN_MIN, SIZE_MAX) < LATTICE_MAX - POSITION_MAX, "of a box that is turned"


def _without_negative_zero(value: float) -> float:
    return value + 0.0


def _between(low: float, high: float) -> Any:
    return Field(strict=True, ge=low, le=high, allow_inf_nan=False)


_POSITIVE_ZERO: Final = AfterValidator(_without_negative_zero)
_WHOLE: Final = Field(strict=True, ge=-int(POSITION_MAX), le=int(POSITION_MAX))

Position = Annotated[float, _between(-POSITION_MAX, POSITION_MAX), _POSITIVE_ZERO]
Component = Annotated[float, _between(-VECTOR_MAX, VECTOR_MAX), _POSITIVE_ZERO]
Size = Annotated[float, _between(SIZE_MIN, SIZE_MAX)]
Strength = Annotated[float, _between(-STRENGTH_MAX, STRENGTH_MAX), _POSITIVE_ZERO]
Share = Annotated[float, _between(0, 1), _POSITIVE_ZERO]
Count = Annotated[int, Field(strict=True, ge=1, le=DELTA_SAMPLES_MAX)]
Whole = Annotated[int, _WHOLE]
Point = tuple[Position, Position, Position]


def _check_direction(vector: tuple[float, ...], name: str) -> None:
    if max(map(abs, vector)) < VECTOR_MIN:
        raise ValueError(f"the {name} should have a component of at least {VECTOR_MIN}")


def unit(vector: tuple[float, ...]) -> tuple[float, ...]:
    """Return the vector of length 1."""
    length = math.sqrt(math.fsum(component * component for component in vector))
    return tuple(component / length for component in vector)


class Stroke(BaseModel):
    """What all strokes share: frozen, no field that is not known."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    op: str


class Shaped(Stroke):
    """A stroke with a shape."""

    shape: str


class Sphere(Shaped):
    """All points nearer to the centre than the radius."""

    shape: Literal["sphere"]
    center: Point
    radius: Size


class Cuboid(Shaped):
    """A box around a centre. rotation: a quaternion x, y, z, w of any length, which turns the box."""

    shape: Literal["box"]
    center: Point
    half_extents: tuple[Size, Size, Size]
    rotation: tuple[Component, Component, Component, Component] = (0.0, 0.0, 0.0, 1.0)

    @model_validator(mode="after")
    def _check_rotation(self) -> Self:
        _check_direction(self.rotation, "rotation")
        return self


class Capsule(Shaped):
    """All points nearer to the segment from a to b than the radius."""

    shape: Literal["capsule"]
    a: Point
    b: Point
    radius: Size


class Carve(Shaped):
    """Make air."""

    op: Literal["carve"]


class Fill(Shaped):
    """Make rock."""

    op: Literal["fill"]


class Add(Shaped):
    """Add rock, or take it away where the strength is negative, softly: less towards the shape's border."""

    op: Literal["add"]
    strength: Strength


class Smooth(Shaped):
    """Draw densities towards the mean of what is around them."""

    op: Literal["smooth"]
    strength: Share


class Flatten(Shaped):
    """Draw densities towards the distance from a plane, air on the normal's side."""

    op: Literal["flatten"]
    point: Point
    normal: tuple[Component, Component, Component]
    strength: Share

    @model_validator(mode="after")
    def _check_normal(self) -> Self:
        _check_direction(self.normal, "normal")
        return self


class Delta(Stroke):
    """Add integers to the deltas of a box of lattice points.

    min: x, y, z of the first. size: how many along x, y, z.
    values: base64 of little-endian int32, in the order of samples: x fastest, then z, then y.
    """

    op: Literal["delta"]
    min: tuple[Whole, Whole, Whole]
    size: tuple[Count, Count, Count]
    values: Annotated[str, Field(strict=True, max_length=4 * DELTA_SAMPLES_MAX * 4 // 3 + 4)]

    @model_validator(mode="after")
    def _check_values(self) -> Self:
        if math.prod(self.size) > DELTA_SAMPLES_MAX:
            raise ValueError(f"the size should be at most {DELTA_SAMPLES_MAX} samples")
        if any(low + count - 1 > POSITION_MAX for low, count in zip(self.min, self.size, strict=True)):
            raise ValueError("the box should lie within the limit on positions")
        try:
            decoded = base64.b64decode(self.values, validate=True)
        except (binascii.Error, ValueError):
            raise ValueError("the values should be base64") from None
        if len(decoded) != 4 * math.prod(self.size):
            raise ValueError(f"the values should be {math.prod(self.size)} int32")
        if (found := np.abs(np.frombuffer(decoded, "<i4").astype(np.int64)).max()) > UNITS_MAX:
            raise ValueError(f"the values should lie within {UNITS_MAX}, not {found}")
        return self

    @property
    def box(self) -> Box:
        """The lattice points that have values."""
        (x, y, z), (width, planes, rows) = self.min, self.size
        return Box(self.min, (x + width - 1, y + planes - 1, z + rows - 1))

    def deltas(self) -> NDArray[np.int32]:
        """Return the values: (y, z, x) int32."""
        x, y, z = self.size
        return np.frombuffer(base64.b64decode(self.values), "<i4").astype(np.int32).reshape(y, z, x)


OPS: Final[dict[str, type[Shaped]]] = {"carve": Carve, "fill": Fill, "add": Add, "smooth": Smooth, "flatten": Flatten}
SHAPES: Final[dict[str, type[Shaped]]] = {"sphere": Sphere, "box": Cuboid, "capsule": Capsule}
KINDS: Final[dict[tuple[str, str | None], type[Stroke]]] = {
    ("delta", None): Delta,
    **{
        (op, shape): create_model(f"{by.__name__}{of.__name__}", __base__=(by, of))
        for op, by in OPS.items()
        for shape, of in SHAPES.items()
    },
}
"""The model of each op with each shape."""
