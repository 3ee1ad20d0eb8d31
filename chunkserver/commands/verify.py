"""`chunkserver verify`: is what is kept of edits what their log makes?"""

import json
from collections.abc import Iterator, Mapping
from itertools import chain, product
from typing import Annotated, Any, Final, NamedTuple

import numpy as np
import typer
from numpy.typing import NDArray

from chunkserver.commands.editing import SETTINGS, EditedWorld, Parts, begins_with_foundation, behind
from chunkserver.commands.folder import check_generator, existing, opened
from chunkserver.commands.saying import counted, end, with_bar
from chunkserver.commands.warm import make_ready
from chunkserver.edits import Bricks, Edit, History
from chunkserver.errors import ChunkError, StoreError
from chunkserver.grid import APRON_DEFAULT, LATTICE_MAX, ChunkKey
from chunkserver.server import Settings, with_settings
from chunkserver.store import Store
from chunkserver.worker import warm_edits
from chunkserver.world import WORLDS_MAX, World

app: Final = typer.Typer(add_completion=False, rich_markup_mode=None)

BRICK: Final = 16
"""Deltas along a side of a brick."""

Key = tuple[int, int, int, int]
"""Of a brick: its level, and x, y, z in bricks."""


@app.command()
@with_settings(*SETTINGS)
def command(
    settings: Settings,
    _origins: Mapping[str, str],
    names: Annotated[
        list[str] | None, typer.Argument(metavar="ID", help="The worlds; all of them, if none is named.")
    ] = None,
) -> None:
    """Work the edits of worlds out again, one by one, and compare: ends at the first difference, with exit code 1.

    Every edit can be read, and follows the one before. Every chunk that it changes was told. What was made of the edits
    and kept is what they make.
    """
    with opened(settings, "verify a copy: `chunkserver world backup` takes one meanwhile") as store:
        worlds = [existing(store, name) for name in names or ()] or store.catalogue.page("", WORLDS_MAX)
        make_ready()
        warm_edits()
        for world in worlds:
            check_generator(world)
            typer.echo(f"{world.id}: {_verify(store, world, settings)}")


class _Kept(NamedTuple):
    """What was made of the edits up to a revision, and kept. parts: all of it."""

    what: str
    revision: int
    parts: Parts


def _verify(store: Store, world: World, settings: Settings) -> str:
    """Return what was found of a world, if nothing is wrong with it. Ends the command if something is."""
    edited = EditedWorld(store, world, settings)
    states, said = _states(store, world), list[str]()
    start = 0
    if begins_with_foundation(store.log, world.epoch):
        begun = states.pop(0)
        start = begun.revision
        edited.restore(begun.parts, start)
        said.append(f"the foundation of revision {start} is taken as it is")
    migrated = store.log.migrated(world.epoch)
    replayed = (_replay(world, edited, edit, migrated) for edit in behind(store.log, world.epoch, start))
    for revision in chain([start], with_bar("edits", replayed, world.revision - start)):
        while states and states[0].revision <= revision:
            state = states.pop(0)
            _compare(world, edited.history, EditedWorld(store, world, settings), state)
            said.append(f"equal to the {state.what} of revision {state.revision}")
    if edited.history.revision != world.revision:
        end(
            f"{world.id}: behind revision {edited.history.revision} no edit can be read; the world has {world.revision}"
        )
    for state in states:
        end(f"{world.id}: the {state.what} is of revision {state.revision}; the log ends at {world.revision}")
    made = f"they make {counted(len(edited.history.bricks), 'brick')}"
    return "; ".join([f"{counted(world.revision - start, 'edit')} worked out again, {made}", *said])


def _states(store: Store, world: World) -> list[_Kept]:
    """Return what was kept, the foundation first if there is one."""
    foundation, snapshot = store.log.foundation(world.epoch), store.snapshots.load(world.epoch, world.generator)
    states = [_Kept("foundation", foundation.revision, foundation.parts)] if foundation.revision else []
    if snapshot is not None and snapshot.revision >= foundation.revision:
        states.append(_Kept("snapshot", snapshot.revision, snapshot.parts.items()))
    return states


def _replay(world: World, edited: EditedWorld, logged: Any, migrated: int) -> int:
    """Fold one more edit and return its revision. Ends the command if it is none, or changed a chunk untold.

    migrated: up to which revision edits have told what they change in other terrain.
    """
    history = edited.history
    where = f"{world.id}: revision {history.revision + 1}"
    if logged.revision != history.revision + 1:
        end(f"{where} is missing: {logged.revision} comes next")
    before = history.bricks
    try:
        if Edit.read(logged.strokes).source != logged.strokes:
            end(f"{where}: the strokes are not as an edit is written")
        history.logged(logged.strokes, logged.stale, on_other_ground=logged.revision <= migrated)
        edited.fold()
    except (ChunkError, ValueError, KeyError, TypeError) as error:
        end(f"{where} cannot be applied: {error}")
    told = json.loads(logged.stale)
    for key in _changed(before, history.bricks, world.chunk_cells):
        if logged.revision > migrated and not any(_holds(each, key) for each in told):
            end(f"{where} changes chunk {tuple(key)}, which is not among those that it told")
    return history.revision


def _compare(world: World, history: History, kept: EditedWorld, state: _Kept) -> None:
    """Restore a state that was kept. Ends the command if it is not what the edits make."""
    where = f"{world.id}: the {state.what} of revision {state.revision}"
    try:
        kept.restore(state.parts, state.revision)
        found, wanted = (each.change(everything=True) for each in (kept.history, history))
        for key in sorted({*found.bricks} | {*wanted.bricks}):
            if not _alike(kept.history.bricks, history.bricks, key):
                end(f"{where} has other deltas than the log makes in brick {key}: lod, x, y, z")
        for group in sorted({*found.revisions} | {*wanted.revisions}):
            if found.revisions.get(group) != wanted.revisions.get(group):
                end(f"{where} has other revisions than the log in chunks {group}: lod, x, y, z in groups of 4")
    except StoreError as error:
        end(f"{where} cannot be read: {error.message}")


def _alike(one: Bricks, other: Bricks, key: Key) -> bool:
    """Return whether a brick has the same deltas in both, and says that they lie between the same bounds."""
    bounds = [(brick.low, brick.high) if (brick := bricks.get(key)) else None for bricks in (one, other)]
    return bounds[0] == bounds[1] and np.array_equal(_deltas(one, key), _deltas(other, key))


def _changed(before: Bricks, after: Bricks, cells: int) -> Iterator[ChunkKey]:
    """Yield the chunks that read a delta which is another one: of their own level, or of the next at their faces."""
    seen = set[ChunkKey]()
    for key in after.changed:
        lod, *place = key
        differs = _deltas(before, key) != _deltas(after, key)
        for level, side in ((lod, cells), (lod - 1, cells // 2)):
            limit = LATTICE_MAX // (cells << level) if level >= 0 else 0
            spans = (_spans(BRICK * at, side, limit) for at in place)
            for (x, xs), (y, ys), (z, zs) in product(*spans):
                chunk = ChunkKey(level, x, y, z)
                if chunk not in seen and differs[ys, zs, xs].any():
                    seen.add(chunk)
                    yield chunk


def _spans(low: int, side: int, limit: int) -> list[tuple[int, slice]]:
    """Return the chunks along an axis that read some of the deltas of a brick, and which of them.

    low: where the brick begins, in steps of its level. side: of a chunk, in such steps. limit: chunks of the world, on
        each side of the origin.
    """
    found = []
    for at in range(max((low - 2) // side, -limit), min((low + BRICK) // side, limit - 1) + 1):
        start, stop = max(at * side - APRON_DEFAULT - low, 0), min((at + 1) * side + APRON_DEFAULT - low + 1, BRICK)
        if start < stop:
            found.append((at, slice(start, stop)))
    return found


def _deltas(bricks: Bricks, key: Key) -> NDArray[np.int32]:
    brick = bricks.get(key)
    return np.zeros((BRICK,) * 3, np.int32) if brick is None else brick.deltas


def _holds(each: dict[str, Any], key: ChunkKey) -> bool:
    lod, *place = key
    ends = zip(each["min"], place, each["max"], strict=True)
    return bool(each["lod"] == lod and all(low <= at <= high for low, at, high in ends))
