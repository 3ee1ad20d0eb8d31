"""When the client asks again: without sockets, and without waiting."""

import pickle
from email.utils import formatdate

import httpx2
import pytest

from chunkserver_client import BadAnswer, BadRequest, NotFound, Problem, Retry, Unavailable, Unreachable
from chunkserver_client.exchange import checked
from chunkserver_client.retry import Trial, retry_after
from chunkserver_client.steps import Answer, Request
from tests.client.scripted import Script, exchange, json_answer

GET = Request("GET", "/x")
LOST = httpx2.ReadError("broken")


def body(answer: Answer) -> bytes:
    return checked(answer, 200).content


class Clock:
    """A clock that stands still until it is set."""

    def __init__(self) -> None:
        self.now = 0.0

    def __call__(self) -> float:
        return self.now


@pytest.mark.parametrize("answer", [LOST, httpx2.DecodingError("?"), *(json_answer(s) for s in (429, 502, 503, 504))])
def test_what_may_pass_is_asked_for_again(answer):
    script = Script([answer, answer, json_answer()])
    assert script.run(exchange().ask(GET, body)) == b"{}"
    assert (len(script.requests), len(script.pauses)) == (3, 2)


@pytest.mark.parametrize("status", [400, 401, 403, 404, 405, 409, 410, 413, 415, 422, 500, 507])
def test_what_stays_is_not(status):
    script = Script([json_answer(status)])
    with pytest.raises(Problem) as raised:
        script.run(exchange().ask(GET, body))
    assert raised.value.status == status
    assert not script.pauses


@pytest.mark.parametrize(
    ("error", "kind"), [(LOST, Unreachable), (json_answer(503), Unavailable), (json_answer(200, b"?"), BadAnswer)]
)
def test_attempts_are_counted(error, kind):
    script = Script([error] * 9)

    def parse(answer: Answer) -> bytes:
        if body(answer) == b"?":
            raise BadAnswer("?")
        return answer.content

    with pytest.raises(kind):
        script.run(exchange(Retry(attempts_max=3)).ask(GET, parse))
    assert (len(script.requests), len(script.pauses)) == (3, 2)


def test_what_is_not_repeatable_is_repeated_only_if_the_server_did_nothing():
    once = Request("DELETE", "/x", repeatable=False)
    for harmless in (httpx2.ConnectError("?"), httpx2.PoolTimeout("?"), json_answer(503), json_answer(429)):
        assert Script([harmless, json_answer()]).run(exchange().ask(once, body)) == b"{}"
    for unclear in (LOST, httpx2.ReadTimeout("?"), httpx2.RemoteProtocolError("?")):
        script = Script([unclear, json_answer()])
        with pytest.raises(Unreachable) as raised:
            script.run(exchange().ask(once, body))
        assert raised.value.__cause__ is unclear
        assert len(script.requests) == 1
    for status in (502, 504):
        script = Script([json_answer(status), json_answer()])
        with pytest.raises(Unavailable):
            script.run(exchange().ask(once, body))
        assert len(script.requests) == 1


def test_the_backoff_doubles_and_its_jitter_is_full():
    ranges: list[tuple[float, float]] = []

    def jitter(low: float, high: float) -> float:
        ranges.append((low, high))
        return high / 2

    retry = Retry(attempts_max=9, seconds_max=100, backoff_seconds=0.1, backoff_seconds_max=2.0)
    trial = Trial(retry, Clock(), jitter)
    pauses = [trial.pause_after(LOST) for _ in range(7)]
    assert ranges == [(0.0, high) for high in (0.1, 0.2, 0.4, 0.8, 1.6, 2.0, 2.0)]
    assert pauses == [high / 2 for _, high in ranges]


def test_time_is_bounded():
    clock = Clock()
    trial = Trial(Retry(attempts_max=100, seconds_max=10), clock, lambda _low, high: high)
    clock.now = 9.0
    assert trial.pause_after(LOST) == 0.1
    clock.now = 9.9
    with pytest.raises(Unreachable, match="2 attempts"):
        trial.pause_after(LOST)
    trial.renew()
    assert trial.seconds_left == pytest.approx(10)
    assert trial.pause_after(LOST) == 0.1


def test_retry_after_is_a_lower_bound():
    trial = Trial(Retry(seconds_max=10), Clock(), lambda _low, high: high)
    assert trial.pause_after(Unavailable(503, {}, retry_after=3.0)) == 3.1
    with pytest.raises(Unavailable):
        trial.pause_after(Unavailable(503, {}, retry_after=10.0))


@pytest.mark.parametrize(
    ("text", "seconds"),
    [
        ("7", 7.0),
        ("0", 0.0),
        (formatdate(1100, usegmt=True), 100.0),
        (formatdate(900, usegmt=True), 0.0),
        ("Fri, 31 Dec 9999 23:59:59 -2359", None),
        ("9" * 400, None),
        ("-1", 0.0),
        ("1.5", 0.0),
        ("soon", 0.0),
        ("²", 0.0),
        ("", 0.0),
    ],
)
def test_retry_after_in_seconds_and_as_a_date(text, seconds):
    found = retry_after({"retry-after": text}, lambda: 1000.0)
    assert found == seconds if seconds is not None else found >= 0.0
    assert retry_after({}) == 0.0


@pytest.mark.parametrize("wrong", [{"attempts_max": 0}, {"seconds_max": float("inf")}, {"backoff_seconds": -1.0}])
def test_a_patience_without_bounds_is_refused(wrong):
    with pytest.raises(ValueError, match="attempt"):
        Retry(**wrong)


def test_a_problem_has_all_values():
    text = b"""
        {"type": "urn:chunkserver:problem:bad-key", "title": "T", "status": 422, "detail": "D", "lod": 21, "more": [1]}
    """
    answer = Answer(422, {"content-type": "application/problem+json; charset=utf-8"}, text)
    with pytest.raises(BadRequest, match="422 T: D") as raised:
        checked(answer, 200)
    error = raised.value
    assert (error.name, error.title, error.detail, error.status, error.instance) == ("bad-key", "T", "D", 422, "")
    assert error.values == {"lod": 21, "more": [1]}
    copied = pickle.loads(pickle.dumps(error))  # as a pool of processes does
    assert (type(copied), str(copied), vars(copied)) == (BadRequest, str(error), vars(error))


@pytest.mark.parametrize("content", [b"<html>", b"", b"[]", b'{"type": 3}', b"\xff\xfe"])
def test_a_problem_that_is_none_is_still_an_error_of_its_status(content):
    for media_type in ("application/problem+json", "text/html"):
        with pytest.raises(NotFound):
            checked(Answer(404, {"content-type": media_type}, content), 200)


def test_a_body_is_not_read_beyond_its_limit(monkeypatch):
    monkeypatch.setattr("chunkserver_client.exchange.BODY_BYTES_MAX", 100)
    once = Retry(attempts_max=1)
    assert Script([json_answer(200, bytes(100))]).run(exchange(once).ask(GET, body)) == bytes(100)
    with pytest.raises(BadAnswer, match="more than 100 bytes"):
        Script([json_answer(200, bytes(101))]).run(exchange(once).ask(GET, body))


def test_a_redirect_is_not_followed():
    with pytest.raises(BadAnswer, match="302"):
        Script([json_answer(302)]).run(exchange(Retry(attempts_max=1)).ask(GET, body))
