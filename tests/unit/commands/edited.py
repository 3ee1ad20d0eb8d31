"""Folders of worlds with edits, for tests of commands."""

import json
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

from chunkserver.commands.editing import EditedWorld, behind
from chunkserver.server import Settings
from chunkserver.store import Store
from chunkserver.world import World
from tests.unit.commands.typed import run


def ball(x: float, y: float = 0.0, z: float = 0.0, **more: Any) -> dict[str, Any]:
    """Return a carve of a ball; `more` changes it."""
    return {"op": "carve", "shape": "sphere", "center": [x, y, z], "radius": 4, **more}


def text(*strokes: dict[str, Any], **more: Any) -> str:
    """Return an edit as a line of a file."""
    return json.dumps({"strokes": strokes, **more})


def plane(folder: Path, name: str = "w", recipe: str = "plane") -> None:
    """Create a world in a folder: a plane, or another recipe."""
    options = ("--recipe", recipe, "--cells", 16, "--lods", 3, "--data", folder)
    assert run("world", "create", name, *options).exit_code == 0


def dig(folder: Path, count: int, name: str = "w", first: int = 0) -> None:
    """Apply so many edits to a world: a row of balls that overlap."""
    lines = [text(ball(3 * x, 0, -x), ball(3 * x, 6, 0, op="fill")) for x in range(first, first + count)]
    ended = run("edit", name, "-", "--data", folder, piped="\n".join(lines))
    assert ended.exit_code == 0, ended.output


def logged(folder: Path, name: str = "w") -> list[tuple[int, bytes, bytes]]:
    """Return revision, strokes and stale of each edit that the log of a world has."""
    with closing(Store(folder)) as store:
        world = store.catalogue.find(name)
        assert world is not None
        log = store.log
        return [(edit.revision, edit.strokes, edit.stale) for edit in log.read(world.epoch, log.floor(world.epoch))]


def made(store: Store, name: str, revision: int) -> tuple[World, dict[bytes, bytes]]:
    """Return a world, and what its edits up to a revision make, as it is kept."""
    world = store.catalogue.find(name)
    assert world is not None
    state = EditedWorld(store, world, Settings())
    foundation = store.log.foundation(world.epoch)
    if foundation.revision:
        state.restore(foundation.parts, foundation.revision)
    for edit in behind(store.log, world.epoch, state.history.revision, revision):
        state.history.logged(edit.strokes, edit.stale)
    state.fold()
    assert state.history.revision == revision
    return world, dict(state.history.change(everything=True).parts())


def found(folder: Path, *revisions: int, name: str = "w") -> None:
    """Lay foundations of these revisions, one after the other, and sweep what nothing refers to then."""
    for revision in revisions:
        with closing(Store(folder)) as store:
            world, parts = made(store, name, revision)
            store.log.lay(world.epoch, revision, parts.items())
            while store.log.sweep():
                pass


def keep(folder: Path, revision: int, change: Callable[[dict[bytes, bytes]], object] = len, name: str = "w") -> None:
    """Keep a snapshot of a revision, as a server does; or another one."""
    with closing(Store(folder)) as store:
        world, parts = made(store, name, revision)
        change(parts)
        assert store.snapshots.put(world.epoch, world.generator, revision, parts.items())
