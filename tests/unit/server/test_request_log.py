import asyncio
import json
import logging
import re
import time
from typing import Any
from urllib.parse import unquote

import pytest
from fastapi import FastAPI, Response
from fastapi.testclient import TestClient

from chunkserver.errors import BadParameter
from chunkserver.server import problems
from chunkserver.server.access import KEY_NAME
from chunkserver.server.chunks import CLIENT_LEFT
from chunkserver.server.log_format import FIELDS, JsonFormat, request_id
from chunkserver.server.problems import INSTANCE_PREFIX
from chunkserver.server.request_counts import RequestCounts
from chunkserver.server.request_log import LINES_AT_ONCE_MAX, LINES_PER_SECOND_MAX, RequestLog

MADE = r"[0-9a-f]{12}-[0-9a-f]+"
OF_REQUESTS = "chunkserver.requests"


@pytest.fixture
def counts():
    return RequestCounts()


@pytest.fixture(autouse=True)
def _all_levels(caplog):
    caplog.set_level(logging.INFO)


def client_of(counts, which="problems"):
    app = FastAPI()
    problems.install(app)

    @app.get("/things/{thing}")
    async def thing(thing: str) -> Response:
        logging.getLogger("inside").info("looking at %s", thing)
        if thing == "wrong":
            raise BadParameter("it is wrong")
        if thing == "broken":
            raise ValueError("a fault of the server")
        return Response(f"id {request_id.get()}", int(thing) if thing.isdecimal() else 200)

    return TestClient(RequestLog(app, counts, which), raise_server_exceptions=False)


def scope_of(name):
    return {"type": "http", "method": "GET", "path": "/", "query_string": b"", "headers": [(b"x-request-id", name)]}


def lines(caplog):
    return [record for record in caplog.records if record.name == OF_REQUESTS]


def test_a_request_is_called_what_its_client_calls_it(counts):
    for name in ("a", "x" * 128, "~!", "1-67891233-abcdef012345678912345678", "QUJD+/=="):
        answer = client_of(counts).get("/things/some", headers={"X-Request-Id": name})
        assert (answer.headers["x-request-id"], answer.text) == (name, f"id {name}")


@pytest.mark.parametrize("name", ["", "x" * 129, "a b", "\xe4", "a\tb", None])
def test_a_request_without_a_sane_name_gets_one(counts, name):
    client = client_of(counts)
    names = [] if name is None else [(b"X-Request-Id", name.encode("latin-1"))]
    found = [client.get("/things/some", headers=names).headers["x-request-id"] for _ in range(20)]
    assert len(set(found)) == 20
    assert all(re.fullmatch(MADE, one) for one in found)
    assert request_id.get() == ""


def test_a_problem_names_its_request(counts):
    client = client_of(counts)
    for path in ("/things/wrong", "/things/broken", "/nothing"):
        answer = client.get(path)
        assert answer.json()["instance"] == INSTANCE_PREFIX + answer.headers["x-request-id"]
    odd = 'a%41"<>\\^`{|}'
    answer = client.get("/things/wrong", headers={"X-Request-Id": odd})
    instance = answer.json()["instance"]
    assert re.fullmatch(r"urn:[A-Za-z0-9._~:/%-]+", instance), "a URI"
    assert unquote(instance.removeprefix(INSTANCE_PREFIX)) == odd


def test_what_is_logged_meanwhile_has_the_id(counts, caplog):
    said = []

    class Lines(logging.Handler):
        def emit(self, record):
            said.append(json.loads(JsonFormat().format(record)))

    logging.getLogger().addHandler(handler := Lines())
    try:
        client_of(counts, "all").get("/things/some", headers={"X-Request-Id": "abc"})
    finally:
        logging.getLogger().removeHandler(handler)
    assert [line.get("request") for line in said if line["logger"] in ("inside", OF_REQUESTS)] == ["abc", "abc"]
    assert caplog.records


def test_a_fault_keeps_its_id_until_the_http_server_has_logged_it(counts):
    async def fail(*_: Any) -> Any:
        raise ValueError("a fault")

    async def served():
        with pytest.raises(ValueError, match="a fault"):
            await RequestLog(fail, counts, "none")(scope_of(b"a"), fail, fail)
        return request_id.get()

    assert asyncio.run(served()) == "a"
    assert counts.answered == {("other", "GET", 500): 1}
    assert counts.in_flight == 0


def test_the_next_request_of_a_connection_starts_without_a_name(counts):
    async def answer(_scope: Any, _receive: Any, send: Any) -> Any:
        await send({"type": "http.response.start", "status": 200, "headers": []})

    async def served():
        async def ignore(_message):
            assert request_id.get() == "a"

        await RequestLog(answer, counts, "none")(scope_of(b"a"), answer, ignore)  # type: ignore[arg-type]
        return request_id.get()

    assert asyncio.run(served()) == ""


def test_head_sends_nothing(counts, caplog):
    async def answer(_scope: Any, _receive: Any, send: Any) -> Any:
        await send({"type": "http.response.start", "status": 404, "headers": []})
        await send({"type": "http.response.body", "body": b"what the HTTP server leaves out"})

    TestClient(RequestLog(answer, counts, "all")).head("/")
    assert getattr(lines(caplog)[0], FIELDS)["bytes"] == 0


def test_counts_have_as_many_keys_as_there_are_routes(counts):
    client = client_of(counts)
    for number in range(5):
        client.get(f"/things/{number}abc")
        client.get(f"/nothing/{number}")
        client.request(f"METHOD{number}", "/things/1")
        client.head("/things/1")
    client.get("/things/broken")
    assert counts.answered == {
        ("/things/{thing}", "GET", 200): 5,
        ("other", "GET", 404): 5,
        ("/things/{thing}", "other", 405): 5,
        ("/things/{thing}", "HEAD", 405): 5,
        ("/things/{thing}", "GET", 500): 1,
    }
    assert {route: sum(found.counts) for route, found in counts.seconds.items()} == {"/things/{thing}": 16, "other": 5}
    assert counts.in_flight == 0


def test_a_line_says_what_was_asked_and_answered(counts, caplog):
    answer = client_of(counts).get("/things/wrong?a=%0Ab&c", headers={"X-Request-Id": "abc"})
    (line,) = lines(caplog)
    assert (line.levelname, line.getMessage()) == ("INFO", "GET /things/wrong?a=%0Ab&c")
    fields = getattr(line, FIELDS)
    assert (fields["status"], fields["bytes"]) == (422, len(answer.content))
    assert 0 < fields["ms"] < 10_000
    assert fields.keys() == {"status", "bytes", "ms"}


def test_a_line_says_whose_key_it_was(counts, caplog):
    async def answer(*asked: Any) -> Any:
        await asked[2]({"type": "http.response.start", "status": 200, "headers": []})

    async def ignore(_message):
        pass

    scope = {**scope_of(b"a"), KEY_NAME: "game"}
    asyncio.run(RequestLog(answer, counts, "all")(scope, answer, ignore))
    assert getattr(lines(caplog)[0], FIELDS)["key"] == "game"


@pytest.mark.parametrize(
    ("which", "told"),
    [("none", []), ("problems", [404, 422, 500, 503]), ("all", [200, 304, 404, 422, 499, 500, 503])],
)
def test_which_requests_are_logged(counts, caplog, which, told):
    client = client_of(counts, which)
    for status in (200, 304, 404, 422, CLIENT_LEFT, 500, 503):
        client.get(f"/things/{status}")
    assert [getattr(line, FIELDS)["status"] for line in lines(caplog)] == told
    assert sum(counts.answered.values()) == 7


@pytest.mark.parametrize(("which", "told"), [("problems", 0), ("all", 1)])
def test_to_be_asked_and_not_ready_is_no_failure(counts, caplog, which, told):
    client_of(counts, which).get("/readyz")
    assert len(lines(caplog)) == told
    assert counts.answered == {("other", "GET", 404): 1}


@pytest.fixture
def clock(monkeypatch):
    """The seconds that the allowances see; the test moves them."""
    now = [1000.0]
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    return now


def test_nobody_fills_the_disk_with_failures(counts, caplog, clock):
    status = 0

    async def refuse(*asked: Any) -> Any:
        await asked[2]({"type": "http.response.start", "status": status, "headers": []})

    async def ignore(_message):
        pass

    log = RequestLog(refuse, counts, "problems")

    def ask(answer, times):
        nonlocal status
        status = answer
        caplog.clear()
        for _ in range(times):
            asyncio.run(log(scope_of(b"a"), refuse, ignore))
        return len(lines(caplog))

    assert ask(422, LINES_AT_ONCE_MAX + 50) == LINES_AT_ONCE_MAX
    assert ask(503, 20) == 20, "what is our fault is told all the same"
    assert counts.unlogged == getattr(lines(caplog)[0], FIELDS)["left_out"] == 50
    clock[0] += 2
    assert ask(422, 50) == 2 * LINES_PER_SECOND_MAX
    assert "left_out" not in getattr(lines(caplog)[0], FIELDS)
    clock[0] += 1
    assert ask(422, 1) == 1
    assert getattr(lines(caplog)[0], FIELDS)["left_out"] == 30
    clock[0] += 1e6
    assert ask(422, LINES_AT_ONCE_MAX + 1) == LINES_AT_ONCE_MAX
    assert counts.unlogged == 81
