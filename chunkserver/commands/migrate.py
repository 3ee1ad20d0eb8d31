"""`chunkserver migrate`: worlds that another version has made."""

from collections.abc import Mapping
from typing import Annotated, Final

import typer

from chunkserver.pipeline import generator
from chunkserver.server import Settings, with_settings
from chunkserver.store import migrate

app: Final = typer.Typer(add_completion=False, rich_markup_mode=None)


@app.command()
@with_settings("data")
def command(
    settings: Settings,
    _origins: Mapping[str, str],
    worlds: Annotated[list[str] | None, typer.Argument(metavar="WORLD", help="The worlds to move.")] = None,
    everything: Annotated[bool, typer.Option("--all", help="Move all worlds that need it.")] = False,
) -> None:
    """Move worlds to this version's generator: from then on it makes their terrain, which may be another one.

    Epochs and revisions stay. No server may run on the folder meanwhile.
    """
    if bool(worlds) is everything:
        raise typer.BadParameter("either the worlds, or --all")
    if settings.data is None:
        raise typer.BadParameter("where the worlds are kept is needed: --data DIR")
    moved = migrate(settings.data, worlds or (), generator)
    for world, before in moved:
        typer.echo(f"{world.id}: from generator {before} to {world.generator}, epoch {world.epoch} stays")
    typer.echo(f"{len(moved)} worlds moved")
