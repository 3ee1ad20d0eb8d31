"""JSON that somebody else wrote: what is asked of it is there and of the right type, or the error says where.

Json(text, BadChunk)["nodes"][0]["extras"]["lod"].text()
"""

import json
import math
from collections.abc import Iterator
from typing import Any, Final, NoReturn, TypeVar

from chunkserver_client.errors import BadAnswer

SHOWN_CHARACTERS_MAX: Final = 80
DECIMAL_CHARACTERS_MAX: Final = 20

Known = TypeVar("Known", bound=str)


class Json:
    """One value of a JSON text, and the way to it."""

    __slots__ = ("_above", "_error", "_name", "_value")

    def __init__(
        self, value: Any, error: type[BadAnswer] = BadAnswer, above: "Json | None" = None, name: str | int = "$"
    ) -> None:
        self._value = value
        self._error = error
        self._above = above
        self._name = name

    @classmethod
    def parse(cls, text: bytes, error: type[BadAnswer] = BadAnswer) -> "Json":
        """Return the value of a text. Raises `error` if it is no JSON, or nested deeper than Python's stack."""
        try:
            return cls(json.loads(text, parse_constant=_no_constant), error)
        except (ValueError, RecursionError) as cause:
            raise error(f"no JSON: {str(cause)[:SHOWN_CHARACTERS_MAX]}") from None

    def refuse(self, expected: str) -> NoReturn:
        """Raise the error that says what was expected here."""
        raise self._error(f"{self._path()}: expected {expected}, found {_shown(self._value)}")

    def __getitem__(self, name: str | int) -> "Json":
        return self.get(name) or Json(None, self._error, self, name).refuse("a value")

    def get(self, name: str | int) -> "Json | None":
        """Return a member of an object or an element of a list; None if it is not there, or null."""
        found = self.members().get(name) if isinstance(name, str) else next(iter(self.elements()[name:][:1]), None)
        return None if found is None else Json(found, self._error, self, name)

    def __iter__(self) -> Iterator["Json"]:
        return (Json(value, self._error, self, at) for at, value in enumerate(self.elements()))

    def members(self) -> dict[str, Any]:
        """Return the object that this is."""
        return self._value if isinstance(self._value, dict) else self.refuse("an object")

    def elements(self) -> list[Any]:
        """Return the list that this is."""
        return self._value if isinstance(self._value, list) else self.refuse("a list")

    def text(self) -> str:
        """Return the string that this is."""
        return self._value if isinstance(self._value, str) else self.refuse("a string")

    def one_of(self, *known: Known) -> Known:
        """Return which of these strings this is."""
        text = self.text()
        return next((value for value in known if value == text), None) or self.refuse(f"one of {known}")

    def boolean(self) -> bool:
        """Return the truth value that this is."""
        return self._value if isinstance(self._value, bool) else self.refuse("true or false")

    def number(self) -> float:
        """Return the finite number that this is."""
        value = self._value
        if isinstance(value, int) and not isinstance(value, bool) and value.bit_length() <= 1023:
            return float(value)
        return value if isinstance(value, float) and math.isfinite(value) else self.refuse("a finite number")

    def integer(self, low: int, high: int) -> int:
        """Return the integer that this is, low and high included."""
        value = self._value
        if isinstance(value, int) and not isinstance(value, bool) and low <= value <= high:
            return value
        return self.refuse(f"an integer from {low} to {high}")

    def decimal(self, low: int, high: int) -> int:
        """Return the integer whose decimal string this is: no sign but a minus, no leading zeros."""
        text = self.text()
        value = (
            int(text)
            if len(text) <= DECIMAL_CHARACTERS_MAX and text.removeprefix("-").isdecimal() and text.isascii()
            else None
        )
        if value is None or str(value) != text or not low <= value <= high:
            self.refuse(f"a decimal string from {low} to {high}")
        return value

    def _path(self) -> str:
        names: list[str] = []
        at: Json | None = self
        while at is not None:
            names.append(str(at._name))
            at = at._above
        return ".".join(reversed(names))


def _no_constant(name: str) -> NoReturn:
    raise ValueError(f"{name} is no number of JSON")


def _shown(value: Any) -> str:
    if isinstance(value, (dict, list)):
        return f"{type(value).__name__} of {len(value)}"
    return repr(value)[:SHOWN_CHARACTERS_MAX]
