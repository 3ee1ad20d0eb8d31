"""A mapping that never changes: the next one is made of it, and shares what is the same."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Final, Generic, TypeVar

PARTS: Final = 1 << 12
"""What is copied for a change of n keys is PARTS references and n PARTS-ths of the mapping: for 500,000 keys of which
100 change, 0.25 ms, where a copy of one dict takes 7 ms."""

_Key = TypeVar("_Key")
_Value = TypeVar("_Value")


class SharedMap(Generic[_Key, _Value]):
    """Keys and their values, in no order."""

    __slots__ = ("_count", "_parts")

    def __init__(self) -> None:
        """Begin with nothing in it."""
        nothing: dict[_Key, _Value] = {}
        self._parts = [nothing] * PARTS
        self._count = 0

    def __len__(self) -> int:
        return self._count

    def __iter__(self) -> Iterator[tuple[_Key, _Value]]:
        """Yield keys with their values."""
        for part in self._parts:
            yield from part.items()

    def get(self, key: _Key) -> _Value | None:
        """Return a key's value, None if it has none."""
        return self._parts[hash(key) % PARTS].get(key)

    def of(self, keys: Sequence[_Key]) -> list[_Value | None]:
        """Return the values of keys, None for each that has none."""
        parts = self._parts
        return [parts[hash(key) % PARTS].get(key) for key in keys]

    def changed(self, changes: Mapping[_Key, _Value | None]) -> "SharedMap[_Key, _Value]":
        """Return the mapping with other values for some keys, and without those that are changed to None."""
        after: SharedMap[_Key, _Value] = SharedMap()
        after._parts = parts = self._parts.copy()
        after._count = self._count
        fresh: set[int] = set()
        for key, value in changes.items():
            at = hash(key) % PARTS
            if at not in fresh:
                fresh.add(at)
                parts[at] = parts[at].copy()
            part, before = parts[at], len(parts[at])
            if value is None:
                part.pop(key, None)
            else:
                part[key] = value
            after._count += len(part) - before
        return after
