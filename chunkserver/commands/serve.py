"""`chunkserver serve`: the HTTP server."""

from collections.abc import Mapping
from typing import Final

import typer

from chunkserver.commands.saying import end
from chunkserver.server import Settings, create_app, listen, serve, with_settings

app: Final = typer.Typer(add_completion=False, rich_markup_mode=None)


@app.command()
@with_settings()
def command(settings: Settings, _origins: Mapping[str, str]) -> None:
    """Answer requests until SIGTERM or Ctrl-C; those in flight are answered first."""
    try:
        listening = listen(settings.host, settings.port)
    except OSError as error:
        end(f"cannot serve on {settings.host} port {settings.port}: {error}")
    served = create_app(settings)
    serve(served, listening, served.state.service.connections)
