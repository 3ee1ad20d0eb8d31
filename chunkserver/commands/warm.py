"""`chunkserver warm`: compiled code, ahead of time; and for commands that need it now."""

from typing import Final

import typer

from chunkserver import worker

app: Final = typer.Typer(add_completion=False, rich_markup_mode=None)


@app.command()
def command() -> None:
    """Compile ahead of time, so that the next start is ready at once."""
    done = worker.warm()
    what = f"compiled {done.compiled} functions" if done.compiled else "everything was compiled already"
    typer.echo(f"{what} ({done.seconds:.1f} s)")
