"""Profiles follow from their seed, and ask as they say they do."""

import itertools
import math
import random
from collections.abc import Iterator

import pytest

from chunkserver_loadtest import profiles
from chunkserver_loadtest.errors import BadOption
from chunkserver_loadtest.exchange import Answer
from chunkserver_loadtest.flight import LOOKS_PER_SECOND, Point, distance, path, ring, urgency, views
from chunkserver_loadtest.profiles import PROFILES, Due, Options, arrivals, columns
from tests.loadtest.test_checks import WORLD

CELLS = 32


def first(profile: str, options: Options, count: int = 300) -> list[Due]:
    primed = [
        (request, Answer(200, b'HTTP/1.1 200 OK\r\nETag: "t"', ()))
        for request in PROFILES[profile].prime(WORLD, options)
    ]
    return list(itertools.islice(PROFILES[profile].schedule(WORLD, options, primed), count))


@pytest.mark.parametrize("profile", PROFILES)
def test_a_profile_follows_from_its_seed(profile):
    options = Options(seed=1, arrivals="poisson", codings=("identity", "zstd"))
    assert first(profile, options) == first(profile, options)
    assert first(profile, options) != first(profile, Options(seed=2, arrivals="poisson", codings=("identity", "zstd")))


@pytest.mark.parametrize("profile", PROFILES)
def test_what_is_due_comes_in_order(profile):
    moments = [due for due, _ in first(profile, Options(seed=3, arrivals="poisson"), 2000)]
    assert moments == sorted(moments)


def test_arrivals_have_their_rate():
    even = list(itertools.islice(arrivals(Options(rate=50)), 101))
    assert even[100] == pytest.approx(2.0)
    assert len({round(after - before, 9) for before, after in itertools.pairwise(even)}) == 1
    random_ones = list(itertools.islice(arrivals(Options(seed=5, rate=50, arrivals="poisson")), 20_001))
    gaps = [after - before for before, after in itertools.pairwise(random_ones)]
    mean = sum(gaps) / len(gaps)
    assert mean == pytest.approx(1 / 50, rel=0.05)
    assert math.sqrt(sum((gap - mean) ** 2 for gap in gaps) / len(gaps)) == pytest.approx(1 / 50, rel=0.05)


@pytest.mark.parametrize("spread", [1, 3, 32])
def test_cold_chunks_are_each_asked_for_once(spread):
    keys = list(columns(Options(seed=7, spread=spread, at=(3200.0, -40.0, 0.0)), CELLS))
    assert len(set(keys)) == len(keys) == (2 * spread) ** 2 * 2
    assert {key[2] for key in keys} == {-3, -2}
    assert {key[1] for key in keys} == set(range(100 - spread, 100 + spread))


def test_cold_chunks_outside_the_world_are_left_out():
    keys = columns(Options(at=(float(1 << 40), 0.0, 0.0), spread=2), CELLS)
    assert sum(WORLD.has(key) for key in keys) == 16
    requests = PROFILES["cold-unique"].schedule(WORLD, Options(at=(float(1 << 40), 0.0, 0.0), spread=2), ())
    assert len(list(requests)) == 16


def test_the_hot_set_is_small_and_a_share_is_revalidated():
    asked = first("warm-hot", Options(seed=9, hot=8, revalidate=0.25), 4000)
    assert len({request.path for _, request in asked}) == 8
    tagged = [request for _, request in asked if request.etag]
    assert len(tagged) == pytest.approx(1000, abs=150)
    assert {(request.kind, request.etag) for request in tagged} == {("revalidate", '"t"')}


def test_the_hot_set_prefers_chunks_with_a_surface():
    options = Options(hot=4)
    asked = list(PROFILES["warm-hot"].prime(WORLD, options))
    primed = [(request, Answer(200 if place % 2 else 204, b"", ())) for place, request in enumerate(asked)]
    schedule = PROFILES["warm-hot"].schedule(WORLD, options, primed)
    wanted = {request.path for request, answer in primed if answer.status == 200}
    assert {request.path for _, request in itertools.islice(schedule, 200)} == wanted
    with pytest.raises(BadOption, match="hot set"):
        next(PROFILES["warm-hot"].schedule(WORLD, options, ()))


@pytest.mark.parametrize("speed", [5.0, 40.0])
def test_a_path_is_smooth_and_has_its_speed(speed):
    points = list(itertools.islice(path(random.Random(11), (0.0, 24.0, 0.0), speed), 600))
    steps = [tuple(b - a for a, b in zip(*pair, strict=True)) for pair in itertools.pairwise(points)]
    assert all(math.hypot(*step) * LOOKS_PER_SECOND == pytest.approx(speed) for step in steps)
    turns = [math.dist(before, after) for before, after in itertools.pairwise(steps)]
    assert max(turns) < 0.1 * speed / LOOKS_PER_SECOND
    assert abs(points[-1][1] - 24.0) < speed
    assert math.dist(points[0], points[-1]) > speed * 5


@pytest.mark.parametrize("reach", [1, 2])
@pytest.mark.parametrize("viewer", [(0.0, 0.0, 0.0), (-1.0, 31.9, 32.0), (12345.6, -789.0, 63.9)])
def test_rings_fill_a_cube_without_gaps_and_overlaps(viewer, reach):
    lods = 4
    rings = [ring(lod, viewer, CELLS, reach) for lod in range(lods)]
    side = 2 * (2 * reach + 1)
    assert [len(one) for one in rings] == [side**3] + [side**3 - (2 * reach + 1) ** 3] * (lods - 1)
    covered: set[tuple[int, ...]] = set()
    for key in set().union(*rings):
        lod, *place = key
        inside = itertools.product(*(range(at << lod, (at + 1) << lod) for at in place))
        if lod < 3:
            fine = set(inside)
            assert not covered & fine
            covered |= fine
    hole = {(x, y, z) for lod, x, y, z in ring(3, viewer, CELLS, reach)}
    assert len(covered) == (side * 4) ** 3
    assert not {tuple(at >> 3 for at in fine) for fine in covered} & hole
    assert tuple(math.floor(at / CELLS) for at in viewer) in covered


def test_a_flight_asks_for_each_chunk_once_the_nearest_first():
    points = itertools.islice(path(random.Random(13), (5.0, 24.0, 7.0), 40.0), 300)
    seen: set[tuple[int, ...]] = set()
    moments = []
    for view in views(points, CELLS, 3, 1):
        order = [(distance(key, view.viewer, CELLS), -key[0]) for key in view.missing]
        assert order == sorted(order)
        assert not seen & set(view.missing)
        assert len(set(view.missing)) == len(view.missing)
        seen |= set(view.missing)
        shown = set().union(*(ring(lod, view.viewer, CELLS, 1) for lod in range(3)))
        assert shown <= seen
        moments.append(view.seconds)
    assert moments[0] == 0.0
    assert len(moments) > 5


def test_urgency_falls_with_the_distance():
    viewer = (16.0, 16.0, 16.0)
    found = [urgency((0, x, 0, 0), viewer, CELLS) for x in (0, 1, 2, 3, 5, 10, 1000)]
    assert found == [0, 0, 1, 2, 3, 4, 6]


@pytest.mark.parametrize("batch", [0, 50])
def test_a_flight_asks_with_urgency_alone_or_in_batches(batch):
    options = Options(seed=17, viewers=3, lods=3, batch=batch)
    asked = first("fly-through", options, 400)
    requests = [request for _, request in asked]
    keys = [key for request in requests for key in request.keys]
    assert {request.kind for request in requests} == ({"batch"} if batch else {"arrive"})
    assert max(len(request.keys) for request in requests) == (batch or 1)
    assert {key[0] for key in keys} == {0, 1, 2}
    assert len({request.urgency for request in requests}) > 2
    assert all(bool(request.body) is bool(batch) for request in requests)


def test_viewers_join_one_after_another_and_then_fly():
    asked = first("fly-through", Options(seed=19, viewers=2, lods=2, speed=200.0), 3000)
    arriving = [due for due, request in asked if request.kind == "arrive"]
    assert len(arriving) == 2 * (216 + 189)
    assert {round(due, 9) for due in arriving} == {0.0, 0.25}
    assert sum(request.kind == "fly" for _, request in asked) == 3000 - len(arriving)


def test_a_flight_ends_where_the_world_does(monkeypatch):
    def leaving(*_of_a_flight: object) -> Iterator[Point]:
        yield from ((float((1 << 40) + step), 0.0, 0.0) for step in range(0, 6400, 64))
        raise AssertionError("the viewer is followed outside of the world")

    monkeypatch.setattr(profiles, "path", leaving)
    asked = list(profiles.flight(WORLD, Options(lods=2), 0))
    assert {request.kind for _, request in asked} == {"arrive", "fly"}


@pytest.mark.parametrize(
    "wrong",
    [
        {"rate": 0},
        {"viewers": 0},
        {"speed": 0},
        {"batch": 1025},
        {"revalidate": 1.1},
        {"codings": ("br",)},
        {"reach": 99},
        {"editors": 0},
        {"subscribers": -1},
        {"silent": 1.5},
        {"strokes": 501},
        {"ground": 0},
        {"look": -1},
        {"missed": -1},
        {"cuts": 0},
    ],
)
def test_options_are_limited(wrong):
    with pytest.raises(BadOption, match=next(iter(wrong)).removesuffix("s")):
        Options(**wrong)
