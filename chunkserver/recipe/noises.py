"""Nodes that are noise: a function of the point and the world's seed, without units.

`frequency` is in lattice cells of the noise per voxel, so a feature is about 1 / `frequency` voxels large. 2-D noises
look at x and z. `salt` tells noises of one world apart: two of equal op and salt are the same function at another scale
around the origin, so noises that are combined want different salts.
"""

from typing import Any, ClassVar, Final, Literal, Self

from pydantic import Field, model_validator

from chunkserver.recipe.node import FREQUENCY_MAX, Facts, Fraction, Frequency, Gain, Node, Octaves, Ratio, Salt

FOLD_COST: Final = 0.5
"""What ridged and billow sums cost beyond the noise, ns a sample and octave."""

_LATTICE: Final = "1 / frequency; its mean is left"
_OCTAVES: Final = "1 / frequency of each octave; their means are left"


class Noise(Node):
    """Noise of one octave, mean 0: gradient (Perlin) and simplex are 0 on their lattice, value has its random values
    there."""

    facts: ClassVar = {
        "gradient2": Facts("gradient noise of (x, z)", "[-1, 1]", 6.0, _LATTICE),
        "gradient3": Facts("gradient noise of (x, y, z)", "[-1, 1]", 8.0, _LATTICE),
        "value2": Facts("value noise of (x, z)", "[-1, 1]", 4.0, _LATTICE),
        "value3": Facts("value noise of (x, y, z)", "[-1, 1]", 6.0, _LATTICE),
        "simplex2": Facts("simplex noise of (x, z)", "[-1, 1]", 7.0, _LATTICE),
        "simplex3": Facts("simplex noise of (x, y, z)", "[-1, 1]", 8.0, _LATTICE),
    }
    op: Literal["gradient2", "gradient3", "value2", "value3", "simplex2", "simplex3"]
    frequency: Frequency
    salt: Salt = 0


class Cellular(Node):
    """Cellular (Worley) noise: one point in each lattice cell, up to half a `jitter` off its middle on each axis.

    `returns` is what is given: `distance` to the nearest point (F1) in lattice cells; `edge`, by how much the second
    nearest is farther (F2 - F1), so 0 on the borders between points; or `value`, a number that is random for each point
    and jumps at those borders. Distances are cut off at 1 cell.
    """

    facts: ClassVar = {
        "cellular2": Facts("F1, F2 - F1 or a value, of (x, z)", "[0, 1]; value: [-1, 1]", 8.0, _LATTICE),
        "cellular3": Facts("F1, F2 - F1 or a value, of (x, y, z)", "[0, 1]; value: [-1, 1]", 24.0, _LATTICE),
    }
    op: Literal["cellular2", "cellular3"]
    frequency: Frequency
    salt: Salt = 0
    jitter: Fraction = 1.0
    returns: Literal["distance", "edge", "value"] = "distance"


class Sum(Node):
    """Octaves of noise, summed and divided by the sum of their amplitudes.

    Octave k has frequency `frequency` · `lacunarity`^k and amplitude `gain`^k. `fbm` sums the noise n itself, `ridged`
    1 - 2 |n| (sharp crests at 1), `billow` 2 |n| - 1 (round hills over sharp creases).
    """

    facts: ClassVar = {
        "fbm2": Facts("Σ gain^k n_k / Σ gain^k, of (x, z)", "[-1, 1]", 6.0, _OCTAVES, "octave"),
        "fbm3": Facts("Σ gain^k n_k / Σ gain^k, of (x, y, z)", "[-1, 1]", 8.0, _OCTAVES, "octave"),
        "ridged2": Facts("Σ gain^k (1 - 2 |n_k|) / Σ gain^k, of (x, z)", "[-1, 1]", 6.5, _OCTAVES, "octave"),
        "ridged3": Facts("Σ gain^k (1 - 2 |n_k|) / Σ gain^k, of (x, y, z)", "[-1, 1]", 8.5, _OCTAVES, "octave"),
        "billow2": Facts("Σ gain^k (2 |n_k| - 1) / Σ gain^k, of (x, z)", "[-1, 1]", 6.5, _OCTAVES, "octave"),
        "billow3": Facts("Σ gain^k (2 |n_k| - 1) / Σ gain^k, of (x, y, z)", "[-1, 1]", 8.5, _OCTAVES, "octave"),
    }
    op: Literal["fbm2", "fbm3", "ridged2", "ridged3", "billow2", "billow3"]
    frequency: Frequency
    octaves: Octaves
    lacunarity: Ratio = 2.0
    gain: Gain = 0.5
    salt: Salt = 0
    noise: Literal["gradient", "value", "simplex"] = Field(
        "gradient", description="Which noise is summed. Left out: `gradient` in 2-D, `simplex` in 3-D."
    )

    @model_validator(mode="before")
    @classmethod
    def _choose_noise(cls, given: Any) -> Any:
        if isinstance(given, dict) and "noise" not in given and str(given.get("op")).endswith("3"):
            return {**given, "noise": "simplex"}
        return given

    @model_validator(mode="after")
    def _check_last_band(self) -> Self:
        if self.bands()[-1][0] > FREQUENCY_MAX:
            raise ValueError(f"the frequency of the last octave should be at most {FREQUENCY_MAX}")
        return self

    def cost(self) -> float:
        """Return the cost of all octaves, ns a sample."""
        fold = 0.0 if self.op.startswith("fbm") else FOLD_COST
        return (Noise.facts[self.of_octave].cost + fold) * self.octaves

    @property
    def of_octave(self) -> str:
        """The op of the noise that is summed."""
        return self.noise + self.op[-1]

    def bands(self) -> list[tuple[float, float]]:
        """Return (frequency, amplitude) of each octave, by multiplication alone: a power is not the same everywhere."""
        bands = [(self.frequency, 1.0)]
        for _ in range(self.octaves - 1):
            frequency, amplitude = bands[-1]
            bands.append((frequency * self.lacunarity, amplitude * self.gain))
        return bands
