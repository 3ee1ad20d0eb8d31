"""From what a user wrote to canonical JSON: limits first, then the models, then one spelling for each recipe.

Nothing here recurses before the depth is known, and nothing is built before its size is: a bomb costs one short walk.
"""

import json
from collections.abc import Iterable
from itertools import chain, islice
from typing import Final

from pydantic import TypeAdapter, ValidationError

from chunkserver.errors import BadRecipe
from chunkserver.recipe.nodes import Expression, Node
from chunkserver.recipe.refusals import bad_recipe

SOURCE_BYTES_MAX: Final = 1 << 16
NODES_MAX: Final = 1024
DEPTH_MAX: Final = 64
"""JSON levels below the root: each node is one, its numbers one more."""
VALUES_MAX: Final = 8 * NODES_MAX
"""JSON values in a recipe, keys not counted. A node has an op, two operands or a few numbers."""
FIELDS_MAX: Final = 8
"""Fields of one object. Each unknown one would be looked into, and explained."""
COST_MAX: Final = 2000.0
"""Nanoseconds a sample, by the costs that nodes state: at most about 0.1 s for a chunk of 32 cells, 0.6 s of 64."""
INTEGER_BITS_MAX: Final = 1024
"""Larger integers do not fit a float64."""

_EXPRESSION: Final[TypeAdapter[Node]] = TypeAdapter(Expression)


def read_json(text: str | bytes) -> object:
    """Return parsed JSON. Raises `BadRecipe` for text that is too long, too deep, no JSON, or holds NaN or Infinity."""
    if len(text) > SOURCE_BYTES_MAX:
        raise BadRecipe(f"recipe has {len(text)} bytes; the limit is {SOURCE_BYTES_MAX}", bytes=len(text))
    try:
        parsed: object = json.loads(text, parse_constant=_no_constant)
    except RecursionError:
        raise _too_deep() from None
    except ValueError as error:
        raise BadRecipe(f"recipe is not JSON: {error}") from None
    return parsed


def canonical_tree(tree: object) -> str:
    """Return the canonical JSON of a tree given as parsed JSON or as a node: defaults written out, keys sorted.

    Equal recipes have equal canonical JSON: 1 and 1.0, 0 and -0.0, a number and its constant node are the same.

    Raises `BadRecipe` that names the path of the bad node and what was expected.
    """
    node = tree if isinstance(tree, Node) else _validated(tree)
    plain = node.model_dump()
    _check_extent(plain)
    _check_cost(node)
    source = json.dumps(plain, sort_keys=True, separators=(",", ":"), allow_nan=False)
    if len(source) > SOURCE_BYTES_MAX:
        raise BadRecipe(f"recipe has {len(source)} bytes; the limit is {SOURCE_BYTES_MAX}", bytes=len(source))
    return source


def parse(source: str) -> Node:
    """Return the tree of a recipe's JSON. Raises `BadRecipe` as `read_json` and `canonical_tree` do."""
    return _validated(read_json(source))


def _validated(tree: object) -> Node:
    _check_extent(tree)
    try:
        return _EXPRESSION.validate_python(tree)
    except ValidationError as error:
        raise bad_recipe(error, tree) from None


def _check_cost(root: Node) -> None:
    """Raise `BadRecipe` that names the node with which the cost of the whole tree passes the limit."""
    waiting, cost = [("", root)], 0.0
    while waiting:
        path, node = waiting.pop()
        cost += node.cost()
        if cost > COST_MAX:
            raise BadRecipe.at(path, f"the recipe costs more than {COST_MAX:.0f} ns a sample, up to here", cost=cost)
        waiting += [(f"{path}.{name}" if path else name, child) for name, child in node.children()]


def _check_extent(tree: object) -> None:
    """Raise `BadRecipe` if parsed JSON passes a limit. Goes level by level, so depth cannot exhaust the stack."""
    level, values, nodes = [tree], 0, 0
    for _ in range(DEPTH_MAX + 1):
        values += len(level)
        nodes += sum(isinstance(value, dict) for value in level)
        if values > VALUES_MAX or nodes > NODES_MAX:
            raise BadRecipe(f"recipe is larger than {NODES_MAX} nodes, {VALUES_MAX} values", nodes_max=NODES_MAX)
        for value in level:
            _check_size(value)
        below = chain.from_iterable(_children(value) for value in level)
        level = list(islice(below, VALUES_MAX + 1))
        if not level:
            return
    raise _too_deep()


def _check_size(value: object) -> None:
    if isinstance(value, int) and value.bit_length() > INTEGER_BITS_MAX:
        raise BadRecipe(f"recipe has an integer of {value.bit_length()} bits", bits=value.bit_length())
    if isinstance(value, dict) and len(value) > FIELDS_MAX:
        raise BadRecipe(f"recipe has an object of {len(value)} fields; the limit is {FIELDS_MAX}", fields=len(value))


def _children(value: object) -> Iterable[object]:
    if isinstance(value, dict):
        return value.values()
    return value if isinstance(value, list | tuple) else ()


def _no_constant(name: str) -> object:
    raise BadRecipe(f"recipe has {name}; every number must be finite", value=name)


def _too_deep() -> BadRecipe:
    return BadRecipe(f"recipe is nested deeper than {DEPTH_MAX} levels", depth_max=DEPTH_MAX)
