import numpy as np
import pytest
from pydantic import ValidationError

from chunkserver.edits import Arena, Bricks, Edit, History
from chunkserver.edits.arena import BRICK_DELTAS
from chunkserver.errors import BadStroke
from chunkserver.field import Ground
from chunkserver.recipe import WorldRecipe, builtin
from chunkserver.server.connections import ConnectionLimits
from chunkserver.server.keys import Scope, mint
from chunkserver.server.pool import Limits
from chunkserver.server.settings import ARENA_BYTES_MIN, MASK, WORKERS_MAX, Settings
from chunkserver.worker import cores


def refused(**values):
    with pytest.raises(ValidationError) as caught:
        Settings(**values)
    return [error["loc"] for error in caught.value.errors()], str(caught.value.errors()[0]["msg"])


def test_a_worker_for_each_core():
    assert Settings().workers == min(cores(), WORKERS_MAX) >= 1


def test_frozen():
    with pytest.raises(ValidationError, match="frozen"):
        Settings().port = 1  # type: ignore[misc]


def test_made_as_it_stands(monkeypatch):
    monkeypatch.setenv("CHUNKSERVER_PORT", "1")
    assert Settings().port == 8000


def test_the_limits_have_one_default_each():
    assert Settings().pool_limits == Limits()
    assert Settings().connection_limits == ConnectionLimits()


def test_the_limits_are_those_that_were_chosen():
    chosen = Settings(jobs_waiting=1, answer_seconds=3, build_seconds=1.5, worker_bytes=3 << 30, arena_bytes=1 << 31)
    assert chosen.pool_limits == Limits(1, 3, 1.5, 3 << 30, 1 << 31)
    chosen = Settings(connections_max=1, header_seconds=2, keep_alive_seconds=3, send_seconds=4)
    assert chosen.connection_limits == ConnectionLimits(
        connections_max=1, header_seconds=2, keep_alive_seconds=3, send_seconds=4
    )


def test_an_arena_has_whole_bricks():
    for size in (ARENA_BYTES_MIN, ARENA_BYTES_MIN + 1, "1GB"):
        cut = Settings(arena_bytes=size).pool_limits.arena_bytes
        assert 0 <= Settings(arena_bytes=size).arena_bytes - cut < 1 << 20
        assert len(Arena(np.zeros(cut // 4, np.int32)).deltas) * 4 * BRICK_DELTAS == cut


def test_the_smallest_arena_has_room_for_the_largest_ball(monkeypatch):
    monkeypatch.setattr("chunkserver.edits.arena.SLOTS_DEFAULT", ARENA_BYTES_MIN // (4 * BRICK_DELTAS))
    history = History(Bricks(), Ground(WorldRecipe(0, builtin("plane"))).bound, 32)
    ball = {"op": "add", "shape": "sphere", "center": [0, 0, 0], "radius": 80.0, "strength": 1.0}
    with pytest.raises(BadStroke, match="limit is 4194304"):
        Edit.of([{**ball, "radius": 81.0}])
    assert history.take(Edit.of([ball])).stale


@pytest.mark.parametrize(
    ("name", "value"),
    [
        *[("host", ""), ("port", -1), ("port", 65536), ("port", "http"), ("workers", 0), ("workers", WORKERS_MAX + 1)],
        *[("cache_bytes", -1), ("cache_bytes", "2PiB"), ("cache_bytes", "much"), ("disk_cache_bytes", 0)],
        *[
            ("answer_seconds", float("nan")),
            ("answer_seconds", float("inf")),
            ("send_seconds", 0),
            ("insecure", "maybe"),
        ],
        *[("log_format", "xml"), ("log_requests", "some"), ("log_level", "loud"), ("connections_max", 0)],
        *[("arena_bytes", ARENA_BYTES_MIN - 1), ("arena_bytes", "2TiB")],
    ],
)
def test_what_cannot_be(name, value):
    assert refused(**{name: value})[0] == [(name,)]


def test_what_does_not_agree():
    assert "tried once more" in refused(answer_seconds=1, build_seconds=0.6)[1]


@pytest.mark.parametrize(("text", "length"), [("1MiB", 1 << 20), ("1MB", 10**6), ("0", 0), ("4096", 4096)])
def test_bytes_have_units(text, length):
    assert Settings(cache_bytes=text).cache_bytes == length


def test_a_list_is_written_in_one_line_too():
    sites = ("https://a.example", "http://localhost:3000")
    for text in (",".join(sites), " ".join(sites), f" {sites[0]} ,\n{sites[1]},", list(sites)):
        assert Settings(cors_origins=text).cors_origins == sites
    assert Settings(cors_origins="").cors_origins == ()


@pytest.mark.parametrize(
    "text", ["example.org", "https://a/path path", "https://ä.example", "https://a.example/x", "**"]
)
def test_what_is_no_origin(text):
    assert "is no origin" in refused(cors_origins=[text])[1]


def test_keys_are_shown_without_their_digests():
    _, first = mint("game", Scope.READ)
    _, second = mint("tool", Scope.ADMIN)
    chosen = Settings(api_keys=f"{first} {second}")
    assert chosen.api_keys == (first, second) == Settings(api_keys=[str(first), str(second)]).api_keys
    assert chosen.shown()["api_keys"] == [f"game:read:{MASK}", f"tool:admin:{MASK}"]
    assert first.digest not in repr(chosen)
    assert Settings().shown().keys() == Settings.model_fields.keys()


def test_one_name_is_one_key():
    keys = [str(mint("game", Scope.READ)[1]) for _ in range(2)]
    assert "same name" in refused(api_keys=keys)[1]
    assert refused(api_keys=[7])[0] == [("api_keys", 0)]


def test_no_folder_is_written_as_nothing():
    assert Settings(data="").data is None
    assert Settings(disk_cache="").disk_cache is None


def test_every_setting_says_what_it_is():
    for name, field in Settings.model_fields.items():
        assert field.description, name
        assert field.description.endswith("."), name
