"""Recipes that clients post, asked of the real server over a socket: harmless ones, and bombs."""

import json
import socket
import time
from pathlib import Path

import httpx2
import pytest

from chunkserver.grid import ChunkKey
from chunkserver.pipeline import ChunkRequest, build_chunk
from chunkserver.recipe import BUILTINS, WorldRecipe, canonical
from chunkserver.server.recipes import BODY_BYTES_MAX
from chunkserver.wire import Encoding
from tests.serving import until

TREE = {"op": "max", "a": {"op": "y"}, "b": {"op": "subtract", "a": 8, "b": {"op": "sphere", "radius": 20}}}
PIECE = b"[" * 1024
SECONDS_MAX = 1.0
"""From a bomb's last byte to its refusal. Measured: 25 ms at most; a machine that runs other tests too is slower."""
BYTES_MORE_MAX = 10 << 20

BOMBS = {
    "a million nodes": (b'{"op":"add","a":1,"b":' * 10**6 + b"1" + b"}" * 10**6, 413),
    "as many nodes as a body holds": (b"[" + b"{}," * 21_000 + b"1]", 422),
    "a depth of 100,000": (b"[" * 10**5 + b"]" * 10**5, 413),
    "as deep as a body can be": (b"[" * (BODY_BYTES_MAX // 2) + b"]" * (BODY_BYTES_MAX // 2), 422),
    "a depth that never ends": (b'{"a":' * 13_000, 422),
    "octaves": (b'{"op":"fbm2","frequency":0.01,"octaves":1000000000}', 422),
    "NaN": (b'{"op":"sphere","radius":NaN}', 422),
    "infinity": (b"-Infinity", 422),
    "beyond float64": (b'{"op":"sphere","radius":1e400}', 422),
    "beyond the world": (b'{"op":"sphere","radius":1e300}', 422),
    "an integer of 60,000 digits": (b"9" * 60_000, 422),
    "an integer of 4,000 digits": (b"9" * 4_000, 422),
    "a name of 60,000 characters": (b'"' + b"a" * 60_000 + b'"', 422),
    "thousands of unknown fields": (b'{"op":"x",' + b",".join(b'"k%d":1' % n for n in range(5000)) + b"}", 422),
    "half a surrogate": (b'"\\ud800"', 422),
}


@pytest.fixture(scope="module")
def client(server):
    with httpx2.Client(base_url=server.url) as client:
        yield client


def resident_bytes(server, field):
    status = Path(f"/proc/{server.child.pid}/status").read_text()
    (line,) = (line for line in status.splitlines() if line.startswith(f"{field}:"))
    return int(line.split()[1]) << 10


def connected(server):
    host, port = server.url.removeprefix("http://").split(":")
    return socket.create_connection((host, int(port)), timeout=10)


def opened(server, header):
    """A connection on which a POST has begun, with `header` to tell how long it is."""
    connection = connected(server)
    head = f"POST /v1/recipes HTTP/1.1\r\nHost: x\r\nContent-Type: application/json\r\n{header}\r\n\r\n"
    connection.sendall(head.encode())
    return connection


def read_answer(connection):
    """The status and the problem that the server answers with, and whether it ends the connection."""
    with connection.makefile("rb") as stream:
        status = int(stream.readline().split()[1])
        headers = dict(line.decode().lower().strip().split(": ", 1) for line in iter(stream.readline, b"\r\n"))
        answer = json.loads(stream.read(int(headers["content-length"])))
    return status, answer, headers.get("connection") == "close"


def test_a_posted_recipe_is_a_world(client):
    posted = client.post("/v1/recipes", json=TREE)
    assert posted.status_code == 201
    digest, source = posted.json()["digest"], canonical(TREE)
    assert posted.headers["location"] == f"/v1/recipes/{digest}"
    assert (
        client.get(posted.headers["location"]).json() == posted.json() == client.post("/v1/recipes", json=TREE).json()
    )
    descriptor = client.get(f"/v1/seeds/42?recipe={digest}").json()
    url = descriptor["urls"]["chunk_immutable"].format(lod=0, x=0, y=-1, z=0, extension=".glb")
    expected = build_chunk(ChunkRequest(WorldRecipe(42, source), ChunkKey(0, 0, -1, 0), encoding=Encoding("glb")))
    assert client.get(url).content == expected.body
    assert expected.content == "surface"


def test_the_digest_of_a_built_in_is_another_name_of_it(client):
    chunk = "/v1/seeds/42/chunks/0/0/0/0.glb?recipe={}"
    for row in client.get("/v1/recipes").json()["recipes"]:
        by_name, by_digest = (client.get(chunk.format(row[name])) for name in ("name", "digest"))
        assert by_name.headers["etag"] == by_digest.headers["etag"]
        assert by_name.content == by_digest.content
    assert by_name.status_code == 200
    assert len(client.get("/v1/recipes").json()["recipes"]) == len(BUILTINS)


def test_head_has_the_headers_of_get_and_no_body(client):
    digest = client.post("/v1/recipes", json=TREE).json()["digest"]
    for url in ("/v1/recipes", "/v1/recipes/terrain", f"/v1/recipes/{digest}", "/v1/recipes/nonsense"):
        got, head = (ask(url, headers={"X-Request-Id": "mine"}) for ask in (client.get, client.head))
        for answer in (got, head):
            del answer.headers["date"]
            answer.headers.pop("x-request-id", None)  # what is answered out of memory has none
        assert (head.status_code, head.content, head.headers) == (got.status_code, b"", got.headers), url


def test_the_methods_of_the_list(client):
    answer = client.delete("/v1/recipes")
    assert answer.status_code == 405
    assert set(answer.headers["allow"].split(", ")) == {"GET", "HEAD", "POST"}


@pytest.mark.parametrize(("body", "status"), BOMBS.values(), ids=BOMBS)
def test_a_bomb_is_refused_at_once(server, client, body, status):
    client.post("/v1/recipes", json=TREE)
    before = resident_bytes(server, "VmHWM")
    with opened(server, f"Content-Length: {len(body)}") as connection:
        if status == 422:
            connection.sendall(body)
        started = time.perf_counter()
        answered, problem, ends = read_answer(connection)
        assert time.perf_counter() - started < SECONDS_MAX
    assert (answered, problem["status"], ends) == (status, status, status == 413)
    assert problem["detail"]
    assert resident_bytes(server, "VmHWM") - before < BYTES_MORE_MAX
    assert client.get("/livez").status_code == 200


def test_a_gigabyte_that_is_announced_is_refused_before_it_comes(server):
    with opened(server, "Content-Length: 1000000000") as connection:
        assert read_answer(connection)[0::2] == (413, True)


def test_a_body_without_an_end_is_refused_at_the_limit(server):
    before = resident_bytes(server, "VmHWM")
    with opened(server, "Transfer-Encoding: chunked") as connection:
        for _ in range(BODY_BYTES_MAX // len(PIECE)):
            connection.sendall(b"%x\r\n%s\r\n" % (len(PIECE), PIECE))
        connection.settimeout(0.1)
        with pytest.raises(TimeoutError):
            connection.recv(1)  # up to the limit it may still be a recipe
        connection.settimeout(10)
        connection.sendall(b"1\r\n[\r\n")
        assert read_answer(connection)[0::2] == (413, True)
    assert resident_bytes(server, "VmHWM") - before < BYTES_MORE_MAX


@pytest.mark.parametrize("length", [BODY_BYTES_MAX + 1, 10**6, 10**7])
def test_a_client_that_sends_all_of_a_large_body_reads_why(client, length):
    answer = client.post("/v1/recipes", content=b"1" * length, headers={"Content-Type": "application/json"})
    assert (answer.status_code, answer.json()["bytes_max"]) == (413, BODY_BYTES_MAX)


def test_a_client_that_leaves_in_the_middle_is_no_news(server, client):
    for _ in range(3):
        with opened(server, "Content-Length: 100") as connection:
            connection.sendall(b"[1")
    until(lambda: client.get("/livez").status_code == 200, SECONDS_MAX)  # what it did to the log, the fixture looks at


def test_not_json(client):
    answer = client.post("/v1/recipes", content=b"op=y", headers={"Content-Type": "application/x-www-form-urlencoded"})
    assert (answer.status_code, answer.json()["type"]) == (415, "urn:chunkserver:problem:not-json")
