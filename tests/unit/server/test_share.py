"""What peers may have of the event loop: on a clock that nobody waits for, and over sockets."""

import asyncio
from collections.abc import Callable
from typing import Any

import pytest
from starlette.websockets import WebSocket
from uvicorn.config import Config
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol
from uvicorn.server import ServerState

from chunkserver.server.connections import Connections
from chunkserver.server.share import BURST_SECONDS, COUNTED_SECONDS_MAX, OWN_SHARE, REST, TURN_SECONDS, Share, Shares
from chunkserver.server.stream import SUBPROTOCOL, _Session
from chunkserver.server.stream_protocol import streaming
from chunkserver.stream import Connection
from tests.frames import FIN, PING, TEXT, Frame
from tests.unit.stream.worlds import World, hello

WORK_SECONDS = 0.0005
"""That each message of a test takes, by the clock of the shares. All pings of a piece take less than is counted."""


class Clock:
    """Seconds that pass by work alone, or beside others'. beside: another clock."""

    def __init__(self, beside: Callable[[], float] = lambda: 0.0) -> None:
        self.worked = 0.0
        self._beside = beside

    def __call__(self) -> float:
        return self._beside() + self.worked


def work(clock: Clock, share: Share, seconds: float = WORK_SECONDS) -> None:
    with share.used():
        clock.worked += seconds


def most(peers: int, seconds: float) -> float:
    """Return what so many peers may have of so many seconds of the loop."""
    beyond = seconds / REST
    return peers * (BURST_SECONDS + OWN_SHARE * seconds + TURN_SECONDS + WORK_SECONDS) + beyond


@pytest.mark.parametrize("peers", [1, 4, 32])
def test_all_who_want_everything_get_a_part_of_it_and_equal_ones(peers: int):
    clock = Clock()
    shares = Shares(clock)
    each = [Share(shares) for _ in range(peers)]
    had = [0.0] * peers
    while clock() < 100.0:
        rests = [share.rest_seconds for share in each]
        if min(rests):
            clock.worked += min(rests)
        for number, share in enumerate(each):
            if not share.rest_seconds:
                work(clock, share)
                had[number] += WORK_SECONDS
    assert sum(had) <= most(peers, clock())
    assert sum(had) >= 0.15 * clock(), "it is shared out, and not kept"
    assert min(had) >= 0.9 * max(had)


def test_who_keeps_to_its_share_never_rests_whatever_others_do():
    clock = Clock()
    shares = Shares(clock)
    one, *others = (Share(shares) for _ in range(9))
    for _ in range(5000):
        work(clock, one)
        assert not one.rest_seconds
        for other in others:
            if not other.rest_seconds:
                work(clock, other, 0.004)
        clock.worked += WORK_SECONDS / OWN_SHARE


def test_a_burst_is_taken_at_once_and_comes_back():
    clock = Clock()
    share = Share(Shares(clock))
    for _ in range(2):
        for _ in range(round(BURST_SECONDS / WORK_SECONDS)):
            work(clock, share)
            assert not share.rest_seconds
        clock.worked += BURST_SECONDS / OWN_SHARE
    for _ in range(round(BURST_SECONDS / COUNTED_SECONDS_MAX)):
        work(clock, share, COUNTED_SECONDS_MAX)
        assert not share.rest_seconds
    work(clock, share, COUNTED_SECONDS_MAX)
    assert share.rest_seconds == pytest.approx(REST * COUNTED_SECONDS_MAX, rel=0.2)


def test_a_loop_that_stood_still_is_nobody_s_fault():
    clock = Clock()
    share = Share(Shares(clock))
    work(clock, share, 5.0)
    assert not share.rest_seconds


class Room:
    """A server of streams in this process, whose shares go by a clock that also counts the work of a test."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, seconds: float = WORK_SECONDS) -> None:
        """seconds: that each message takes, or each ping."""
        self._seconds = seconds
        self.clock = Clock(asyncio.get_running_loop().time)
        self.world = World()
        self.handled: dict[str | None, int] = {}
        connections = Connections()
        connections.shares = Shares(self.clock)
        config = Config(self._app, interface="asgi3", ws_per_message_deflate=False)
        config.load()
        self._new = lambda: streaming(connections)(config, ServerState(), {})  # type: ignore[call-arg]
        taken, pinged = Connection.received, WebSocketsSansIOProtocol.handle_ping

        def received(connection: Connection, frame: str | bytes) -> None:
            taken(connection, frame)
            self._count(connection.client)
            if connection.client and connection._state == "introducing":
                connection.introduced(None, 0)

        def handle_ping(protocol: WebSocketsSansIOProtocol) -> None:
            pinged(protocol)
            self._count("pings")

        monkeypatch.setattr(Connection, "received", received)
        monkeypatch.setattr(WebSocketsSansIOProtocol, "handle_ping", handle_ping)

    async def begin(self) -> asyncio.Server:
        return await asyncio.get_running_loop().create_server(self._new, "127.0.0.1")

    def _count(self, who: str | None) -> None:
        self.clock.worked += self._seconds
        self.handled[who] = self.handled.get(who, 0) + 1

    async def _app(self, scope: Any, receive: Any, send: Any) -> None:
        session = _Session(WebSocket(scope, receive, send))
        session.connection = self.world.stream.connect(session.wake)
        await session.run()


UPGRADE = (
    b"GET / HTTP/1.1\r\nHost: x\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
    b"Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\nSec-WebSocket-Version: 13\r\n"
    b"Sec-WebSocket-Protocol: %b\r\n\r\n" % SUBPROTOCOL.encode()
)
SUBSCRIBE = Frame(FIN | TEXT, b'{"type":"subscribe","regions":[]}').encoded()
FLOODS = {"flood": SUBSCRIBE, "pings": Frame(FIN | PING, bytes(125)).encoded()}
AT_ONCE = {"flood": 1, "pings": 16}
"""That are taken before they can be counted: messages one by one, pings of a piece together."""
FRAMES = 5000
ROUNDS = 20


async def entered(server: asyncio.Server, name: str) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
    reader, writer = await asyncio.open_connection(*server.sockets[0].getsockname())
    writer.write(UPGRADE + Frame(FIN | TEXT, hello(name).encode()).encoded())
    await reader.readuntil(b'"limits"')
    return reader, writer


@pytest.mark.parametrize("kind", FLOODS)
def test_others_come_between_the_messages_of_a_flood(kind: str, monkeypatch: pytest.MonkeyPatch):
    async def scenario() -> None:
        room = Room(monkeypatch)
        async with await room.begin() as server:
            witness, says = await entered(server, "witness")
            answers, floods = await entered(server, "flood")
            floods.write(FLOODS[kind] * FRAMES)
            reading = asyncio.ensure_future(answers.read())
            before, began = room.handled.get(kind, 0), room.clock()
            for _ in range(ROUNDS):
                says.write(SUBSCRIBE)
                await witness.readuntil(b'"progress"')
                await asyncio.sleep(0.01)
            handled = room.handled[kind] - before
            for writer in (says, floods):
                writer.close()
            reading.cancel()
        assert room.handled["witness"] == ROUNDS + 1
        assert 0 < handled <= most(1, room.clock() - began) / WORK_SECONDS + AT_ONCE[kind]
        assert handled < FRAMES

    asyncio.run(scenario())


def test_all_that_a_flood_sends_is_taken_in_the_end(monkeypatch: pytest.MonkeyPatch):
    async def scenario() -> None:
        room = Room(monkeypatch, seconds=WORK_SECONDS / 5)
        async with await room.begin() as server, asyncio.timeout(60):
            answers, floods = await entered(server, "flood")
            floods.write(SUBSCRIBE * FRAMES)
            reading = asyncio.ensure_future(answers.read())
            while room.handled["flood"] <= FRAMES:
                await asyncio.sleep(0.01)
            floods.close()
            reading.cancel()

    asyncio.run(scenario())
