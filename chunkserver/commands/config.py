"""`chunkserver config`: what the settings are."""

import json
from collections.abc import Mapping
from typing import Annotated, Final

import typer

from chunkserver.commands.saying import say_json
from chunkserver.server import Settings, with_settings

app: Final = typer.Typer(
    no_args_is_help=True, add_completion=False, rich_markup_mode=None, help="What the settings are."
)


@app.callback()
def _group() -> None: ...


@app.command("show")
@with_settings()
def show_command(
    settings: Settings,
    origins: Mapping[str, str],
    as_json: Annotated[bool, typer.Option("--json", help="As one JSON object.")] = False,
) -> None:
    """Say each setting's value, and where it comes from: a flag, a variable, a file, or the default."""
    values = settings.shown()
    if as_json:
        say_json({name: {"value": value, "from": origins[name]} for name, value in values.items()})
        return
    width = max(map(len, values))
    for name, value in values.items():
        typer.echo(f"{name:<{width}} = {json.dumps(value)}  # {origins[name]}")
