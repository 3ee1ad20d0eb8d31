"""A crowd: who joins, who cannot, who does not read; and editors on their own."""

import asyncio
from collections.abc import Awaitable, Callable
from http import HTTPStatus
from typing import Any

import pytest

from chunkserver_loadtest.crowd import Crowd
from chunkserver_loadtest.editor import Editor
from chunkserver_loadtest.errors import BadOption
from chunkserver_loadtest.event_loop import new_event_loop
from chunkserver_loadtest.machine import allow_files
from chunkserver_loadtest.target import resolve
from chunkserver_loadtest.tellings import Sent
from tests.loadtest.stream_stub import PATH, Lie, Stub, honest, streaming

SECONDS_MAX = 10.0
STROKES = [{"op": "carve"}]


def with_crowd(play: Callable[[Crowd, Stub], Awaitable[None]], lie: Lie = honest, **options: Any) -> None:
    async def limited(server: Stub) -> None:
        crowd = Crowd(resolve(server.url), PATH, **options)
        try:
            await asyncio.wait_for(play(crowd, server), SECONDS_MAX)
        finally:
            crowd.close()

    with streaming(lie) as server, asyncio.Runner(loop_factory=new_event_loop) as runner:
        runner.run(limited(server))


def test_edits_are_answered_and_told():
    async def play(crowd: Crowd, server: Stub) -> None:
        await crowd.join(["editor"], edit=True)
        await crowd.join(["one", "other"])
        sent = await crowd.edited("editor", STROKES)
        await crowd.settle(SECONDS_MAX)
        assert (sent.status, sent.revision, sent.told) == (200, 1, 2)
        assert sent.due <= sent.sent <= sent.answered
        assert max(sent.tellings) == sent.told_at
        assert (crowd.unsettled, crowd.lost, crowd.skipped, crowd.acknowledged) == (0, {}, 0, 1)
        assert server.edits == [("editor", 1, STROKES)]

    with_crowd(play)


def test_who_is_refused_is_an_error_without_patience():
    async def play(crowd: Crowd, server: Stub) -> None:
        server.refuse = 1, HTTPStatus.SERVICE_UNAVAILABLE
        with pytest.raises(ConnectionError, match=r"one is not welcome: HTTP.* 503"):
            await crowd.join(["one"])
        assert list(crowd.lost) == ["one"]
        assert crowd.connects == 1

    with_crowd(play)


def test_who_is_refused_tries_again_with_patience():
    async def play(crowd: Crowd, server: Stub) -> None:
        server.refuse = 2, HTTPStatus.SERVICE_UNAVAILABLE
        await crowd.join(["one"])
        assert (crowd.connects, crowd.refusals.total(), crowd.lost) == (3, 2, {})

    with_crowd(play, patience=SECONDS_MAX)


def test_a_server_that_is_away_is_an_error():
    async def play(crowd: Crowd, _server: Stub) -> None:
        with pytest.raises(ConnectionError, match="one is not welcome"):
            await crowd.join(["one"])

    with streaming() as server:
        url = server.url

    async def alone() -> None:
        await play(Crowd(resolve(url), PATH), server)

    with asyncio.Runner(loop_factory=new_event_loop) as runner:
        runner.run(alone())


def test_who_does_not_read_takes_nothing_and_is_owed_nothing():
    async def play(crowd: Crowd, _server: Stub) -> None:
        await crowd.join(["editor"], edit=True)
        await crowd.join(["silent"], silent=True)
        sent = await crowd.edited("editor", [{"op": "x" * 30_000}])
        await asyncio.sleep(0.05)
        assert crowd.received < 10_000
        assert (crowd.unsettled, sent.told) == (0, 0)
        await crowd.notice()
        assert crowd.received > 30_000
        assert (crowd.gone, crowd.lost) == (set(), {})

    with_crowd(play)


def test_who_waits_for_an_answer_is_told_that_the_editor_is_lost():
    def closing(_client: str, message: dict[str, Any]) -> list[dict[str, Any]]:
        return [{"type": "close", "code": 1011} if message["type"] == "ack" else message]

    async def play(crowd: Crowd, _server: Stub) -> None:
        await crowd.join(["editor"], edit=True)
        for _ in range(2):
            with pytest.raises(ConnectionError, match="editor is lost: 1011"):
                await crowd.edited("editor", STROKES)
        assert crowd.unanswered == 1
        await crowd.settle(SECONDS_MAX)
        assert len(crowd.forget()) == 1
        assert crowd.unsettled == 0

    with_crowd(play, closing)


class Line:
    """Stands for a peer: keeps what is sent."""

    def __init__(self) -> None:
        self.seqs: list[int] = []

    def send(self, _kind: str, **members: Any) -> None:
        self.seqs.append(members["seq"])


def test_an_editor_sends_what_there_is_room_for_and_again_what_was_not_answered():
    editor, line, later = Editor(), Line(), Line()
    editor.welcomed(line, {"last_seq": 40, "limits": {"inflight": 2}})  # type: ignore[arg-type]
    edits = [Sent(0.0, STROKES) for _ in range(4)]
    for sent in edits:
        editor.add(sent)
        editor.flush(1.0)
    assert line.seqs == [41, 42], "above all that was written by this name"
    assert [sent.sent for sent in edits] == [1.0, 1.0, 0.0, 0.0]
    assert editor.answered(42) is edits[1]
    assert editor.answered(42) is None
    editor.flush(2.0)
    assert line.seqs == [41, 42, 43]
    editor.lost()
    editor.flush(3.0)
    editor.welcomed(later, {"last_seq": 42, "limits": {"inflight": 2}})  # type: ignore[arg-type]
    editor.flush(4.0)
    assert (line.seqs[3:], later.seqs) == ([], [41, 43])
    assert edits[0].sent == 1.0, "it counts from the first time"
    assert len(editor) == 3
    assert editor.forget() == [edits[0], edits[2], edits[3]]


def test_more_files_than_the_system_allows_are_refused(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("resource.getrlimit", lambda _: (100, 1000))
    raised: list[tuple[int, int]] = []
    monkeypatch.setattr("resource.setrlimit", lambda _, limits: raised.append(limits))
    allow_files(100)
    assert raised == []
    allow_files(500)
    assert raised == [(500, 1000)]
    with pytest.raises(BadOption, match="1001 files are needed"):
        allow_files(1001)
