"""Many rows, a few at a time."""

from collections.abc import Callable, Iterable, Iterator
from typing import Final, TypeVar

STEP_ROWS_MAX: Final = 250
STEP_BYTES_MAX: Final = 1 << 19
"""Of one step of a long change: others write between two. A row that is larger comes alone."""

_Row = TypeVar("_Row")


def portions(
    rows: Iterable[_Row], weight: Callable[[_Row], int], rows_max: int, bytes_max: int
) -> Iterator[list[_Row]]:
    """Yield rows, in their order, `rows_max` or fewer together.

    weight: returns the bytes of a row. Those of a portion are `bytes_max` at most, unless it has one row.
    """
    portion: list[_Row] = []
    total = 0
    for row in rows:
        size = weight(row)
        if portion and (len(portion) == rows_max or total + size > bytes_max):
            yield portion
            portion, total = [], 0
        portion.append(row)
        total += size
    if portion:
        yield portion
