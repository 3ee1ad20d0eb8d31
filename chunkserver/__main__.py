"""The command line. Every option that has a setting's name is that setting; all else about settings is in `server`."""

import json
import sys
from collections.abc import Mapping
from typing import Annotated, Final, Literal, NoReturn

import typer

from chunkserver import __version__
from chunkserver.catalogue import migrate
from chunkserver.errors import BadSetting, ChunkError
from chunkserver.pipeline import generator
from chunkserver.server import Settings, create_app, listen, mint, serve, with_settings
from chunkserver.worker import warm

FAILED: Final = 1
MISUSED: Final = 2
"""Exit codes: it could not be done; what is asked for cannot be."""

app = typer.Typer(no_args_is_help=True, rich_markup_mode=None, add_completion=False, pretty_exceptions_enable=False)
config_app = typer.Typer(no_args_is_help=True, rich_markup_mode=None, help="What the settings are.")
key_app = typer.Typer(no_args_is_help=True, rich_markup_mode=None, help="API keys.")
app.add_typer(config_app, name="config")
app.add_typer(key_app, name="key")

Origins = Mapping[str, str]
Scope = Literal["read", "edit", "admin"]


def _say_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"chunkserver {__version__}")
        raise typer.Exit


@app.callback()
def main(
    _version: Annotated[
        bool, typer.Option("--version", callback=_say_version, is_eager=True, help="Say the version, and end.")
    ] = False,
) -> None:
    """Serve marching-cubes terrain over HTTP."""


@app.command("serve")
@with_settings()
def serve_command(settings: Settings, _origins: Origins) -> None:
    """Answer requests until SIGTERM or Ctrl-C; those in flight are answered first."""
    try:
        listening = listen(settings.host, settings.port)
    except OSError as error:
        _end(f"cannot serve on {settings.host} port {settings.port}: {error}")
    try:
        served = create_app(settings)
    except BadSetting as error:
        _end(error.message, MISUSED)
    except ChunkError as error:
        _end(error.message)
    serve(served, listening, served.state.service.connections)


@app.command("warm")
def warm_command() -> None:
    """Compile ahead of time, so that the next start is ready at once."""
    done = warm()
    what = f"compiled {done.compiled} functions" if done.compiled else "everything was compiled already"
    typer.echo(f"{what} ({done.seconds:.1f} s)")


@app.command("migrate")
@with_settings("data")
def migrate_command(
    settings: Settings,
    _origins: Origins,
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
    try:
        moved = migrate(settings.data, worlds or (), generator)
    except ChunkError as error:
        _end(error.message)
    for world, before in moved:
        typer.echo(f"{world.id}: from generator {before} to {world.generator}, epoch {world.epoch} stays")
    typer.echo(f"{len(moved)} worlds moved")


@config_app.command("show")
@with_settings()
def show_command(
    settings: Settings,
    origins: Origins,
    as_json: Annotated[bool, typer.Option("--json", help="As one JSON object.")] = False,
) -> None:
    """Say each setting's value, and where it comes from: a flag, a variable, a file, or the default."""
    values = settings.shown()
    if as_json:
        typer.echo(
            json.dumps({name: {"value": value, "from": origins[name]} for name, value in values.items()}, indent=2)
        )
        return
    width = max(map(len, values))
    for name, value in values.items():
        typer.echo(f"{name:<{width}} = {json.dumps(value)}  # {origins[name]}")


@key_app.command("new")
def new_key_command(
    name: Annotated[str, typer.Option("--name", help="Whose it is: for people, and for the log.")],
    scope: Annotated[Scope, typer.Option("--scope", help="What it is good for; each includes those before it.")],
) -> None:
    """Make an API key. It is shown this once; the server keeps its digest alone."""
    try:
        secret, kept = mint(name, scope)
    except ValueError as error:
        raise typer.BadParameter(str(error)) from None
    typer.echo(f"The key, for the client; nobody can show it again:\n\n    {secret}\n")
    typer.echo(f'For the server, one more entry of api_keys in its file of settings:\n\n    api_keys = ["{kept}"]\n')
    typer.echo(f"or in the environment, separated by spaces:\n\n    CHUNKSERVER_API_KEYS={kept}")


def _end(why: str, code: int = FAILED) -> NoReturn:
    typer.echo(why, err=True)
    raise typer.Exit(code)


if __name__ == "__main__":
    sys.exit(app())
