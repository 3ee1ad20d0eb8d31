"""The built-in recipes: each is a short function from its parameters to an expression that a user could have posted."""

import inspect
from collections.abc import Callable
from typing import Final

from pydantic import ValidationError

from chunkserver.errors import BadRecipe
from chunkserver.recipe.nodes import Axis, Binary, Constant, Fbm, Node, Simplex3, Sphere
from chunkserver.recipe.world import canonical

RELIEF_VOXELS: Final = 24.0
CAVE_FREQUENCY: Final = 0.05
CAVE_THRESHOLD: Final = 0.6
CAVE_SCALE: Final = 12.0
"""Makes the gradient of the cave term about 1 per voxel at its surface (measured: `tests/unit/field/test_library.py`),
without moving that surface, so that an edit's strength means voxels."""

SPHERE_RADIUS: Final = 48.0
PLANET_RADIUS: Final = 200.0
RECIPE_DEFAULT: Final = "terrain"

Builtin = Callable[..., Node]


def _terrain(relief: float = RELIEF_VOXELS) -> Node:
    """Rolling hills with caves cut out: the article's field."""
    return Binary(op="max", a=_hills(relief), b=_caves())


def _hills(relief: float = RELIEF_VOXELS) -> Node:
    """A heightfield of five octaves of gradient noise, `relief` voxels high."""
    heights = Fbm(op="fbm2", frequency=0.02, octaves=5)
    return Binary(op="subtract", a=Axis(op="y"), b=_times(heights, relief))


def _caves() -> Node:
    """Rock with caves where simplex noise passes a threshold."""
    above_threshold = Binary(op="subtract", a=Simplex3(frequency=CAVE_FREQUENCY), b=Constant(value=CAVE_THRESHOLD))
    return _times(above_threshold, CAVE_SCALE)


def _sphere(radius: float = SPHERE_RADIUS) -> Node:
    """A ball of rock at the origin."""
    return Sphere(radius=radius)


def _plane() -> Node:
    """Rock below y = 0."""
    return Axis(op="y")


def _planet(radius: float = PLANET_RADIUS, relief: float = RELIEF_VOXELS) -> Node:
    """A ball of rock with relief on its surface and caves inside."""
    heights = Fbm(op="fbm3", frequency=0.01, octaves=5)
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


def builtin(name: str, **parameters: float) -> str:
    """Return the canonical JSON of a built-in recipe. Raises `BadRecipe` for an unknown name, parameter or value."""
    build = BUILTINS.get(name)
    if build is None:
        raise BadRecipe(f"recipe is {name!r}; built in are {sorted(BUILTINS)}", recipe=name)
    known = inspect.signature(build).parameters
    for parameter in parameters:
        if parameter not in known:
            raise BadRecipe(f"recipe {name!r} has no parameter {parameter!r}; it has {sorted(known)}", recipe=name)
    try:
        return canonical(build(**parameters))
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        raise BadRecipe(f"recipe {name!r}: {parameters}: {first['msg']}", recipe=name) from None
