"""Edits that wait for their answers: sent in the order of their seqs, and sent again, unchanged, after a reconnect."""

from typing import Final

EDITS_MAX: Final = 1024
BYTES_MAX: Final = 16 << 20


class Unanswered:
    """Frames by seq, each either sent on this connection or not yet."""

    def __init__(self) -> None:
        self._frames: dict[int, str | bytes] = {}
        self._unsent: list[int] = []
        self._bytes = 0

    def __len__(self) -> int:
        """Return how many wait."""
        return len(self._frames)

    def __contains__(self, seq: int) -> bool:
        """Return whether an edit waits."""
        return seq in self._frames

    def add(self, seq: int, frame: str | bytes) -> None:
        """Add an edit with a higher seq than any before. Raises `OverflowError` if too many wait."""
        if len(self._frames) >= EDITS_MAX or self._bytes + len(frame) > BYTES_MAX:
            raise OverflowError(f"{len(self._frames)} edits wait for their answers, which have {self._bytes} bytes")
        self._frames[seq] = frame
        self._unsent.append(seq)
        self._bytes += len(frame)

    def to_send(self, inflight_max: int) -> list[str | bytes]:
        """Return what may be sent now, if so many edits may be without an answer on one connection."""
        room = max(inflight_max - len(self._frames) + len(self._unsent), 0)
        now, self._unsent = self._unsent[:room], self._unsent[room:]
        return [self._frames[seq] for seq in now]

    def answered(self, seq: int) -> None:
        """Forget an edit."""
        self._bytes -= len(self._frames.pop(seq))
        if seq in self._unsent:
            self._unsent.remove(seq)

    def resend(self) -> None:
        """Have all of them sent again: there is another connection."""
        self._unsent = list(self._frames)

    def clear(self) -> tuple[int, ...]:
        """Forget all of them; return their seqs."""
        seqs = tuple(self._frames)
        self._frames.clear()
        self._unsent, self._bytes = [], 0
        return seqs
