"""The stream of edits, asked of the real server over real WebSockets."""

import json
import re
import struct
import threading
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import suppress
from itertools import count

import httpx2
import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus

from chunkserver.server.keys import mint
from chunkserver.stream.limits import FRAME_BYTES_MAX
from tests.frames import CLOSE, CONT, FIN, PING, PONG, TEXT, Frame, Raw
from tests.serving import Server, serving, until
from tests.streams import SECONDS_MAX, Peer, ball

WORLD = {"id": "w", "seed": "7", "recipe": "terrain", "chunk_cells": 16, "lods": 3}
NAMES = (f"peer-{number}" for number in count())


@pytest.fixture(scope="module")
def running(tmp_path_factory) -> Iterator[Server]:
    folder = tmp_path_factory.mktemp("stream")
    with serving(folder / "log", "--workers", "1", "--data", str(folder / "data")) as server:
        yield server


@pytest.fixture
def world(running) -> Iterator[str]:
    """The URL of a new world."""
    with httpx2.Client(base_url=running.url, timeout=SECONDS_MAX) as http:
        assert http.post("/v1/worlds", json=WORLD).status_code == 201
        yield f"{running.url}/v1/worlds/w"
        http.delete("/v1/worlds/w")


def closed_with(peer: Peer) -> int:
    """Return the code with which the server closes a connection."""
    try:
        while True:
            peer.socket.recv(timeout=SECONDS_MAX)
    except ConnectionClosed as found:
        return found.rcvd.code if found.rcvd is not None else 0


def refused(url: str, **more) -> httpx2.Response:
    """Return the answer to a WebSocket that is refused."""
    with pytest.raises(InvalidStatus) as found:
        Peer(url, **more)
    response = found.value.response
    assert response.headers["content-type"] == "application/problem+json"
    return httpx2.Response(response.status_code, content=bytes(response.body or b""))


def test_an_edit_is_acknowledged_and_told_to_the_others(world):
    with Peer(world, "alice") as alice, Peer(world, "bob") as bob:
        assert alice.welcome["revision"] == "0"
        ack = alice.edit(5, ball(), ball(3.0))
        assert (ack["type"], ack["seq"], ack["revision"], ack["duplicate"]) == ("ack", 5, "1", False)
        told = bob.receive("edits")
        assert (told["after"], told["revision"]) == ("0", "1")
        assert [len(edit["strokes"]) for edit in told["edits"]] == [2]
        assert told["stale"] == ack["stale"] != []
        assert alice.receive("progress")["revision"] == "1"
    log = httpx2.get(f"{world}/edits").json()["edits"]
    assert [edit["strokes"] for edit in log] == [told["edits"][0]["strokes"]]


def test_edits_over_http_are_told_too(world):
    with Peer(world, "listener") as peer:
        answer = httpx2.post(f"{world}/edits", json={"strokes": [ball()]}, timeout=SECONDS_MAX).json()
        told = peer.receive("edits")
        assert (told["revision"], told["stale"]) == (answer["revision"], answer["stale"])


def test_a_client_resumes_and_its_edits_are_written_once(world):
    with Peer(world, "alice") as alice:
        alice.edit(1, ball())
        epoch = alice.welcome["epoch"]
    with Peer(world, "bob") as bob:
        bob.edit(1, ball(9.0))
    with Peer(world, "alice", epoch=epoch, resume="1") as alice:
        assert (alice.welcome["revision"], alice.welcome["last_seq"]) == ("2", 1)
        assert [edit["revision"] for edit in alice.receive("edits")["edits"]] == ["2"]
        again = alice.edit(1, ball())
        assert (again["revision"], again["duplicate"]) == ("1", True)
        assert alice.edit(2, ball(op="fill"))["revision"] == "3"
    with Peer(world, "alice", epoch="another", resume="1") as alice:
        assert (alice.welcome["epoch"], alice.receive("edits", "progress")["type"]) == (epoch, "progress"), (
            "it starts over"
        )


def test_refused_edits_say_why_and_write_nothing(world):
    with Peer(world, next(NAMES)) as peer:
        nack = peer.edit(1, ball(radius=-1.0))
        assert (nack["type"], nack["seq"]) == ("nack", 1)
        assert nack["problem"]["status"] == 422
        assert "radius" in nack["problem"]["detail"]
        assert peer.edit(2, ball())["revision"] == "1"


def test_binary_edits(world):
    values = struct.pack("<8i", *range(8))
    stroke = {"op": "delta", "min": [0, 0, 0], "size": [2, 2, 2]}
    text = json.dumps({"type": "edit", "seq": 1, "strokes": [stroke]}).encode()
    text += b" " * (-len(text) % 4)
    with Peer(world, next(NAMES)) as peer:
        peer.socket.send(struct.pack("<I", len(text)) + text + values)
        assert peer.receive("ack", "nack")["type"] == "ack"
    (edit,) = httpx2.get(f"{world}/edits").json()["edits"]
    assert edit["strokes"][0]["size"] == [2, 2, 2]


@pytest.mark.parametrize(
    ("sent", "code"),
    [
        ("no JSON", 4400),
        ("[]", 4400),
        ('{"type":"who"}', 4400),
        ('{"type":"edit","seq":-1,"strokes":[]}', 4400),
        ('{"type":"hello","client":"x","epoch":null,"resume":null,"regions":[]}', 4412),
        (b"\x01\x02", 4400),
        ("x" * 65537, 1009),
        (b"\xff" * 65537, 1009),
    ],
)
def test_what_is_no_message_ends_the_connection_alone(world, sent, code):
    with Peer(world, "other") as other, Peer(world, "bad") as peer:
        peer.socket.send(sent)
        assert closed_with(peer) == code
        assert other.edit(1, ball())["type"] == "ack"


def test_a_message_before_hello_is_out_of_order(world):
    with Peer(world, None) as peer:
        peer.send("edit", seq=1, strokes=[ball()])
        assert closed_with(peer) == 4412


def test_who_says_nothing_is_let_go(world):
    with Peer(world, None) as peer:
        begun = time.monotonic()
        assert closed_with(peer) == 4408
        assert time.monotonic() - begun > 4.0


def test_the_newer_connection_of_a_client_replaces_the_older(world):
    with Peer(world, "twice") as first, Peer(world, "twice") as second:
        assert closed_with(first) == 4409
        assert second.edit(1, ball())["type"] == "ack"


def test_a_world_that_is_deleted_ends_its_streams(world):
    with Peer(world, next(NAMES)) as peer:
        httpx2.delete(world)
        assert closed_with(peer) == 4404


def test_what_cannot_be_opened(world):
    assert refused(world + "x").json()["type"].endswith("unknown-world")
    assert refused(world, subprotocols=None).json()["offered"] == "none"
    assert refused(world, subprotocols=["chunkserver.v2"]).status_code == 422
    assert httpx2.get(f"{world}/stream").status_code == 404


def test_compression_is_not_offered(world):
    with Peer(world, next(NAMES), compression="deflate") as peer:
        assert peer.socket.protocol.extensions == []


MANY = 1 << 28
"""Bytes: more than fits into the buffers of two sockets and what the server lets wait."""
MORE, LAST = CONT, FIN | CONT


@pytest.mark.parametrize(
    ("frames", "code"),
    [
        ([(0x81, b"\xff\xfe")], 1007),
        ([(TEXT, b"{"), *[(MORE, b"")] * 80], 1009),
        ([(LAST, b"no beginning")], 1002),
        ([(0x83, b"no such opcode")], 1002),
        ([(0xC1, b"a reserved bit")], 1002),
        ([(TEXT, b"a"), (TEXT, b"b")], 1002),
        ([(0x09, b"a ping in pieces")], 1002),
        ([(0x88, b"\x00")], 1002),
    ],
)
def test_frames_that_are_none_end_the_connection_alone(world, frames, code):
    with Raw(world) as raw:
        raw.send(*(Frame(*frame) for frame in frames))
        assert raw.code() == code
    with Peer(world, next(NAMES)) as peer:
        assert peer.edit(1, ball())["type"] == "ack"


def closed(server: Server) -> Counter[int]:
    """Return how many connections have ended, by code, as the metrics have it."""
    text = httpx2.get(f"{server.url}/metrics").text
    found = re.findall(r'^chunkserver_streams_closed_total{code="(\d+)"} (\S+)', text, re.MULTILINE)
    return Counter({int(code): int(float(count)) for code, count in found})


@pytest.mark.parametrize(
    ("frames", "code"),
    [
        ([Frame(FIN | CLOSE, struct.pack(">H", 4999))], 1000),
        ([], 1006),
        ([Frame(FIN | TEXT, b"{}", masked=False)], 1002),
        ([Frame(FIN | TEXT, b"\xff")], 1007),
        ([Frame(FIN | TEXT, claimed=1 << 20)], 1009),
        ([Frame(FIN | TEXT, b"{}")], 4400),
    ],
)
def test_connections_are_counted_by_how_they_ended(running, world, frames, code):
    before = closed(running)
    with Raw(world) as raw:
        raw.send(*frames)
        raw.ends()
    until(lambda: closed(running) - before == {code: 1}, SECONDS_MAX, f"one more with {code}")


def test_a_frame_without_a_mask_ends_the_connection(world):
    with Raw(world) as raw:
        raw.send(Frame(FIN | TEXT, b"{}", masked=False))
        assert raw.code() == 1002


def test_a_message_may_come_in_pieces_with_pings_between(world):
    hello = json.dumps({"type": "hello", "client": "p", "epoch": None, "resume": None, "regions": []}).encode()
    with Raw(world) as raw:
        raw.send(Frame(TEXT, hello[:30]), Frame(FIN | PING, b"are you there"), Frame(LAST, hello[30:]))
        assert raw.receive() == (PONG, b"are you there")
        assert json.loads(raw.receive()[1])["type"] == "welcome"


def test_a_ping_in_the_middle_of_the_longest_message_is_not_counted(world):
    hello = json.dumps({"type": "hello", "client": "p", "regions": []}).encode().ljust(FRAME_BYTES_MAX)
    with Raw(world) as raw:
        raw.send(Frame(TEXT, hello), Frame(FIN | PING, bytes(125)), Frame(LAST))
        assert raw.receive() == (PONG, bytes(125))
        assert json.loads(raw.receive()[1])["type"] == "welcome"


def test_pings_of_a_peer_that_does_not_read_do_not_fill_the_server(world):
    pings = Frame(FIN | PING, bytes(125)).encoded() * 500
    sent = 0
    with Raw(world) as raw, suppress(OSError):
        while sent < MANY:
            sent += raw.socket.send(pings)
    assert sent < MANY


def test_a_stop_ends_streams(tmp_path):
    ended: list[int] = []
    with serving(tmp_path / "log", "--workers", "1") as server:
        httpx2.post(f"{server.url}/v1/worlds", json=WORLD, timeout=SECONDS_MAX)
        peer = Peer(f"{server.url}/v1/worlds/w")
        waiting = threading.Thread(target=lambda: ended.append(closed_with(peer)))
        waiting.start()
    waiting.join(SECONDS_MAX)
    assert ended[0] in (1001, 1012)


# Who may do what


@pytest.fixture(scope="module")
def keys():
    return {scope: mint(scope, scope) for scope in ("read", "edit", "admin")}


@pytest.fixture(scope="module")
def keyed(tmp_path_factory, keys) -> Iterator[Server]:
    options = ("--api-keys", " ".join(str(key) for _, key in keys.values()))
    folder = tmp_path_factory.mktemp("keyed")
    extra = ("--anonymous-read", "--cors-origins", "https://friend.example")
    with serving(folder / "log", "--workers", "1", *options, *extra) as server:
        answer = httpx2.post(
            f"{server.url}/v1/worlds", json=WORLD, headers=bearer(keys["admin"][0]), timeout=SECONDS_MAX
        )
        assert answer.status_code == 201
        yield server


def bearer(key: str) -> dict[str, str]:
    return {"Authorization": f"Bearer {key}"}


def test_to_edit_needs_the_scope(keyed, keys):
    url = f"{keyed.url}/v1/worlds/w"
    for given, status in ((None, 403), ("read", 403), ("edit", None), ("admin", None)):
        headers = bearer(keys[given][0]) if given else {}
        with Peer(url, next(NAMES), headers=headers) as peer:
            answer = peer.edit(1, ball())
            assert answer.get("problem", {}).get("status") == status
    assert refused(url, headers=bearer("chunkserver_wrong")).status_code == 401


def test_a_ticket_is_good_once_and_for_its_world_alone(keyed, keys):
    url = f"{keyed.url}/v1/worlds/w"
    headers = bearer(keys["edit"][0])
    anonymous = httpx2.post(f"{url}/tickets").json()["ticket"]
    with Peer(url, next(NAMES), query=f"?ticket={anonymous}") as peer:
        assert peer.edit(1, ball())["type"] == "nack"
    ticket = httpx2.post(f"{url}/tickets", headers=headers).json()
    assert ticket["seconds"] == 30
    assert refused(url + "x", query=f"?ticket={ticket['ticket']}").status_code == 401
    assert refused(url, query=f"?ticket={ticket['ticket']}").status_code == 401, "it was used, though for another world"
    ticket = httpx2.post(f"{url}/tickets", headers=headers).json()
    with Peer(url, next(NAMES), query=f"?ticket={ticket['ticket']}") as peer:
        assert peer.edit(1, ball())["type"] == "ack"
    assert refused(url, query=f"?ticket={ticket['ticket']}").status_code == 401


def test_pages_of_other_sites(keyed, keys, world):
    url, headers = f"{keyed.url}/v1/worlds/w", bearer(keys["edit"][0])
    host = httpx2.URL(url).netloc.decode()
    for origin in ("https://friend.example", f"http://{host}"):
        with Peer(url, next(NAMES), headers={**headers, "Origin": origin}) as peer:
            assert peer.edit(1, ball())["type"] == "ack"
    assert refused(url, headers={**headers, "Origin": "https://else.example"}).json()["type"].endswith("origin-refused")
    with Peer(world, next(NAMES), headers={"Origin": "https://else.example"}) as peer:
        assert peer.edit(1, ball())["problem"]["status"] == 403, "pages of any site may read, and no more"
        assert peer.welcome["type"] == "welcome"
