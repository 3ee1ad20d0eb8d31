"""Every call of the two clients, once, as generators of steps: see steps.py. `client.py` says what each does."""

from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Final

from chunkserver_client.answers import head_of_chunk, mesh_of, number_of
from chunkserver_client.batch import CHUNKS_MAX, Batch
from chunkserver_client.coding import Coding
from chunkserver_client.descriptors import (
    ChunkHead,
    ListedWorld,
    Recipe,
    SeedDescriptor,
    WorldDescriptor,
    read_seed,
    read_world,
)
from chunkserver_client.edits import ChunkRange, Stroke, WrittenEdit, is_stale, read_log, read_written
from chunkserver_client.errors import BadAnswer, Unavailable, Unreachable
from chunkserver_client.exchange import Exchange, checked, json_of
from chunkserver_client.json_tree import Json
from chunkserver_client.mesh import REVISION_MAX, ChunkMesh
from chunkserver_client.questions import (
    AnyWorld,
    ChunkOptions,
    Key,
    MaskedKey,
    RecipeTree,
    chunk_asked,
    chunk_key,
    chunk_request,
    edit_request,
    fitted,
    got,
    posted,
)
from chunkserver_client.retry import Retry
from chunkserver_client.steps import Answer, Deliver, Request, Steps, Value

WORLDS_PER_PAGE: Final = 1000
PAGES_MAX: Final = 1000
"""Of the list of worlds: a million. A server that goes on for ever is not believed."""
EDITS_PER_PAGE: Final = 1000
READY_ATTEMPTS_MAX: Final = 1 << 20
READY_POLL_SECONDS_MAX: Final = 1.0


@dataclass(frozen=True, slots=True)
class Calls:
    """What a client can do. coding: of chunks, alone and in batches."""

    exchange: Exchange
    coding: Coding

    def seed(self, seed: int, recipe: str) -> Steps[SeedDescriptor]:
        return self._json(got("v1", "seeds", str(int(seed)), query={"recipe": recipe}), read_seed)

    def world(self, world_id: str) -> Steps[WorldDescriptor]:
        return self._json(got("v1", "worlds", world_id), read_world)

    def worlds(self) -> Steps[tuple[ListedWorld, ...]]:
        found = list[ListedWorld]()
        page: dict[str, str] = {"limit": str(WORLDS_PER_PAGE)}
        for _ in range(PAGES_MAX):
            worlds, after = yield from self._json(got("v1", "worlds", query=page), _read_page)
            found += worlds
            if after is None:
                return tuple(found)
            page["after"] = after
        raise BadAnswer(f"the list of worlds has more than {PAGES_MAX} pages")

    def create_world(
        self,
        world_id: str,
        seed: int,
        recipe: str | RecipeTree,
        options: dict[str, Any],
    ) -> Steps[WorldDescriptor]:
        given = {name: value for name, value in options.items() if value is not None}
        body = {"id": world_id, "seed": str(int(seed)), "recipe": recipe, **given}
        return self._json(posted("/v1/worlds", body), read_world, 200, 201)

    def delete_world(self, world_id: str) -> Steps[None]:
        request = got("v1", "worlds", world_id)
        return self.exchange.ask(
            Request("DELETE", request.url, request.headers, repeatable=False), lambda answer: _nothing(answer, 204)
        )

    def recipes(self) -> Steps[tuple[Recipe, ...]]:
        return self._json(
            got("v1", "recipes", cached=True), lambda json: tuple(Recipe.read(row) for row in json["recipes"])
        )

    def recipe(self, name: str) -> Steps[Recipe]:
        return self._json(got("v1", "recipes", name, cached=True), Recipe.read)

    def post_recipe(self, recipe: RecipeTree) -> Steps[Recipe]:
        return self._json(posted("/v1/recipes", recipe), Recipe.read, 200, 201)

    def chunk(self, world: AnyWorld, key: Key, options: ChunkOptions) -> Steps[ChunkMesh]:
        asked = chunk_key(key)
        return self.exchange.ask(chunk_request(world, asked, options), partial(mesh_of, place=world.place(asked)))

    def chunk_head(self, world: AnyWorld, key: Key, options: ChunkOptions) -> Steps[ChunkHead]:
        return self.exchange.ask(chunk_request(world, chunk_key(key), options, "HEAD"), head_of_chunk)

    def chunks(
        self, world: AnyWorld, keys: Iterable[Key | MaskedKey], viewer: Sequence[float] | None, options: ChunkOptions
    ) -> Steps[None]:
        asked = list(dict.fromkeys(fitted(key, options) for key in keys))
        if viewer is not None and len(asked) > CHUNKS_MAX:
            asked.sort(key=lambda chunk: (world.place(chunk.key).squared_distance(viewer), -chunk.key.lod))
        for start in range(0, len(asked), CHUNKS_MAX):
            part = asked[start : start + CHUNKS_MAX]
            yield from Batch(self.exchange, world, part, options, viewer, self.coding).steps()

    def edit(self, world: WorldDescriptor, strokes: Iterable[Stroke], key: str | None) -> Steps[WrittenEdit]:
        written = yield from self._json(edit_request(world, strokes, key), read_written)
        self.outdate(world, written.stale, written.revision)
        return written

    def edits(self, world: WorldDescriptor, after: int, limit: int | None) -> Steps[None]:
        last = REVISION_MAX if limit is None else after + limit
        while after < last:
            query = {"after": str(after), "limit": str(min(EDITS_PER_PAGE, last - after))}
            request = got("v1", "worlds", world.id, "edits", query=query)
            edits, revision = yield from self._json(request, partial(read_log, after=after))
            for edit in edits:
                self.outdate(world, edit.stale, edit.revision)
                yield Deliver(edit)
            after += len(edits)
            last = min(last, revision)

    def is_ready(self) -> Steps[bool]:
        try:
            yield from self.exchange.ask(got("readyz"), _nothing, Retry(attempts_max=1))
        except (Unavailable, Unreachable):
            return False
        return True

    def wait_until_ready(self, seconds: float) -> Steps[None]:
        patience = Retry(
            attempts_max=READY_ATTEMPTS_MAX, seconds_max=seconds, backoff_seconds_max=READY_POLL_SECONDS_MAX
        )
        return self.exchange.ask(got("readyz"), _nothing, patience)

    def _json(self, request: Request, read: Callable[[Json], Value], *statuses: int) -> Steps[Value]:
        return self.exchange.ask(request, lambda answer: read(json_of(checked(answer, *(statuses or (200,))))))

    def outdate(self, world: WorldDescriptor, stale: Collection[ChunkRange] | None, revision: int) -> None:
        """Forget the chunks that are older than what may have changed them. stale: which; None is all."""

        def is_old(url: str, answer: Answer) -> bool:
            key = chunk_asked(world, url)
            older = key is not None and number_of(answer.headers, "chunk-revision") < revision
            return older and key is not None and (stale is None or is_stale(key, stale))

        if stale is None or stale:
            self.exchange.cache.drop_where(is_old)


def _nothing(answer: Answer, status: int = 200) -> None:
    checked(answer, status)


def _read_page(json: Json) -> tuple[list[ListedWorld], str | None]:
    after = json.get("next")
    return [ListedWorld.read(row) for row in json["worlds"]], None if after is None else after.text()
