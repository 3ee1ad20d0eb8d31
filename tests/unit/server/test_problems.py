import json

import pytest
from fastapi import FastAPI
from fastapi.testclient import TestClient
from starlette.exceptions import HTTPException

from chunkserver import errors
from chunkserver.server.pool import BuildFault
from chunkserver.server.problems import (
    MEDIA_TYPE,
    PROBLEMS,
    VALUE_CHARS_MAX,
    VALUES_MAX,
    BodyTooLarge,
    BodyTooSlow,
    HeadTooLarge,
    HeadTooSlow,
    KeyNeeded,
    MalformedHttp,
    NotJson,
    OldEpoch,
    OldGenerator,
    OtherGenerator,
    Problem,
    ScopeNeeded,
    TooManyConnections,
    UnknownKey,
    UnknownRecipe,
    UnknownRevision,
    UnknownWorld,
    UrlTooLong,
    WorldExists,
    install,
)

ERRORS = [kind for kind in vars(errors).values() if isinstance(kind, type) and issubclass(kind, errors.ChunkError)]
OF_HTTP = (
    *(OldGenerator, OldEpoch, OtherGenerator, UnknownRecipe, UnknownRevision, UnknownWorld, WorldExists),
    *(BodyTooSlow, BodyTooLarge, NotJson, MalformedHttp, HeadTooSlow, HeadTooLarge, UrlTooLong, TooManyConnections),
    *(KeyNeeded, UnknownKey, ScopeNeeded),
)
SECRET = "the path of a file"


def answer_to(error):
    app = FastAPI()
    install(app)

    @app.get("/")
    async def fail() -> None:
        raise error

    return TestClient(app, raise_server_exceptions=False).get("/")


@pytest.mark.parametrize("kind", [*ERRORS, *OF_HTTP])
def test_every_error_of_ours_is_a_problem_with_its_values(kind):
    answer = answer_to(kind("what was wrong", lod=99))
    row = next(PROBLEMS[parent] for parent in kind.__mro__ if parent in PROBLEMS)
    assert answer.status_code == row.status
    assert answer.headers["content-type"] == MEDIA_TYPE
    assert answer.headers["cache-control"] == "no-store"
    assert answer.headers.get("retry-after") == (str(row.retry_after) if row.status == 503 else None)
    body = answer.json()
    assert (body.pop("type"), body.pop("title"), body.pop("status")) == (row.type, row.title, row.status)
    assert body == (
        {"detail": "the cause is in the server's log"} if row.status == 500 else {"detail": "what was wrong", "lod": 99}
    )


@pytest.mark.parametrize(
    ("kind", "status"),
    [
        (errors.BadKey, 422),
        (errors.BadRecipe, 422),
        (errors.BadParameter, 422),
        (errors.BadRequest, 400),
        (errors.WireError, 500),
        (errors.ChunkError, 500),
        (errors.WorkerLost, 503),
        (errors.Overloaded, 503),
        (errors.DeadlinePassed, 503),
        (errors.Unavailable, 503),
        (OldGenerator, 410),
        (OldEpoch, 410),
        (OtherGenerator, 409),
        (WorldExists, 409),
        (errors.StoreError, 500),
        (errors.StoreFull, 507),
        (UnknownWorld, 404),
        (UnknownRevision, 404),
        (UnknownRecipe, 404),
        (BodyTooSlow, 408),
        (BodyTooLarge, 413),
        (NotJson, 415),
    ],
)
def test_statuses(kind, status):
    assert answer_to(kind("x")).status_code == status


def test_a_problem_type_has_one_row_of_values():
    rows: dict[str, Problem] = {}
    for row in PROBLEMS.values():
        assert rows.setdefault(row.type, row) == row


@pytest.mark.parametrize("error", [ValueError(SECRET), errors.WireError(SECRET, path=SECRET)])
def test_a_failure_of_the_server_says_nothing_and_is_logged_with_its_cause(error, caplog):
    error.__cause__ = KeyError("the cause")
    answer = answer_to(error)
    assert answer.status_code == 500
    assert answer.json()["type"] == "urn:chunkserver:problem:internal"
    assert SECRET not in answer.text
    if isinstance(error, errors.ChunkError):  # uvicorn logs the others: tests/contract/test_http_stop.py
        assert SECRET in caplog.text
        assert "the cause" in caplog.text


def test_a_fault_that_the_log_has_already_is_not_logged_again(caplog):
    answer = answer_to(BuildFault(SECRET))
    assert (answer.status_code, answer.json()["type"]) == (500, "urn:chunkserver:problem:internal")
    assert SECRET not in answer.text + caplog.text


def test_what_the_framework_raises_keeps_its_status_and_headers():
    answer = answer_to(HTTPException(418, "short and stout", {"X-Pot": "tea"}))
    assert answer.status_code == 418
    assert answer.headers["x-pot"] == "tea"
    assert answer.headers["content-type"] == MEDIA_TYPE
    assert answer.json()["type"] == "about:blank"


def test_values_are_bounded_and_exact():
    values = {f"v{number}": number for number in range(2 * VALUES_MAX)}
    body = answer_to(errors.BadParameter("x", **values)).json()
    assert len(body) == 4 + VALUES_MAX
    odd = {"a": "x" * 5000, "b": 2**53, "c": -(2**53) + 1, "d": float("nan"), "e": [1], "f": None, "g": True, "h": 0.5}
    body = answer_to(errors.BadParameter("x" * 5000, **odd, **{"k" * 5000: 1})).json()
    assert body["a"] == "x" * VALUE_CHARS_MAX
    assert (body["b"], body["c"], body["d"], body["e"]) == (str(2**53), -(2**53) + 1, "nan", "[1]")
    assert (body["f"], body["g"], body["h"]) == (None, True, 0.5)
    assert len(json.dumps(body)) < 3000


@pytest.mark.parametrize("kind", [BodyTooLarge, BodyTooSlow])
def test_a_body_that_is_not_read_to_its_end_ends_the_connection(kind):
    assert answer_to(kind("x")).headers["connection"] == "close"


def test_a_405_names_the_methods_of_every_route_of_its_path():
    app = FastAPI()
    install(app)
    for method in ("GET", "POST"):
        app.add_api_route("/{some}/path", lambda some: some, methods=[method])
    app.add_api_route("/other/{path}", lambda path: path, methods=["DELETE"])
    answer = TestClient(app).put("/a/path")
    assert (answer.status_code, answer.headers["allow"]) == (405, "GET, POST")


def test_a_value_never_hides_a_standard_member():
    body = answer_to(errors.BadParameter("wrong", status=7, type="x", title="x")).json()
    assert (body["status"], body["detail"]) == (422, "wrong")
