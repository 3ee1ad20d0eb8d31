import asyncio
import itertools
import tracemalloc
from functools import partial
from typing import Any, cast

import pytest
from fastapi import Response

from chunkserver.catalogue import World
from chunkserver.pipeline import Chunk, generator
from chunkserver.recipe import WorldRecipe, builtin
from chunkserver.server import Settings, create_app
from chunkserver.server.cache import ChunkCache
from chunkserver.server.front import ENTRY_BYTES, KEY_BYTES_MAX, Answers
from tests.unit.server.stub import StubPool

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
CONDITIONS = [[], ["*"], [" * "], ["TAG"], ["W/TAG"], ['"x", W/TAG'], ['"x"', "TAG"], ['"x"'], [""], ['"x, *"']]
CONDITIONS += [["\xff"], ["TAG, TAG"]]


def world_w(seed=42, epoch="abc", revision=0):
    recipe = WorldRecipe(seed, builtin("terrain"))
    return World(
        id="w", recipe=recipe, recipe_name="terrain", generator=generator(recipe), epoch=epoch, revision=revision
    )


class Terrain(StubPool):
    """The chunks at y = 1 are air."""

    async def build(self, request, begun):
        await super().build(request, begun)
        return Chunk("air", b"nothing") if request.key.y else Chunk("surface", repr(request).encode())


class Service:
    """An application with the world `w`, and how often a request got behind its front."""

    def __init__(self):
        self.app = create_app(Settings(workers=1), Terrain())
        self.shared = self.app.state.service
        self.passed = 0
        self.front = cast("Any", self.app.middleware_stack)
        self.plain = self.front._app
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

    async def ask(self, app, method, path, query="", accept=(), condition=()):
        told = []

        async def send(message):
            told.append(message)

        headers = [(b"host", b"x"), *((b"accept", value.encode()) for value in accept)]
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
        await app(scope, Requests().receive, send)
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


def in_service(scenario):
    async def run():
        async with Service() as service:
            await scenario(service)

    asyncio.run(run())


def test_every_answer_is_the_applications_own(rng):
    async def scenario(service):
        plain_headers = list(itertools.product(("GET", "HEAD"), ACCEPTS, CONDITIONS))
        requests = [(path, query) for path in PATHS for query in QUERIES]
        known = 0
        for path, query in [requests[number] for number in rng.permutation(len(requests))[:400]]:
            tag = tag_of(await service.ask(service.plain, "GET", path, query))
            for number in rng.integers(len(plain_headers), size=3):
                method, accept, condition = plain_headers[number]
                asked = (method, path, query, accept, [value.replace("TAG", tag) for value in condition])
                expected = await service.ask(service.plain, *asked)
                passed = service.passed
                assert await service.ask(service.front, *asked) == expected, asked
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
        assert service.passed == 2
        assert service.shared.cache.hits == hits + 2

    in_service(scenario)


def test_a_body_that_is_gone_is_built_again_and_a_304_does_not_need_it():
    async def scenario(service):
        path = f"{SEED}/0/0"
        first = await service.get(path)
        await service.get(path, condition=["*"])
        service.shared.cache._kept.clear()
        assert (await service.get(path, condition=["*"]))[0] == 304
        assert await service.get(path) == first
        assert (service.passed, len(service.shared.pool.built)) == (3, 2)

    in_service(scenario)


def test_a_hit_keeps_its_body_in_the_cache():
    async def scenario(service):
        cache = service.shared.cache
        for y in "0123":
            await service.get(f"{SEED}/{y}/0")
        oldest = next(iter(cache._kept))
        await service.get(f"{SEED}/0/0")
        assert service.passed == 4
        assert oldest == next(reversed(cache._kept))

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
        assert service.passed == 2
        await worlds.delete("w")
        assert (await service.get(path))[0] == 404
        await worlds.create(world_w(43, epoch="def"))
        assert tag_of(await service.get(path)) != tag_of(first)

    in_service(scenario)


def scope_of(path, query=b"", headers=()):
    return {"path": path, "query_string": query, "headers": headers}


def test_entries_weigh_no_more_than_they_are_charged():
    count = 500
    answers = Answers(ChunkCache(0), bytes_max=count * (ENTRY_BYTES + 300))
    heads = [("ETag", '"' + "0" * 32 + '"'), ("Vary", "Accept, Accept-Encoding"), ("Chunk-Revision", str(1 << 62))]
    heads += [("World-Revision", str(1 << 62)), ("Cache-Control", "public, max-age=31536000, immutable")]
    heads += [("Chunk-Content", "surface")]
    tracemalloc.start()
    before, _ = tracemalloc.get_traced_memory()
    for number in range(3 * count):
        scope = scope_of(f"/v1/worlds/{'w' * 64}/chunks/0/{number}/0/0", f"g={number:0100}".encode())
        for status in (200, 304):
            response = Response(b"x", status, dict(heads), GLB)
            answers.keep(scope, f"{number:032x}", response, partial(bool, f"{number:0100}"))
    after, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert 0.25 * answers.bytes < after - before < answers.bytes <= answers.bytes_max
    assert len(answers._kept) > count // 2


def test_what_is_not_kept():
    answers = Answers(ChunkCache(0))
    answers.keep(scope_of("/a" * KEY_BYTES_MAX), "0", Response(), lambda: True)
    answers.keep(scope_of("/a", headers=[(b"accept", b"a" * KEY_BYTES_MAX)]), "0", Response(), lambda: True)
    answers.keep(scope_of("/a"), "0", Response(status_code=503), lambda: True)
    answers.keep(scope_of("/a"), "0", Response(), lambda: False)
    assert not answers.bytes
    answers.keep(scope_of("/a"), "0", Response(), lambda: True)
    assert answers.bytes
