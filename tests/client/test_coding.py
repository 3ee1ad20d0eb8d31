"""Content codings undone: whole, and no longer than allowed."""

import gzip

import pytest
from backports import zstd

from chunkserver_client import BadAnswer
from chunkserver_client.coding import decoded

CONTENT = bytes(range(256)) * 100
CODED = {"identity": CONTENT, "gzip": gzip.compress(CONTENT), "zstd": zstd.compress(CONTENT)}


@pytest.mark.parametrize("coding", CODED)
def test_whole_bodies(coding: str):
    assert decoded(CODED[coding], coding, len(CONTENT)) == CONTENT


@pytest.mark.parametrize("coding", ["gzip", "zstd"])
def test_bodies_that_are_cut_or_broken_or_too_long(coding: str):
    body = CODED[coding]
    for wrong in (body[:-1], body[:10], b"", body + b"x", body + body, b"\0" * 30):
        with pytest.raises(BadAnswer):
            decoded(wrong, coding, len(CONTENT))
    with pytest.raises(BadAnswer):
        decoded(body, coding, len(CONTENT) - 1)


def test_a_bomb_is_not_unpacked():
    bomb = zstd.compress(bytes(1 << 28))
    with pytest.raises(BadAnswer):
        decoded(bomb, "zstd", 1 << 16)


def test_another_coding_is_refused_by_name():
    with pytest.raises(BadAnswer, match="br"):
        decoded(b"", "br", 1)
