import re
from hashlib import sha256

import pytest

from chunkserver.server import keys
from chunkserver.server.keys import DIGEST_PATTERN, ApiKey, Keyring, Scope, digest_of_key, mint, parse_key

DIGEST = "0123456789abcdef" * 4


@pytest.mark.parametrize("scope", Scope)
def test_a_new_key_is_found_by_itself_alone(scope):
    secret, key = mint("viewer", scope)
    ring = Keyring([key, mint("other", Scope.READ)[1]])
    assert len(ring) == 2
    assert ring.find(secret.encode()) is key
    assert (key.name, key.scope) == ("viewer", scope)
    for guess in (b"", key.digest.encode(), secret.encode()[:-1], secret.upper().encode()):
        assert ring.find(guess) is None


def test_a_key_has_256_bits_that_differ_each_time():
    minted = {mint("a", Scope.READ)[0] for _ in range(100)}
    assert len(minted) == 100
    for secret in minted:
        assert re.fullmatch("chunkserver_[A-Za-z0-9_-]{43}", secret)  # 43 base64 digits hold 32 bytes


def test_nothing_of_the_key_is_kept():
    secret, key = mint("viewer", Scope.READ)
    assert secret.removeprefix(keys.KEY_PREFIX) not in repr(key)
    assert re.fullmatch(DIGEST_PATTERN, key.digest)
    assert key.digest == sha256(secret.encode()).hexdigest() == digest_of_key(secret)


def test_a_line_of_the_settings():
    line = f"viewer:read:{DIGEST}"
    assert parse_key(line) == ApiKey("viewer", Scope.READ, DIGEST)
    assert str(parse_key(line)) == line


@pytest.mark.parametrize(
    ("line", "what"),
    [
        ("", "three parts; this one has 1"),
        (f"viewer:read:{DIGEST}:", "three parts; this one has 4"),
        (f":read:{DIGEST}", "name of an API key is ''"),
        (f"My Key:read:{DIGEST}", "'My Key'"),
        (f"{'a' * 65}:read:{DIGEST}", "name"),
        (f"viewer:write:{DIGEST}", "'viewer': the scope is 'write'.* read, edit, admin"),
        (f"viewer:Read:{DIGEST}", "scope"),
        (f"viewer:read:{DIGEST[1:]}", "'viewer': the digest"),
        (f"viewer:read:{DIGEST.upper()}", "digest"),
    ],
)
def test_a_line_that_is_wrong(line, what):
    with pytest.raises(ValueError, match=what):
        parse_key(line)


def test_a_key_where_its_digest_belongs_is_not_shown():
    secret, _ = mint("viewer", Scope.READ)
    with pytest.raises(ValueError, match="itself") as raised:
        parse_key(f"viewer:read:{secret}")
    assert secret not in str(raised.value)


def test_each_scope_covers_those_before_it():
    order = [Scope.READ, Scope.EDIT, Scope.ADMIN]
    for place, scope in enumerate(order):
        assert [scope.covers(needed) for needed in order] == [other <= place for other in range(3)]


@pytest.mark.parametrize("name", ["", "two words", "a" * 65, "name:admin"])
def test_a_name_that_no_line_can_hold(name):
    with pytest.raises(ValueError, match="must match"):
        mint(name, Scope.READ)


def test_a_ring_without_doubles_and_with_a_bound(monkeypatch):
    one, other = mint("a", Scope.READ)[1], mint("b", Scope.READ)[1]
    for double in (ApiKey("a", Scope.READ, other.digest), ApiKey("c", Scope.ADMIN, one.digest)):
        with pytest.raises(ValueError, match="same"):
            Keyring([one, double])
    monkeypatch.setattr(keys, "KEYS_MAX", 1)
    with pytest.raises(ValueError, match="there are 2 API keys; the limit is 1"):
        Keyring([one, other])
