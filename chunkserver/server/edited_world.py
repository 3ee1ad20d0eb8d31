"""The edits of one world in memory: folded in a thread, behind their being written, and kept now and then.

History.take -> log, durable -> written -> folded, some at once -> bricks -> chunks of that revision
                                                                     |
                                                 what has changed, every KEPT_SECONDS -> snapshot, for the next start
                                             all, when the log has got long       -> the log's foundation
"""

import asyncio
import logging
import time
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from functools import partial
from typing import Final, NamedTuple

from chunkserver.edits import Arena, Bricks, Edit, History, Taken
from chunkserver.errors import BadStroke, ChunkError, StoreError, StoreFull, Unavailable, WorldGone
from chunkserver.field import Ground
from chunkserver.server.edit_counts import EditCounts
from chunkserver.server.pace import gently
from chunkserver.store import Store
from chunkserver.worker import warm_edits
from chunkserver.world import World

FOLDED_AT_ONCE_MAX: Final = 64
"""Edits whose bricks are published together: the coarser levels are worked out once for all of them."""
REPLAYED_AT_ONCE_MAX: Final = 512
"""Edits that are read from the log together, after a start."""
MEASURED_STROKES_MAX: Final = 16
MEASURED_BYTES_MAX: Final = 1 << 14
"""What an edit has at most whose effect is found out on the event loop; for a larger one in a thread."""
ROOM_SECONDS: Final = 0.05
"""How long a fold waits for room, before it is tried again."""
ROOM_TOLD_SECONDS: Final = 1.0
"""After which the log says that it waits."""
KEPT_SECONDS: Final = 5.0
"""What a start has to work out again at most, but for the time that keeping takes."""
KEEPS_FAILED_MAX: Final = 2
"""Failures to keep, one after the other: then it is tried again when more is folded."""

_STOPPING: Final = partial(Unavailable, "the server is stopping")
_log: Final = logging.getLogger(__name__)


class Place(NamedTuple):
    """What all worlds share.

    store: where they are kept. arena: where their bricks lie. thread: that folds. laying: that gives a log another
        foundation, which takes as long as the disk does: one after the other. keeping: that changes snapshots, with
        rests: one after the other too. counts: what is counted.
    log_edits: of each world, that are kept one by one at least. sweep: called when rows of the log can go.
    """

    store: Store
    arena: Arena
    thread: ThreadPoolExecutor
    laying: ThreadPoolExecutor
    keeping: ThreadPoolExecutor
    counts: EditCounts
    log_edits: int
    sweep: Callable[[], None]


class EditedWorld:
    """One world: its history, who folds and keeps it, and who waits for that. Belongs to the event loop.

    revision: of the last edit that is written.
    """

    def __init__(self, world: World, history: History, ground: Ground, place: Place, founded: int) -> None:
        """founded: the revision of the log's foundation."""
        self.history = history
        self._world, self._ground = world, ground
        self._store, self._counts = place.store, place.counts
        self._thread, self._laying, self._snapshot_thread = place.thread, place.laying, place.keeping
        self._sweep = place.sweep
        self._log_edits, self._founds_at = place.log_edits, founded + place.log_edits
        self._moved = asyncio.Event()
        self._taking = asyncio.Lock()
        self._folding: asyncio.Task[None] | None = None
        self._keeping: asyncio.Task[None] | None = None
        self._fault: Callable[[], ChunkError] | None = None
        self._closing = asyncio.Event()
        self._is_gone = False
        self._whole, self._kept = True, history.bricks.revision
        self._no_room_since = 0.0

    @classmethod
    async def open(cls, world: World, place: Place) -> "EditedWorld":
        """Return a world with all edits that the log has. Raises `StoreError`; `StoreFull` if there is no room."""
        ground, read = Ground(world.recipe), place.store.log.read
        history, founded = await asyncio.to_thread(_begun, world, ground, place)
        state = cls(world, history, ground, place, founded)
        migrated = await asyncio.to_thread(place.store.log.migrated, world.epoch)
        try:
            while edits := await asyncio.to_thread(read, world.epoch, history.revision, REPLAYED_AT_ONCE_MAX):
                for edit in edits:
                    history.logged(edit.strokes, edit.stale, on_other_ground=edit.revision <= migrated)
                    await asyncio.sleep(0)  # a large one takes 40 ms: others get their turn between
                await state._fold()
                state._check()
        except BaseException:
            await state.close()
            raise
        return state

    async def take(self, edit: Edit, write: Callable[[Taken], None]) -> Taken:
        """Take an edit, and have `write` called with it before another one is taken.

        Raises what `History.take` raises; `StoreError` if edits cannot be folded any more.
        """
        async with self._taking:
            self._check()
            try:
                taken = await self._took(edit)
            except BadStroke:  # what is known of unfolded edits is coarse
                if not self.history.waiting:
                    raise
                await self._until(lambda: not self.history.waiting)
                taken = await self._took(edit)
            try:
                write(taken)
            except BaseException:
                self.dropped(taken)
                raise
            return taken

    def dropped(self, taken: Taken) -> None:
        """Note that an edit that was taken is not written."""
        self.history.dropped(taken)
        self._move()

    def written(self, taken: Taken, revision: int) -> None:
        """Note that an edit is durable; it is folded soon."""
        self.history.written(taken, revision)
        self._move()
        if self._folding is None or self._folding.done():
            self._folding = asyncio.ensure_future(self._fold())

    async def folded(self, revision: int) -> Bricks:
        """Return the bricks when all edits up to `revision` are in them.

        Raises `StoreError` if edits cannot be folded any more, or the world is gone; `Unavailable` when it is closed.
        """
        await self._until(lambda: self.history.bricks.revision >= revision)
        return self.history.bricks

    async def close(self, why: Callable[[], ChunkError] = _STOPPING) -> None:
        """Fold no more, and keep what is folded; who waits is told why. Whoever writes has to have ended before."""
        if self._folding is not None:
            self._folding.cancel()
        self._stop(why)
        self._closing.set()
        if self._keeping is not None:
            await self._keeping

    async def drop(self) -> None:
        """Let go of a world that is gone."""
        self._is_gone = True
        await self.close(partial(WorldGone, "the world is gone"))
        drop = partial(self._store.snapshots.drop, self._world.epoch)
        await asyncio.get_running_loop().run_in_executor(self._snapshot_thread, drop)

    async def _took(self, edit: Edit) -> Taken:
        measure = self.history.measuring(edit)
        small = len(edit.strokes) <= MEASURED_STROKES_MAX and len(edit.source) <= MEASURED_BYTES_MAX
        return self.history.took(measure() if small else await asyncio.to_thread(measure))

    def _check(self) -> None:
        if self._fault is not None:
            raise self._fault()

    def _stop(self, why: Callable[[], ChunkError]) -> None:
        """Refuse edits and bricks from now on, to those who wait too."""
        self._fault = self._fault or why
        self._move()

    def _move(self) -> None:
        """Wake all who wait for something to change."""
        self._moved.set()
        self._moved = asyncio.Event()

    async def _until(self, condition: Callable[[], bool]) -> None:
        while not condition():
            self._check()
            await self._moved.wait()

    def _tell_room(self, since: float, edits: int) -> None:
        """Have the log say, once, that edits wait for room."""
        waited = time.perf_counter() - since
        if waited >= ROOM_TOLD_SECONDS and self._no_room_since != since:
            self._no_room_since = since
            message = "%d edits of world %s have waited %.1f s for room in memory: chunks that are built have all of it"
            _log.warning(message, edits, self._world.id, waited)

    async def _fold(self) -> None:
        """Fold until all that is written is folded."""
        history, sample, at_once = self.history, self._ground.sample, FOLDED_AT_ONCE_MAX
        since: float | None = None
        try:
            while edits := history.unfolded(at_once):
                revision = history.bricks.revision + len(edits)
                fold = partial(history.bricks.apply, edits, revision, lambda box: sample(box.low, box.shape))
                begun = time.perf_counter()
                try:
                    bricks = await asyncio.get_running_loop().run_in_executor(self._thread, fold)
                except StoreFull:  # there is room, when chunks that are being built let go of their bricks
                    at_once = max(1, len(edits) // 2)
                    since = since or begun
                    self._tell_room(since, len(edits))
                    await asyncio.sleep(ROOM_SECONDS)
                    continue
                at_once, since = min(2 * at_once, FOLDED_AT_ONCE_MAX), None
                history.publish(bricks)
                self._move()
                self._counts.folded += len(edits)
                self._counts.fold_seconds.observe(time.perf_counter() - begun)
                self._keep_soon()
        except Exception as error:  # noqa: BLE001 - whatever it was: nobody may be answered with chunks that lack an edit
            _log.critical("edits cannot be worked out any more: %r", error)
            self._stop(partial(StoreError, "the edits of this world cannot be worked out; the server's log says why"))

    def _keep_soon(self) -> None:
        if self._is_behind() and (self._keeping is None or self._keeping.done()):
            self._keeping = asyncio.ensure_future(self._keep())

    def _is_behind(self) -> bool:
        wanted = self._store.folder is not None or self._is_log_long()
        return wanted and not self._is_gone and self._kept < self.history.bricks.revision

    def _is_log_long(self) -> bool:
        return self.history.bricks.revision >= self._founds_at

    async def _keep(self) -> None:
        """Keep what is folded, some time later, and what is folded meanwhile; after a failure all that there is."""
        failures = 0
        while self._is_behind() and failures < KEEPS_FAILED_MAX:
            with suppress(TimeoutError):
                await asyncio.wait_for(self._closing.wait(), KEPT_SECONDS)
            if self._is_gone:
                return
            revision, self._whole, was_whole = self.history.bricks.revision, False, self._whole
            try:
                self._whole = await self._put(everything=not was_whole)
            except Exception as error:  # noqa: BLE001 - whatever it was: the log of edits has all of it
                _log.error("what edits of world %s have made is not kept: %r", self._world.id, error)
            failures = 0 if self._whole else failures + 1
            self._kept = revision if self._whole else self._kept

    async def _put(self, *, everything: bool) -> bool:
        """Bring the snapshot up to date, and the foundation if the log is long. Return whether there is a snapshot."""
        founds = self._is_log_long()
        change = self.history.change(everything=founds or everything)
        put = partial(self._store.snapshots.put, self._world.epoch, self._world.generator, change.revision)
        parts = partial(gently, is_urgent=self._closing.is_set)
        loop, kept = asyncio.get_running_loop(), partial(put, parts(change.parts()), parts(change.gone()), change.since)
        whole = await loop.run_in_executor(self._snapshot_thread, kept)
        if founds:
            found = partial(self._found, change.revision, parts(change.parts()))
            await loop.run_in_executor(self._laying, found)
            self._sweep()
        return whole

    def _found(self, revision: int, parts: Iterable[tuple[bytes, bytes]]) -> None:
        """Have what all edits have made stand for them in the log; if that fails, a while later."""
        try:
            self._store.log.lay(self._world.epoch, revision, parts)
        except ChunkError as error:
            _log.warning("the log of world %s gets no shorter: %s", self._world.id, error)
            self._founds_at = revision + self._log_edits // 10
        else:
            self._founds_at = revision + self._log_edits


def _begun(world: World, ground: Ground, place: Place) -> tuple[History, int]:
    """Return the history of a world as it was kept, and the revision of the log's foundation. For a thread.

    There may be more in the log.
    """
    warm_edits()
    *snapshots, foundation = place.store.kept(world.epoch, world.generator)
    for state in snapshots:
        try:
            return _restored(world, ground, place.arena, state.parts, state.revision), foundation.revision
        except StoreFull:  # nor would there be room for what is made of the log
            raise
        except StoreError as error:
            _log.warning("a %s of world %s is not used: %s", state.what, world.id, error)
    return _restored(world, ground, place.arena, foundation.parts, foundation.revision), foundation.revision


def _restored(
    world: World, ground: Ground, arena: Arena, parts: Iterable[tuple[bytes, bytes]], revision: int
) -> History:
    before = Bricks(world.lods, arena)
    if not revision:
        return History(before, ground.bound, world.chunk_cells)
    history = History.restored(parts, before, revision, ground.bound, world.chunk_cells)
    if arena.weight > arena.weight_max + arena.deltas.nbytes:  # what is taken may pass the limit by about an arena
        message = f"the edits of all open worlds and of {world.id!r} take {arena.weight} bytes of memory"
        raise StoreFull(f"{message}; the limit is {arena.weight_max}", bytes_max=arena.weight_max)
    return history
