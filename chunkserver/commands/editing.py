"""A world's edits without a server: what was kept of them, the log behind that, and more, taken as a server would."""

from collections.abc import Iterable, Iterator
from typing import Any, Final

import numpy as np

from chunkserver.edits import Arena, Bricks, Edit, History, Taken
from chunkserver.errors import ChunkError, StoreError
from chunkserver.field import Ground
from chunkserver.server import Settings
from chunkserver.store import Draft, EditLog, Outcome, Store
from chunkserver.world import World

SETTINGS: Final = ("data", "arena_bytes", "edit_bytes")
"""Those of a server that count here too."""
READ_AT_ONCE_MAX: Final = 512
"""Edits that are read from the log together."""
FOLDED_AT_ONCE_MAX: Final = 64
"""Edits whose bricks are published together: the coarser levels are worked out once for all of them."""

Parts = Iterable[tuple[bytes, bytes]]


class EditedWorld:
    """A world of a store, and its edits up to a revision. history: theirs."""

    def __init__(self, store: Store, world: World, settings: Settings) -> None:
        """Begin without any edit. settings: how much memory edits may take."""
        self._store, self._world = store, world
        self._ground = Ground(world.recipe)
        slots = np.zeros(settings.pool_limits.arena_bytes // np.dtype(np.int32).itemsize, np.int32)
        self._arena = Arena(slots, settings.edit_bytes)
        self.history = History(Bricks(world.lods, self._arena), self._ground.bound, world.chunk_cells)

    def restore(self, parts: Parts, revision: int) -> None:
        """Go on from what the edits up to a revision have made. Raises `StoreError` for what is no part."""
        before, cells = Bricks(self._world.lods, self._arena), self._world.chunk_cells
        self.history = History.restored(parts, before, revision, self._ground.bound, cells)

    def resume(self) -> None:
        """Go on from the newest state that is kept."""
        *snapshots, foundation = self._store.kept(self._world.epoch, self._world.generator)
        for state in snapshots:
            try:
                self.restore(state.parts, state.revision)
            except StoreError:  # it can be worked out again
                continue
            return
        if foundation.revision:
            self.restore(foundation.parts, foundation.revision)

    def replay(self) -> Iterator[int]:
        """Fold what the log has behind that; yield the revision of each edit that is folded."""
        history, migrated = self.history, self._store.log.migrated(self._world.epoch)
        for number, edit in enumerate(behind(self._store.log, self._world.epoch, history.revision), 1):
            history.logged(edit.strokes, edit.stale, on_other_ground=edit.revision <= migrated)
            if number % FOLDED_AT_ONCE_MAX == 0:
                self.fold()
            yield edit.revision
        self.fold()

    def write(self, edit: Edit, key: str | None) -> Outcome:
        """Write one more edit, durably. What the log has has to be folded before.

        Raises what `History.take` and `Writer.submit` raise, and what `EditLog.append` refuses a draft with.
        """
        taken = self._taken(edit)
        draft = Draft(epoch=self._world.epoch, digest=edit.digest, strokes=edit.source, stale=taken.told, key=key)
        try:
            outcome = self._store.writer.submit(draft).result()
        except BaseException:
            self.history.dropped(taken)
            raise
        if outcome.duplicate:
            self.history.dropped(taken)
        else:
            self.history.written(taken, outcome.revision)
        return outcome

    def fold(self) -> None:
        """Fold all that is written."""
        history = self.history
        while edits := history.unfolded(FOLDED_AT_ONCE_MAX):
            revision = history.bricks.revision + len(edits)
            sample = lambda box: self._ground.sample(box.low, box.shape)  # noqa: E731
            history.publish(history.bricks.apply(edits, revision, sample))

    def _taken(self, edit: Edit) -> Taken:
        """Take an edit. What is known of unfolded ones is coarse: one that is refused is tried again without any."""
        if len(self.history.unfolded(FOLDED_AT_ONCE_MAX)) == FOLDED_AT_ONCE_MAX:
            self.fold()
        try:
            return self.history.take(edit)
        except ChunkError:
            self.fold()
            return self.history.take(edit)


def begins_with_foundation(log: EditLog, epoch: str) -> bool:
    """Return whether a world's edits cannot be worked out from the first on to what a server has.

    Those before the foundation are gone; or it was made in another generator's terrain, and its deltas have stayed.
    """
    return log.floor(epoch) > 0 or 0 < log.foundation(epoch).revision <= log.migrated(epoch)


def behind(log: EditLog, epoch: str, after: int, last: int | None = None) -> Iterator[Any]:
    """Yield the edits of a log behind a revision, up to its end, or up to `last`."""
    end = log.revision(epoch) if last is None else last
    while after < end and (edits := log.read(epoch, after, min(READ_AT_ONCE_MAX, end - after))):
        yield from edits
        after = edits[-1].revision
