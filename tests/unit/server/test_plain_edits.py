"""Plain posts of edits are answered as the framework answers them: a field that is there twice sends a post to it."""

import json
from collections import Counter

import pytest

from chunkserver.server import edits, plain_edits
from tests.unit.server.stub import StubPool, client_of

URL = "/v1/worlds/w/edits"
JSON = {"Content-Type": "application/json"}
TWICE = [("X-Twice", "1"), ("X-Twice", "2")]
CARVE = {"op": "carve", "shape": "sphere", "center": [0.5, -3.0, 0.0], "radius": 2.0}
GOOD = json.dumps({"strokes": [CARVE]}).encode()
BAD = json.dumps({"strokes": [{**CARVE, "radius": -1}]}).encode()


@pytest.fixture(scope="module")
def client():
    with client_of(StubPool()) as client:
        world = {"id": "w", "seed": "7", "recipe": "plane", "lods": 3, "chunk_cells": 16}
        assert client.post("/v1/worlds", json=world).status_code == 201
        yield client


@pytest.fixture
def handed_on(monkeypatch):
    """What the framework was asked."""
    asked = []
    plain = plain_edits._plain

    def noted(scope):
        found = plain(scope)
        if found is None and scope["type"] == "http":
            asked.append(scope["path"])
        return found

    monkeypatch.setattr(plain_edits, "_plain", noted)
    return asked


def both(client, handed_on, body=GOOD, headers=JSON, url=URL):
    """Post the same plainly and to the framework; return both answers."""
    answers = []
    for more in ([], TWICE):
        before = len(handed_on)
        answers.append(client.post(url, content=body, headers=[*dict(headers).items(), *more]))
        assert len(handed_on) - before == bool(more)
    return answers


@pytest.mark.parametrize(
    ("body", "headers", "url", "status"),
    [
        (GOOD, JSON, URL, 200),
        (GOOD, {"Content-Type": "application/json; charset=utf-8", "Origin": "https://example.org"}, URL, 200),
        (BAD, JSON, URL, 422),
        (b"{", JSON, URL, 422),
        (b'{"strokes": [], "more": 1}', JSON, URL, 422),
        (b"", JSON, URL, 422),
        (GOOD, {"Content-Type": "text/plain"}, URL, 415),
        (b" " * (edits.BODY_BYTES_MAX + 1), JSON, URL, 413),
        (GOOD, JSON, "/v1/worlds/nowhere/edits", 404),
    ],
)
def test_the_answer_is_the_same(client, handed_on, body, headers, url, status):
    plain, framework = both(client, handed_on, body, headers, url)
    assert plain.status_code == framework.status_code == status
    assert plain.headers.keys() == framework.headers.keys()
    own = {"x-request-id", "content-length"}
    assert {**plain.headers, **dict.fromkeys(own)} == {**framework.headers, **dict.fromkeys(own)}
    ours, theirs = plain.json(), framework.json()
    for answer in (ours, theirs):
        answer.pop("instance", None)
        answer.pop("revision", None)
    assert ours == theirs


def test_a_key_is_the_same_in_both(client, handed_on):
    plain, framework = both(client, handed_on, headers={**JSON, "Idempotency-Key": "!one~"})
    assert (plain.headers["content-type"], edits.Written(**plain.json()).duplicate) == ("application/json", False)
    assert framework.json() == {**plain.json(), "duplicate": True}
    plain, framework = both(
        client, handed_on, body=GOOD.replace(b"2.0", b"3.0"), headers={"Idempotency-Key": "!one~", **JSON}
    )
    assert plain.status_code == framework.status_code == 422


@pytest.mark.parametrize(
    ("method", "url", "headers"),
    [
        ("POST", f"{URL}?x=1", {}),
        ("POST", f"{URL}/", {}),
        ("POST", "/v1/worlds/W/edits", {}),
        ("POST", f"/v1/worlds/{'w' * 65}/edits", {}),
        ("POST", "/v1/worlds/w%0A/edits", {}),
        ("POST", URL, {"Idempotency-Key": ""}),
        ("POST", URL, {"Idempotency-Key": "a b"}),
        ("POST", URL, {"Idempotency-Key": b"\xe9"}),
        ("POST", URL, {"Idempotency-Key": "k" * 129}),
        ("GET", URL, {}),
        ("PUT", URL, {}),
        ("OPTIONS", URL, {}),
    ],
)
def test_what_is_not_plain_is_for_the_framework(client, handed_on, method, url, headers):
    answer = client.request(method, url, content=GOOD, headers={**JSON, **headers})
    assert len(handed_on) == 1
    assert answer.status_code in ({200} if method == "GET" else {404, 405, 422})


def test_it_is_counted_under_its_route(client, handed_on):
    before = Counter(client.app.state.service.requests.answered)
    both(client, handed_on)
    both(client, handed_on, body=BAD)
    counted = Counter(client.app.state.service.requests.answered) - before
    assert counted == {(edits.EDITS, "POST", 200): 2, (edits.EDITS, "POST", 422): 2}


def test_a_fault_is_answered_and_told_as_any_other(client, handed_on, monkeypatch):
    async def fails(*_):
        raise ZeroDivisionError

    monkeypatch.setattr(client.app.state.service.worlds.edits, "take", fails)
    plain, framework = both(client, handed_on)
    assert plain.status_code == framework.status_code == 500
    assert plain.json() | {"instance": ""} == framework.json() | {"instance": ""}
