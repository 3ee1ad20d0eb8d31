"""The name of a chunk's bytes: a digest of what they are made from, known before they are made."""

import hashlib
import re
from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Final

from chunkserver.grid import ChunkKey
from chunkserver.pipeline import ChunkRequest, generator
from chunkserver.recipe import WorldRecipe
from chunkserver.wire import CODINGS

ETAG_BYTES: Final = 16
_ORIGIN: Final = ChunkKey(0, 0, 0, 0)
_ENTITY_TAG: Final = re.compile(r'(?:W/)?"([^"]*)"')


def tags(template: ChunkRequest, epoch: str = "") -> Callable[[ChunkKey, int], str]:
    """Return what names the answers to requests that are like `template` in all but key and revision, given these two.

    A name is a strong entity tag without its quotes: hex, also the cache's key. epoch: of the world, if they are chunks
    of one: revisions of another epoch count other edits.

    `repr` of the frozen request writes every field, those to come included, and the recipe by its digest: the source
    may be 64 KB. The generator adds the sources that shape a chunk, the coding its compressor. Same tag, same bytes.
    """
    recipe = template.recipe
    named = replace(template, recipe=WorldRecipe(recipe.seed, recipe.digest), key=_ORIGIN, revision=0)
    version = CODINGS[template.encoding.coding].version
    begun = hashlib.blake2b(f"{generator(recipe)} {named!r} {epoch} {version} ".encode(), digest_size=ETAG_BYTES)

    def tag(key: ChunkKey, revision: int) -> str:
        digest = begun.copy()
        digest.update(b"%d %d %d %d %d" % (*key, revision))
        return digest.hexdigest()

    return tag


def etag(request: ChunkRequest, epoch: str = "") -> str:
    """Return what `tags` gives for this one request."""
    return tags(request, epoch)(request.key, request.revision)


def body_etag(body: bytes) -> str:
    """Return the strong entity tag of an answer that is made anyway, without its quotes: hex."""
    return hashlib.blake2b(body, digest_size=ETAG_BYTES).hexdigest()


def is_known(if_none_match: Iterable[str], tag: str) -> bool:
    """Return whether a client that sent these `If-None-Match` fields has the bytes named `tag` (weak comparison)."""
    return any(field.strip() == "*" or tag in _ENTITY_TAG.findall(field) for field in if_none_match)
