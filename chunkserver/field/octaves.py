"""Writers of noise: octaves, their sums, and what a level leaves of each."""

import math
from typing import Final, NamedTuple

from chunkserver.field import ops
from chunkserver.field.noise.facts import NOISES, NoiseFacts
from chunkserver.field.noise.names import noise_name
from chunkserver.field.tape import Step
from chunkserver.field.writer import Frame, Writer
from chunkserver.recipe import nodes

STEEPEST: Final = 1e30
"""Stands for the slope of what jumps: infinity times no distance would be no number."""

_RETURNS: Final = ("distance", "edge", "value")
_OPS: Final = {
    "gradient2": ops.GRADIENT2,
    "gradient3": ops.GRADIENT3,
    "value2": ops.VALUE2,
    "value3": ops.VALUE3,
    "simplex2": ops.SIMPLEX2,
    "simplex3": ops.SIMPLEX3,
    "cellular2": ops.CELLULAR2,
    "cellular3": ops.CELLULAR3,
}
_SIGNS: Final = {"fbm": 0.0, "ridged": 1.0, "billow": -1.0}


class Octave(NamedTuple):
    """One octave of noise: which, how fine, and what tells it from others. `extras`: what cellular noise wants."""

    op: str
    facts: NoiseFacts
    frequency: float
    salt: int
    number: int = 0
    extras: tuple[float, float] = (0.0, 0.0)


def write_noise(writer: Writer, node: nodes.Noise, frame: Frame) -> int:
    """Write one octave."""
    faded = writer.weight(1 / node.frequency, frame)
    octave = Octave(node.op, NOISES[node.op], node.frequency, node.salt)
    return _put(writer, octave, writer.constant(0.0, frame), faded, frame)


def write_cellular(writer: Writer, node: nodes.Cellular, frame: Frame) -> int:
    """Write one octave, faded towards its mean."""
    facts = NOISES[f"{node.op} {node.returns}"]
    faded = writer.weight(1 / node.frequency, frame)
    below = writer.constant(facts.mean_at(node.jitter) * (1 - faded), frame)
    extras = node.jitter, float(_RETURNS.index(node.returns))
    return _put(writer, Octave(node.op, facts, node.frequency, node.salt, extras=extras), below, faded, frame)


def write_sum(writer: Writer, node: nodes.Sum, frame: Frame) -> int:
    """Write the octaves of a sum, each on top of the one before."""
    bands, facts = node.bands(), NOISES[node.of_octave]
    total = math.fsum(amplitude for _, amplitude in bands)
    sign = _SIGNS[node.op[:-1]]
    place = writer.constant(0.0, frame)
    for number, (frequency, amplitude) in enumerate(bands, 1):
        octave = Octave(node.of_octave, facts, frequency, node.salt, number)
        faded = writer.weight(1 / frequency, frame)
        if sign:
            place = _ridge(writer, octave, place, sign * amplitude / total, faded, frame)
        else:
            place = _put(writer, octave, place, amplitude / total * faded, frame)
    return place


def _ridge(writer: Writer, octave: Octave, below: int, share: float, faded: float, frame: Frame) -> int:
    """Write below + share * (1 - 2 |noise|), faded towards its mean."""
    mean = 1 - 2 * octave.facts.mean_absolute
    raw = _put(writer, octave, writer.constant(0.0, frame), 1.0 if faded else 0.0, frame)
    numbers = share * (mean * (1 - faded) + faded), -2 * share * faded
    return writer.put(Step(ops.FOLD, raw, below, numbers=numbers), frame.path)


def _put(writer: Writer, octave: Octave, below: int, amplitude: float, frame: Frame) -> int:
    """Write below + amplitude * noise: nothing where the level has lost this octave."""
    if amplitude == 0.0:
        return below
    offsets, keys = noise_name(writer.seed, octave.salt, octave.number)
    facts = octave.facts
    own = facts.low, facts.high, min(facts.lipschitz, STEEPEST)
    numbers = amplitude, octave.frequency, *offsets, *octave.extras, *own
    x, y, z = frame.places
    reads_y = y if facts.dimensions == 3 else x
    return writer.put(Step(_OPS[octave.op], b=below, x=x, y=reads_y, z=z, numbers=numbers, keys=keys), frame.path)
