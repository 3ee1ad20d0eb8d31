"""`chunkserver world`: the worlds that a folder keeps, while no server runs on it; and copies of them, at any time."""

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Final

import typer

from chunkserver.commands.folder import IdArgument, JsonOption, existing, folder_of, opened
from chunkserver.commands.given import RecipeOption, SeedOption, recipe_of
from chunkserver.commands.saying import counted, end, say_json, say_table
from chunkserver.commands.warm import make_ready
from chunkserver.errors import BadParameter
from chunkserver.field import prove
from chunkserver.grid import CELLS_DEFAULT, ChunkKey, ChunkShape
from chunkserver.pipeline import ChunkRequest, check_request, generator
from chunkserver.recipe import RECIPE_DEFAULT, WorldRecipe
from chunkserver.server import Settings, with_settings
from chunkserver.store import Store
from chunkserver.world import LODS_DEFAULT, VOXEL_SIZE_DEFAULT, WORLDS_MAX, World

app: Final = typer.Typer(
    no_args_is_help=True, add_completion=False, rich_markup_mode=None, help="The worlds that a folder keeps."
)

Origins = Mapping[str, str]

_MIDDLE: Final = ChunkKey(0, 0, 0, 0)


@app.command("list")
@with_settings("data")
def list_command(settings: Settings, _origins: Origins, as_json: JsonOption = False) -> None:
    """List the worlds of a folder."""
    with opened(settings) as store:
        worlds = store.catalogue.page("", WORLDS_MAX)
    if as_json:
        say_json([_described(world) for world in worlds])
        return
    head = ("world", "seed", "recipe", "cells", "voxel", "lods", "revision", "created")
    say_table(head, [_row(world) for world in worlds])


@app.command("show")
@with_settings("data")
def show_command(settings: Settings, _origins: Origins, name: IdArgument, as_json: JsonOption = False) -> None:
    """Say what a world is."""
    with opened(settings) as store:
        described = _described(existing(store, name))
    if as_json:
        say_json(described)
        return
    width = max(map(len, described))
    for member, value in described.items():
        typer.echo(f"{member:<{width}}  {value}")


@app.command("create")
@with_settings("data")
def create_command(
    settings: Settings,
    _origins: Origins,
    name: IdArgument,
    recipe: RecipeOption = RECIPE_DEFAULT,
    seed: SeedOption = 0,
    voxel_size: Annotated[
        float, typer.Option("--voxel-size", metavar="METRES", help="Of one voxel.")
    ] = VOXEL_SIZE_DEFAULT,
    lods: Annotated[int, typer.Option("--lods", metavar="NUMBER", help="Levels of detail.")] = LODS_DEFAULT,
    cells: Annotated[int, typer.Option("--cells", metavar="16|32|64", help="Cells a side of a chunk.")] = CELLS_DEFAULT,
) -> None:
    """Create a world; and the folder, if there is none."""
    given = recipe_of(recipe)
    pristine = WorldRecipe(seed, given.source)
    world = World(
        id=name,
        recipe=pristine,
        recipe_name=given.name or pristine.digest,
        generator=generator(pristine),
        voxel_size=voxel_size,
        lods=lods,
        chunk_cells=cells,
    )
    check_request(ChunkRequest(pristine, _MIDDLE, cells, voxel_size))
    make_ready()
    prove(pristine, _MIDDLE, ChunkShape(cells))
    with opened(settings, new=True) as store:
        if store.catalogue.create(world) is not world:
            end(f"there is a world {name!r} already")
    typer.echo(f"{name} is created, epoch {world.epoch}")


@app.command("delete")
@with_settings("data")
def delete_command(
    settings: Settings,
    _origins: Origins,
    name: IdArgument,
    sure: Annotated[bool, typer.Option("--yes", help="Do not ask.")] = False,
) -> None:
    """Delete a world for good."""
    with opened(settings) as store:
        existing(store, name)
        if not sure and not _confirmed(name):
            end("nothing was deleted")
        store.catalogue.delete(name)
    typer.echo(f"{name} is deleted")


@app.command("backup")
@with_settings("data")
def backup_command(
    settings: Settings,
    _origins: Origins,
    file: Annotated[Path, typer.Argument(metavar="FILE", help="A new file.")],
) -> None:
    """Copy the worlds of a folder and their edits to one file, as of one moment. A server may run on the folder."""
    Store.back_up(folder_of(settings), file)
    typer.echo(f"{file}: {file.stat().st_size:,} bytes")


@app.command("restore")
@with_settings("data")
def restore_command(
    settings: Settings,
    _origins: Origins,
    file: Annotated[Path, typer.Argument(metavar="FILE", help="What `world backup` has written.")],
) -> None:
    """Put a backup into a folder that holds no worlds.

    Each world gets a new epoch: clients that have seen more than the backup has start over.
    """
    worlds = Store.restore(file, folder_of(settings))
    for world in worlds:
        typer.echo(f"{world.id}: revision {world.revision}, new epoch {world.epoch}")
    typer.echo(f"{counted(len(worlds), 'world')} restored")


def _confirmed(name: str) -> bool:
    if not _can_ask():
        raise BadParameter(f"nobody can be asked whether {name!r} shall be deleted: --yes says so", id=name)
    return typer.confirm(f"Delete {name!r} for good?", err=True)


def _can_ask() -> bool:
    return sys.stdin.isatty()


def _row(world: World) -> tuple[str, ...]:
    numbers = (str(world.chunk_cells), f"{world.voxel_size:g} m", str(world.lods), str(world.revision))
    return (world.id, str(world.recipe.seed), world.recipe_name, *numbers, world.created)


def _described(world: World) -> dict[str, Any]:
    """Return what the HTTP API says of it too, by the same names."""
    return {
        "id": world.id,
        "epoch": world.epoch,
        "revision": str(world.revision),
        "created": world.created,
        "seed": str(world.recipe.seed),
        "recipe": world.recipe_name,
        "generator": world.generator,
        "generator_is_current": world.generator == generator(world.recipe),
        "voxel_size": world.voxel_size,
        "lods": world.lods,
        "chunk_cells": world.chunk_cells,
    }
