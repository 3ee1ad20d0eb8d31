import asyncio
import itertools
from typing import Any, cast

import pytest

from chunkserver.errors import Overloaded
from chunkserver.pipeline import Chunk, generator
from chunkserver.recipe import WorldRecipe, builtin
from chunkserver.server import Settings
from chunkserver.server.cache import ENTRY_BYTES as ENTRY_BYTES_OF_CHUNK
from chunkserver.server.front import Front
from chunkserver.world import World
from tests.unit.server.stub import StubPool, app_of

SEED, WORLD = "/v1/seeds/42/chunks/0/0", "/v1/worlds/w/chunks/0/0"
NATIVE, GLB = "application/vnd.chunkserver.mesh", "model/gltf-binary"
POSTED = '{"op":"x"}'
TOKEN = generator(WorldRecipe(42, builtin("terrain")))
PATHS = [
    *(f"{place}/{y}/0{tail}" for place in (SEED, WORLD) for y in (0, 1) for tail in ("", ".mesh", ".glb")),
    *(f"{SEED}/0/{last}" for last in ("-0", "00", "+0", " 0", "0.obj", "0.GLB", "\u0661", "\xff", "\0", "0/", "")),
    *("/v1/seeds/042/chunks/0/0/0/0", "/v1/seeds/42/chunks/21/0/0/0", "/v1/worlds/v/chunks/0/0/0/0"),
    *("/v1/seeds/42", "/v1/worlds/w", "/livez", "/", "/nowhere"),
]
QUERIES = [
    *("", "profile=f32", "profile=std", "frame=chunk", "frame=world", "seam=none", "mesher=marching-cubes"),
    *("coarser=0", "coarser=1", "coarser=0&coarser=0", "profile=f32&frame=chunk", "profile=f32&seam=none"),
    *("recipe=terrain", "recipe=hills", "recipe=nonsense", "recipe=%74errain", "recipe=" + "0" * 32, "recipe=terrain&"),
    *("recipe=terrain&recipe=hills", f"g={TOKEN}", "g=0123", "g=", "nonsense=1", "%ff=1", "&", "=", "seam=none;g=1"),
    *("revision=0", "revision=1", "min_revision=0", "epoch=abc", f"g={TOKEN}&epoch=abc&revision=0", "seam=n%6fne"),
]
ACCEPTS = [[], ["*/*"], [GLB], [f"{NATIVE};q=0.1, {GLB}"], [NATIVE, f"{GLB};q=0.5"], [""]]
CODINGS = [[], ["gzip"], ["zstd, gzip;q=0.5"], ["br"], ["*"], ["identity;q=0"]]
ORIGINS = [[], ["https://game.example"]]
CONDITIONS = [[], ["*"], [" * "], ["TAG"], ["W/TAG"], ['"x", W/TAG'], ['"x"', "TAG"], ['"x"'], [""], ['"x, *"']]
CONDITIONS += [["\xff"], ["TAG, TAG"]]


def world_w(seed=42, epoch="abc", revision=0):
    recipe = WorldRecipe(seed, builtin("terrain"))
    return World(
        id="w", recipe=recipe, recipe_name="terrain", generator=generator(recipe), epoch=epoch, revision=revision
    )


class Terrain(StubPool):
    """The chunks at y = 1 are air."""

    async def build(self, request, begun, **rank):
        await super().build(request, begun, **rank)
        return Chunk("air", b"nothing") if request.key.y else Chunk("surface", repr(request).encode())


class Service:
    """An application with the world `w`, and how often a request got behind its front."""

    def __init__(self, pool=None):
        self.app = app_of(Settings(workers=1), pool or Terrain())
        self.shared = self.app.state.service
        self.passed = 0
        self.front = cast("Front", self.app.front)
        self.plain = cast("Any", self.front._app)._app  # within the log of requests, which gives each another id
        self.front._app = self._pass

    async def __aenter__(self):
        self.shared.posted.add(POSTED)
        await self.shared.worlds.create(world_w())
        return self

    async def __aexit__(self, *_):
        await self.shared.worlds.close()

    async def _pass(self, scope, receive, send):
        self.passed += 1
        await self.plain(scope, receive, send)

    async def ask(self, app, method, path, query="", accept=(), condition=(), coding=(), origin=(), receive=None):
        told = []

        async def send(message):
            told.append(message)

        headers = [(b"host", b"x"), *((b"accept", value.encode()) for value in accept)]
        headers += [(b"accept-encoding", value.encode()) for value in coding]
        headers += [(b"origin", value.encode()) for value in origin]
        headers += [(b"if-none-match", value.encode("latin-1")) for value in condition]
        scope = {
            "type": "http",
            "asgi": {"version": "3.0"},
            "http_version": "1.1",
            "scheme": "http",
            "root_path": "",
            "server": ("x", 80),
            "client": ("y", 1),
            "app": self.app,
            "method": method,
            "path": path,
            "raw_path": path.encode(),
            "query_string": query.encode(),
            "headers": headers,
        }
        await app(scope, receive or Requests().receive, send)
        start, *rest = told
        assert {message["type"] for message in rest} == {"http.response.body"}
        return start["status"], list(start["headers"]), b"".join(message["body"] for message in rest)

    async def get(self, path, query="", **headers):
        return await self.ask(self.front, "GET", path, query, **headers)


class Requests:
    """The client's side of a request without a body."""

    def __init__(self):
        self._messages = iter([{"type": "http.request", "body": b"", "more_body": False}])

    async def receive(self):
        return next(self._messages, None) or await asyncio.Future()


def tag_of(answer):
    return dict(answer[1]).get(b"etag", b'"none"').decode()


def in_service(scenario, pool=None):
    async def run():
        async with Service(pool) as service:
            await scenario(service)

    asyncio.run(run())


def test_every_answer_is_the_applications_own(rng):
    async def scenario(service):
        plain_headers = list(itertools.product(("GET", "HEAD"), ACCEPTS, CONDITIONS, CODINGS, ORIGINS))
        requests = [(path, query) for path in PATHS for query in QUERIES]
        known = 0
        for path, query in [requests[number] for number in rng.permutation(len(requests))[:400]]:
            tag = tag_of(await service.ask(service.plain, "GET", path, query))
            for number in rng.integers(len(plain_headers), size=3):
                method, accept, condition, *others = plain_headers[number]
                request = (method, path, query, accept, [value.replace("TAG", tag) for value in condition], *others)
                expected = await service.ask(service.plain, *request)
                passed = service.passed
                assert await service.ask(service.front, *request) == expected, request
                known += service.passed == passed
        assert known > 100
        for method in ("POST", "PUT", "DELETE", "OPTIONS"):
            expected = await service.ask(service.plain, method, PATHS[0])
            assert await service.ask(service.front, method, PATHS[0]) == expected

    in_service(scenario)


@pytest.mark.parametrize("path", PATHS[:12])
def test_what_was_answered_once_does_not_get_behind_the_front(path):
    async def scenario(service):
        first = await service.get(path)
        hits = service.shared.cache.hits
        assert await service.get(path) == first
        assert await service.ask(service.front, "HEAD", path) == first
        assert (service.passed, service.shared.cache.hits) == (1, hits + 2)
        condition = [tag_of(first)]
        for _ in range(2):
            assert (await service.get(path, condition=condition))[0] == 304
        assert service.passed == 1
        assert service.shared.cache.hits == hits + 2

    in_service(scenario)


def test_a_body_that_is_gone_is_built_again_and_a_304_does_not_need_it():
    async def scenario(service):
        path = f"{SEED}/0/0"
        first = await service.get(path)
        await service.get(path, condition=["*"])
        service.shared.cache._drop_oldest()
        assert (await service.get(path, condition=["*"]))[0] == 304
        assert await service.get(path) == first
        assert (service.passed, len(service.shared.pool.built)) == (1, 2)

    in_service(scenario)


def test_a_hit_keeps_its_body_in_the_cache():
    async def scenario(service):
        cache = service.shared.cache
        cache.bytes_max = 4 * (ENTRY_BYTES_OF_CHUNK + 7)
        for y in "1234":
            await service.get(f"{SEED}/{y}/0")
        await service.get(f"{SEED}/1/0")
        await service.get(f"{SEED}/5/0")
        assert len(service.shared.pool.built) == 5
        await service.get(f"{SEED}/1/0")
        assert (service.passed, len(service.shared.pool.built)) == (1, 5)
        await service.get(f"{SEED}/2/0")
        assert len(service.shared.pool.built) == 6

    in_service(scenario)


def test_a_recipe_that_is_forgotten_is_not_answered():
    async def scenario(service):
        digest = WorldRecipe(0, POSTED).digest
        for _ in range(2):
            assert (await service.get(f"{SEED}/0/0", f"recipe={digest}"))[0] == 200
        assert service.passed == 1
        service.shared.posted._sources.clear()
        for condition in ([], ["*"]):
            assert (await service.get(f"{SEED}/0/0", f"recipe={digest}", condition=condition))[0] == 404

    in_service(scenario)


def test_a_world_that_went_on_or_away_is_answered_anew():
    async def scenario(service):
        path, worlds = f"{WORLD}/0/0", service.shared.worlds
        first = await service.get(path)
        assert await service.get(path) == first
        found = worlds._catalogue._worlds
        found["w"] = world_w(revision=7)
        assert dict((await service.get(path))[1])[b"world-revision"] == b"7"
        assert service.passed == 1, "the front makes the new head by itself"
        await worlds.delete("w")
        assert (await service.get(path))[0] == 404
        await worlds.create(world_w(43, epoch="def"))
        assert tag_of(await service.get(path)) != tag_of(first)

    in_service(scenario)


def test_a_chunk_that_is_edited_while_it_is_built_is_answered_as_what_it_is():
    async def scenario(service):
        path, pool = f"{WORLD}/0/0", service.shared.pool
        first = await service.get(path)
        pool.chunk = Chunk("surface", b"later", 3)
        service.shared.cache._kept.clear()
        for _ in range(2):
            later = await service.get(path)
            assert (dict(later[1])[b"chunk-revision"], later[2]) == (b"3", b"later")
            assert tag_of(later) != tag_of(first)
            assert service.shared.cache.find(tag_of(first).strip('"')) is None
        assert (await service.get(path, condition=[tag_of(first)]))[0] == 304

    in_service(scenario, StubPool())


def test_chunks_beside_one_that_was_answered_do_not_get_behind_the_front():
    async def scenario(service):
        for place in ("/v1/seeds/42/chunks", "/v1/worlds/w/chunks"):
            for tail in ("", ".mesh", ".glb"):
                await service.get(f"{place}/0/0/0/0{tail}", accept=[GLB])
                passed = service.passed
                for key in ("0/1/0/0", "0/0/1/0", "3/-7/0/9", f"0/{(1 << 35) - 1}/0/0"):
                    for condition in ([], ["*"], []):
                        path = f"{place}/{key}{tail}"
                        answer = await service.get(path, accept=[GLB], condition=condition)
                        assert service.passed == passed
                        asked = ("GET", path, "", [GLB], condition)
                        assert answer == await service.ask(service.plain, *asked)
                for wrong in ("21/0/0/0", f"0/{1 << 35}/0/0", "0/00/0/0", "0/+1/0/0", "0/0/0", "0/0/0/0/0"):
                    assert (await service.get(f"{place}/{wrong}{tail}", accept=[GLB]))[0] in (404, 422)

    in_service(scenario)


def test_a_full_queue_refuses_what_is_not_at_hand():
    async def scenario(service):
        for y in "01":
            await service.get(f"{SEED}/{y}/0")
        service.shared.pool.full = True
        for _ in range(2):
            answer = await service.get(f"{SEED}/2/0")
            assert (answer[0], dict(answer[1])[b"retry-after"]) == (503, b"1")
            assert b"urn:chunkserver:problem:overloaded" in answer[2]
        assert (await service.get(f"{SEED}/1/0"))[0] == 204
        assert (await service.get(f"{SEED}/3/0", condition=["*"]))[0] == 304
        assert (service.passed, len(service.shared.pool.built), service.shared.answers.refused) == (1, 2, 2)

    in_service(scenario)


def test_what_an_answer_depends_on_is_no_plan_of_another():
    async def scenario(service):
        await service.get(f"{SEED}/0/0")
        different: tuple[dict[str, Any], ...] = (
            {"path": f"{SEED}/1/0", "coding": ["gzip"]},
            {"path": f"{SEED}/1/0", "accept": [GLB]},
            {"path": f"{SEED}/1/0", "query": "profile=f32"},
            {"path": f"{SEED}/1/0.glb"},
            {"path": "/v1/seeds/43/chunks/0/0/1/0"},
        )
        for number, request in enumerate(different, 2):
            await service.get(**request)
            assert service.passed == number

    in_service(scenario)


def test_a_failed_build_is_told_and_not_kept():
    async def scenario(service):
        await service.get(f"{SEED}/0/0")
        service.shared.pool.error = Overloaded("too many", waiting=1)
        expected = await service.ask(service.plain, "GET", f"{SEED}/2/0")
        assert await service.get(f"{SEED}/2/0") == expected
        assert expected[0] == 503
        service.shared.pool.error = None
        assert (await service.get(f"{SEED}/2/0"))[0] == 204
        assert (service.passed, service.shared.answers.refused) == (1, 1)

    in_service(scenario)


class Slow(Terrain):
    """Begins a build, and ends it once it is `released`."""

    def __init__(self):
        super().__init__()
        self.begun, self.released = asyncio.Event(), asyncio.Event()

    async def build(self, request, begun, **rank):
        begun()
        self.begun.set()
        await self.released.wait()
        return await super().build(request, begun, **rank)


def test_what_nobody_read_is_not_the_answer_to_the_next():
    async def scenario(service):
        pool = service.shared.pool
        pool.released.set()
        await service.get(f"{SEED}/0/0")
        pool.released.clear()
        pool.begun.clear()

        async def leave():
            await pool.begun.wait()
            return {"type": "http.disconnect"}

        assert (await service.get(f"{SEED}/2/0", receive=leave))[0] == 499
        pool.released.set()
        while service.shared.cache.entries < 2:
            await asyncio.sleep(0)
        for _ in range(2):
            assert (await service.get(f"{SEED}/2/0"))[0] == 204
        assert (service.passed, len(pool.built)) == (1, 2)

    in_service(scenario, Slow())
