"""Whatever comes over a stream of edits: the right close code, and nobody else is the worse for it."""

import json
import socket
import struct
import threading
import time
from collections.abc import Iterator
from contextlib import suppress
from itertools import chain, count, pairwise
from typing import Any

import httpx2
import hypothesis.strategies as st
import pytest
from hypothesis import HealthCheck, given, settings

from tests.contract.stream_model import MALFORMED, REFUSALS, Model
from tests.fault.sockets import sockets_of
from tests.frames import BINARY, CLOSE, CONT, FIN, PING, PONG, TEXT, Frame, Raw, code_of
from tests.scale import TORTURE
from tests.serving import Server, serving, until
from tests.streams import SECONDS_MAX, Peer, ball

EXAMPLES = 20_000 if TORTURE else 600
FRAMES_MAX = 8
PAUSE_SECONDS = 0.0005
"""Between two pieces of what is sent: the server may have read the first by then."""
FLOOD_FRAMES = 1 << 22
"""To parse them takes the server half a minute."""
ACK_SECONDS_MAX = 3.0
LEFT_SECONDS_MAX = 12.0
"""Until the server has let go of everybody."""
WORLD = {"id": "w", "seed": "7", "recipe": "terrain", "chunk_cells": 16, "lods": 3}
NAMES = (f"fuzz-{number}" for number in count())
PROBE = b"is anybody there"
RESET = struct.pack("ii", 1, 0)
"""SO_LINGER: a close is a reset."""

# Messages, as JSON

bytes_few = st.binary(max_size=40)
places = st.lists(st.integers(-100, 100), min_size=3, max_size=3)
regions = st.builds(
    lambda low, size, more: {"min": low, "max": [a + b for a, b in zip(low, size, strict=True)], **more},
    places,
    st.lists(st.integers(0, 50), min_size=3, max_size=3),
    st.sampled_from([{}, {"lod": 0}, {"lod": 20}]),
)
strokes = st.lists(
    st.one_of(
        st.builds(ball, st.integers(-9, 9), op=st.sampled_from(["carve", "fill", "add", "nothing"])),
        st.sampled_from([ball(radius=-1.0), ball(radius=1e999), ball(center="\ud800"), None, {}, [[]], "\udfff"]),
    ),
    max_size=3,
)
seqs = st.one_of(st.integers(0, 9), st.sampled_from([-1, 2**53 - 1, 2**53, 1.0, None, True]))
revisions = st.sampled_from([None, "0", "7", "007", "-1", str(2**63 - 1), str(2**63), "9" * 5000, 7])
names = st.sampled_from(["a", "b", "a b", "", "x" * 128, "x" * 129, "\ud800", None, 7])
messages = st.one_of(
    st.builds(lambda seq, strokes: {"type": "edit", "seq": seq, "strokes": strokes}, st.integers(0, 99), strokes),
    st.builds(lambda seq, strokes: {"type": "edit", "seq": seq, "strokes": strokes}, seqs, strokes),
    st.builds(
        lambda kind, some: {"type": kind, "regions": some},
        st.sampled_from(["subscribe", "unsubscribe"]),
        st.lists(regions, max_size=3),
    ),
    st.builds(
        lambda client, epoch, resume, some: {
            "type": "hello",
            "client": client,
            "epoch": epoch,
            "resume": resume,
            "regions": some,
        },
        names,
        names,
        revisions,
        st.lists(regions, max_size=2),
    ),
    st.builds(
        lambda number: {
            "type": "subscribe",
            "regions": [{"min": [at, 0, 0], "max": [at, 0, 0]} for at in range(number)],
        },
        st.integers(60, 66),
    ),
)
odd_values = st.recursive(
    st.one_of(st.none(), st.booleans(), st.integers(), st.floats(), st.text(max_size=8)),
    lambda inner: st.one_of(
        st.lists(inner, max_size=3), st.dictionaries(st.sampled_from(["type", "seq", "min", "op"]), inner, max_size=3)
    ),
    max_leaves=6,
)


@st.composite
def mutated(draw) -> bytes:
    """A message some of whose bytes, or of whose members, are others."""
    message = draw(messages)
    if draw(st.booleans()):
        message[draw(st.sampled_from(sorted(message)))] = draw(odd_values)
    if draw(st.booleans()):
        message.pop(draw(st.sampled_from(sorted(message))))
    text = bytearray(json.dumps(message).encode())
    for _ in range(draw(st.integers(0, 2))):
        at = draw(st.integers(0, len(text) - 1))
        text[at : at + draw(st.integers(0, 2))] = draw(st.binary(max_size=2))
    return bytes(text)


NESTED = b'{"type":"edit","seq":%d,"strokes":%b1%b}'
nested = st.builds(
    lambda seq, depth: NESTED % (seq, b"[" * depth, b"]" * depth),
    st.integers(0, 9),
    st.sampled_from([1, 9, 30_000]),
)
texts = st.one_of(
    messages.map(lambda message: json.dumps(message).encode()),
    mutated(),
    nested,
    st.sampled_from([b"", b"{}", b"[]", b"NaN", b"\xef\xbb\xbf{}", b"\xff", b'{"type":"\xed\xa0\x80"}', b"\xe2\x82"]),
    st.sampled_from([65_535, 65_536, 65_537, 70_000]).map(b'{"type":"subscribe","regions":[]}'.ljust),
)
DELTA = {"op": "delta", "min": [0, 0, 0], "size": [2, 1, 1]}


def bulk(seq: int, length: int, encoding: str, values: bytes) -> bytes:
    """Return a binary frame, whose length may be wrong, and its text not UTF-8."""
    text = json.dumps({"type": "edit", "seq": seq, "strokes": [DELTA]}).encode(encoding)
    return struct.pack("<I", len(text) + length) + text + bytes(-len(text) % 4) + values


bulks = st.builds(
    bulk,
    st.integers(0, 99),
    st.sampled_from([0, 0, 0, 1, -1, 1 << 30]),
    st.sampled_from(["utf-8", "utf-8", "utf-16-le", "utf-32-le"]),
    st.sampled_from([bytes(8), bytes(8), bytes(7), bytes(12), b""]),
)

# Frames


@st.composite
def in_pieces(draw, first: int, payload: bytes) -> list[Frame]:
    """The frames of a message, with control frames between them."""
    cuts = draw(st.lists(st.integers(0, len(payload)), max_size=4).map(sorted))
    if draw(st.integers(0, 19)) == 0:
        cuts = sorted(cuts + [0] * draw(st.integers(58, 66)))
    parts = [payload[a:b] for a, b in pairwise([0, *cuts, len(payload)])]
    frames = []
    for number, part in enumerate(parts):
        last = FIN if number == len(parts) - 1 else 0
        frames.append(Frame((CONT if number else first) | last, part))
        if not last and draw(st.integers(0, 3)) == 0:
            frames.append(Frame(FIN | draw(st.sampled_from([PING, PONG])), draw(bytes_few)))
    return frames


def frames_of(firsts: list[int], payloads: st.SearchStrategy[bytes], **more: st.SearchStrategy) -> st.SearchStrategy:
    """Frames that begin with one of some bytes. more: other members of a frame."""
    return st.fixed_dictionaries({"first": st.sampled_from(firsts), "payload": payloads, **more}).map(
        lambda members: Frame(**members)
    )


odd_frames = st.one_of(
    frames_of(list(range(256)), bytes_few),
    frames_of([FIN | TEXT, FIN | PING], bytes_few, masked=st.just(False)),
    frames_of([FIN | TEXT, FIN | PING], bytes_few, size=st.sampled_from([3, 9])),
    frames_of([FIN | PING, FIN | CLOSE], st.sampled_from([bytes(125), bytes(126), bytes(999)])),
    frames_of(
        [FIN | TEXT, FIN | BINARY, TEXT, FIN | PING],
        bytes_few,
        claimed=st.sampled_from([41, 126, 65_536, 65_537, 1 << 31, (1 << 63) - 1, (1 << 64) - 1]),
    ),
)
closes = st.one_of(
    st.builds(
        lambda code, reason: Frame(FIN | CLOSE, struct.pack(">H", code) + reason),
        st.one_of(st.sampled_from([0, 999, 1000, 1001, 1004, 1005, 1006, 1015, 2999, 3000, 4999, 5000]), st.just(1000)),
        st.sampled_from([b"", b"bye", b"\xff", b"x" * 123]),
    ),
    st.sampled_from([Frame(FIN | CLOSE), Frame(FIN | CLOSE, b"\x03")]),
)
some_frames = st.one_of(
    texts.flatmap(lambda text: in_pieces(TEXT, text)),
    bulks.flatmap(lambda whole: in_pieces(BINARY, whole)),
    st.binary(max_size=200).flatmap(lambda whole: in_pieces(BINARY, whole)),
    texts.map(lambda text: [Frame(FIN | TEXT, text)]),
    st.builds(lambda payload: [Frame(FIN | PING, payload)], bytes_few),
    odd_frames.map(lambda frame: [frame]),
    closes.map(lambda frame: [frame]),
)
conversations: st.SearchStrategy[list[Frame]] = st.lists(some_frames, min_size=1, max_size=FRAMES_MAX).map(
    lambda found: list(chain.from_iterable(found))
)


@pytest.fixture(scope="module")
def running(tmp_path_factory) -> Iterator[Server]:
    folder = tmp_path_factory.mktemp("fuzz")
    with serving(folder / "log", "--workers", "1", "--data", str(folder / "data")) as server:
        assert httpx2.post(f"{server.url}/v1/worlds", json=WORLD, timeout=SECONDS_MAX).status_code == 201
        yield server


KINDS = ("ack", "nack", "edits", "progress", "stale", "resync")


class Witness:
    """Somebody who edits beside them."""

    def __init__(self, url: str) -> None:
        self._peer, self._seqs = Peer(url, next(NAMES)), count()
        self._known = int(self._peer.welcome["revision"])

    def looks(self) -> None:
        """Edit, and find every edit of the others between the one before and this one."""
        seq = next(self._seqs)
        self._peer.send("edit", seq=seq, strokes=[ball(8.0 * (seq % 4))])
        while (message := self._peer.receive(*KINDS))["type"] not in ("ack", "nack"):
            assert message["type"] in ("edits", "progress"), message
            assert message["type"] == "progress" or int(message["after"]) == self._known
            self._known = int(message["revision"])
        assert (message["type"], message["seq"], message["duplicate"]) == ("ack", seq, False), message

    def leaves(self) -> None:
        """End the connection, which was the same all the time."""
        self._peer.__exit__()


def streams(server: Server) -> int:
    """Return how many connections there are, as the metrics have it."""
    lines = httpx2.get(f"{server.url}/metrics").text.splitlines()
    return next(int(float(line.split()[1])) for line in lines if line.startswith("chunkserver_streams "))


def welcomed(url: str) -> Raw:
    """Return a connection that is welcome."""
    raw = Raw(url)
    hello: dict[str, Any] = {"type": "hello", "client": next(NAMES), "epoch": None, "resume": None, "regions": []}
    raw.send(Frame(FIN | TEXT, json.dumps(hello).encode()))
    assert json.loads(raw.receive()[1])["type"] == "welcome"
    return raw


def send(raw: Raw, frames: list[Frame], cuts: list[float]) -> None:
    """Send frames in one piece, or in some, whose ends are no frames' ends; until the server takes no more."""
    sent = b"".join(frame.encoded() for frame in frames)
    places = sorted(int(cut * len(sent)) for cut in cuts)
    with suppress(ConnectionError):
        for start, end in pairwise([0, *places, len(sent)]):
            raw.socket.sendall(sent[start:end])
            if end < len(sent):
                time.sleep(PAUSE_SECONDS)


def outcome(raw: Raw, model: Model) -> tuple[int | None, list[bytes], set[int]]:
    """Return the code with which the server ends a connection, 0 without one, None if it does not;
    what it has answered to pings; and which edits."""
    pongs: list[bytes] = []
    seqs: set[int] = set()
    if model.is_cut:
        with suppress(OSError):
            raw.socket.shutdown(socket.SHUT_WR)
    elif not model.is_ended:
        with suppress(ConnectionError):
            raw.send(Frame(FIN | PING, PROBE))
    while True:
        if pongs[-1:] == [PROBE] and model.seqs <= seqs:
            return None, pongs[:-1], seqs
        try:
            opcode, payload = raw.receive()
        except EOFError:
            return 0, pongs, seqs
        if opcode == CLOSE:
            return code_of(payload), pongs, seqs
        if opcode == PONG:
            pongs.append(payload)
        elif (message := json.loads(payload))["type"] in ("ack", "nack"):
            seqs.add(message["seq"])


def check(raw: Raw, frames: list[Frame], cuts: list[float], *, welcome: bool) -> None:
    """Send frames and see what comes of it."""
    model = Model(welcome=welcome)
    sent = []
    for frame in frames:
        if not model.is_cut:  # else what comes behind it would be its own
            model.take(frame)
            sent.append(frame)
    send(raw, sent, cuts)
    code, pongs, seqs = outcome(raw, model)
    if code is None:
        assert not model.is_ended, f"it goes on, where {model.codes} is right"
        assert pongs == model.pongs
        assert seqs == model.seqs
        raw.send(Frame(FIN | CLOSE, struct.pack(">H", 1000)))
        code = raw.code()
        assert code == (1000 if not model.is_amid else 1002)
    else:
        assert code in model.codes, f"it ends with {code}, where {model.codes} is right"
        assert pongs == model.pongs[: len(pongs)]
    says_more = model.is_cut or any(frame.first & 0x0F == CLOSE for frame in sent)  # behind its last word
    if code in REFUSALS and not says_more:
        assert raw.ends(), "it ends with a reset, which may take the close frame away"


def test_however_deep_a_message_is_nested_it_is_answered(running):
    """There is a depth from which on it cannot be read."""
    answers = set()
    for depth in (100, *range(700, 1000, 10)):
        with welcomed(f"{running.url}/v1/worlds/w") as raw:
            raw.send(Frame(FIN | TEXT, NESTED % (1, b"[" * depth, b"]" * depth)))
            opcode, payload = raw.receive()
            while opcode == TEXT and json.loads(payload)["type"] == "progress":
                opcode, payload = raw.receive()
            answers.add(json.loads(payload)["type"] if opcode == TEXT else code_of(payload))
    assert answers == {"nack", MALFORMED}


def test_frames_before_the_answer_to_the_upgrade_have_to_wait(running):
    for number in range(20):
        world = {**WORLD, "id": f"new-{number}"}  # it takes a moment to be opened
        assert httpx2.post(f"{running.url}/v1/worlds", json=world, timeout=SECONDS_MAX).status_code == 201
        with Raw(f"{running.url}/v1/worlds/new-{number}", answered=False) as raw:
            time.sleep(PAUSE_SECONDS)
            raw.send(Frame(FIN | TEXT, b"{}", masked=False))
            assert raw.socket.recv(4096).startswith(b"HTTP/1.1 101")


def pour(raw: Raw, flood: bytes) -> None:
    """Send as much as the server takes."""
    with suppress(OSError):
        raw.socket.sendall(flood)


@pytest.mark.parametrize("before", [b"", b"{}"], ids=["while it is open", "when it is closed"])
def test_many_small_frames_of_one_peer_leave_time_for_others(running, before):
    url = f"{running.url}/v1/worlds/w"
    flood = Frame(FIN | (TEXT if before else PONG), before).encoded() + Frame(FIN | PONG).encoded() * FLOOD_FRAMES
    witness = Witness(url)
    with welcomed(url) as raw, suppress(OSError):
        sending = threading.Thread(target=pour, args=(raw, flood))
        sending.start()
        for _ in range(5):
            begun = time.perf_counter()
            witness.looks()
            assert time.perf_counter() - begun < ACK_SECONDS_MAX
        raw.socket.shutdown(socket.SHUT_RDWR)
        sending.join(SECONDS_MAX)
    witness.leaves()


def test_who_says_whatever_and_leaves_is_forgotten(running):
    url = f"{running.url}/v1/worlds/w"
    witness, sockets = Witness(url), sockets_of(running)
    numbers = count()

    @settings(max_examples=EXAMPLES // 3, derandomize=not TORTURE, suppress_health_check=list(HealthCheck))
    @given(conversations, st.lists(st.floats(0, 1), max_size=3), st.sampled_from(["closes", "resets", "stays"]))
    def run(frames: list[Frame], cuts: list[float], how: str) -> None:
        with welcomed(url) as raw, suppress(ConnectionError):
            send(raw, frames, cuts)
            if how == "stays":
                raw.ends()
            elif how == "resets":
                raw.socket.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, RESET)
        if next(numbers) % 10 == 0:
            witness.looks()  # a peer that reads nothing for 10 s is gone

    run()
    witness.looks()
    until(lambda: streams(running) == 1, LEFT_SECONDS_MAX, "the witness alone is left")
    witness.leaves()
    until(lambda: sockets_of(running) <= sockets, LEFT_SECONDS_MAX, "no socket is left")


def test_whatever_comes_has_the_right_code_and_harms_nobody(running):
    url = f"{running.url}/v1/worlds/w"
    witness, sockets = Witness(url), sockets_of(running)
    numbers = count()

    @settings(max_examples=EXAMPLES, derandomize=not TORTURE, suppress_health_check=list(HealthCheck))
    @given(conversations, st.lists(st.floats(0, 1), max_size=3), st.booleans())
    def run(frames: list[Frame], cuts: list[float], welcome: bool) -> None:
        with welcomed(url) if welcome else Raw(url) as raw:
            check(raw, frames, cuts, welcome=welcome)
        if next(numbers) % 10 == 0:
            witness.looks()

    run()
    witness.looks()
    until(lambda: streams(running) == 1, LEFT_SECONDS_MAX, "the witness alone is left")
    witness.leaves()
    until(lambda: streams(running) == 0, LEFT_SECONDS_MAX, "no stream is left")
    until(lambda: sockets_of(running) <= sockets, LEFT_SECONDS_MAX, "no socket is left")
