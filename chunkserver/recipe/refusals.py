"""What is wrong with a recipe, and where: pydantic's findings in the words of recipes."""

from collections.abc import Iterator
from typing import Any, Final

from pydantic import ValidationError

from chunkserver.errors import BadRecipe

PATH_CHARACTERS_MAX: Final = 300

_EXPECTED: Final = {
    "model_attributes_type": "should be a node (an object with an op) or a number",
    "union_tag_not_found": "should have an op",
    "union_tag_invalid": "should have a known op",
    "extra_forbidden": "is not a field of this node",
    "missing": "should be there",
    "tuple_type": "should be a list",
}
"""What pydantic says in words of its own, in words of recipes. Keyed by its error types."""


def bad_recipe(error: ValidationError, tree: object) -> BadRecipe:
    """Return what `error` says first about `tree`, with the path to it as the user would write it: `a.b.frequency`."""
    first = error.errors(include_url=False)[0]
    path = ".".join(_path(first["loc"], tree))[:PATH_CHARACTERS_MAX]
    expected = _EXPECTED.get(
        first["type"], first["msg"].removeprefix("Input ").removeprefix("Tuple ").removeprefix("Value error, ")
    )
    if "expected_tags" in first.get("ctx", {}):
        expected += f", one of {first['ctx']['expected_tags']}"
    return BadRecipe.at(path, expected)


def _path(location: tuple[int | str, ...], tree: Any) -> Iterator[str]:
    """Yield the parts of `location` that are keys of `tree`: pydantic also puts the op of each node on the way.

    A number has no parts: it stands for a constant node, or for a number each.
    """
    at_node = True
    for part in location:
        if at_node and isinstance(tree, dict) and part == tree.get("op"):
            at_node = False
            continue
        if isinstance(tree, int | float):
            continue
        yield str(part)
        tree = _child(tree, part)
        at_node = True


def _child(tree: Any, part: int | str) -> Any:
    try:
        return tree[part]
    except (KeyError, IndexError, TypeError):
        return None
