"""Edits on the event loop: taken, written to the log, acknowledged; then folded, for chunks to be built.

    edit -> History.take -> log, durable -> the world's revision: acknowledged
                                                |
                                                v
                              folded, some at once, in a thread -> bricks -> chunks of that revision

A world is opened when its edits are first wanted after a start: from its snapshot, and what the log has behind that.
"""

import asyncio
import logging
import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from functools import partial
from typing import Final, NamedTuple

from chunkserver.edits import Arena, Bricks, Edit, Taken
from chunkserver.errors import ChunkError, DeadlinePassed, StoreError, WorldGone
from chunkserver.grid import ChunkKey
from chunkserver.server.edit_counts import EditCounts, Standing
from chunkserver.server.edited_world import EditedWorld, Place
from chunkserver.store import Draft, Outcome, Store
from chunkserver.world import World

SWEEP_SECONDS: Final = 0.02
"""Between two steps of sweeping: who edits comes first."""

_log: Final = logging.getLogger(__name__)


class Answer(NamedTuple):
    """What became of an edit.

    stale: the chunks that it may have changed, as JSON: a list. duplicate: it had been written before.
    """

    revision: int
    stale: bytes
    duplicate: bool


class Editing:
    """The edits of all worlds of one server. Belongs to the event loop.

    arena: where bricks lie; workers read it.
    answer_seconds: how long a chunk waits for its bricks at most.
    log_edits: of each world, that are kept one by one at least.
    moved: called when a world has got to another revision.
    gone: called with the epoch of a world that is deleted.
    told: called with each edit that is written, in the order of a world's revisions, before who sent it is answered.
    counts: what it has counted.
    """

    def __init__(self, store: Store, arena: Arena, answer_seconds: float, log_edits: int) -> None:
        self.moved: Callable[[], None] = lambda: None
        self.gone: Callable[[str], None] = lambda _epoch: None
        self.told: Callable[[Draft, int], None] = lambda _draft, _revision: None
        self.counts = EditCounts()
        self._store = store
        fold, lay, keep = (ThreadPoolExecutor(1, name) for name in ("fold", "lay", "keep"))
        self._place = Place(store, arena, fold, lay, keep, self.counts, log_edits, self.sweep)
        self._answer_seconds = answer_seconds
        self._worlds: dict[str, EditedWorld] = {}
        self._opening: dict[str, asyncio.Task[EditedWorld]] = {}
        self._leaving: set[asyncio.Task[None]] = set()
        self._sweeping: asyncio.Task[None] | None = None
        self._unswept = False

    def revision(self, world: World) -> int:
        """Return how many edits a world has taken."""
        found = self._worlds.get(world.epoch)
        return world.revision if found is None else found.history.revision

    def last_edit(self, epoch: str, key: ChunkKey) -> int:
        """Return the revision of a chunk's own last edit; 0 for a world that is not open."""
        found = self._worlds.get(epoch)
        return 0 if found is None else found.history.last_edit(key)

    def standing(self) -> Standing:
        """Return how things stand."""
        histories = [state.history for state in self._worlds.values()]
        unfolded = sum(history.revision - history.bricks.revision for history in histories)
        bricks, arena = sum(len(history.bricks) for history in histories), self._place.arena
        return Standing(len(histories), unfolded, bricks, arena.taken, len(arena.deltas), arena.weight)

    async def open(self, world: World) -> None:
        """Have it known which chunks of a world are edited: its log is read. It stays open.

        Raises `StoreError`, and `DeadlinePassed` if that takes too long; it goes on meanwhile.
        """
        await self._opened(world)

    async def take(
        self, world: World, edit: Edit, key: str | None = None, client: str | None = None, seq: int | None = None
    ) -> Answer:
        """Write an edit. When this returns, it is durable, and every answer from now on has it.

        key: another name of the edit; the same edit under the same key is written once.
        client, seq: who sends it, and the client's own number for it, which rises; it is written once too.

        Edits that are taken one after the other, without a wait between, are written in this order.

        Raises what `History.take` and `Writer.submit` raise; `WorldGone`, `BadParameter` if the key is another edit's;
        `StoreError`.
        """
        begun = time.perf_counter()
        state = await self._opened(world)
        loop, answer = asyncio.get_running_loop(), asyncio.get_running_loop().create_future()

        def write(taken: Taken) -> None:
            draft = Draft(
                epoch=world.epoch,
                digest=edit.digest,
                strokes=edit.source,
                stale=taken.told,
                key=key,
                client=client,
                seq=seq,
            )
            written = partial(self._written, state, taken, draft, answer, begun)
            writing = self._store.writer.submit(draft)
            writing.add_done_callback(lambda done: loop.call_soon_threadsafe(written, done))

        await state.take(edit, write)
        result: Answer = await asyncio.shield(answer)
        return result

    async def read(self, world: World, after: int, limit: int) -> list[tuple[int, bytes, bytes]]:
        """Return edits behind revision `after`, in order: the first `limit`, or fewer if they are large.

        Of each its revision, its source and what it made stale, as JSON. Raises what `EditLog.read` raises.
        """
        found = await asyncio.to_thread(self._store.log.read, world.epoch, after, limit)
        return [(edit.revision, edit.strokes, edit.stale) for edit in found]

    async def bricks(self, epoch: str, key: ChunkKey, revision: int) -> tuple[int, Bricks]:
        """Return the bricks of a world when its edits up to `revision` are in them, or later ones.

        Beside them, the revision of the last edit that is in them and has reached chunk `key`.

        Raises `DeadlinePassed`; `StoreError` if edits cannot be folded any more, or the world is gone; `Unavailable`.
        """
        state = self._worlds.get(epoch)
        if state is None:
            raise WorldGone("the world is gone")
        try:
            async with asyncio.timeout(self._answer_seconds):
                bricks = await state.folded(revision)
        except TimeoutError:
            message = f"edits up to {revision} were not worked out within {self._answer_seconds:g} s"
            raise DeadlinePassed(message, revision=str(revision), answer_seconds=self._answer_seconds) from None
        return state.history.last_folded(key), bricks

    def forget(self, epoch: str) -> None:
        """Let go of a world that is gone."""
        self.gone(epoch)
        self._let_go(epoch)
        if epoch in self._opening:
            self._opening[epoch].add_done_callback(lambda _: self._let_go(epoch))
        self.sweep()

    def sweep(self) -> None:
        """Begin to delete what nothing refers to any more, or go on with it."""
        self._unswept = True
        if self._sweeping is None or self._sweeping.done():
            self._sweeping = asyncio.ensure_future(self._sweep())

    async def close(self) -> None:
        """Fold no more, and keep what is folded. The writer of the log has to be closed before."""
        openings = list(self._opening.values())
        for opening in openings:
            opening.cancel()
        await asyncio.gather(*openings, return_exceptions=True)
        await asyncio.gather(*(state.close() for state in self._worlds.values()), *self._leaving)
        if self._sweeping is not None:
            self._sweeping.cancel()
            await asyncio.gather(self._sweeping, return_exceptions=True)
        for thread in (self._place.thread, self._place.laying, self._place.keeping):
            await asyncio.to_thread(thread.shutdown, cancel_futures=True)

    def _let_go(self, epoch: str) -> None:
        state = self._worlds.pop(epoch, None)
        if state is not None:
            self._leaving.add(leaving := asyncio.ensure_future(state.drop()))
            leaving.add_done_callback(self._leaving.discard)

    async def _sweep(self) -> None:
        try:
            while self._unswept:
                self._unswept = False
                while await asyncio.to_thread(self._store.log.sweep):
                    await asyncio.sleep(SWEEP_SECONDS)
        except ChunkError as error:
            _log.warning("what is not needed any more stays in the log for now: %s", error)

    def _written(
        self,
        state: EditedWorld,
        taken: Taken,
        draft: Draft,
        answer: asyncio.Future[Answer],
        begun: float,
        done: Future[Outcome],
    ) -> None:
        """Go on from what the log says. The answer is given in the same turn of the loop: nothing comes between."""
        error = done.exception()
        if error is not None:
            state.dropped(taken)
            _settle(answer, error)
            return
        outcome = done.result()
        if outcome.duplicate:
            state.dropped(taken)
            self.counts.duplicates += 1
        else:
            state.written(taken, outcome.revision)
            self._count(taken, outcome, time.perf_counter() - begun)
            try:
                self.moved()
                self.told(draft, outcome.revision)
            except Exception:  # noqa: BLE001 - whatever it was: the edit is written, and who sent it has to know
                _log.exception("an edit of world epoch %s is not told to others", draft.epoch)
        _settle(answer, Answer(outcome.revision, outcome.stale or b"[]", outcome.duplicate))

    def _count(self, taken: Taken, outcome: Outcome, seconds: float) -> None:
        counts = self.counts
        counts.written += 1
        counts.strokes += len(taken.edit.strokes)
        counts.stale += taken.chunks
        counts.log_bytes += len(taken.edit.source) + len(outcome.stale)
        counts.write_seconds.observe(seconds)

    async def _opened(self, world: World) -> EditedWorld:
        found = self._worlds.get(world.epoch)
        if found is not None:
            return found
        opening = self._opening.get(world.epoch)
        if opening is None:
            opening = self._opening[world.epoch] = asyncio.ensure_future(self._open(world))
            opening.add_done_callback(lambda _: self._opening.pop(world.epoch, None))
        try:
            return await asyncio.wait_for(asyncio.shield(opening), self._answer_seconds)
        except TimeoutError:
            message = f"the edits of world {world.id!r} were not worked out within {self._answer_seconds:g} s"
            raise DeadlinePassed(message, world=world.id, answer_seconds=self._answer_seconds) from None

    async def _open(self, world: World) -> EditedWorld:
        state = self._worlds[world.epoch] = await EditedWorld.open(world, self._place)
        return state


def _settle(answer: asyncio.Future[Answer], outcome: Answer | BaseException) -> None:
    if answer.done():
        return
    if isinstance(outcome, Answer):
        answer.set_result(outcome)
    else:
        answer.set_exception(outcome if isinstance(outcome, ChunkError) else StoreError("the edit was not written"))
        answer.exception()  # it is no fault if nobody waits any more
