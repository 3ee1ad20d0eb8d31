"""The table of built-in recipes, and what a user may give as a recipe: a name, a tree, JSON."""

import inspect
from collections.abc import Callable
from functools import lru_cache
from typing import Final

from pydantic import ValidationError, validate_call

from chunkserver.errors import BadRecipe
from chunkserver.recipe.library.arches import arches
from chunkserver.recipe.library.canyon import canyon
from chunkserver.recipe.library.city import city
from chunkserver.recipe.library.continents import continents
from chunkserver.recipe.library.floating_islands import floating_islands
from chunkserver.recipe.library.islands import islands
from chunkserver.recipe.library.moon import moon
from chunkserver.recipe.library.planet import planet
from chunkserver.recipe.library.ring import ring
from chunkserver.recipe.library.solids import plane, sphere
from chunkserver.recipe.library.spires import spires
from chunkserver.recipe.library.terrain import caves, hills, terrain
from chunkserver.recipe.node import Node
from chunkserver.recipe.reading import canonical_tree, read_json
from chunkserver.recipe.refusals import bad_recipe

RECIPE_DEFAULT: Final = "terrain"
NAME_CHARACTERS_MAX: Final = 64

Builtin = Callable[..., Node]

BUILTINS: Final[dict[str, Builtin]] = {
    "terrain": terrain,
    "hills": hills,
    "sphere": sphere,
    "plane": plane,
    "caves": caves,
    "planet": planet,
    "islands": islands,
    "canyon": canyon,
    "floating-islands": floating_islands,
    "arches": arches,
    "moon": moon,
    "city": city,
    "spires": spires,
    "ring": ring,
    "continents": continents,
}


def canonical(given: object) -> str:
    """Return the canonical JSON of whatever a user may give as a recipe.

    given: the name of a built-in, `{"builtin": name, parameter: value, ...}`, or an expression tree; parsed JSON, or
        JSON itself as bytes. A tree may also be a node.

    Equal recipes have equal canonical JSON: 1 and 1.0, 0 and -0.0, a number and its constant node are the same.

    Raises `BadRecipe` that names the path of what is bad and says what was expected.
    """
    if isinstance(given, bytes):
        given = read_json(given)
    if isinstance(given, str):
        return builtin(given)
    if isinstance(given, dict) and "builtin" in given:
        return builtin(given["builtin"], **{name: value for name, value in given.items() if name != "builtin"})
    return canonical_tree(given)


def builtin(name: str, /, **parameters: float) -> str:
    """Return the canonical JSON of a built-in recipe. Raises `BadRecipe` for an unknown name, parameter or value."""
    if not isinstance(name, str) or name not in BUILTINS:
        shown = repr(name)[:NAME_CHARACTERS_MAX]
        raise BadRecipe(f"recipe is {shown}; built in are {sorted(BUILTINS)}", recipe=str(name)[:NAME_CHARACTERS_MAX])
    return canonical_tree(_build(name, parameters)) if parameters else _plain(name)


@lru_cache
def _plain(name: str) -> str:
    """Built-ins without parameters are asked for with every request."""
    return canonical_tree(BUILTINS[name]())


def _build(name: str, parameters: dict[str, float]) -> Node:
    known = sorted(inspect.signature(BUILTINS[name]).parameters)
    for parameter in parameters:
        if parameter not in known:
            shown = parameter[:NAME_CHARACTERS_MAX]
            raise BadRecipe(f"recipe {name!r} has no parameter {shown!r}; it has {known}", recipe=name, parameter=shown)
    try:
        return validate_call(BUILTINS[name])(**parameters)
    except ValidationError as error:
        raise bad_recipe(error, parameters) from None
