"""What a world is made of: a seed and a recipe, frozen and hashable, cheap to send to a worker process."""

import hashlib
from dataclasses import dataclass
from functools import lru_cache
from typing import Final

from chunkserver.errors import BadRecipe
from chunkserver.recipe.nodes import Node
from chunkserver.recipe.reading import parse

RECIPE_VERSION: Final = 1
"""Raised when the meaning of a node changes; part of every digest."""
DIGEST_BYTES: Final = 16
RECIPES_KEPT_MAX: Final = 64
"""Recipes kept parsed, and digests kept, in one process."""

SEED_MIN: Final = -(1 << 63)
SEED_MAX: Final = (1 << 63) - 1


@dataclass(frozen=True, slots=True)
class WorldRecipe:
    """A world before any edit.

    seed: signed 64-bit.
    source: the expression tree as canonical JSON, as `canonical` writes it. That is trusted, not checked: another
        spelling of the same tree has another digest, and text that is no tree fails in `expression`.

    Raises `BadRecipe` for another seed.
    """

    seed: int
    source: str

    def __post_init__(self) -> None:
        if not SEED_MIN <= self.seed <= SEED_MAX:
            raise BadRecipe(f"seed is {self.seed}; it must be a signed 64-bit integer", seed=self.seed)

    @property
    def expression(self) -> Node:
        """The tree, parsed."""
        return _parsed(self.source)

    @property
    def digest(self) -> str:
        """Hex name of the expression alone, without the seed."""
        return _digest(self.source)


@lru_cache(maxsize=RECIPES_KEPT_MAX)
def _parsed(source: str) -> Node:
    return parse(source)


@lru_cache(maxsize=RECIPES_KEPT_MAX)
def _digest(source: str) -> str:
    tagged = f"chunkserver recipe {RECIPE_VERSION}\n{source}".encode()
    return hashlib.blake2b(tagged, digest_size=DIGEST_BYTES).hexdigest()
