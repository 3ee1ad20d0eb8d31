"""Edits on the event loop: taken, written to the log, acknowledged; then folded in a thread, for chunks to be built.

    edit -> History.take -> log, durable -> the world's revision: acknowledged
                                                |
                                                v
                              folded, some at once, in a thread -> bricks -> chunks of that revision

The log is all that is kept. A world's bricks are made of it again when they are first wanted after a start.
"""

import asyncio
import json
import logging
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from functools import partial
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from chunkserver.edits import Arena, Bricks, Edit, History, Taken
from chunkserver.errors import BadStroke, ChunkError, DeadlinePassed, StoreError, StoreFull, WorldGone
from chunkserver.field import Ground
from chunkserver.grid import ChunkKey
from chunkserver.store import Draft, Outcome, Store
from chunkserver.worker import warm_edits
from chunkserver.world import World

FOLDED_AT_ONCE_MAX: Final = 64
"""Edits whose bricks are published together: the coarser levels are worked out once for all of them."""
REPLAYED_AT_ONCE_MAX: Final = 512
"""Edits that are read from the log together, after a start."""

ROOM_SECONDS: Final = 0.05
"""How long a fold waits for room, before it is tried again."""

_log: Final = logging.getLogger(__name__)


class Answer(NamedTuple):
    """What became of an edit.

    stale: the chunks that it may have changed, as JSON's values. duplicate: it had been written before.
    """

    revision: int
    stale: list[dict[str, Any]]
    duplicate: bool


class _EditedWorld:
    """One world: its history, who folds it, and who waits for that.

    fault: why it cannot be folded any more; None if it can.
    """

    def __init__(self, world: World, arena: Arena) -> None:
        self.ground = Ground(world.recipe)
        self.history = History(Bricks(world.lods, arena), self.ground.bound, world.chunk_cells)
        self.moved = asyncio.Event()
        self.folding: asyncio.Task[None] | None = None
        self.fault: StoreError | None = None

    def move(self) -> None:
        """Wake all who wait for something to change."""
        self.moved.set()
        self.moved = asyncio.Event()

    async def until(self, condition: Callable[[], bool]) -> None:
        """Return when `condition` holds. Raises `StoreError` if edits cannot be folded any more."""
        while not condition():
            if self.fault is not None:
                raise self.fault
            await self.moved.wait()

    def is_folded(self) -> bool:
        """Whether all edits that are written are in the bricks."""
        return self.history.bricks.revision == self.history.revision


class Editing:
    """The edits of all worlds of one server. Belongs to the event loop.

    arena: (n,) int32, memory that workers read: where bricks lie.
    answer_seconds: how long a chunk waits for its bricks at most.
    moved: called when a world has got to another revision.
    """

    def __init__(self, store: Store, arena: NDArray[np.int32], answer_seconds: float) -> None:
        self.moved: Callable[[], None] = lambda: None
        self._store = store
        self._arena = Arena(arena)
        self._answer_seconds = answer_seconds
        self._worlds: dict[str, _EditedWorld] = {}
        self._opening: dict[str, asyncio.Task[_EditedWorld]] = {}
        self._folder = ThreadPoolExecutor(1, "fold")

    def revision(self, world: World) -> int:
        """Return how many edits a world has taken."""
        found = self._worlds.get(world.epoch)
        return world.revision if found is None else found.history.revision

    def last_edit(self, epoch: str, key: ChunkKey) -> int:
        """Return the revision of a chunk's own last edit; 0 for a world that is not open."""
        found = self._worlds.get(epoch)
        return 0 if found is None else found.history.last_edit(key)

    async def open(self, world: World) -> None:
        """Have it known which chunks of a world are edited: its log is read. It stays open.

        Raises `StoreError`, and `DeadlinePassed` if that takes too long; it goes on meanwhile.
        """
        await self._opened(world)

    async def take(self, world: World, edit: Edit, key: str | None) -> Answer:
        """Write an edit. When this returns, it is durable, and every answer from now on has it.

        key: another name of the edit; the same edit under the same key is written once.

        Raises what `History.take` and `Writer.submit` raise; `WorldGone`, `BadParameter` if the key is another edit's;
        `StoreError`.
        """
        state = await self._opened(world)
        taken = await self._taken(state, edit)
        loop, answer = asyncio.get_running_loop(), asyncio.get_running_loop().create_future()
        try:
            draft = Draft(epoch=world.epoch, digest=edit.digest, strokes=edit.source, stale=taken.told, key=key)
            writing = self._store.writer.submit(draft)
        except BaseException:
            state.history.dropped(taken)
            raise
        written = partial(self._written, state, taken, answer)
        writing.add_done_callback(lambda done: loop.call_soon_threadsafe(written, done))
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

        Raises `DeadlinePassed`; `StoreError` if edits cannot be folded any more, or the world is gone.
        """
        state = self._worlds.get(epoch)
        if state is None:
            raise WorldGone("the world is gone")
        try:
            async with asyncio.timeout(self._answer_seconds):
                await state.until(lambda: state.history.bricks.revision >= revision)
        except TimeoutError:
            message = f"edits up to {revision} were not worked out within {self._answer_seconds:g} s"
            raise DeadlinePassed(message, revision=str(revision), answer_seconds=self._answer_seconds) from None
        return state.history.last_folded(key), state.history.bricks

    def forget(self, epoch: str) -> None:
        """Let go of a world that is gone."""
        self._worlds.pop(epoch, None)

    async def close(self) -> None:
        """Fold no more. The writer of the log has to be closed before."""
        for opening in self._opening.values():
            opening.cancel()
        for state in self._worlds.values():
            if state.folding is not None:
                state.folding.cancel()
        await asyncio.to_thread(self._folder.shutdown, cancel_futures=True)

    async def _taken(self, state: _EditedWorld, edit: Edit) -> Taken:
        """Take an edit. What is known of unfolded edits is coarse: one that is refused for that is tried once more."""
        if state.fault is not None:
            raise state.fault
        try:
            return state.history.take(edit)
        except BadStroke:
            if state.is_folded():
                raise
        await state.until(state.is_folded)
        return state.history.take(edit)

    def _written(
        self, state: _EditedWorld, taken: Taken, answer: asyncio.Future[Answer], done: Future[Outcome]
    ) -> None:
        """Go on from what the log says. The answer is given in the same turn of the loop: nothing comes between."""
        error = done.exception()
        if error is not None:
            state.history.dropped(taken)
            _settle(answer, error)
            return
        outcome = done.result()
        if outcome.duplicate:
            state.history.dropped(taken)
        else:
            state.history.written(taken, outcome.revision)
            state.move()
            self.moved()
            self._fold_soon(state)
        _settle(answer, Answer(outcome.revision, json.loads(outcome.stale or b"[]"), outcome.duplicate))

    def _fold_soon(self, state: _EditedWorld) -> None:
        if state.folding is None or state.folding.done():
            state.folding = asyncio.ensure_future(self._fold(state))

    async def _fold(self, state: _EditedWorld) -> None:
        """Fold until all that is written is folded."""
        history, ground = state.history, state.ground
        try:
            while edits := history.unfolded(FOLDED_AT_ONCE_MAX):
                revision = history.bricks.revision + len(edits)
                fold = partial(history.bricks.apply, edits, revision, lambda box: ground.sample(box.low, box.shape))
                try:
                    bricks = await asyncio.get_running_loop().run_in_executor(self._folder, fold)
                except (
                    StoreFull
                ):  # there is room for all that is taken, when chunks that are being built let go of theirs
                    await asyncio.sleep(ROOM_SECONDS)
                    continue
                history.publish(bricks)
                state.move()
        except Exception as error:  # noqa: BLE001 - whatever it was: nobody may be answered with chunks that lack an edit
            _log.critical("edits cannot be worked out any more: %r", error)
            state.fault = StoreError("the edits of this world cannot be worked out; the server's log says why")
            state.move()

    async def _opened(self, world: World) -> _EditedWorld:
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

    async def _open(self, world: World) -> _EditedWorld:
        state = await asyncio.to_thread(_prepared, world, self._arena)
        history, log = state.history, self._store.log
        while edits := await asyncio.to_thread(log.read, world.epoch, history.revision, REPLAYED_AT_ONCE_MAX):
            for edit in edits:
                history.logged(edit.strokes, edit.stale)
            await self._fold(state)
            if state.fault is not None:
                raise state.fault
        self._worlds[world.epoch] = state
        return state


def _prepared(world: World, arena: Arena) -> _EditedWorld:
    """Return a world without edits, when all that edits run is compiled: this is for a thread, the loop has no time."""
    warm_edits()
    return _EditedWorld(world, arena)


def _settle(answer: asyncio.Future[Answer], outcome: Answer | BaseException) -> None:
    if answer.done():
        return
    if isinstance(outcome, Answer):
        answer.set_result(outcome)
    else:
        answer.set_exception(outcome if isinstance(outcome, ChunkError) else StoreError("the edit was not written"))
        answer.exception()  # it is no fault if nobody waits any more
