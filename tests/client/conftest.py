"""One real server for all tests of clients, and each test once for either client."""

import asyncio
import inspect
from collections.abc import Callable, Iterator
from typing import Any, Final

import pytest

from chunkserver_client import AsyncClient, Client
from tests.serving import Server, serving

KINDS: Final[dict[str, type[Client] | type[AsyncClient]]] = {"blocking": Client, "async": AsyncClient}


class Asker:
    """Either client, with methods that block: `asker.chunk(...)`, `list(asker.chunks(...))`."""

    def __init__(self, kind: str, url: str, **options: Any) -> None:
        self._runner = asyncio.Runner()
        self.client = KINDS[kind](url, **options)

    def __getattr__(self, name: str) -> Any:
        return lambda *given, **options: self._settled(getattr(self.client, name)(*given, **options))

    def close(self) -> None:
        """Close the client, and its event loop."""
        self._settled(self.client.close())
        self._runner.close()

    def _settled(self, value: Any) -> Any:
        if inspect.iscoroutine(value):
            return self._runner.run(_awaited(value))
        return self._each(value) if inspect.isasyncgen(value) else value

    def _each(self, values: Any) -> Iterator[Any]:
        try:
            while (value := self._runner.run(_awaited(anext(values, None)))) is not None:
                yield value
        finally:
            self._runner.run(values.aclose())


async def _awaited(value: Any) -> Any:
    return await value


@pytest.fixture(scope="package")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    with serving(tmp_path_factory.mktemp("server") / "log", "--workers", "1") as running:
        yield running


@pytest.fixture(params=KINDS)
def connect(request: pytest.FixtureRequest) -> Iterator[Callable[..., Asker]]:
    """Makes clients of one kind, and closes them."""
    made: list[Asker] = []

    def new(url: str, **options: Any) -> Asker:
        made.append(Asker(request.param, url, **options))
        return made[-1]

    yield new
    for asker in made:
        asker.close()


@pytest.fixture
def client(connect: Callable[..., Asker], server: Server) -> Asker:
    """A client of the server."""
    return connect(server.url)
