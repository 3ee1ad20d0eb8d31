"""The nodes that a recipe is made of, as a user writes them in JSON: one model per node, one union of them all.

A recipe is an expression tree. Each node is an object with an `op`; a bare number stands for a constant node. Every
node is a density (or a height, or a weight) per point: a scalar that is negative in rock and positive in air. Lengths
are in voxels, frequencies in lattice cells of the noise per voxel. Nothing in a recipe is ever run as code.

Numbers are numbers: no string, no boolean is taken for one, and -0.0 is read as 0.0.
"""

from typing import Annotated, Any, Final, Literal, Self

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, model_validator

MAGNITUDE_MAX: Final = float(1 << 40)
"""Largest magnitude of any number in a recipe: the extent of the world."""
FREQUENCY_MIN: Final = 2.0**-40
FREQUENCY_MAX: Final = 1.0
"""At most one noise cell a voxel: beyond it neighbouring samples have nothing to do with each other."""
OCTAVES_MAX: Final = 16
RATIO_MAX: Final = 8.0
GAIN_MIN: Final = 2.0**-10
"""Each octave has at least about a thousandth of the amplitude of the one before: chosen to keep amplitudes sensible,
not where float32 ends, which holds 16,384 times finer ones."""


def _without_negative_zero(value: float) -> float:
    return value + 0.0


Number = Annotated[
    float,
    Field(strict=True, ge=-MAGNITUDE_MAX, le=MAGNITUDE_MAX, allow_inf_nan=False),
    AfterValidator(_without_negative_zero),
]
Length = Annotated[float, Field(strict=True, gt=0, le=MAGNITUDE_MAX, allow_inf_nan=False)]
Frequency = Annotated[float, Field(strict=True, ge=FREQUENCY_MIN, le=FREQUENCY_MAX, allow_inf_nan=False)]
Ratio = Annotated[float, Field(strict=True, ge=1.0, le=RATIO_MAX, allow_inf_nan=False)]
Gain = Annotated[float, Field(strict=True, ge=GAIN_MIN, le=1.0, allow_inf_nan=False)]
Octaves = Annotated[int, Field(strict=True, ge=1, le=OCTAVES_MAX)]
Salt = Annotated[int, Field(strict=True, ge=0, lt=1 << 32)]
Point = tuple[Number, Number, Number]


class Node(BaseModel):
    """What all nodes share: frozen, hashable, and no field that is not known."""

    model_config = ConfigDict(frozen=True, extra="forbid")


class Constant(Node):
    """The same value everywhere."""

    op: Literal["constant"] = "constant"
    value: Number


class Axis(Node):
    """One coordinate of the point, in voxels, rounded to float32: exact up to 2^24 voxels, coarser beyond.

    Arithmetic on it inherits that. Shapes and noise do not: they start from the float64 coordinates.
    """

    op: Literal["x", "y", "z"]


class Binary(Node):
    """Two densities, point by point. `max` cuts (air wins), `min` joins (rock wins)."""

    op: Literal["add", "subtract", "multiply", "min", "max"]
    a: "Expression"
    b: "Expression"


class Sphere(Node):
    """Distance to a sphere in voxels, negative inside."""

    op: Literal["sphere"] = "sphere"
    center: Point = (0.0, 0.0, 0.0)
    radius: Length


class Simplex3(Node):
    """Simplex noise in three dimensions, in [-1, 1], mean 0. `salt` tells noises of one world apart.

    Two of equal salt are the same function at another scale around the origin: noises that are combined want different
    salts.
    """

    op: Literal["simplex3"] = "simplex3"
    frequency: Frequency
    salt: Salt = 0


class Fbm(Node):
    """Octaves of noise, summed and divided by the sum of their amplitudes: in [-1, 1], mean 0.

    Octave k has frequency `frequency * lacunarity**k` and amplitude `gain**k`. `fbm2` sums gradient noise over (x, z),
    `fbm3` sums simplex noise over (x, y, z). Octave k of two with the same op and salt is the same function at another
    scale around the origin: noises that are combined want different salts.
    """

    op: Literal["fbm2", "fbm3"]
    frequency: Frequency
    octaves: Octaves
    lacunarity: Ratio = 2.0
    gain: Gain = 0.5
    salt: Salt = 0

    @model_validator(mode="after")
    def _check_last_band(self) -> Self:
        if self.bands()[-1][0] > FREQUENCY_MAX:
            raise ValueError(f"the frequency of the last octave should be at most {FREQUENCY_MAX}")
        return self

    def bands(self) -> list[tuple[float, float]]:
        """Return (frequency, amplitude) of each octave, by multiplication alone: a power is not the same everywhere."""
        bands = [(self.frequency, 1.0)]
        for _ in range(self.octaves - 1):
            frequency, amplitude = bands[-1]
            bands.append((frequency * self.lacunarity, amplitude * self.gain))
        return bands


def _number_is_constant(value: Any) -> Any:
    if isinstance(value, int | float) and not isinstance(value, bool):
        return {"op": "constant", "value": value}
    return value


Expression = Annotated[
    Annotated[Constant | Axis | Binary | Sphere | Simplex3 | Fbm, Field(discriminator="op")],
    BeforeValidator(_number_is_constant),
]
"""Any node, or a number."""

Binary.model_rebuild()
