"""A peer: what it says, what it makes of bytes however they are cut, and what ends it."""

import json
from typing import Any

import pytest

from chunkserver_loadtest.peer import DISORDERED, ENDED, MALFORMED, REFUSED, Loss, Message, Peer, upgrade

TAKEN = b"HTTP/1.1 101 Switching Protocols\r\nUpgrade: websocket\r\n\r\n"


class Wire:
    """Stands for a transport: keeps what is written."""

    def __init__(self) -> None:
        self.written = b""
        self.is_aborted = False

    def write(self, content: bytes) -> None:
        self.written += content

    def abort(self) -> None:
        self.is_aborted = True


class Ear:
    """A peer on a wire, and what it hears."""

    def __init__(self, known: int | None = None, epoch: str | None = None) -> None:
        self.heard: list[Message] = []
        self.losses: list[Loss] = []
        self.wire = Wire()
        self.peer = Peer(
            *(upgrade("/v1/worlds/w", "here"), "me"),
            lambda _peer, message, _moment: self.heard.append(message),
            lambda _peer, why: self.losses.append(why),
            regions=[{"min": [0, 0, 0], "max": [9, 9, 9]}],
            known=known,
            epoch=epoch,
        )
        self.peer.connection_made(self.wire)  # type: ignore[arg-type]

    def hear(self, *messages: dict[str, Any]) -> None:
        for message in messages:
            self.peer.data_received(frame(json.dumps(message).encode()))

    def welcome(self, revision: int = 5, epoch: str = "one") -> None:
        self.peer.data_received(TAKEN)
        self.hear(
            {"type": "welcome", "revision": str(revision), "epoch": epoch, "last_seq": None, "limits": {"inflight": 9}}
        )


def frame(payload: bytes, first: int = 0x81) -> bytes:
    """Return a frame as a server sends it."""
    length = bytes([len(payload)]) if len(payload) < 126 else b"\x7e" + len(payload).to_bytes(2, "big")
    return bytes([first]) + length + payload


def edits(after: int, revision: int, *revisions: int) -> dict[str, Any]:
    some = [{"revision": str(each), "strokes": []} for each in revisions]
    return {"type": "edits", "after": str(after), "revision": str(revision), "edits": some, "stale": []}


def test_it_introduces_itself_when_it_is_taken():
    ear = Ear(known=7, epoch="one")
    assert ear.wire.written.startswith(b"GET /v1/worlds/w/stream HTTP/1.1\r\nHost: here\r\n")
    before = len(ear.wire.written)
    ear.peer.data_received(TAKEN[:30])
    assert len(ear.wire.written) == before
    ear.peer.data_received(TAKEN[30:])
    hello = json.loads(ear.wire.written[before:].partition(b"\0\0\0\0")[2])
    assert (hello["type"], hello["client"], hello["resume"], hello["epoch"]) == ("hello", "me", "7", "one")


@pytest.mark.parametrize("size", [1, 2, 3, 1000])
def test_frames_may_be_cut_anywhere(size: int):
    ear = Ear()
    ear.welcome()
    long = {**edits(5, 8, 6, 8), "padding": "x" * 300}
    told = b"".join(frame(json.dumps(each).encode()) for each in (long, {"type": "progress", "revision": "9"}))
    for start in range(0, len(told), size):
        ear.peer.data_received(told[start : start + size])
    assert [each["type"] for each in ear.heard] == ["welcome", "edits", "progress"]
    assert ear.heard[1]["revisions"] == (6, 8)
    assert ear.peer.known == 9
    assert not ear.losses


def test_a_ping_is_answered():
    ear = Ear()
    ear.welcome()
    ear.peer.data_received(frame(b"here?", 0x89))
    assert ear.wire.written.endswith(b"\x8a\x85\0\0\0\0here?")


@pytest.mark.parametrize(
    ("message", "kind"),
    [
        (edits(4, 8, 6), DISORDERED),
        (edits(6, 8, 7), DISORDERED),
        (edits(5, 4), DISORDERED),
        (edits(5, 8, 7, 6), DISORDERED),
        (edits(5, 8, 6, 6), DISORDERED),
        (edits(5, 8, 5), DISORDERED),
        (edits(5, 8, 9), DISORDERED),
        ({"type": "progress", "revision": "4"}, DISORDERED),
        ({"type": "stale", "revision": "4"}, DISORDERED),
        ({"type": "resync", "revision": "4"}, DISORDERED),
        ({"type": "progress"}, MALFORMED),
        ({"type": "ack", "seq": 1}, MALFORMED),
        ({"type": "nack", "seq": 1, "problem": {}}, MALFORMED),
        ({"revision": "6"}, MALFORMED),
    ],
)
def test_what_does_not_lead_on_ends_it(message: dict[str, Any], kind: str):
    ear = Ear()
    ear.welcome(5)
    ear.hear(message)
    assert [loss.kind for loss in ear.losses] == [kind]
    assert ear.losses[0].is_final
    assert ear.wire.is_aborted
    ear.hear(edits(5, 8, 6))
    assert len(ear.heard) == 1, "it hears nothing more"


def test_another_world_ends_it():
    ear = Ear(known=3, epoch="one")
    ear.welcome(9, "two")
    assert [loss.kind for loss in ear.losses] == [DISORDERED]


def test_who_comes_back_goes_on_from_what_it_knows():
    ear = Ear(known=3, epoch="one")
    ear.welcome(9)
    assert ear.peer.known == 3
    ear.hear(edits(3, 9, 4))
    assert (ear.peer.known, ear.losses) == (9, [])


@pytest.mark.parametrize(
    ("content", "loss", "is_final"),
    [
        (b"HTTP/1.1 503 Service Unavailable\r\n\r\n", (REFUSED, "HTTP/1.1 503 Service Unavailable", 503), False),
        (b"HTTP/1.1 401 Unauthorized\r\n\r\n", (REFUSED, "HTTP/1.1 401 Unauthorized", 401), True),
        (TAKEN + frame((1001).to_bytes(2, "big") + b"away", 0x88), (ENDED, "1001 away", 1001), False),
        (TAKEN + frame((4404).to_bytes(2, "big"), 0x88), (ENDED, "4404", 4404), True),
        (TAKEN + b"\x81\x7f" + (1 << 40).to_bytes(8, "big"), (MALFORMED, f"a frame of {1 << 40} bytes", 0), True),
        (TAKEN + frame(b"", 0x82), (MALFORMED, "a frame that begins with 0x82", 0), True),
        (b"x" * 70_000, (MALFORMED, "70000 bytes without the end of a head", 0), True),
    ],
)
def test_how_it_ends(content: bytes, loss: tuple[str, str, int], is_final: bool):
    ear = Ear()
    ear.peer.data_received(content)
    assert ear.losses == [Loss(*loss)]
    assert ear.losses[0].is_final is is_final


def test_a_lost_connection_is_told_once_and_a_closed_one_never():
    ear = Ear()
    ear.peer.connection_lost(OSError("reset"))
    ear.peer.connection_lost(None)
    assert [loss.detail for loss in ear.losses] == ["closed reset"]
    ear = Ear()
    ear.peer.close()
    ear.peer.connection_lost(None)
    assert (ear.losses, ear.wire.is_aborted) == ([], True)
