import asyncio
import json
import socket

import pytest
from fastapi.routing import iter_route_contexts

from chunkserver.server import Settings, create_app
from chunkserver.server.access import KEY_NAME, NEEDS, STREAM, Access, Exposed, Row, Table, check_exposure, scope_of
from chunkserver.server.cors import Cors
from chunkserver.server.keys import Keyring, Scope, mint

SECRETS, KEYS = {}, []
for _scope in Scope:
    SECRETS[_scope], _key = mint(f"{_scope}-key", _scope)
    KEYS.append(_key)
CHUNK = "/v1/seeds/1/chunks/0/0/0/0.glb"
IMMUTABLE = b"public, max-age=31536000, immutable"
STREAM_ROW = Row(Scope.EDIT, STREAM, ("/v1/worlds/{world}/stream",))


class App:
    """Answers everything alike, and keeps what it was asked."""

    def __init__(self):
        self.asked = []

    async def __call__(self, asked, _receive, send):
        self.asked.append(asked)
        await send({"type": "http.response.start", "status": 200, "headers": ((b"cache-control", IMMUTABLE),)})
        await send({"type": "http.response.body", "body": b"answer"})


async def never():
    await asyncio.Event().wait()
    return {}


def ask(method, path, *authorization, kind="http", extensions=None, origin=None, **options):
    """Return what the application was asked, and what was sent."""
    app, sent = App(), []
    headers = [(b"host", b"x"), *((b"authorization", value) for value in authorization)]
    headers += [(b"origin", origin)] if origin else []
    asked = {"type": kind, "path": path, "headers": headers, "extensions": extensions or {}}
    if kind == "http":
        asked["method"] = method

    async def send(message):
        sent.append(message)

    access = Access(app, Keyring(KEYS), needs=(*NEEDS, STREAM_ROW), **options)
    asyncio.run(access(asked, never, send))
    return app.asked, sent


def status(method, path, *authorization, **options):
    return ask(method, path, *authorization, **options)[1][0]["status"]


def bearer(scope):
    return b"Bearer " + SECRETS[scope].encode()


def headers_of(sent):
    return dict(sent[0]["headers"])


@pytest.fixture(scope="module")
def routes():
    app = create_app(Settings())
    return {(route.path, method) for route in iter_route_contexts(app.routes) for method in route.methods or {STREAM}}


def test_every_route_has_a_row_that_was_meant_for_it(routes):
    assert len(routes) > 20
    meant = {(path, method) for row in NEEDS for path in row.paths for method in {row.method, "HEAD"}}
    assert routes - meant == set()


def test_every_route_finds_its_row(routes):
    table = Table(NEEDS)
    rows = {(path, row.method): row.scope for row in NEEDS for path in row.paths}
    for path, method in routes:
        wanted = rows[path, "GET" if method == "HEAD" else method]
        assert table.row(method, path).scope == wanted
        assert table.row(method, path.replace("{", "").replace("}", "")).scope == wanted


def test_where_a_key_may_say_more_than_is_needed():
    looks = {(row.method, path) for row in NEEDS if row.looks for path in row.paths}
    assert looks == {("POST", "/v1/worlds/{world}/tickets"), (STREAM, "/v1/worlds/{world}/stream")}
    assert Table(NEEDS).row("POST", "/v1/worlds/tickets/chunks").looks is False


def test_what_only_looks_like_a_resource_needs_admin():
    table = Table(NEEDS)
    others = ("/v1/worlds/", "/v1/worlds\n", "/livez/", "/livezz", "/v1/worlds/a/b", "/v1/worldsx", "", "/favicon.ico")
    for method in ("GET", "HEAD", "POST", "DELETE"):
        assert {table.row(method, path).scope for path in others} == {Scope.ADMIN}, method
    assert table.row("PATCH", "/v1/worlds").scope == table.row(STREAM, "/livez").scope == Scope.ADMIN
    assert table.row("OPTIONS", "/v1/worlds").scope is None


@pytest.mark.parametrize(
    ("method", "path", "needed"),
    [
        ("GET", CHUNK, Scope.READ),
        ("HEAD", CHUNK, Scope.READ),
        ("GET", "/metrics", Scope.READ),
        ("POST", "/v1/worlds/a/chunks", Scope.READ),
        ("POST", "/v1/recipes", Scope.EDIT),
        ("POST", "/v1/worlds", Scope.ADMIN),
        ("DELETE", "/v1/worlds/a", Scope.ADMIN),
        ("PUT", "/v1/worlds/a", Scope.ADMIN),
        ("GET", "/unknown", Scope.ADMIN),
    ],
)
def test_a_key_opens_what_its_scope_covers(method, path, needed):
    assert status(method, path) == 401
    for scope in Scope:
        asked, sent = ask(method, path, bearer(scope))
        if scope.covers(needed):
            assert sent[0]["status"] == 200
            assert asked[0][KEY_NAME] == f"{scope}-key"
        else:
            assert not asked
            assert sent[0]["status"] == 403
            assert json.loads(sent[1]["body"])["scope"] == needed
            assert (
                headers_of(sent)[b"www-authenticate"] == f'Bearer error="insufficient_scope", scope="{needed}"'.encode()
            )


@pytest.mark.parametrize("path", ["/livez", "/readyz"])
def test_what_needs_no_key(path):
    assert status("GET", path) == status("HEAD", path) == status("OPTIONS", "/v1/worlds") == 200
    assert status("POST", path) == 401


@pytest.mark.parametrize(
    ("values", "name"),
    [
        ([], "key-needed"),
        ([b"Basic abc"], "key-needed"),
        ([bearer(Scope.READ)] * 2, "key-needed"),
        ([SECRETS[Scope.READ].encode()], "key-needed"),
        ([b"Bearer "], "unknown-key"),
        ([b"Bearer x"], "unknown-key"),
        ([b"Bearer " + KEYS[0].digest.encode()], "unknown-key"),
        ([b"Bearer \xff"], "unknown-key"),
    ],
)
def test_without_a_key_that_is_known(values, name):
    asked, sent = ask("GET", CHUNK, *values)
    assert not asked
    assert sent[0]["status"] == 401
    assert headers_of(sent)[b"www-authenticate"].startswith(b"Bearer")
    assert headers_of(sent)[b"cache-control"] == b"no-store"
    assert headers_of(sent)[b"content-type"] == b"application/problem+json"
    problem = json.loads(sent[1]["body"])
    assert problem["type"].endswith(f":{name}")
    assert "Bearer x" not in problem["detail"]


@pytest.mark.parametrize("value", [b"bearer ", b"BEARER ", b"Bearer  "])
def test_a_scheme_is_written_in_any_case(value):
    assert status("GET", CHUNK, value + SECRETS[Scope.READ].encode()) == 200


def test_reading_without_a_key_where_that_is_allowed():
    assert status("GET", CHUNK, anonymous=Scope.READ) == 200
    assert status("POST", "/v1/worlds/a/chunks", anonymous=Scope.READ) == 200
    for method, path in (("POST", "/v1/recipes"), ("POST", "/v1/worlds"), ("GET", "/unknown")):
        assert status(method, path, anonymous=Scope.READ) == 401
        assert status(method, path, bearer(Scope.ADMIN), anonymous=Scope.READ) == 200
    assert status("POST", "/v1/worlds/a/chunks", b"Bearer x", anonymous=Scope.READ) == 200  # nobody looks at it


def test_an_answer_that_needed_a_key_is_not_for_others():
    _, sent = ask("GET", CHUNK, bearer(Scope.READ))
    assert headers_of(sent)[b"cache-control"] == b"private, max-age=31536000, immutable"
    assert sent[1]["body"] == b"answer"
    for options in ({"anonymous": Scope.READ}, {"anonymous": Scope.ADMIN}):
        _, sent = ask("GET", CHUNK, bearer(Scope.READ), **options)
        assert headers_of(sent)[b"cache-control"] == IMMUTABLE


def test_a_stream_is_refused_before_it_is_accepted():
    path = "/v1/worlds/a/stream"
    assert ask("", path, kind="websocket") == ([], [{"type": "websocket.close", "code": 1008}])
    for scope in (Scope.READ, Scope.EDIT):
        asked, _ = ask("", path, bearer(scope), kind="websocket")
        assert [scope_of(one) for one in asked] == [scope]
    extensions: dict[str, dict[str, str]] = {"websocket.http.response": {}}
    for values, wanted in (([], 401), ([b"Bearer x"], 401)):
        asked, sent = ask("", path, *values, kind="websocket", extensions=extensions)
        assert not asked
        assert [message["type"] for message in sent] == [
            "websocket.http.response.start",
            "websocket.http.response.body",
        ]
        assert sent[0]["status"] == wanted
    assert ask("", "/v1/other", bearer(Scope.EDIT), kind="websocket")[0] == []


def test_a_page_of_another_site_can_read_why():
    _, sent = ask("GET", CHUNK, origin=b"https://game.example", cors=Cors(["https://game.example"]))
    assert headers_of(sent)[b"access-control-allow-origin"] == b"https://game.example"
    assert b"access-control-allow-origin" not in headers_of(ask("GET", CHUNK, origin=b"https://game.example")[1])


def test_the_lifespan_passes():
    assert len(ask("", "", kind="lifespan")[0]) == 1


def test_the_document_says_what_needs_a_key():
    app = create_app(Settings())
    document = json.loads(json.dumps(app.openapi()))
    Access(App(), Keyring(KEYS), Scope.READ).describe(document)
    paths = document["paths"]
    assert paths["/v1/worlds"]["post"]["security"] == [{"key": ["admin"]}]
    assert {"401", "403"} <= set(paths["/v1/worlds"]["post"]["responses"])
    assert document["components"]["securitySchemes"]["key"] == {"type": "http", "scheme": "bearer"}
    for method in ("get", "head"):
        assert "security" not in paths["/v1/worlds"][method]
        assert "401" not in paths["/v1/worlds"][method]["responses"]


@pytest.mark.parametrize("host", ["127.0.0.1", "127.8.9.10", "localhost", "::1", "::ffff:127.0.0.1"])
def test_hosts_that_only_this_machine_reaches(host):
    check_exposure(host, [], insecure=False)


@pytest.mark.parametrize("host", ["", "0.0.0.0", "::", "192.0.2.1", "::ffff:192.0.2.1", "2001:db8::1"])
def test_hosts_that_others_reach(host):
    with pytest.raises(Exposed, match=r"API keys.*--insecure") as raised:
        check_exposure(host, [], insecure=False)
    assert raised.value.values == {"host": host}
    check_exposure(host, KEYS, insecure=False)
    check_exposure(host, [], insecure=True)


def test_a_name_counts_as_all_that_it_resolves_to(monkeypatch):
    def resolve(name, port):
        addresses = {"near": ["127.0.0.1", "::1"], "both": ["127.0.0.1", "192.0.2.1"], "scoped": ["fe80::1%eth0"]}
        return [(socket.AF_INET, socket.SOCK_STREAM, 6, "", (address, port)) for address in addresses[name]]

    monkeypatch.setattr(socket, "getaddrinfo", resolve)
    check_exposure("near", [], insecure=False)
    for name in ("both", "scoped"):
        with pytest.raises(Exposed, match=name):
            check_exposure(name, [], insecure=False)
