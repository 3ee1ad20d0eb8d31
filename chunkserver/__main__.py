"""The command line. Every option of `serve` can be given as an environment variable too."""

import sys
from pathlib import Path
from typing import Annotated, Final, NoReturn

import typer

from chunkserver import __version__
from chunkserver.errors import StoreError
from chunkserver.server import WORKERS_MAX, Settings, create_app, listen, serve
from chunkserver.worker import warm

DEFAULTS: Final = Settings()
PORT_MAX: Final = 65535
CACHE_BYTES_MAX: Final = 1 << 40

app = typer.Typer(no_args_is_help=True, rich_markup_mode=None, add_completion=False, pretty_exceptions_enable=False)


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
def serve_command(
    host: Annotated[str, typer.Option(envvar="CHUNKSERVER_HOST", help="The address to listen on.")] = DEFAULTS.host,
    port: Annotated[
        int, typer.Option(envvar="CHUNKSERVER_PORT", min=0, max=PORT_MAX, help="The port; 0 takes a free one.")
    ] = DEFAULTS.port,
    workers: Annotated[
        int, typer.Option(envvar="CHUNKSERVER_WORKERS", min=1, max=WORKERS_MAX, help="Processes that build chunks.")
    ] = DEFAULTS.workers,
    cache_bytes: Annotated[
        int,
        typer.Option(envvar="CHUNKSERVER_CACHE_BYTES", min=0, max=CACHE_BYTES_MAX, help="Memory for finished chunks."),
    ] = DEFAULTS.cache_bytes,
    folder: Annotated[
        Path | None,
        typer.Option(
            "--data",
            envvar="CHUNKSERVER_DATA",
            metavar="DIR",
            file_okay=False,
            help="Where worlds are kept, for one server alone. Without it they are in memory and end with the server.",
        ),
    ] = DEFAULTS.folder,
) -> None:
    """Answer requests until SIGTERM or Ctrl-C; those in flight are answered first."""
    try:
        listening = listen(host, port)
    except OSError as error:
        _end(f"cannot serve on {host} port {port}: {error}")
    try:
        app = create_app(Settings(host, port, workers, cache_bytes, folder))
    except StoreError as error:
        _end(error.message)
    serve(app, listening)


def _end(why: str) -> NoReturn:
    typer.echo(why, err=True)
    raise typer.Exit(1)


@app.command("warm")
def warm_command() -> None:
    """Compile ahead of time, so that the next start is ready at once."""
    done = warm()
    what = f"compiled {done.compiled} functions" if done.compiled else "everything was compiled already"
    typer.echo(f"{what} ({done.seconds:.1f} s)")


if __name__ == "__main__":
    sys.exit(app())
