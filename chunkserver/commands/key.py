"""`chunkserver key`: API keys."""

from typing import Annotated, Final, Literal

import typer

from chunkserver.server import mint

app: Final = typer.Typer(no_args_is_help=True, add_completion=False, rich_markup_mode=None, help="API keys.")

Scope = Literal["read", "edit", "admin"]


@app.callback()
def _group() -> None: ...


@app.command("new")
def new_command(
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
