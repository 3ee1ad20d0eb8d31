"""API keys: what an operator hands to a client, what the server keeps of it, and what its holder may do.

A key is 256 random bits, so its SHA-256 is all that must be kept: nobody can try 2^256 of them, however fast the hash.
It is looked up by that digest. How long a look-up takes tells about the digest of a guess, which is of no use.
"""

import re
import secrets
from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum
from hashlib import sha256
from typing import Final

KEY_BYTES: Final = 32
KEY_PREFIX: Final = "chunkserver_"
"""In front of each key, so that one that was committed or logged by accident can be searched for."""
NAME_PATTERN: Final = "^[a-z0-9_-]{1,64}$"
DIGEST_PATTERN: Final = "^[0-9a-f]{64}$"
KEYS_MAX: Final = 10_000


class Scope(StrEnum):
    """What the holder of a key may do. Each includes those before it."""

    READ = "read"
    EDIT = "edit"
    ADMIN = "admin"

    __hash__ = str.__hash__  # the enum's own is a Python function, and is called several times a request

    def covers(self, needed: "Scope") -> bool:
        """Return whether this is enough where `needed` is needed."""
        return _LEVELS[self] >= _LEVELS[needed]


_LEVELS: Final = {scope: level for level, scope in enumerate(Scope)}


@dataclass(frozen=True, slots=True)
class ApiKey:
    """What the server keeps of a key. `str` writes it as one line of the settings, `parse_key` reads it.

    name: whose it is; for people and for the log.
    scope: what it is good for.
    digest: of the key itself, SHA-256 in hex.
    """

    name: str
    scope: Scope
    digest: str

    def __str__(self) -> str:
        return f"{self.name}:{self.scope}:{self.digest}"


def mint(name: str, scope: str) -> tuple[str, ApiKey]:
    """Return a new key, to be shown once and kept nowhere, and what the server needs to know it again.

    Raises `ValueError` if the name does not match NAME_PATTERN, or if there is no such scope.
    """
    _check_name(name)
    key = KEY_PREFIX + secrets.token_urlsafe(KEY_BYTES)
    return key, ApiKey(name, Scope(scope), digest_of_key(key))


def parse_key(line: str) -> ApiKey:
    """Return the key that `str` has written as `line`: NAME:SCOPE:DIGEST.

    Raises `ValueError` that says which part is wrong. It does not repeat the digest: that may be the key, by mistake.
    """
    parts = line.split(":")
    if len(parts) != 3:
        raise ValueError(f"an API key is written NAME:SCOPE:DIGEST, three parts; this one has {len(parts)}")
    name, scope, digest = parts
    _check_name(name)
    if scope not in _LEVELS:
        raise ValueError(f"API key {name!r}: the scope is {scope!r}; it must be one of {', '.join(Scope)}")
    if not re.fullmatch(DIGEST_PATTERN, digest):
        raise ValueError(f"API key {name!r}: the digest must be 64 digits 0-9a-f; is it the key itself?")
    return ApiKey(name, Scope(scope), digest)


def digest_of_key(key: str) -> str:
    """Return the digest under which `key` is kept: SHA-256 in hex."""
    return sha256(key.encode()).hexdigest()


class Keyring:
    """All keys of one server.

    Raises `ValueError` if two have one name or one digest, or if there are more than KEYS_MAX.
    """

    def __init__(self, keys: Iterable[ApiKey]) -> None:
        listed = list(keys)
        if len(listed) > KEYS_MAX:
            raise ValueError(f"there are {len(listed)} API keys; the limit is {KEYS_MAX}")
        self._by_digest = {bytes.fromhex(key.digest): key for key in listed}
        names = {key.name for key in listed}
        if len(names) < len(listed) or len(self._by_digest) < len(listed):
            raise ValueError("two API keys have the same name or the same digest")

    def __len__(self) -> int:
        return len(self._by_digest)

    def find(self, key: bytes) -> ApiKey | None:
        """Return what is known of a key that a client has sent, or None."""
        return self._by_digest.get(sha256(key).digest())


def _check_name(name: str) -> None:
    if not re.fullmatch(NAME_PATTERN, name):
        raise ValueError(f"the name of an API key is {name[:64]!r}; it must match {NAME_PATTERN}")
