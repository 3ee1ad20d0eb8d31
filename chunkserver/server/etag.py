"""The name of a chunk's bytes: a digest of what they are made from, known before they are made."""

import hashlib
import re
from collections.abc import Iterable
from dataclasses import replace
from typing import Final

from chunkserver.pipeline import ChunkRequest, generator
from chunkserver.recipe import WorldRecipe

ETAG_BYTES: Final = 16
_ENTITY_TAG: Final = re.compile(r'(?:W/)?"([^"]*)"')


def etag(request: ChunkRequest, epoch: str = "") -> str:
    """Return the strong entity tag of the answer to `request`, without its quotes: hex, also the cache's key.

    epoch: of the world, if it is a chunk of one. Revisions of another epoch count other edits.

    `repr` of the frozen request writes every field, those to come included, and the recipe by its digest: the source
    may be 64 KB. The generator adds the sources that shape a chunk. Same tag, same bytes.
    """
    recipe = request.recipe
    named = replace(request, recipe=WorldRecipe(recipe.seed, recipe.digest))
    text = f"{generator(recipe)} {named!r}{epoch and ' '}{epoch}".encode()
    return hashlib.blake2b(text, digest_size=ETAG_BYTES).hexdigest()


def body_etag(body: bytes) -> str:
    """Return the strong entity tag of an answer that is made anyway, without its quotes: hex."""
    return hashlib.blake2b(body, digest_size=ETAG_BYTES).hexdigest()


def is_known(if_none_match: Iterable[str], tag: str) -> bool:
    """Return whether a client that sent these `If-None-Match` fields has the bytes named `tag` (weak comparison)."""
    return any(field.strip() == "*" or tag in _ENTITY_TAG.findall(field) for field in if_none_match)
