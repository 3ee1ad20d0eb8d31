"""The last edits of a world, kept once for all who read it."""

from collections import deque
from itertools import islice

from chunkserver.stream.edit import StreamEdit
from chunkserver.stream.limits import RECENT_BYTES_MAX, RECENT_EDITS_MAX


class Recent:
    """Edits without a hole, in order: those in (start, end]."""

    def __init__(self, revision: int) -> None:
        """Begin with none, behind a revision."""
        self.start = self.end = revision
        self._edits: deque[StreamEdit] = deque()
        self._bytes = 0

    def add(self, edit: StreamEdit) -> None:
        """Add the next edit."""
        assert edit.revision == self.end + 1, f"revision {edit.revision} follows {self.end}"
        self._edits.append(edit)
        self._bytes += edit.weight
        self.end = edit.revision

    @property
    def first_kept(self) -> int:
        """The start as `trim` will leave it: where it is, or a quarter of the limits below them."""
        if len(self._edits) <= RECENT_EDITS_MAX and self._bytes <= RECENT_BYTES_MAX:
            return self.start
        start, left = self.start, self._bytes
        for edit in self._edits:
            if self.end - start <= RECENT_EDITS_MAX * 3 // 4 and left <= RECENT_BYTES_MAX * 3 // 4:
                break
            start, left = edit.revision, left - edit.weight
        return start

    def trim(self) -> None:
        """Let go of the edits up to `first_kept`."""
        for _ in range(self.first_kept - self.start):
            self._bytes -= self._edits.popleft().weight
            self.start += 1

    def after(self, revision: int, limit: int) -> tuple[StreamEdit, ...] | None:
        """Return the first edits behind a revision, at most `limit`; None if some of them are not kept any more."""
        if revision < self.start:
            return None
        first = revision - self.start
        if first > len(self._edits) // 2:  # islice walks from the left; those who are nearly there are the most
            return tuple(self._edits[at] for at in range(first, min(first + limit, len(self._edits))))
        return tuple(islice(self._edits, first, first + limit))
