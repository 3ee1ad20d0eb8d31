"""Many peers of one stream: some edit, all others listen. When each edit was answered, and when each was told.

editor -- edit --> server -- ack --> editor
                          -- edits --> listener, listener, ...     told: when the last of them has it

Whoever is cut comes back as a client does: with what it knows, and with the edits that were not answered.
"""

import asyncio
import random
import socket
import time
from collections import Counter
from collections.abc import Awaitable, Callable, Iterable
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

from chunkserver_loadtest.editor import Editor
from chunkserver_loadtest.peer import DISORDERED, Loss, Message, Peer, upgrade
from chunkserver_loadtest.target import Target
from chunkserver_loadtest.tellings import EVERYWHERE, Listener, Look, Sent, Strokes, Tellings, Verdict

OK: Final = 200
CELLS: Final = 32
POLL_SECONDS: Final = 0.01
OPEN_SECONDS_MAX: Final = 30.0
"""Until a connection is there, and its peer knows what there is."""
BACKOFF_SECONDS: Final = 0.1
BACKOFF_SECONDS_MAX: Final = 5.0
"""A peer that was refused waits for a random time: up to the first, doubled each time, and never more than this."""
EXPONENT_MAX: Final = 16
REASONS_MAX: Final = 32
"""Reasons of refusals that are counted one by one."""
SILENT_BYTES: Final = 4096
"""That the kernel takes for a peer which does not read."""
NOTICE_SECONDS: Final = 0.3
"""For peers that read again to see that their connection is over."""
NOT_WELCOME: Final = "not-welcome"


class Back(NamedTuple):
    """A peer that came back: after how many seconds it was welcome, and knew everything up to that welcome.

    Of an editor, which is told of nothing, both are the same.
    """

    name: str
    is_editor: bool
    welcomed: float
    caught_up: float


@dataclass(slots=True)
class _Joining:
    """A peer that is not caught up. wanted: the revision of its welcome, and welcomed: when that came, once it did."""

    done: asyncio.Future[float]
    wanted: int | None = None
    welcomed: float = 0.0


class Crowd:
    """The peers, by name. Belongs to the event loop.

    lost: who was lost for good, and why. gone: who never read, and was dropped for it.
    connects: connections that were tried. refusals: those that came to nothing, by why.
    acknowledged, duplicates, nacks: answers; of nacks how many of each type of problem.
    stale, resync: messages that stand for edits which were not told one by one.
    answered: called when an edit is answered. told: when, moreover, all who were owed it have been told of it.
    """

    def __init__(
        self,
        target: Target,
        path: str,
        fixed: bytes = b"",
        *,
        cells: int = CELLS,
        patience: float = 0.0,
        answered: Callable[[Sent], None] = lambda _: None,
        told: Callable[[Sent], None] = lambda _: None,
    ) -> None:
        """path: of the world, cells: of a side of its chunks. fixed: header lines that each upgrade has.

        patience: for how many seconds a peer that is refused tries again.
        """
        self.lost: dict[str, Loss] = {}
        self.gone: set[str] = set()
        self.connects = self.acknowledged = self.duplicates = self.stale = self.resync = 0
        self.refusals, self.nacks = Counter[str](), Counter[str]()
        self._target, self._upgrade, self._patience = target, upgrade(path, target.authority, fixed), patience
        self._answered = answered
        self._tellings = Tellings(cells, told)
        self._peers: dict[str, Peer] = {}
        self._looks: dict[str, Look] = {}
        self._listeners: dict[str, Listener] = {}
        self._editors: dict[str, Editor] = {}
        self._silent: set[str] = set()
        self._joining: dict[str, _Joining] = {}
        self._answers: dict[int, tuple[str, asyncio.Future[None]]] = {}
        self._received = 0
        self._read: Message = {}

    @property
    def skipped(self) -> int:
        """Messages that stand for edits which were not told one by one."""
        return self.stale + self.resync

    @property
    def refused(self) -> int:
        """Edits that were not written."""
        return self.nacks.total()

    @property
    def received(self) -> int:
        """Bytes that came."""
        return self._received + sum(peer.received for peer in self._peers.values())

    @property
    def unanswered(self) -> int:
        """Edits that have no answer."""
        return sum(map(len, self._editors.values()))

    @property
    def unsettled(self) -> int:
        """Edits that are not answered, or that some listeners have not been told."""
        return self.unanswered + self._tellings.unsettled

    async def join(
        self, names: Iterable[str], *, edit: bool = False, silent: bool = False, look: Look = EVERYWHERE
    ) -> None:
        """Have editors or listeners join, until all are welcome. Raises ConnectionError that says who is not.

        silent: read nothing from then on, and are told of nothing. look: where listeners look.
        """
        joining = tuple(names)
        if edit:
            self._editors |= {name: Editor() for name in joining}
        else:
            self._looks |= dict.fromkeys(joining, look)
        self._silent.update(joining if silent else ())
        await asyncio.gather(*map(self._enter, joining))

    async def come_back(
        self, away: Callable[[], Awaitable[Any]] | None = None, editors: Iterable[str] = ()
    ) -> list[Back]:
        """Cut all listeners, and have all of them come back at once. Return how long that took each who did.

        away: awaited while they are away. editors: who are cut with them. Who does not come back is in `lost`.
        """
        going = [name for name in (*self._listeners, *editors) if name not in self.lost]
        for name in going:
            self._peers[name].close()
            if name in self._editors:
                self._editors[name].lost()
        if away is not None:
            await away()
        begun = time.perf_counter()
        found = await asyncio.gather(*map(self._enter, going), return_exceptions=True)
        backs = []
        for name, each in zip(going, found, strict=True):
            if isinstance(each, tuple):
                backs.append(Back(name, name in self._editors, each[0] - begun, each[1] - begun))
            elif not isinstance(each, ConnectionError):
                raise each
        return backs

    def edit(self, name: str, strokes: Strokes, due: float | None = None) -> Sent:
        """Have an editor send an edit, as soon as there is room. due: when it was to be sent; now, if left out.

        Raises ConnectionError if the editor is lost.
        """
        self._check(name)
        now = time.perf_counter()
        sent = Sent(now if due is None else due, strokes)
        self._editors[name].add(sent)
        self._editors[name].flush(now)
        return sent

    async def edited(self, name: str, strokes: Strokes) -> Sent:
        """Have an editor send an edit, and return it when it is answered, as `answer` does."""
        return await self.answer(name, self.edit(name, strokes))

    async def answer(self, name: str, sent: Sent) -> Sent:
        """Return an edit of an editor when it is answered. Raises ConnectionError if the editor is lost before that."""
        if not sent.answered:
            self._check(name)
            waiting = asyncio.get_running_loop().create_future()
            self._answers[id(sent)] = name, waiting
            try:
                await waiting
            finally:
                self._answers.pop(id(sent), None)
        return sent

    async def settle(self, seconds: float) -> None:
        """Wait until every edit is answered and told, or nobody can be told any more, or so long."""
        end = time.perf_counter() + seconds
        while self.unsettled and time.perf_counter() < end:
            is_answered = all(name in self.lost or not len(editor) for name, editor in self._editors.items())
            if is_answered and self._tellings.is_over:
                return
            await asyncio.sleep(POLL_SECONDS)

    async def notice(self) -> None:
        """Find out who of those that never read is gone."""
        for name in self._silent:
            self._peers[name].resume()
        await asyncio.sleep(NOTICE_SECONDS if self._silent else 0)

    def forget(self) -> list[Sent]:
        """Return the edits that were not answered, and wait for them no more."""
        return [sent for editor in self._editors.values() for sent in editor.forget()]

    def verdict(self) -> Verdict:
        """Return what listeners should have been told, and were not, if nothing more comes."""
        return self._tellings.verdict()

    def close(self) -> None:
        """End all connections."""
        for peer in self._peers.values():
            peer.close()

    def _check(self, name: str) -> None:
        if name in self.lost:
            raise ConnectionError(f"{name} is lost: {self.lost[name].detail}")

    async def _enter(self, name: str) -> tuple[float, float]:
        """Have a peer connect until it is caught up. Return when it was welcome, and when that was so."""
        end, tries = time.perf_counter() + self._patience, 0
        while True:
            try:
                return await self._open(name)
            except OSError as error:  # of which ConnectionError and TimeoutError are some
                loss = error.args[0] if error.args and isinstance(error.args[0], Loss) else _loss(error)
            why = loss.detail if loss.detail in self.refusals or len(self.refusals) < REASONS_MAX else "other"
            self.refusals[why] += 1
            self._peers[name].close()
            if loss.is_final or time.perf_counter() >= end:
                self._lose(name, loss._replace(kind=NOT_WELCOME))
                raise ConnectionError(f"{name} is not welcome: {loss.detail}")
            longest = min(BACKOFF_SECONDS * 2.0 ** min(tries, EXPONENT_MAX), BACKOFF_SECONDS_MAX)
            await asyncio.sleep(random.uniform(0, longest))
            tries += 1

    async def _open(self, name: str) -> tuple[float, float]:
        peer = self._new(name)
        loop = asyncio.get_running_loop()
        joining = self._joining[name] = _Joining(loop.create_future())
        self.connects += 1
        tls, host = self._target.tls, self._target.name if self._target.tls else None
        try:
            async with asyncio.timeout(max(self._patience, OPEN_SECONDS_MAX)):
                await loop.create_connection(
                    lambda: peer, sock=await self._connected(name), ssl=tls, server_hostname=host
                )
                caught_up = await joining.done
        finally:
            self._joining.pop(name, None)
        return joining.welcomed, caught_up

    def _new(self, name: str) -> Peer:
        """Return a peer that goes on from what is known by the last one of its name."""
        before = self._peers.get(name)
        self._received += before.received if before else 0
        known = (before.epoch, before.known) if before else (None, None)
        regions = [self._looks[name].written()] if name in self._looks else []
        arguments = (self._upgrade, name, self._heard, self._end)
        peer = self._peers[name] = Peer(*arguments, regions=regions, epoch=known[0], known=known[1])
        return peer

    async def _connected(self, name: str) -> socket.socket:
        address = (self._target.address, self._target.port)
        connection = socket.socket(socket.AF_INET6 if ":" in address[0] else socket.AF_INET)
        connection.setblocking(False)
        if name in self._silent:
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, SILENT_BYTES)
        try:
            await asyncio.get_running_loop().sock_connect(connection, address)
        except BaseException:
            connection.close()
            raise
        return connection

    def _heard(self, peer: Peer, message: Message, moment: float) -> None:
        kind, name = message["type"], peer.client
        if kind == "welcome":
            self._welcome(peer, message, moment)
        elif kind in ("ack", "nack") and name in self._editors:
            self._take_answer(name, message, moment)
        elif name in self._listeners and peer.known is not None:
            self._tell(self._listeners[name], peer.known, message, moment)
        joining = self._joining.get(name)
        if joining is not None and joining.wanted is not None and peer.known is not None:
            is_caught_up = name in self._editors or peer.known >= joining.wanted
            if is_caught_up and not joining.done.done():
                joining.done.set_result(moment)

    def _welcome(self, peer: Peer, message: Message, moment: float) -> None:
        name = peer.client
        joining = self._joining.get(name)
        if joining is None:
            peer.close()
            self._end(peer, Loss(DISORDERED, "a second welcome"))
            return
        joining.wanted, joining.welcomed = int(message["revision"]), moment
        if name in self._editors:
            self._editors[name].welcomed(peer, message)
            self._editors[name].flush(moment)
        elif name in self._silent:
            peer.pause()
        elif name not in self._listeners:
            self._listeners[name] = self._tellings.join(self._looks[name], joining.wanted)

    def _tell(self, listener: Listener, known: int, message: Message, moment: float) -> None:
        match message["type"]:
            case "edits":
                if message is not self._read:
                    self._read = message
                    for edit in message["edits"]:
                        if edit["strokes"] is not None:
                            self._tellings.content(int(edit["revision"]), edit["strokes"])
                self._tellings.tell(listener, message["revisions"], known, moment)
            case "progress":
                listener.known = known
            case "stale" | "resync" as kind:
                self.stale += kind == "stale"
                self.resync += kind == "resync"
                self._tellings.leave_out(listener, known)

    def _take_answer(self, name: str, message: Message, moment: float) -> None:
        sent = self._editors[name].answered(message["seq"])
        self._editors[name].flush(moment)
        if sent is None:
            return
        sent.answered = moment
        if message["type"] == "ack":
            sent.status, sent.revision = OK, int(message["revision"])
            self.acknowledged += 1
            self.duplicates += message["duplicate"]
        else:
            problem = message["problem"]
            sent.status, sent.refusal = int(problem["status"]), str(problem["type"]).rpartition(":")[2]
            self.nacks[sent.refusal] += 1
        self._answered(sent)
        if (waiting := self._answers.get(id(sent))) is not None and not waiting[1].done():
            waiting[1].set_result(None)
        if sent.status == OK:
            self._tellings.answer(sent, message["stale"])

    def _end(self, peer: Peer, why: Loss) -> None:
        name = peer.client
        joining = self._joining.get(name)
        if joining is not None:
            if not joining.done.done():
                joining.done.set_exception(ConnectionError(why))
        elif name in self._silent:
            self.gone.add(name)
        else:
            self._lose(name, why)

    def _lose(self, name: str, why: Loss) -> None:
        """Note that a peer does not come back."""
        self.lost[name] = why
        if name in self._listeners:
            self._tellings.lose(self._listeners[name])
        if name in self._editors:
            self._editors[name].lost()
        for editor, waiting in tuple(self._answers.values()):
            if editor == name and not waiting.done():
                waiting.set_exception(ConnectionError(f"{name} is lost: {why.detail}"))


def _loss(error: OSError) -> Loss:
    return Loss(NOT_WELCOME, error.strerror or str(error) or type(error).__name__)
