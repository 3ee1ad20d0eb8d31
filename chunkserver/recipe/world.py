"""What a world is made of: a seed and a recipe, frozen and hashable, cheap to send to a worker process."""

import hashlib
import json
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Final

from pydantic import TypeAdapter, ValidationError

from chunkserver.errors import BadRecipe
from chunkserver.recipe.nodes import Binary, Expression, Node

RECIPE_VERSION: Final = 1
"""Raised when the meaning of a node changes; part of every digest."""
SOURCE_BYTES_MAX: Final = 1 << 16
NODES_MAX: Final = 1024
DEPTH_MAX: Final = 64
DIGEST_BYTES: Final = 16
PARSED_MAX: Final = 64
"""Recipes kept parsed in one process."""

SEED_MIN: Final = -(1 << 63)
SEED_MAX: Final = (1 << 63) - 1

_EXPRESSION: Final[TypeAdapter[Node]] = TypeAdapter(Expression)


@dataclass(frozen=True, slots=True)
class WorldRecipe:
    """A world before any edit.

    seed: signed 64-bit.
    source: the expression tree as canonical JSON, as `canonical` writes it.
    """

    seed: int
    source: str

    def __post_init__(self) -> None:
        if not SEED_MIN <= self.seed <= SEED_MAX:
            raise BadRecipe(f"seed is {self.seed}; it must be a signed 64-bit integer", seed=self.seed)

    @property
    def expression(self) -> Node:
        """The tree, parsed."""
        return _parse(self.source)

    @property
    def digest(self) -> str:
        """Hex name of the expression alone, without the seed."""
        return source_digest(self.source)


def canonical(tree: object) -> str:
    """Return the canonical JSON of a recipe given as parsed JSON or as a node: defaults written out, keys sorted.

    Raises `BadRecipe` that names the path of the bad node and what was expected.
    """
    try:
        node = _EXPRESSION.validate_python(tree)
    except ValidationError as error:
        raise _bad_recipe(error) from None
    _check_size(node)
    source = json.dumps(node.model_dump(), sort_keys=True, separators=(",", ":"), allow_nan=False)
    if len(source) > SOURCE_BYTES_MAX:
        raise BadRecipe(f"recipe has {len(source)} bytes; the limit is {SOURCE_BYTES_MAX}", bytes=len(source))
    return source


def children(node: Node) -> tuple[Node, ...]:
    """Return the nodes directly below `node`."""
    return (node.a, node.b) if isinstance(node, Binary) else ()


@lru_cache(maxsize=PARSED_MAX)
def source_digest(source: str) -> str:
    """Return the hex name of a canonical recipe."""
    tagged = f"chunkserver recipe {RECIPE_VERSION}\n{source}".encode()
    return hashlib.blake2b(tagged, digest_size=DIGEST_BYTES).hexdigest()


@lru_cache(maxsize=PARSED_MAX)
def _parse(source: str) -> Node:
    return _EXPRESSION.validate_json(source)


def _check_size(root: Node) -> None:
    nodes, level = 0, [root]
    for _ in range(DEPTH_MAX):
        nodes += len(level)
        level = [child for node in level for child in children(node)]
        if nodes + len(level) > NODES_MAX:
            raise BadRecipe(f"recipe has more than {NODES_MAX} nodes", nodes_max=NODES_MAX)
    if level:
        raise BadRecipe(f"recipe is deeper than {DEPTH_MAX} nodes", depth_max=DEPTH_MAX)


def _bad_recipe(error: ValidationError) -> BadRecipe:
    first: Any = error.errors(include_url=False)[0]
    path = ".".join(str(part) for part in first["loc"]) or "the root"
    return BadRecipe(f"recipe: at {path}: {first['msg']}", path=path)
