"""Recipes that clients have posted, kept by digest; and what any recipe's name in a URL stands for."""

import re
from collections import OrderedDict
from collections.abc import Callable
from functools import partial
from typing import Final

from chunkserver.recipe import BUILTINS, WorldRecipe, builtin
from chunkserver.server.problems import UnknownRecipe

POSTED_MAX: Final = 4096
POSTED_BYTES_MAX: Final = 32 << 20
"""Room for 500 of the largest recipes, or for all POSTED_MAX of up to 7 KB."""
ENTRY_BYTES: Final = 512
"""What an entry costs besides its source: digest and table slots. An upper bound, held by its unit test."""
DIGEST_PATTERN: Final = "^[0-9a-f]{32}$"

_DIGEST: Final = re.compile(DIGEST_PATTERN)


class PostedRecipes:
    """Canonical sources by their digests, in memory. The least recently used go first.

    `add` and `find` are all that a store which outlives the server has to offer too. One event loop owns it; nothing
    in it is thread-safe.

    bytes: what the kept entries weigh now, at most `bytes_max`. There are at most `count_max` of them.
    """

    def __init__(self, count_max: int = POSTED_MAX, bytes_max: int = POSTED_BYTES_MAX) -> None:
        self.count_max = count_max
        self.bytes_max = bytes_max
        self.bytes = 0
        self._sources: OrderedDict[str, str] = OrderedDict()

    def __len__(self) -> int:
        return len(self._sources)

    def add(self, source: str) -> None:
        """Keep the recipe whose canonical JSON is `source`. One that is kept already counts as used."""
        digest = digest_of(source)
        if self.find(digest) is not None:
            return
        self._sources[digest] = source
        self.bytes += _weight(source)
        while self.bytes > self.bytes_max or len(self) > self.count_max:
            _, oldest = self._sources.popitem(last=False)
            self.bytes -= _weight(oldest)

    def find(self, digest: str) -> str | None:
        """Return the canonical JSON of the recipe named `digest`, or None if it is not kept. It counts as used."""
        source = self._sources.get(digest)
        if source is not None:
            self._sources.move_to_end(digest)
        return source


def source_of(name: str, posted: PostedRecipes) -> str:
    """Return the canonical JSON of the recipe that a URL names: a built-in's name, or the digest of any recipe.

    Raises `UnknownRecipe` for a digest that is neither a built-in's nor kept, `BadRecipe` for any other name.
    """
    if not _DIGEST.fullmatch(name):
        return builtin(name)
    source = source_by_digest(name, posted)
    if source is None:
        message = f"recipe {name} is not kept here, or not any more; post it again, it will have the same digest"
        raise UnknownRecipe(message, recipe=name)
    return source


def source_by_digest(digest: str, posted: PostedRecipes) -> str | None:
    """Return the canonical JSON of a built-in or kept recipe, or None."""
    return _BUILTIN_SOURCES.get(digest) or posted.find(digest)


def known(digest: str, posted: PostedRecipes) -> Callable[[], bool]:
    """Return what tells whether `source_by_digest` finds a recipe still, and counts as a use of it."""
    if digest in _BUILTIN_SOURCES:
        return _always
    return partial(_is_posted, digest, posted)


def _is_posted(digest: str, posted: PostedRecipes) -> bool:
    return source_by_digest(digest, posted) is not None


def _always() -> bool:
    return True


def digest_of(source: str) -> str:
    """Return the hex name of the recipe whose canonical JSON is `source`."""
    return WorldRecipe(0, source).digest


_BUILTIN_SOURCES: Final = {digest_of(builtin(name)): builtin(name) for name in BUILTINS}


def _weight(source: str) -> int:
    return len(source) + ENTRY_BYTES
