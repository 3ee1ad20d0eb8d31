"""Noise over points: hashes and blends, no table gathers, written so that the loops vectorise.

Every noise is a function of one shape, in `simplex2`, `simplex3`, `cellular`, or for gradient and value noise in
`blended`: `add_<noise>(x, y, z, numbers, keys, below, out, fractions, words, width)`. It writes

    out = below + amplitude * noise(frequency * point + offset)

x, y, z: (n,) float64 coordinates, voxels; 2-D noises do not read y.
numbers: (5 or more,) float64: amplitude, frequency (lattice cells per voxel), offsets of x, y, z (lattice cells); for
    cellular noise jitter in [0, 1] and what it returns (`cellular.py`).
keys: (3,) uint32, the noise's hash keys of x, y, z.
below, out: (n,) float32 that do not overlap.
fractions, words: scratch memory, as `scratch` makes it.
width: 0, or how many points a row has: then the points come in whole rows, all with the same x, and each with one y and
    one z. What depends on one axis, or on y and z, is then worked out once. The bits are the same either way.

Defined where the coordinates in lattice cells are at most COORDINATE_MAX. Only + - * sqrt and comparisons: the same
bits on every machine. `tests/reference/noise_twin.py` says it all again in plain Python, point by point.
"""

from chunkserver.field.noise.facts import NOISES, NoiseFacts
from chunkserver.field.noise.lattice import COORDINATE_MAX, scratch
from chunkserver.field.noise.names import noise_name

__all__ = ["COORDINATE_MAX", "NOISES", "NoiseFacts", "noise_name", "scratch"]
