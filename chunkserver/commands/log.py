"""`chunkserver log`: the edits of a world, to look at and to carry elsewhere, while no server runs on its folder."""

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Final

import typer

from chunkserver.commands.editing import begins_with_foundation, behind
from chunkserver.commands.files import PIPE, check_writable, lines, written
from chunkserver.commands.folder import IdArgument, JsonOption, existing, folder_of, opened
from chunkserver.commands.log_file import LINE_BYTES_MAX, Header, Line, LogReader, LogWriter
from chunkserver.commands.saying import counted, end, say_json, say_table, with_bar
from chunkserver.commands.warm import make_ready
from chunkserver.edits import Edit
from chunkserver.errors import BadParameter
from chunkserver.field import prove
from chunkserver.grid import ChunkKey, ChunkShape
from chunkserver.pipeline import ChunkRequest, check_request, generator
from chunkserver.recipe import BUILTINS
from chunkserver.server import Settings, with_settings
from chunkserver.store import Draft
from chunkserver.world import World, new_epoch, now

app: Final = typer.Typer(
    no_args_is_help=True, add_completion=False, rich_markup_mode=None, help="The edits of a world."
)

SHOWN_DEFAULT: Final = 20
SHOWN_MAX: Final = 10_000
WRITTEN_AT_ONCE_MAX: Final = 1000
WRITTEN_BYTES_MAX: Final = 16 << 20
"""Edits that are written together."""

Origins = Mapping[str, str]
Object = dict[str, Any]

_MIDDLE: Final = ChunkKey(0, 0, 0, 0)


@app.command("show")
@with_settings("data")
def show_command(
    settings: Settings,
    _origins: Origins,
    name: IdArgument,
    after: Annotated[
        int | None, typer.Option("--after", metavar="REVISION", help="Those behind it, not the last ones.")
    ] = None,
    limit: Annotated[int, typer.Option("--limit", metavar="NUMBER", help="So many at most.")] = SHOWN_DEFAULT,
    as_json: JsonOption = False,
) -> None:
    """List edits of a world: the last ones, or those behind a revision."""
    if not 1 <= limit <= SHOWN_MAX:
        raise BadParameter(f"limit is {limit}; it lies in [1, {SHOWN_MAX}]", limit=limit)
    with opened(settings, f"ask it: GET /v1/worlds/{name}/edits") as store:
        world, log = existing(store, name), store.log
        floor, revision = log.floor(world.epoch), log.revision(world.epoch)
        start = max(floor, revision - limit) if after is None else after
        edits = [_members(edit) for edit in behind(log, world.epoch, start, min(start + limit, revision))]
    if as_json:
        say_json({"world": name, "epoch": world.epoch, "revision": str(revision), "floor": str(floor), "edits": edits})
        return
    head = ("revision", "strokes", "stale", "by")
    width = len(head) if any("client" in edit for edit in edits) else len(head) - 1
    say_table(head[:width], [_row(edit)[:width] for edit in edits])


@app.command("export")
@with_settings("data")
def export_command(
    settings: Settings,
    _origins: Origins,
    name: IdArgument,
    file: Annotated[str, typer.Argument(metavar="FILE", help="What is written; - is stdout.")],
) -> None:
    """Write a world and all of its edits to a file, which `log import` makes a world of, here or elsewhere."""
    check_writable(file)
    if file != PIPE and Path(file).resolve().parent == folder_of(settings).resolve():
        end(f"{file} cannot be written: what is in {settings.data} is the server's own")
    with (
        opened(settings, "export a copy: `chunkserver world backup` takes one meanwhile") as store,
        written(file) as sink,
    ):
        world, log = existing(store, name), store.log
        found = log.foundation(world.epoch) if begins_with_foundation(log, world.epoch) else None
        writer = LogWriter(Header(world, found.revision if found else 0, log.migrated(world.epoch)), sink.write)
        for part in found.parts if found else ():
            writer.part(part)
        start = found.revision if found else 0
        edits = behind(log, world.epoch, start, world.revision)
        for edit in with_bar("edits", edits, world.revision - start):
            sender = None if edit.client is None or edit.seq is None else (edit.client, edit.seq)
            writer.edit(Line(edit.revision, edit.strokes, edit.stale, sender))
        writer.end()
    said = f"{file}: {name} at revision {world.revision}, {counted(writer.edits, 'edit')}"
    typer.echo(f"{said} behind a foundation" if writer.parts else said, err=file == PIPE)


@app.command("import")
@with_settings("data")
def import_command(
    settings: Settings,
    _origins: Origins,
    file: Annotated[str, typer.Argument(metavar="FILE", help="What `log export` has written; - is stdin.")],
    name: Annotated[
        str | None, typer.Option("--id", metavar="ID", help="Of the new world; otherwise that which it had.")
    ] = None,
    regenerate: Annotated[
        bool, typer.Option("--other-terrain", help="Also if this version makes other terrain of its recipe.")
    ] = False,
) -> None:
    """Make a world of an exported one: a new one, with an epoch of its own.

    It is there when all of it is on the disk, or not at all. Keys of edits, and what clients have sent, are not known
    to it.
    """
    reader = LogReader(file, lines(file, LINE_BYTES_MAX))
    world = _new_world(reader.header.world, name, regenerate)
    make_ready()
    prove(world.recipe, _MIDDLE, ChunkShape(world.chunk_cells))
    with opened(settings, "import into another folder", new=True) as store:
        if store.catalogue.find(world.id) is not None:
            end(f"there is a world {world.id!r} already: --id gives this one another name")
        is_other = world.generator != reader.header.world.generator
        store.catalogue.prepare(world.epoch, world.revision if is_other else reader.header.migrated)
        if reader.header.foundation:
            store.log.lay(world.epoch, reader.header.foundation, reader.parts())
        count = world.revision - reader.header.foundation
        for drafts in _portions(_drafts(world.epoch, with_bar("edits", reader.edits(), count))):
            for written in [store.writer.submit(draft) for draft in drafts]:
                written.result()
        store.catalogue.create(world)
    typer.echo(f"{world.id} is created at revision {world.revision}, epoch {world.epoch}")


def _new_world(told: World, name: str | None, regenerate: bool) -> World:
    """Return the world that is to be made of an exported one. Ends the command if its terrain would be another."""
    current = generator(told.recipe)
    if told.generator != current and not regenerate:
        message = f"the world is of generator {told.generator}, and this version has {current}"
        end(f"{message}, which would make other terrain: --other-terrain takes that")
    recipe_name = told.recipe_name if told.recipe_name in BUILTINS else told.recipe.digest
    check_request(ChunkRequest(told.recipe, _MIDDLE, told.chunk_cells, told.voxel_size))
    return replace(
        told, id=name or told.id, epoch=new_epoch(), created=now(), generator=current, recipe_name=recipe_name
    )


def _drafts(epoch: str, edits: Iterable[tuple[Edit, bytes]]) -> Iterator[Draft]:
    for edit, stale in edits:
        yield Draft(epoch=epoch, digest=edit.digest, strokes=edit.source, stale=stale)


def _portions(drafts: Iterable[Draft]) -> Iterator[list[Draft]]:
    """Yield drafts, as many at a time as may wait to be written."""
    waiting, weight = list[Draft](), 0
    for draft in drafts:
        if waiting and (len(waiting) == WRITTEN_AT_ONCE_MAX or weight + draft.weight > WRITTEN_BYTES_MAX):
            yield waiting
            waiting, weight = [], 0
        waiting.append(draft)
        weight += draft.weight
    yield waiting


def _members(edit: Any) -> Object:
    """Return an edit as JSON has it."""
    strokes, stale = json.loads(edit.strokes), json.loads(edit.stale)
    sender = {} if edit.client is None else {"client": edit.client, "seq": edit.seq}
    return {"revision": str(edit.revision), **sender, "strokes": strokes, "stale": stale}


def _row(edit: Object) -> tuple[str, ...]:
    first, *others = edit["strokes"]
    more = f", and {counted(len(others), 'stroke')} more" if others else ""
    by = f"{edit['client']} {edit['seq']}" if "client" in edit else ""
    return edit["revision"], _short(first) + more, counted(_chunks(edit["stale"]), "chunk"), by


def _short(stroke: Object) -> str:
    """Return a stroke in a few words."""
    if stroke["op"] == "delta":
        return f"delta of {' x '.join(map(str, stroke['size']))} from {_point(stroke['min'])}"
    said = f"{stroke['op']} {stroke['shape']} "
    if stroke["shape"] == "capsule":
        return f"{said}{_point(stroke['a'])} to {_point(stroke['b'])}, radius {stroke['radius']:g}"
    size = stroke.get("radius")
    extent = f"half extents {_point(stroke['half_extents'])}" if size is None else f"radius {size:g}"
    return f"{said}{_point(stroke['center'])}, {extent}"


def _point(place: Sequence[float]) -> str:
    return f"({', '.join(f'{at:.1f}'.removesuffix('.0') for at in place)})"


def _chunks(stale: list[Object]) -> int:
    sides = ([high - low + 1 for low, high in zip(each["min"], each["max"], strict=True)] for each in stale)
    return sum(x * y * z for x, y, z in sides)
