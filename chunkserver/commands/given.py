"""A recipe as it is given to a command: the name of a built-in, a file of JSON, or - for what is piped in."""

import os
from pathlib import Path
from typing import Annotated, Final, NamedTuple

import typer

from chunkserver.commands.files import PIPE, read
from chunkserver.errors import BadRecipe
from chunkserver.recipe import BUILTINS, canonical

RECIPE_BYTES_MAX: Final = 1 << 20
"""More than any recipe may have: a file that is longer is read no further."""


class Given(NamedTuple):
    """A recipe. name: the built-in's; None, if it is none. source: canonical JSON."""

    name: str | None
    source: str


def complete_builtin(incomplete: str) -> list[str]:
    """Return the built-ins that begin so, for the shell."""
    return [name for name in BUILTINS if name.startswith(incomplete)]


def complete_recipe(incomplete: str) -> list[str]:
    """Return what a recipe that begins so may be, for the shell: built-ins, and files of JSON."""
    head, slash, begun = incomplete.rpartition(os.sep)
    folder = Path(head + slash)
    files = [file.name for file in folder.iterdir()] if folder.is_dir() else []
    wanted = sorted(file for file in files if file.startswith(begun) and file.endswith(".json"))
    return [*complete_builtin(incomplete), *(head + slash + file for file in wanted)]


RecipeOption = Annotated[
    str,
    typer.Option(
        "--recipe", metavar="NAME|FILE|-", autocompletion=complete_recipe, help="A built-in, or a file of JSON."
    ),
]
SeedOption = Annotated[int, typer.Option("--seed", metavar="NUMBER", help="A signed 64-bit integer.")]


def recipe_of(given: str) -> Given:
    """Return the recipe that is given. Ends the command, if a file cannot be read. Raises `BadRecipe`."""
    if given in BUILTINS:
        return Given(given, canonical(given))
    if given != PIPE and not _is_there(given):
        shown = ", ".join(BUILTINS)
        raise BadRecipe(f"recipe {given!r} is no file, and none that is built in: {shown}", recipe=given)
    try:
        return Given(None, canonical(read(given, RECIPE_BYTES_MAX)))
    except BadRecipe as error:
        raise BadRecipe(f"{given}: {error.message}", **error.values) from None


def _is_there(name: str) -> bool:
    """Return whether there may be a file of that name: what is in the way is said by whoever reads it."""
    try:
        return Path(name).exists()
    except OSError:
        return True
