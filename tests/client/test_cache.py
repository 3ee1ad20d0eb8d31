"""What is kept, for how long, and that a 304 is believed only about what was asked."""

import threading

import pytest

from chunkserver_client import Retry
from chunkserver_client.cache import ENTRY_BYTES, AnswerCache
from chunkserver_client.exchange import checked
from chunkserver_client.steps import Answer, Request
from tests.client.scripted import Script, exchange, json_answer

FOR_EVER = "public, max-age=31536000, immutable"


def get(url: str = "/x", accept: str = "a") -> Request:
    return Request("GET", url, {"accept": accept}, cached=True)


def body(answer: Answer) -> bytes:
    return checked(answer, 200).content


def asked(asking, script: Script, request: Request | None = None) -> bytes:
    found: bytes = script.run(asking.ask(request or get(), body))
    return found


def test_an_immutable_answer_is_used_without_asking():
    asking, script = exchange(), Script([json_answer(200, b"1", etag='"t"', cache_control=FOR_EVER)])
    assert [asked(asking, script) for _ in range(3)] == [b"1"] * 3
    assert len(script.requests) == 1


def test_any_other_is_asked_for_with_its_tag():
    script = Script(
        [
            json_answer(200, b"1", etag='"t"', cache_control="no-cache"),
            json_answer(304, b"", etag='"t"'),
            json_answer(200, b"2", etag='"u"', cache_control="no-cache"),
            json_answer(304, b"", etag='"u"'),
        ]
    )
    asking = exchange()
    assert [asked(asking, script) for _ in range(4)] == [b"1", b"1", b"2", b"2"]
    sent = [request.headers.get("if-none-match") for request in script.requests]
    assert sent == [None, '"t"', '"t"', '"u"']


@pytest.mark.parametrize("headers", [{"etag": '"other"'}, {}, {"etag": "t"}, {"etag": 'W/"t"'}])
def test_a_304_about_something_else_is_not_believed(headers):
    asking = exchange(Retry(backoff_seconds=0))
    script = Script(
        [
            json_answer(200, b"1", etag='"t"', cache_control="no-cache"),
            json_answer(304, b"", **headers),
            json_answer(200, b"2", etag='"other"'),
        ]
    )
    assert [asked(asking, script), asked(asking, script)] == [b"1", b"2"]
    assert "if-none-match" not in script.requests[2].headers, "what is there cannot be trusted"


def test_a_304_is_never_another_urls_or_another_types_answer():
    asking = exchange()
    script = Script([json_answer(200, content, etag='"t"') for content in (b"1", b"2", b"3")])
    assert asked(asking, script, get("/x", "a")) == b"1"
    assert asked(asking, script, get("/y", "a")) == b"2"
    assert asked(asking, script, get("/x", "b")) == b"3"
    for url, accept, content in (("/x", "a", b"1"), ("/y", "a", b"2"), ("/x", "b", b"3")):
        assert asked(asking, Script([json_answer(304, b"", etag='"t"')]), get(url, accept)) == content


@pytest.mark.parametrize(
    "headers",
    [
        {"cache_control": FOR_EVER},
        {"etag": "t", "cache_control": FOR_EVER},
        {"etag": 'W/"t"', "cache_control": FOR_EVER},
        {"etag": '"t"', "cache_control": "no-store"},
    ],
)
def test_without_a_strong_tag_or_with_no_store_nothing_is_kept(headers):
    asking, script = exchange(), Script([json_answer(200, b"1", **headers), json_answer(200, b"2")])
    assert [asked(asking, script), asked(asking, script)] == [b"1", b"2"]
    assert "if-none-match" not in script.requests[1].headers
    assert asking.cache.bytes == 0


def test_freshness_ends_with_max_age_and_a_304_renews_it():
    now = [0.0]
    asking = exchange(cache=AnswerCache(1 << 20, lambda: now[0]))
    fresh = {"etag": '"t"', "cache_control": "max-age=60"}
    script = Script([json_answer(200, b"1", **fresh), json_answer(304, b"", **fresh)])
    for now[0] in (0, 59, 60, 119):
        assert asked(asking, script) == b"1"
    assert len(script.requests) == 2


@pytest.mark.parametrize(
    "control", ["", "no-cache", "no-cache, max-age=60", "max-age=", "max-age=-1", "max-age=6e9", "s-max-age=60x"]
)
def test_what_does_not_say_how_long_is_asked_for(control):
    asking = exchange()
    script = Script([json_answer(200, b"1", etag='"t"', cache_control=control), json_answer(304, etag='"t"')])
    assert [asked(asking, script), asked(asking, script)] == [b"1", b"1"]
    assert len(script.requests) == 2


def test_the_cache_is_bounded_and_drops_the_least_recently_used():
    cache = AnswerCache(3 * (ENTRY_BYTES + 100))
    answer = Answer(200, {"etag": '"t"'}, bytes(100))
    for name in "abc":
        cache.keep(get(name), answer)
    assert cache.find(get("a"))
    cache.keep(get("d"), answer)
    assert [cache.find(get(name)) is not None for name in "abcd"] == [True, False, True, True]
    assert cache.bytes == 3 * (ENTRY_BYTES + 100)
    cache.keep(get("d"), Answer(200, {"etag": '"t"'}, bytes(10_000)))
    assert cache.find(get("d")) is None, "too large: and what was there is out of date"
    for name in "abcd":
        cache.drop(get(name))
    assert cache.bytes == 0


def test_a_cache_of_no_bytes_keeps_nothing():
    cache = AnswerCache(0)
    cache.keep(get(), Answer(204, {"etag": '"t"'}, b""))
    assert (cache.find(get()), cache.bytes) == (None, 0)


def test_threads_may_share_it():
    cache = AnswerCache(20 * ENTRY_BYTES)

    def work(seed: int) -> None:
        for step in range(2000):
            name = get(str((seed * 7919 + step * 31) % 50))
            cache.keep(name, Answer(200, {"etag": '"t"'}, bytes(step % 300)))
            cache.find(name)
            if step % 5 == 0:
                cache.drop(name)

    threads = [threading.Thread(target=work, args=(seed,)) for seed in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(30)
    held = [cache.find(get(str(number))) for number in range(50)]
    assert cache.bytes == sum(entry.bytes for entry in held if entry) <= 20 * ENTRY_BYTES
