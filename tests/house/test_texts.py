"""What no file of the repository may hold: open ends, and traces of the machine or the registry it was made with."""

import re
from collections.abc import Iterator

from tests.house.checkout import holds

# Each pattern is written so that it does not match itself.
BANNED = {
    r"\b(TO[D]O|FIX[M]E|X[X]X)\b": "an open end: do it, or write an issue",
    r"\bpytest\.(mark\.)?ski[p]": "a skipped test: in CI a missing part is a failure",
    r"(?<![\w.~}])/(work|root|home|Users)/\w": "a path of somebody's machine",
    r"\b(pypi\.or[g]|pythonhosted\.or[g]|npmjs\.(or[g]|co[m]))\b": "a registry's host name",
}


def banned(path: str, text: str) -> Iterator[str]:
    for number, line in enumerate(text.splitlines(), start=1):
        for pattern, why in BANNED.items():
            if hit := re.search(pattern, line):
                yield f"{path}:{number}: {hit[0]}: {why}"


def addresses(path: str, text: str) -> Iterator[str]:
    for number, line in enumerate(text.splitlines(), start=1):
        if "://" in line:
            yield f"{path}:{number}: a lock names versions and hashes, never where they came from"


def test_nothing_banned():
    holds(banned, ":/")


def test_locks_hold_no_address():
    holds(addresses, "*.lock", "*package-lock.json")


def test_finds_what_is_banned():
    bad = ("# TO" + "DO: later", "pytest.mark.ski" + "p", 'open("' + "/home/" + 'me/x")', "files.pythonhosted" + ".org")
    for line in bad:
        assert len(list(banned("a.py", f"\n{line}"))) == 1, line
    assert not list(banned("a.py", "GET /v1/worlds/home/chunks"))


def test_finds_an_address_in_a_lock():
    assert list(addresses("a.lock", "six==1.0 --index-url https" + "://example.test"))
