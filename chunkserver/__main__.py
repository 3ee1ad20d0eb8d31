"""The command line: the table of commands. Each is a file of its name in `commands/`."""

import sys
from collections.abc import Mapping
from typing import Annotated, ClassVar, Final

import typer

from chunkserver import __version__
from chunkserver.commands import Commands


class _Table(Commands):
    names: ClassVar[Mapping[str, str]] = {
        "serve": "Answer requests until SIGTERM or Ctrl-C.",
        "mesh": "Write a chunk, or a box of chunks, to a file.",
        "inspect": "Say what is in a file of a chunk, and whether it is right.",
        "recipe": "What worlds are made of.",
        "world": "The worlds that a folder keeps.",
        "edit": "Apply edits to a world.",
        "log": "The edits of a world.",
        "migrate": "Move worlds to this version's generator.",
        "verify": "Work the edits of worlds out again, one by one, and compare.",
        "config": "What the settings are.",
        "key": "API keys.",
        "warm": "Compile ahead of time, so that the next start is ready at once.",
    }


app: Final = typer.Typer(cls=_Table, no_args_is_help=True, rich_markup_mode=None, pretty_exceptions_enable=False)


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
    """Serve marching-cubes terrain over HTTP, or write it to files."""


if __name__ == "__main__":
    sys.exit(app())
