"""Which chunks are shown: against the twin of the page, and against what must hold whatever the page says."""

import math
import time
from itertools import product
from typing import Any, Final

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import given, settings

from chunkserver_client import LevelOfDetail, SeedDescriptor, Selection, ladder
from tests.client import slow_cuts
from tests.client.worlds import VOXELS_MAX, Corner, assert_fits, volume, world
from tests.scale import count

PLANET: Final = 6_400_000
VIEW: Final = {"screen_pixels": 1080.0, "fov_degrees": 60.0}
EXAMPLES: Final = count(3000)


def full_box(lods: int, cells: int, low: Corner, roots: Corner) -> tuple[Corner, Corner]:
    """Return the box of some chunks of the last level."""
    side = cells << lods - 1
    ends = [side * (first + many) for first, many in zip(low, roots, strict=True)]
    return (low[0] * side, low[1] * side, low[2] * side), (ends[0], ends[1], ends[2])


@st.composite
def journeys(draw: st.DrawFn) -> tuple[SeedDescriptor, dict[str, Any], list[Any]]:
    """A world and how it is looked at, and a way through it: positions and velocities, small steps and large ones."""
    lods, cells = draw(st.integers(1, 5)), draw(st.sampled_from([16, 32, 64]))
    side = cells << lods - 1
    errors = draw(st.none() | st.lists(st.floats(0, 2.0**lods), min_size=lods, max_size=lods))
    far = draw(st.sampled_from([0, VOXELS_MAX // 2, -VOXELS_MAX + side, VOXELS_MAX - 2 * side]))
    low = [draw(st.integers(far - side, far + side)) for _ in range(3)]
    high = [place + draw(st.integers(1, 2 * side)) for place in low]
    view = {
        "error_pixels": draw(st.sampled_from([10.0, 24.0, 60.0])),
        "reach": draw(st.integers(1, 2 * side)),
        "box": (tuple(low), tuple(high)),
        "chunks_max": draw(st.sampled_from([64, 100, 300, 16384])),
    }
    at = [draw(st.integers(place - side, place + 2 * side)) for place in low]
    way = []
    for _ in range(draw(st.integers(1, 4))):
        step = draw(st.sampled_from([0, 1, 3, cells, side]))
        at = [place + draw(st.integers(-step, step)) for place in at]
        speed = draw(st.sampled_from([0, 0, 40, side]))
        way.append(((at[0], at[1], at[2]), tuple(draw(st.integers(-speed, speed)) for _ in range(3))))
    return world(lods, cells, errors), view, way


@settings(max_examples=EXAMPLES, deadline=None)
@given(journeys())
def test_every_cut_is_that_of_the_page_and_fits(journey):
    descriptor, view, way = journey
    levels = LevelOfDetail(descriptor, **view)
    page = slow_cuts.World(descriptor.chunk_cells, descriptor.lods, view["box"])
    rungs = slow_cuts.ladder(page, descriptor.geometric_errors, VIEW | view)
    selection, before = None, None
    for at, velocity in way:
        selection = levels.select(at, velocity, selection)
        before = slow_cuts.select(page, rungs, at, velocity, before, view["chunks_max"])
        assert sorted(selection.chunks) == sorted(before[1].rows)
        assert len(selection.chunks) <= view["chunks_max"]
        assert_fits(selection.chunks, descriptor.lods)


def test_a_walk_of_small_steps_is_that_of_the_page():
    """Here most levels are those of the frame before, because they cannot have changed."""
    box = ((-300, -40, -300), (300, 40, 300))
    view: dict[str, Any] = {"error_pixels": 30.0, "reach": 400, "box": box}
    levels, page = LevelOfDetail(world(4, 16), **view), slow_cuts.World(16, 4, box)
    rungs = slow_cuts.ladder(page, None, VIEW | view)
    rng, at = np.random.default_rng(11), [-60, 3, -50]
    selection, before, kept = None, None, 0
    for frame in range(90):
        at = [place + int(step) for place, step in zip(at, rng.integers((-1, -1, -1), (4, 2, 4)), strict=True)]
        velocity = (0, frame // 30 * 9, frame // 45 * -20)
        shown = None if selection is None else selection.chunks
        selection = levels.select(at, velocity, selection)
        before = slow_cuts.select(page, rungs, at, velocity, before, 16384)
        assert sorted(selection.chunks) == sorted(before[1].rows)
        kept += selection.chunks is shown
    assert 10 < kept < 80


def test_what_is_out_of_reach_makes_nobody_split():
    """What was split in a chunk of the last level that is not there any more asks for no balance."""
    box = ((-256, -64, -256), (256, 64, 256))
    view: dict[str, Any] = {"error_pixels": 20.0, "reach": 57, "box": box}
    levels, page = LevelOfDetail(world(3, 16), **view), slow_cuts.World(16, 3, box)
    rungs = slow_cuts.ladder(page, None, VIEW | view)
    selection, before = None, None
    for at, velocity in (((-75, -6, 36), (9, 82, 166)), ((-29, 23, 25), (-93, 47, -22))):
        selection = levels.select(at, velocity, selection)
        before = slow_cuts.select(page, rungs, at, velocity, before, 16384)
        assert sorted(selection.chunks) == sorted(before[1].rows)


@pytest.mark.parametrize("errors", [None, [0.1, 3.0, 2.0, 9.0, 9.5]])
def test_what_is_given_up_is_what_the_page_says(errors):
    view = {"error_pixels": 3.0, "reach": 2000}
    sharpness = 1080 / (2 * math.tan(math.radians(30))) / 3
    found = ladder.rungs(32, errors or [0.25 * 2**lod for lod in range(5)], sharpness, 2000)
    page = slow_cuts.ladder(slow_cuts.World(32, 5, ((0, 0, 0), (1, 1, 1))), errors, VIEW | view)
    stated = dict.fromkeys((rung.reach, tuple(rung.distances)) for rung in page)
    assert [tuple(rung) for rung in found] == list(stated)


@pytest.mark.parametrize("low", [(0, 0, 0), (-1, -1, -1), (-(1 << 17), 5, (1 << 17) - 2)])
def test_the_box_is_filled_exactly_once(low):
    lods, cells = 4, 16
    low = tuple(max(-VOXELS_MAX // 128, min(first, VOXELS_MAX // 128 - 2)) for first in low)
    box = full_box(lods, cells, low, (2, 2, 2))
    side = cells << lods
    levels = LevelOfDetail(world(lods, cells), error_pixels=24, box=box, reach=4 * side)
    rng, selection = np.random.default_rng(5), None
    for _ in range(6):
        at = rng.uniform(box[0], box[1])
        selection = levels.select(at, rng.normal(0, 100, 3), selection)
        assert volume(selection.chunks, cells) == side**3
        assert_fits(selection.chunks, lods)
    (x, y, z), (ex, ey, ez) = box
    odd = ((x + 5, y + 5, z + 5), (ex - 77, ey - 77, ez - 77))
    chunks = LevelOfDetail(world(lods, cells), error_pixels=24, box=odd, reach=4 * side).select(at).chunks
    assert volume(chunks, cells, odd) == math.prod(b - a for a, b in zip(*odd, strict=True))
    assert all(volume([chunk], cells, odd) for chunk in chunks), "none is shown that has nothing of the box"


def test_a_planet_of_twenty_levels():
    levels = LevelOfDetail(world(20), error_pixels=12)
    for height in (2.0, 400_000.0):
        at = (0.6 * (PLANET + height), 0.8 * (PLANET + height), 100.0)
        chunks = levels.select(at).chunks
        assert_fits(chunks, 20)
        assert {chunk.lod for chunk in chunks} >= set(range(18))
    whole = ((-PLANET,) * 3, (PLANET,) * 3)
    seen = LevelOfDetail(world(20), box=whole, reach=1 << 26).select((0, 0, 40_000_000))
    assert volume(seen.chunks, 32, whole) == (2 * PLANET) ** 3
    assert min(chunk.lod for chunk in seen.chunks) > 14, "from far away there are no small chunks"


def test_what_is_seen_is_as_fine_as_was_asked():
    """Every leaf's error, seen from the viewer, is small enough; that of its parent is not, but for the balance."""
    levels, lods = LevelOfDetail(world(8), error_pixels=3), 8
    at = np.array((1000.3, 20.0, -77.0))
    sharpness = 1080 / (2 * math.tan(math.radians(30)))
    for chunk in levels.select(at).chunks:
        low = np.array(chunk[1:4]) * (32 << chunk.lod)
        gap = np.maximum(np.maximum(low - at, at - low - (32 << chunk.lod)), 0)
        if chunk.lod:
            assert 0.25 * 2**chunk.lod * sharpness <= 3 * (np.linalg.norm(gap) + 3), "3: positions are rounded"
    assert {chunk.lod for chunk in levels.select(at).chunks} == set(range(lods - 1))


@pytest.mark.parametrize(
    ("error_pixels", "chunks_max", "voxels"),
    [(4, 16384, 8.0), (4, 2500, 2.0), (8, 1500, 2.0)],
    ids=["free", "at the limit", "now over it and now far below"],
)
def test_a_viewer_who_trembles_changes_nothing(error_pixels, chunks_max, voxels):
    levels = LevelOfDetail(world(10), error_pixels=error_pixels, chunks_max=chunks_max)
    rng, flickers, limited = np.random.default_rng(2), 0, False
    for centre in rng.uniform(-5000, 5000, (3, 3))[:1]:
        tremble = centre + rng.uniform(-voxels / 2, voxels / 2, (20, 3))
        selection = levels.select(centre)
        for at in tremble:
            selection = levels.select(at, previous=selection)
        shown = selection.chunks
        limited |= selection.coarsened > 0
        for at in tremble:
            selection = levels.select(at, previous=selection)
            assert selection.chunks == shown
        flickers += len({levels.select(at).chunks for at in tremble}) - 1
    assert flickers > 0, "without the cut before it would flicker"
    assert limited == (chunks_max < 16384)


def test_what_has_split_merges_at_four_fifths_of_the_error():
    levels = LevelOfDetail(world(2, 16), error_pixels=8, reach=512, box=((0, 0, 0), (32, 32, 32)))
    split = math.floor(0.5 * 1080 / (2 * math.tan(math.radians(30))) / 8)
    counts = []
    selection = None
    for gap in (split + 1, split, split - 1, split, split * 5 // 4 - 1, split * 5 // 4, split + 1, split - 1):
        selection = levels.select((32 + gap, 0, 0), previous=selection)
        counts.append(len(selection.chunks))
    assert counts == [1, 1, 8, 8, 8, 1, 1, 8]


def test_what_does_not_change_is_the_same_object():
    levels = LevelOfDetail(world(10))
    selection = levels.select((10, 20, 30))
    again = levels.select((10.4, 20.1, 30.2), previous=selection)
    assert again.chunks is selection.chunks


def test_who_moves_sees_what_is_ahead_in_time():
    levels = LevelOfDetail(world(10), ahead_seconds=2.0)
    here, there = np.array((16.0, 16.0, 16.0)), np.array((166.0, 16.0, 16.0))
    still, moving, arrived = levels.select(here), levels.select(here, (50, 0, 0)), levels.select(there)

    def fine(selection: Selection, at: Any) -> bool:
        return (0, *(int(place) // 32 for place in at)) in {chunk.key for chunk in selection.chunks}

    ahead = here + np.array((200.0, 0.0, 0.0))
    assert not fine(still, ahead)
    assert fine(moving, ahead)
    assert fine(arrived, ahead)
    assert not fine(levels.select(here, (-50, 0, 0)), ahead)
    assert {c.key for c in still.chunks if c.lod == 0} <= {c.key for c in moving.chunks}, "what is here stays fine"
    fast = levels.select(here, (1e9, 0, 0))
    assert len(fast.chunks) < 2 * len(still.chunks), "no level is looked ahead further than it matters"
    assert_fits(fast.chunks, 10)


def test_limits_hold_and_the_nearest_stays_finest():
    wanted = LevelOfDetail(world(12), error_pixels=2)
    sizes = []
    for chunks_max in (5_000, 1_000, 64):
        levels = LevelOfDetail(world(12), error_pixels=2, chunks_max=chunks_max)
        selection = levels.select((100, 20, 50))
        assert len(selection.chunks) <= chunks_max
        assert_fits(selection.chunks, 12)
        sizes.append((len(selection.chunks), -selection.coarsened))
    assert sizes == sorted(sizes, reverse=True)
    assert sizes[-1][0] > 0
    assert wanted.select((100, 20, 50)).coarsened == 1


def test_what_was_given_up_comes_back():
    levels = LevelOfDetail(world(6, 16), chunks_max=2500, box=((-512, -512, -512), (512, 512, 512)))
    tight = levels.select((0, 0, 0))
    assert tight.coarsened > 0
    away = levels.select((900, 900, 900), previous=tight)
    assert away.coarsened == 0
    assert levels.select((0, 0, 0), previous=away).coarsened > 0


def test_a_world_of_a_single_level():
    levels = LevelOfDetail(world(1, 64), reach=512)
    selection = levels.select((10, 20, 30))
    assert {(chunk.lod, chunk.coarser) for chunk in selection.chunks} == {(0, 0)}
    near = {
        place
        for place in product(range(-10, 11), repeat=3)
        if sum(max(64 * k - p, p - 64 * k - 64, 0) ** 2 for k, p in zip(place, (10, 20, 30), strict=True)) < 512**2
    }
    assert {chunk[1:4] for chunk in selection.chunks} == near


def test_the_edge_of_the_world():
    levels = LevelOfDetail(world(21, 64), reach=1 << 27)
    edge = levels.select((VOXELS_MAX - 1, -VOXELS_MAX, 0))
    assert_fits(edge.chunks, 21)
    for chunk in edge.chunks:
        side = 64 << chunk.lod
        assert all(-VOXELS_MAX <= side * place <= VOXELS_MAX - side for place in chunk[1:4])
    beyond = ((-2 * VOXELS_MAX,) * 3, (2 * VOXELS_MAX,) * 3)
    wide = LevelOfDetail(world(21, 64), reach=1 << 27, box=beyond)
    assert wide.select((VOXELS_MAX - 1, -VOXELS_MAX, 0)).chunks == edge.chunks
    nowhere = LevelOfDetail(world(3), box=((2 * VOXELS_MAX,) * 3, (3 * VOXELS_MAX,) * 3))
    assert nowhere.select((2 * VOXELS_MAX, 2 * VOXELS_MAX, 2 * VOXELS_MAX)).chunks == frozenset()
    assert levels.select((1e300, 0, 0)).chunks == frozenset()
    assert levels.select((3 * VOXELS_MAX, 0, 0), previous=edge).chunks == frozenset()


def test_errors_of_the_descriptor_count():
    flat = LevelOfDetail(world(5, errors=[0.0] * 5)).select((0, 0, 0))
    assert {chunk.lod for chunk in flat.chunks} == {4}
    given = LevelOfDetail(world(5, errors=[0.25 * 2**lod for lod in range(5)])).select((5, 6, 7))
    assert given.chunks == LevelOfDetail(world(5)).select((5, 6, 7)).chunks
    dips = LevelOfDetail(world(5, errors=[0.25, 0.5, 1.0, 0.1, 0.2])).select((5, 6, 7))
    least = LevelOfDetail(world(5, errors=[0.25, 0.5, 1.0, 1.0, 1.0])).select((5, 6, 7))
    assert dips.chunks == least.chunks


def test_zoom_and_voxel_size():
    at = (5, 6, 7)
    chunks = LevelOfDetail(world(8)).select(at).chunks
    assert LevelOfDetail(world(8, voxel_size=0.125)).select(at).chunks == chunks
    assert LevelOfDetail(world(8), screen_pixels=540, error_pixels=2).select(at).chunks == chunks
    assert len(LevelOfDetail(world(8), fov_degrees=30).select(at).chunks) > len(chunks)


@pytest.mark.parametrize(
    ("option", "value"),
    [
        ("error_pixels", 0),
        ("error_pixels", math.nan),
        ("screen_pixels", math.inf),
        ("fov_degrees", 180),
        ("ahead_seconds", -1),
        ("chunks_max", 63),
        ("reach", 0),
        ("reach", (32 << 11) * 16 + 1),
        ("box", ((0, 0, 0), (1, 0, 1))),
    ],
)
def test_what_makes_no_view_is_refused(option, value):
    with pytest.raises(ValueError, match=option):
        LevelOfDetail(world(), **{option: value})


def test_what_is_no_viewer_is_refused():
    levels = LevelOfDetail(world())
    for bad in ((0, 0), (0, math.nan, 0), (math.inf, 0, 0)):
        with pytest.raises(ValueError, match="position"):
            levels.select(bad)
        with pytest.raises(ValueError, match="velocity"):
            levels.select((0, 0, 0), bad)
    with pytest.raises(ValueError, match="previous"):
        levels.select((0, 0, 0), previous=LevelOfDetail(world()).select((0, 0, 0)))


def test_a_frame_is_soon_done():
    """Loose: what it costs is measured by hand. A walk at 60 frames a second, of a planet."""
    levels = LevelOfDetail(world(20))
    selection = levels.select((0, PLANET, 0))
    started = time.process_time()
    for frame in range(60):
        selection = levels.select((frame / 12, PLANET, 0), (5, 0, 0), selection)
    assert (time.process_time() - started) / 60 < 0.05
