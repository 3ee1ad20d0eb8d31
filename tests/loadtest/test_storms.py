"""Storms find what is wrong with a stream: each fault of a server that is made on purpose has its own name."""

import asyncio
from collections.abc import Callable
from http import HTTPStatus
from typing import Any

import pytest

from chunkserver_loadtest.errors import BadTarget
from chunkserver_loadtest.event_loop import new_event_loop
from chunkserver_loadtest.generator import Limits
from chunkserver_loadtest.profiles import Options
from chunkserver_loadtest.record import Record
from chunkserver_loadtest.result import Result, Stream
from chunkserver_loadtest.runs import Plan, run
from chunkserver_loadtest.storms import STORMS, Setting, perform
from chunkserver_loadtest.target import resolve
from chunkserver_loadtest.world import describe
from tests.loadtest.stream_stub import EVERYTHING, PATH, Lie, Message, Stub, streaming

SECONDS = 0.2
EDITS = 20
"""That are due in that time, at the rate of these tests; one more is sent before the clock starts."""
FIFTH = 5


def storm(url: str, profile: str = "edit-storm", closed: bool = False, timeout: float = 3.0, **options: Any) -> Result:
    more = {"editors": 2, "subscribers": 3, "rate": EDITS / SECONDS, "seed": 1} | options
    limits = Limits(seconds=SECONDS, timeout=timeout)
    return run(Plan(url, PATH, profile, Options(**more), limits, closed=closed), lambda _: None)


def stream(result: Result) -> Stream:
    assert result.stream is not None
    return result.stream


def counts(result: Result) -> dict[str, int]:
    return {kind: failed.count for kind, failed in result.failures.items()}


def first_told(change: Lie) -> Lie:
    """Return a lie to the first subscriber alone, when it is to be told of the fifth edit."""

    def lie(client: str, message: Message) -> list[Message]:
        is_it = message["type"] == "edits" and message["revision"] == str(FIFTH) and client.endswith("subscriber-0")
        return change(client, message) if is_it else [message]

    return lie


def without_edits(_client: str, message: Message) -> list[Message]:
    return [{**message, "edits": []}]


def again(_client: str, message: Message) -> list[Message]:
    return [message, message]


def twice_in_one(_client: str, message: Message) -> list[Message]:
    return [{**message, "edits": [*message["edits"], *message["edits"]]}]


def left_out(_client: str, _message: Message) -> list[Message]:
    return []


def other_strokes(_client: str, message: Message) -> list[Message]:
    return [{**message, "edits": [{**edit, "strokes": [{"op": "fill"}]} for edit in message["edits"]]}]


def without_strokes(_client: str, message: Message) -> list[Message]:
    return [{**message, "edits": [{**edit, "strokes": None} for edit in message["edits"]]}]


def stale(_client: str, message: Message) -> list[Message]:
    return [{"type": "stale", "chunks": EVERYTHING, "revision": message["revision"]}]


def resync(_client: str, message: Message) -> list[Message]:
    return [{"type": "resync", "floor": "0", "epoch": "one", "revision": message["revision"]}]


def no_message(_client: str, _message: Message) -> list[Message]:
    return [{"type": "edits", "revision": "many"}]


def closed(_client: str, _message: Message) -> list[Message]:
    return [{"type": "close", "code": 4408}]


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (without_edits, {"edit-missed": 1}),
        (again, {"disordered": 1}),
        (twice_in_one, {"disordered": 1}),
        (left_out, {"disordered": 1}),
        (other_strokes, {"edit-changed": 1}),
        (no_message, {"malformed-message": 1}),
        (closed, {"peer-lost": 1}),
        (without_strokes, {}),
        (stale, {}),
        (resync, {}),
    ],
)
def test_what_one_subscriber_is_told_once(change: Lie, expected: dict[str, int]):
    with streaming(first_told(change)) as server:
        result = storm(server.url)
    assert counts(result) == expected
    found = stream(result)
    assert (found.stale, found.resync) == (change is stale, change is resync)
    assert found.missed == expected.get("edit-missed", 0)
    assert result.counts.answered == EDITS


def test_a_storm_that_is_told_the_truth():
    with streaming() as server:
        result = storm(server.url)
    found = stream(result)
    assert result.failures == {}
    assert (result.counts.due, result.counts.answered, found.acknowledged) == (EDITS, EDITS, EDITS + 1)
    assert server.revision == EDITS + 1
    assert (found.told.count, found.last.count) == (3 * EDITS, EDITS)
    assert (found.connects, found.refused, found.lost) == (5, {}, 0)
    assert found.told.p50 <= found.last.p50
    assert result.throughput.intended == pytest.approx(EDITS / SECONDS)
    assert result.throughput.bytes > 0


def test_an_edit_that_nobody_is_told_of_any_more_is_late():
    def silent(client: str, message: Message) -> list[Message]:
        is_over = message["type"] == "edits" and int(message["revision"]) > EDITS
        return [] if is_over and client.endswith("-2") else [message]

    with streaming(silent) as server:
        result = storm(server.url, timeout=0.3)
    assert counts(result) == {"edit-late": 1}


def test_an_answer_that_does_not_come_is_a_failure():
    def mute(_client: str, message: Message) -> list[Message]:
        return [] if message["type"] == "ack" and message["revision"] == str(FIFTH) else [message]

    with streaming(mute) as server:
        result = storm(server.url, timeout=0.3)
    assert counts(result) == {"timeout": 1}
    assert stream(result).strange == 0, "it may be the one that was not answered"
    assert (result.counts.due, result.counts.answered) == (EDITS, EDITS - 1)


def test_a_refused_edit_is_a_failure_by_its_problem():
    def refusing(_client: str, message: Message) -> list[Message]:
        if message["type"] == "ack" and message["revision"] == str(FIFTH):
            problem = {"type": "urn:chunkserver:problem:overloaded", "status": 503}
            return [{"type": "nack", "seq": message["seq"], "problem": problem}]
        return [message]

    with streaming(refusing) as server:
        result = storm(server.url, subscribers=0)
    assert counts(result) == {"nack": 1}
    assert result.failures["nack"].detail == "overloaded"
    assert stream(result).nacks == {"overloaded": 1}
    assert result.latency.by_status["503"].count == 1


def test_a_closed_loop_sends_the_next_edit_when_the_last_is_answered():
    with streaming() as server:
        result = storm(server.url, closed=True, subscribers=0)
    assert result.failures == {}
    assert result.counts.in_flight_most <= 2
    assert result.counts.due == result.counts.answered > EDITS


def test_more_edits_than_a_connection_has_room_for_wait():
    def slow(_client: str, message: Message) -> list[Message]:
        return [] if message["type"] == "ack" and int(message["revision"]) > 1 else [message]

    with streaming(slow) as server:
        result = storm(server.url, timeout=0.2, editors=1, subscribers=0)
    assert server.revision == 1 + 4, "no more are sent than the server takes at a time"
    assert counts(result) == {"timeout": EDITS}


def test_all_come_back_and_miss_nothing():
    with streaming() as server:
        result = storm(server.url, "reconnect-storm", cuts=2, missed=7)
    found = stream(result)
    assert result.failures == {}
    assert found.acknowledged == server.revision == 1 + EDITS + 2 * 7
    assert found.connects == 5 + 2 * 4, "one editor stays"
    assert (found.welcomed.count, found.back.count, len(found.all_back)) == (2 * 4, 2 * 3, 2)
    assert max(found.all_back) >= found.back.max >= found.back.p50 > 0
    assert found.told.count == 3 * EDITS, "what was missed is in no figure"


def test_edits_without_an_answer_are_sent_again_and_written_once():
    def mute(client: str, message: Message) -> list[Message]:
        is_lost = message["type"] == "ack" and "editor-1" in client and int(message["revision"]) <= FIFTH
        return [] if is_lost and not message["duplicate"] else [message]

    with streaming(mute) as server:
        result = storm(server.url, "reconnect-storm", editors=2, missed=1)
    assert result.failures == {}
    assert stream(result).duplicates >= 2
    assert server.revision == 1 + EDITS + 1


def test_who_is_refused_tries_again():
    def refusing(_client: str, message: Message) -> list[Message]:
        if message["type"] == "edits" and message["revision"] == str(EDITS):
            server.refuse = 3, HTTPStatus.SERVICE_UNAVAILABLE
        return [message]

    with streaming(refusing) as server:
        result = storm(server.url, "reconnect-storm", missed=1)
    assert result.failures == {}
    assert stream(result).refused == {"HTTP/1.1 503 Service Unavailable": 3}


def test_who_does_not_come_back_is_a_failure():
    def refusing(_client: str, message: Message) -> list[Message]:
        if message["type"] == "edits" and message["revision"] == str(EDITS):
            server.refuse = 1, HTTPStatus.FORBIDDEN
        return [message]

    with streaming(refusing) as server:
        result = storm(server.url, "reconnect-storm", missed=1)
    assert counts(result) == {"no-welcome": 1}
    assert "403 Forbidden" in result.failures["no-welcome"].detail


def test_who_cannot_join_ends_it_all():
    with streaming() as server:
        server.refuse = 1, HTTPStatus.UNAUTHORIZED
        with pytest.raises(BadTarget, match=r"not welcome: HTTP.* 401"):
            storm(server.url)


@pytest.mark.parametrize(("more", "expected"), [(0, {}), (2, {"edit-doubled": 2}), (-1, {"edit-lost": 1})])
def test_a_world_of_ones_own_has_as_many_edits_as_were_acknowledged(more: int, expected: dict[str, int]):
    with streaming() as server:
        assert alone(server, lambda: server.revision + more) == expected


def test_an_edit_that_nobody_sent_is_strange_in_a_world_of_ones_own():
    def haunted(_client: str, message: Message) -> list[Message]:
        if message["type"] == "ack" and message["revision"] == str(FIFTH):
            server.edits.append(("ghost", 1, []))
        return [message]

    with streaming(haunted) as server:
        assert alone(server, lambda: server.revision) == {"edit-strange": 1, "edit-doubled": 1}
    with streaming(haunted) as server:
        result = storm(server.url)
    assert result.failures == {}, "others may edit a world that has a name"
    assert stream(result).strange == 1


def alone(server: Stub, revision: Callable[[], int]) -> dict[str, int]:
    """Have a storm in a world that nobody else knows, whose revision is said to be that; return its failures."""
    target, record = resolve(server.url), Record()
    options = Options(editors=2, subscribers=3, rate=EDITS / SECONDS)
    limits = Limits(seconds=SECONDS, timeout=3.0)
    setting = Setting(target, describe(target, PATH, "mesh", {}), b"", options, limits, False, True, revision)
    with asyncio.Runner(loop_factory=new_event_loop) as runner:
        runner.run(perform(STORMS["edit-storm"], setting, record))
    return {kind: failures.count for kind, failures in record.failures.items()}
