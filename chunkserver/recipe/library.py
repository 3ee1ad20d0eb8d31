"""The built-in recipes: each is a short function from its parameters to an expression that a user could have posted."""

import inspect
from collections.abc import Callable
from functools import lru_cache
from typing import Final

from pydantic import ValidationError, validate_call

from chunkserver.errors import BadRecipe
from chunkserver.recipe.nodes import Axis, Binary, Constant, Fbm, Length, Node, Number, Simplex3, Sphere
from chunkserver.recipe.reading import bad_recipe, canonical_tree, read_json

HILLS_FREQUENCY: Final = 0.02
HILLS_OCTAVES: Final = 5
RELIEF_VOXELS: Final = 24.0
CAVE_FREQUENCY: Final = 0.05
CAVE_THRESHOLD: Final = 0.6
CAVE_SCALE: Final = 6.0
"""Makes the gradient of the cave term about 1 per voxel at its surface (measured: `tests/unit/field/test_noise.py`),
without moving that surface, so that an edit's strength means voxels."""

SPHERE_RADIUS: Final = 48.0
PLANET_RADIUS: Final = 200.0
PLANET_FREQUENCY: Final = 0.01
PLANET_OCTAVES: Final = 5
RECIPE_DEFAULT: Final = "terrain"
NAME_CHARACTERS_MAX: Final = 64

Builtin = Callable[..., Node]


def _terrain(relief: Number = RELIEF_VOXELS) -> Node:
    """Rolling hills with caves cut out: the article's field."""
    return Binary(op="max", a=_hills(relief), b=_caves())


def _hills(relief: Number = RELIEF_VOXELS) -> Node:
    """A heightfield of octaves of gradient noise, `relief` voxels high."""
    heights = Fbm(op="fbm2", frequency=HILLS_FREQUENCY, octaves=HILLS_OCTAVES)
    return Binary(op="subtract", a=Axis(op="y"), b=_times(heights, relief))


def _caves() -> Node:
    """Rock with caves where simplex noise passes a threshold."""
    above_threshold = Binary(op="subtract", a=Simplex3(frequency=CAVE_FREQUENCY), b=Constant(value=CAVE_THRESHOLD))
    return _times(above_threshold, CAVE_SCALE)


def _sphere(radius: Length = SPHERE_RADIUS) -> Node:
    """A ball of rock at the origin."""
    return Sphere(radius=radius)


def _plane() -> Node:
    """Rock below y = 0."""
    return Axis(op="y")


def _planet(radius: Length = PLANET_RADIUS, relief: Number = RELIEF_VOXELS) -> Node:
    """A ball of rock with relief on its surface and caves inside."""
    heights = Fbm(op="fbm3", frequency=PLANET_FREQUENCY, octaves=PLANET_OCTAVES)
    surface = Binary(op="subtract", a=Sphere(radius=radius), b=_times(heights, relief))
    return Binary(op="max", a=surface, b=_caves())


def _times(node: Node, factor: float) -> Node:
    return Binary(op="multiply", a=node, b=Constant(value=factor))


BUILTINS: Final[dict[str, Builtin]] = {
    "terrain": _terrain,
    "hills": _hills,
    "sphere": _sphere,
    "plane": _plane,
    "caves": _caves,
    "planet": _planet,
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
