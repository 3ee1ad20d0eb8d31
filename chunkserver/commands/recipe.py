"""`chunkserver recipe`: what worlds are made of."""

import inspect
import json
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, Final

import typer

from chunkserver.commands.given import complete_builtin, complete_recipe, recipe_of
from chunkserver.commands.loading import load
from chunkserver.commands.saying import counted, end, say_json, say_table
from chunkserver.grid import CELLS_DEFAULT, ChunkKey, ChunkShape
from chunkserver.recipe import BUILTINS, WorldRecipe, builtin, nodes

app: Final = typer.Typer(
    no_args_is_help=True, add_completion=False, rich_markup_mode=None, help="What worlds are made of."
)

STARTER: Final = {
    "op": "min",
    "a": {
        "op": "heightfield",
        "height": {"op": "multiply", "a": {"op": "fbm2", "frequency": 0.01, "octaves": 5}, "b": 16},
    },
    "b": {"op": "sphere", "center": [16, 24, 16], "radius": 12},
}
"""Rock where either is rock (`min`): hills (`a`), and a ball above them (`b`)."""

JsonOption = Annotated[bool, typer.Option("--json", help="As JSON.")]
NameArgument = Annotated[str, typer.Argument(metavar="NAME", autocompletion=complete_builtin, help="A built-in.")]


@app.command("list")
def list_command(as_json: JsonOption = False) -> None:
    """List the built-in recipes."""
    if as_json:
        say_json([_described(name, function) for name, function in BUILTINS.items()])
        return
    say_table(("recipe", "what it is"), [(name, _what(function)) for name, function in BUILTINS.items()])


@app.command("show")
def show_command(name: NameArgument) -> None:
    """Print a built-in recipe as JSON: the expression tree that a file could have had."""
    say_json(json.loads(builtin(name)))


@app.command("check")
def check_command(
    file: Annotated[str, typer.Argument(metavar="FILE", autocompletion=complete_recipe, help="JSON; - is stdin.")],
    as_json: JsonOption = False,
) -> None:
    """Say whether a recipe is one, and what it costs. What is wrong is named by its path in the tree."""
    given = recipe_of(file)
    recipe = WorldRecipe(0, given.source)
    load("chunkserver.commands.warm").make_ready()
    load("chunkserver.field").prove(recipe, ChunkKey(0, 0, 0, 0), ChunkShape())
    every = list(_nodes(recipe.expression))
    cost = sum(node.cost() for node in every)
    chunk_ms = cost * ChunkShape().samples ** 3 / 1e6
    if as_json:
        say_json({"digest": recipe.digest, "nodes": len(every), "sample_ns": cost, "chunk_ms": chunk_ms})
        return
    typer.echo(
        f"{file} is a recipe of {counted(len(every), 'node')}, {counted(len(given.source), 'byte')} as it is kept"
    )
    typer.echo(f"cost    {cost:,.0f} ns a sample: about {chunk_ms:.1f} ms for a chunk of {CELLS_DEFAULT} cells")
    typer.echo(f"digest  {recipe.digest}")


@app.command("new")
def new_command(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="It must not be there yet.")],
) -> None:
    """Write a small recipe to begin with: hills, and a ball above them."""
    try:
        with file.open("x", encoding="utf-8") as new:
            new.write(json.dumps(STARTER, indent=2) + "\n")
    except OSError as error:
        end(f"{file} cannot be written: {error.strerror}")
    typer.echo(f"{file}: rock where either is rock (min): hills (a), and a ball above them (b). Now:\n")
    typer.echo(f"  chunkserver recipe check {file}")
    typer.echo(f"  chunkserver mesh {file.with_suffix('.glb')} --recipe {file} --box -2 -1 -2 2 1 2")


def _what(function: Callable[..., object]) -> str:
    return " ".join((inspect.getdoc(function) or "").partition("\n\n")[0].split())


def _described(name: str, function: Callable[..., object]) -> dict[str, Any]:
    parameters = inspect.signature(function).parameters.values()
    return {
        "name": name,
        "description": _what(function),
        "digest": WorldRecipe(0, builtin(name)).digest,
        "parameters": {parameter.name: parameter.default for parameter in parameters},
    }


def _nodes(root: nodes.Node) -> list[nodes.Node]:
    found = [root]
    for node in found:
        found += [child for _, child in node.children()]
    return found
