import tracemalloc

import pytest

from chunkserver.errors import BadRecipe
from chunkserver.recipe import BUILTINS, WorldRecipe, builtin, canonical
from chunkserver.server.posted import (
    ENTRY_BYTES,
    POSTED_BYTES_MAX,
    PostedRecipes,
    digest_of,
    source_by_digest,
    source_of,
)
from chunkserver.server.problems import UnknownRecipe


def room_for(sources):
    return sum(map(len, sources)) + ENTRY_BYTES * len(sources)


def test_what_was_added_is_found_by_its_digest():
    posted = PostedRecipes()
    source = canonical({"op": "sphere", "radius": 7})
    posted.add(source)
    assert posted.find(WorldRecipe(3, source).digest) == source
    assert posted.find(digest_of(canonical({"op": "sphere", "radius": 8}))) is None


def test_adding_twice_keeps_one():
    posted = PostedRecipes()
    for _ in range(2):
        posted.add("a")
    assert (len(posted), posted.bytes) == (1, room_for("a"))


@pytest.mark.parametrize("limits", [{"count_max": 2}, {"bytes_max": room_for("ab")}])
def test_the_least_recently_used_goes_first(limits):
    posted = PostedRecipes(**limits)
    for source in "ab":
        posted.add(source)
    assert posted.find(digest_of("a")) == "a"
    posted.add("c")
    assert posted.find(digest_of("b")) is None
    posted.add("a")
    posted.add("d")
    assert [source for source in "abcd" if posted.find(digest_of(source))] == ["a", "d"]


def test_never_over_its_bounds():
    posted = PostedRecipes(count_max=5, bytes_max=5000)
    for size in (1, 4000, 3000, 300, 200, 100, 10, 9, 8, 6000, 7):
        posted.add("x" * size)
        assert posted.bytes == room_for(list(posted._sources.values())) <= 5000
        assert len(posted) <= 5
    assert [len(source) for source in posted._sources.values()] == [7]


def test_an_entry_costs_no_more_than_it_is_said_to():
    posted, count = PostedRecipes(), 4000
    sources = [f"{number:0200}" for number in range(count)]
    tracemalloc.start()
    try:
        before = tracemalloc.get_traced_memory()[0]
        for source in sources:
            posted.add(source + "x")  # a string of its own
        taken = tracemalloc.get_traced_memory()[0] - before
    finally:
        tracemalloc.stop()
    assert count * 200 < taken <= posted.bytes <= POSTED_BYTES_MAX


@pytest.mark.parametrize("name", BUILTINS)
def test_a_built_in_has_two_names(name):
    posted = PostedRecipes()
    source = builtin(name)
    assert source_of(name, posted) == source_of(digest_of(source), posted) == source
    assert source_by_digest(digest_of(source), posted) == source
    assert len(posted) == 0


def test_names_of_nothing():
    posted = PostedRecipes()
    digest = digest_of("a")
    with pytest.raises(UnknownRecipe, match="post it again") as caught:
        source_of(digest, posted)
    assert caught.value.values == {"recipe": digest}
    assert source_by_digest(digest, posted) is None
    for name in ("", "nonsense", digest[1:], digest + "0", digest.upper(), digest + "\n", " " + digest):
        with pytest.raises(BadRecipe, match="built in are"):
            source_of(name, posted)
