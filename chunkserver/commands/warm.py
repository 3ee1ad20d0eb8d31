"""`chunkserver warm`: compiled code, ahead of time; and for commands that need it now."""

from typing import Final

import typer

from chunkserver import worker
from chunkserver.commands.saying import end
from chunkserver.kernel import CACHE_DIR, cache_root

app: Final = typer.Typer(add_completion=False, rich_markup_mode=None)


@app.command()
def command() -> None:
    """Compile ahead of time, so that the next start is ready at once."""
    done = _warm()
    what = f"compiled {done.compiled} functions" if done.compiled else "everything was compiled already"
    typer.echo(f"{what} ({done.seconds:.1f} s)")


def make_ready() -> None:
    """Have all kernels before the first is needed. If they have to be compiled, say so: it takes a while."""
    if not CACHE_DIR.exists():
        typer.echo("the kernels are compiled, once for this version: half a minute", err=True)
    _warm()


def _warm() -> worker.Warmth:
    """Compile what is not compiled yet. Ends the command if there is no place to keep it."""
    try:
        return worker.warm()
    except OSError as error:
        end(f"{cache_root()} cannot be used for compiled code: {error.strerror}. CHUNKSERVER_CACHE_DIR names a folder")
