"""Many peers of one stream: some edit, all others listen. When each edit was answered, and when the last was told.

editor -- edit --> server -- ack --> editor
                          -- edits --> listener, listener, ...     told: when the last of them has it
"""

import asyncio
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any, Final

from chunkserver_loadtest.peer import EVERYWHERE, Message, Peer, upgrade
from chunkserver_loadtest.target import Target

OK: Final = 200
POLL_SECONDS: Final = 0.01


@dataclass(slots=True)
class Sent:
    """An edit. Times are of `time.perf_counter`, 0.0 for what has not been.

    status: 200, or of the problem with which it was refused; 0 without an answer.
    told: how many listeners have it. told_at: when the last of them got it.
    """

    due: float
    sent: float
    answered: float = 0.0
    status: int = 0
    told: int = 0
    told_at: float = 0.0


@dataclass(slots=True)
class _Joining:
    """A peer that is not caught up. wanted: the revision of its welcome, once it came."""

    done: asyncio.Future[float]
    wanted: int | None = None


class Crowd:
    """The peers. Belongs to the event loop.

    editors, listeners: by name; whoever is lost stays here. lost: of those, why.
    skipped: messages that stand for edits which were not told one by one. refused: edits that were not written.
    told: called when an edit has been answered, and all listeners have been told of it.
    answered: called when it is answered.
    """

    def __init__(
        self,
        target: Target,
        path: str,
        fixed: bytes = b"",
        *,
        answered: Callable[[Sent], None] = lambda _: None,
        told: Callable[[Sent], None] = lambda _: None,
    ) -> None:
        """path: of the world. fixed: header lines that each upgrade has."""
        self.editors: dict[str, Peer] = {}
        self.listeners: dict[str, Peer] = {}
        self.lost: dict[str, str] = {}
        self.skipped = self.refused = 0
        self._target, self._upgrade = target, upgrade(path, target.authority, fixed)
        self._answered, self._told = answered, told
        self._joining: dict[str, _Joining] = {}
        self._waiting: dict[tuple[str, int], Sent] = {}
        self._tellings: dict[int, Sent] = {}
        self._answers: dict[int, asyncio.Future[None]] = {}
        self._seq = 0

    async def join(self, names: Iterable[str], *, edit: bool = False) -> None:
        """Have editors or listeners join, until all are welcome. Raises ConnectionError that says who is not."""
        peers = [
            Peer(self._upgrade, name, self._heard, self._end, regions=() if edit else EVERYWHERE) for name in names
        ]
        (self.editors if edit else self.listeners).update({peer.client: peer for peer in peers})
        await self._open(peers)

    async def come_back(self, away: Callable[[], Any] | None = None) -> list[float]:
        """Cut all listeners, and have all of them come back at once. Return after how many seconds each was caught up.

        away: awaited while they are away.
        """
        for peer in self.listeners.values():
            peer.close()
        if away is not None:
            await away()
        peers = [
            Peer(self._upgrade, name, self._heard, self._end, epoch=old.epoch, known=old.known)
            for name, old in self.listeners.items()
        ]
        self.listeners = {peer.client: peer for peer in peers}
        begun = time.perf_counter()
        return [moment - begun for moment in await self._open(peers)]

    def edit(self, name: str, strokes: list[dict[str, Any]], due: float | None = None) -> Sent:
        """Have an editor send an edit. due: when it was to be sent; now, if left out."""
        now = time.perf_counter()
        sent = self._waiting[name, self._seq] = Sent(now if due is None else due, now)
        self.editors[name].send("edit", seq=self._seq, strokes=strokes)
        self._seq += 1
        return sent

    async def edited(self, name: str, strokes: list[dict[str, Any]]) -> Sent:
        """Have an editor send an edit, and return it when it is answered."""
        sent = self.edit(name, strokes)
        waiting = self._answers[id(sent)] = asyncio.get_running_loop().create_future()
        await waiting
        return sent

    @property
    def unsettled(self) -> int:
        """Edits that are not answered, or that some listeners have not been told."""
        return len(self._waiting) + len(self._tellings)

    async def settle(self, seconds: float) -> None:
        """Wait until every edit is answered and told, or so long."""
        end = time.perf_counter() + seconds
        while self.unsettled and time.perf_counter() < end:
            await asyncio.sleep(POLL_SECONDS)

    def close(self) -> None:
        """End all connections."""
        for peer in (*self.editors.values(), *self.listeners.values()):
            peer.close()

    async def _open(self, peers: list[Peer]) -> list[float]:
        loop = asyncio.get_running_loop()
        joining = [self._joining.setdefault(peer.client, _Joining(loop.create_future())) for peer in peers]
        tls, name = self._target.tls, self._target.name if self._target.tls else None
        address = self._target.address, self._target.port
        opening = (loop.create_connection(lambda p=peer: p, *address, ssl=tls, server_hostname=name) for peer in peers)
        await asyncio.gather(*opening)
        return await asyncio.gather(*(each.done for each in joining))

    def _heard(self, peer: Peer, message: Message, moment: float) -> None:
        kind = message["type"]
        if peer.client in self._joining:
            self._catch_up(peer, message, moment)
        if kind in ("ack", "nack"):
            self._take_answer(peer, message, moment)
        elif kind == "edits":
            for edit in message["edits"]:
                self._tell(int(edit["revision"]), moment)
        elif kind in ("stale", "resync"):
            self.skipped += 1

    def _catch_up(self, peer: Peer, message: Message, moment: float) -> None:
        joining = self._joining[peer.client]
        if message["type"] == "welcome":
            joining.wanted = int(message["revision"])
            self._seq = max(self._seq, (message["last_seq"] or 0) + 1)  # above all that its editors have used before
        if joining.wanted is not None and peer.known is not None and peer.known >= joining.wanted:
            del self._joining[peer.client]
            joining.done.set_result(moment)

    def _take_answer(self, peer: Peer, message: Message, moment: float) -> None:
        sent = self._waiting.pop((peer.client, message["seq"]), None)
        if sent is None:
            return
        sent.answered = moment
        sent.status = OK if message["type"] == "ack" else int(message["problem"]["status"])
        self.refused += sent.status != OK
        self._answered(sent)
        if (waiting := self._answers.pop(id(sent), None)) is not None:
            waiting.set_result(None)
        if sent.status == OK and self.listeners:
            revision = int(message["revision"])
            before = self._tellings.get(revision)  # some have been told before the answer was read
            if before is not None:
                sent.told, sent.told_at = before.told, before.told_at
            self._tellings[revision] = sent
            self._settle(revision, sent)

    def _tell(self, revision: int, moment: float) -> None:
        sent = self._tellings.get(revision)
        if sent is None:
            sent = self._tellings[revision] = Sent(moment, moment)
        sent.told, sent.told_at = sent.told + 1, moment
        self._settle(revision, sent)

    def _settle(self, revision: int, sent: Sent) -> None:
        if sent.answered and sent.told >= len(self.listeners):
            del self._tellings[revision]
            self._told(sent)

    def _end(self, peer: Peer, why: str) -> None:
        self.lost[peer.client] = why
        joining = self._joining.pop(peer.client, None)
        if joining is not None and not joining.done.done():
            joining.done.set_exception(ConnectionError(f"{peer.client} is not welcome: {why}"))
