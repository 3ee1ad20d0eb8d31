"""Clients that leave before their answer, over real sockets: what is queued for them alone is freed at once."""

import asyncio
import json
from contextlib import asynccontextmanager

import pytest
import uvicorn

from chunkserver.recipe import WorldRecipe
from chunkserver.server import Settings, create_app, listen
from chunkserver.server.pool import Pool
from tests.fault import stub
from tests.fault.pools import until

FREED_SECONDS_MAX = 0.05


class Client:
    """One connection, which has sent one request."""

    def __init__(self, reader, writer, url):
        self.reader, self.writer = reader, writer
        writer.write(f"GET {url} HTTP/1.1\r\nHost: x\r\nConnection: close\r\n\r\n".encode())

    async def answer(self):
        head, _, body = (await self.reader.read()).partition(b"\r\n\r\n")
        self.writer.close()
        return int(head.split()[1]), body


class Service:
    """The application over one stub worker, which builds when `marker` exists."""

    def __init__(self, marker, port):
        self.marker, self.port = marker, port
        self.pool = Pool(1, command=stub.COMMAND)
        self.app = create_app(Settings(workers=1), self.pool)
        self.cache = self.app.state.service.cache
        source = json.dumps(["wait", str(marker)])
        self.app.state.service.posted.add(source)
        self.recipe = WorldRecipe(0, source).digest

    async def ask(self, x):
        url = f"/v1/seeds/0/chunks/0/{x}/0/0.mesh?recipe={self.recipe}"
        return Client(*await asyncio.open_connection("127.0.0.1", self.port), url)


@asynccontextmanager
async def serving(marker):
    with listen("127.0.0.1", 0) as listening:
        service = Service(marker, listening.getsockname()[1])
        server = uvicorn.Server(uvicorn.Config(service.app, log_config=None, ws="none"))
        connections = server.server_state.connections
        running = asyncio.create_task(server.serve(sockets=[listening]))
        try:
            await until(lambda: service.pool.ready)
            yield service, connections
        finally:
            marker.touch()
            server.should_exit = True
            await running


@pytest.mark.parametrize("how", ["close", "abort"])
def test_queued_work_is_freed_when_the_last_client_leaves(run, tmp_path, how):
    async def scenario():
        async with serving(tmp_path / "marker") as (service, connections):
            first = await service.ask(0)
            await until(lambda: service.cache.misses == 1)
            one, two, other = await service.ask(1), await service.ask(1), await service.ask(2)
            await until(lambda: (service.pool.waiting, service.cache.joined) == (2, 1))
            getattr(one.writer.transport, how)()
            await until(lambda: len(connections) == 3)
            assert service.pool.waiting == 2
            getattr(two.writer.transport, how)()
            await until(lambda: service.pool.waiting == 1, FREED_SECONDS_MAX)
            service.marker.touch()
            for client, x in ((first, 0), (other, 2), (await service.ask(1), 1)):
                assert await client.answer() == (200, stub.answer(x).body)
            assert (service.cache.misses, service.cache.joined) == (4, 1)

    run(scenario())


def test_what_a_worker_has_begun_goes_into_the_cache(run, tmp_path):
    async def scenario():
        async with serving(tmp_path / "marker") as (service, connections):
            gone = await service.ask(0)
            await until(lambda: service.cache.misses == 1)
            gone.writer.transport.abort()
            await until(lambda: not connections)
            service.marker.touch()
            assert await (await service.ask(0)).answer() == (200, stub.answer(0).body)
            assert (service.cache.misses, service.cache.hits + service.cache.joined) == (1, 1)

    run(scenario())
