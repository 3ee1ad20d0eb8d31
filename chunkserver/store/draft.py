"""An edit before it is written, and what becomes of it. Its content is bytes that mean nothing here."""

from dataclasses import dataclass
from typing import Final, NamedTuple

from chunkserver.errors import BadParameter

EDIT_BYTES_MAX: Final = 16 << 20
"""Of an edit: its strokes, what they make stale, and its digest."""
NAME_CHARS_MAX: Final = 128
"""Of a key, and of a client's name."""
SEQ_MAX: Final = (1 << 53) - 1
"""The largest integer that JSON carries everywhere."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Draft:
    """An edit that is to be written.

    epoch: of its world.
    digest: of the request's body. Who sends a key or a seq again sends the same body.
    strokes: what is kept.
    stale: what is answered, beside the revision; and again to who sends it again.
    client, seq: who sends it, and the client's own number for it, which rises; or neither.
    key: another name for it, unique in its world.

    Raises `BadParameter` for what is too long, and for a seq without a client.
    """

    epoch: str
    digest: bytes
    strokes: bytes
    stale: bytes
    client: str | None = None
    seq: int | None = None
    key: str | None = None

    def __post_init__(self) -> None:
        if (self.client is None) is not (self.seq is None):
            raise BadParameter(f"client is {self.client!r} and seq is {self.seq}: both are needed, or neither")
        if self.seq is not None and not 0 <= self.seq <= SEQ_MAX:
            raise BadParameter(f"seq is {self.seq}; it lies in [0, {SEQ_MAX}]", seq=self.seq)
        for name, value in (("client", self.client), ("key", self.key)):
            if value is not None and not 1 <= len(value) <= NAME_CHARS_MAX:
                message = f"{name} has {len(value)} characters; it has 1 to {NAME_CHARS_MAX}"
                raise BadParameter(message, **{name: value[:NAME_CHARS_MAX]})
        if self.weight > EDIT_BYTES_MAX:
            raise BadParameter(f"the edit has {self.weight} bytes; the limit is {EDIT_BYTES_MAX}", bytes=self.weight)

    @property
    def weight(self) -> int:
        """How many bytes it is."""
        return len(self.strokes) + len(self.stale) + len(self.digest)


class Outcome(NamedTuple):
    """What was written.

    revision: of the edit.
    stale: as its draft said when it was written; b"" if that is not known any more.
    duplicate: it had been written before. If its edit is not there any more and had no key, the revision is that of
        the last such edit of its client: not its own perhaps, but no later than the floor.
    """

    revision: int
    stale: bytes
    duplicate: bool = False
