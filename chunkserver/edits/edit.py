"""An edit: strokes that are applied as one, read from JSON values and written as the bytes that a log keeps."""

import hashlib
import json
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from chunkserver.edits.arena import BRICK_BITS
from chunkserver.edits.brushes import Brushes
from chunkserver.edits.strokes import KINDS, OPS, SHAPES, Stroke
from chunkserver.errors import BadStroke

STROKES_MAX: Final = 1000
"""In one edit."""
STROKE_SAMPLES_MAX: Final = 1 << 22
"""Lattice points that one stroke may change: 20 bytes each while it is folded."""
EDIT_SAMPLES_MAX: Final = 1 << 24
"""Of all strokes of an edit together: what bounds the time that it takes."""
EDIT_BRICKS_MAX: Final = 1 << 15
"""Bricks that these meet, those of each stroke counted: what bounds the memory that it takes, 512 MiB."""
SOURCE_BYTES_MAX: Final = 1 << 23
"""Of an edit's source: room for the largest deltas, which are 1.4 MB each, five times."""
DIGEST_BYTES: Final = 16
VALUE_CHARACTERS_MAX: Final = 80
"""Of a value that is named in an error."""

_EXPECTED: Final = {
    "extra_forbidden": "is no field of this stroke",
    "missing": "should be there",
    "tuple_type": "should be a list",
    "finite_number": "should be a finite number",
}
"""What pydantic says in words of its own, in words of strokes. Keyed by its error types."""


@dataclass(frozen=True, slots=True)
class Edit:
    """One or more strokes, in their order.

    source: the strokes as canonical JSON, a list: defaults written out, keys sorted. Equal edits have equal sources.
    brushes: the strokes as numbers.
    """

    source: bytes
    strokes: tuple[Stroke, ...] = field(compare=False, repr=False)
    brushes: Brushes = field(compare=False, repr=False)

    @property
    def digest(self) -> bytes:
        """Of the source: equal edits have equal digests."""
        return hashlib.blake2b(self.source, digest_size=DIGEST_BYTES).digest()

    def within(self, boxes: NDArray[np.int64]) -> "Edit":
        """Return the edit with other boxes of its strokes, as `Brushes` has them, within those that they have."""
        return Edit(self.source, self.strokes, self.brushes._replace(boxes=boxes))

    @classmethod
    def of(cls, strokes: object) -> "Edit":
        """Return the edit of a list of strokes, given as values of JSON.

        Raises `BadStroke` that names the path, what was expected and the value: `strokes.3.radius`.
        """
        if not isinstance(strokes, list) or not 1 <= len(strokes) <= STROKES_MAX:
            count = len(strokes) if isinstance(strokes, list) else None
            raise BadStroke.at("strokes", f"should be a list of 1 to {STROKES_MAX} strokes", strokes=count)
        read = tuple(_stroke(f"strokes.{number}", value) for number, value in enumerate(strokes))
        brushes = Brushes.of(read)
        _check_extent(brushes)
        plain = [stroke.model_dump() for stroke in read]
        source = json.dumps(plain, sort_keys=True, separators=(",", ":"), allow_nan=False).encode()
        _check_length(source)
        return cls(source, read, brushes)

    @classmethod
    def read(cls, source: bytes) -> "Edit":
        """Return the edit of a source. Raises `BadStroke` as `of` does, and for what is no JSON or too long."""
        _check_length(source)
        try:
            strokes = json.loads(source)
        except (ValueError, RecursionError) as error:
            raise BadStroke(f"the edit is not JSON: {error}") from None
        return cls.of(strokes)


def _check_length(source: bytes) -> None:
    if len(source) > SOURCE_BYTES_MAX:
        raise BadStroke(f"the edit has {len(source)} bytes; the limit is {SOURCE_BYTES_MAX}", bytes=len(source))


def _stroke(path: str, value: object) -> Stroke:
    if not isinstance(value, dict):
        raise _bad(path, "should be an object with an op", value)
    op, shape = value.get("op"), value.get("shape")
    if op not in ("delta", *OPS):
        raise _bad(f"{path}.op", f"should be one of {', '.join((*OPS, 'delta'))}", op)
    if op in OPS and shape not in tuple(SHAPES):
        raise _bad(f"{path}.shape", f"should be one of {', '.join(SHAPES)}", shape)
    try:
        return KINDS[op, shape if op in OPS else None].model_validate(value)
    except ValidationError as error:
        first = error.errors(include_url=False, include_context=False)[0]
    said = first["msg"].removeprefix("Input ").removeprefix("Value error, ")
    where = ".".join((path, *map(str, first["loc"])))
    if first["type"] == "value_error" and not first["loc"]:  # of the stroke as a whole, which is too much to print
        raise BadStroke.at(where, said)
    raise _bad(where, _EXPECTED.get(first["type"], said), first["input"])


def _bad(path: str, expected: str, value: Any) -> BadStroke:
    """Return the error that names a value, or as much of it as is fit to print."""
    said = repr(value)[:VALUE_CHARACTERS_MAX]
    return BadStroke.at(path, f"{expected}; it is {said}", value=said)


def _check_extent(brushes: Brushes) -> None:
    """Raise `BadStroke` if a stroke, or all of them, may change more lattice points or bricks than is allowed."""
    counts = brushes.points()
    for number in np.flatnonzero(counts > STROKE_SAMPLES_MAX).tolist():
        count = int(counts[number])
        expected = f"the stroke reaches over {count} lattice points; the limit is {STROKE_SAMPLES_MAX}"
        raise BadStroke.at(f"strokes.{number}", expected, samples=count)
    if (total := int(counts.sum())) > EDIT_SAMPLES_MAX:
        raise BadStroke.at("strokes", f"they reach over {total} lattice points; the limit is {EDIT_SAMPLES_MAX}")
    if total <= EDIT_BRICKS_MAX:
        return  # a brick that is met has a point
    bricks = int(np.maximum(np.diff(brushes.boxes >> BRICK_BITS, axis=1) + 1, 0).prod(axis=2).sum())
    if bricks > EDIT_BRICKS_MAX:
        raise BadStroke.at("strokes", f"they reach over {bricks} bricks; the limit is {EDIT_BRICKS_MAX}")
