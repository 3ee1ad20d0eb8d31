"""Which edits are in which regions: compared together and one by one."""

import json

import numpy as np
import pytest

from chunkserver.stream import StreamEdit, edit
from chunkserver.stream.edit import edits_in
from chunkserver.stream.limits import LODS_MAX, PLACE_MAX
from chunkserver.stream.regions import Box, Region
from tests.unit.stream.worlds import CELLS


def some_edit(rng: np.random.Generator, revision: int) -> StreamEdit:
    ranges = []
    for _ in range(rng.integers(0, 5)):
        low = rng.integers(-6, 6, 3)
        high = low + rng.integers(0, 3, 3)
        ranges.append({"lod": int(rng.integers(0, 8)), "min": low.tolist(), "max": high.tolist()})
    return StreamEdit(revision, b"[{}]", json.dumps(ranges).encode(), CELLS)


def some_region(rng: np.random.Generator) -> Region:
    scale = float(rng.choice([CELLS, 8 * CELLS, 64 * CELLS, PLACE_MAX / 16]))
    low = (scale * rng.uniform(-8, 8, 3)).astype(int)
    high = low + (scale * rng.uniform(0, 8, 3)).astype(int)
    (x, y, z), (u, v, w) = low.tolist(), high.tolist()
    return Region(Box((x, y, z), (u, v, w)), int(rng.choice([0, 1, 3, 7, LODS_MAX - 1])))


def test_many_are_compared_as_each_is(rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(edit, "PAIRS_MAX", 0)
    sizes = []
    for _ in range(50):
        edits = tuple(some_edit(rng, revision) for revision in range(1, 40))
        regions = frozenset(some_region(rng) for _ in range(rng.integers(0, 9)))
        found = edits_in(edits, regions)
        assert found == tuple(each for each in edits if each.is_in(regions))
        sizes.append(len(found))
    assert sizes.count(0) < len(sizes)
    assert 20 < sum(sizes) < 500, "some of them are in a region, most are in none"


def test_who_looks_elsewhere_with_many_regions_is_looked_at_by_none(monkeypatch: pytest.MonkeyPatch):
    """The pairs of 256 edits and 64 regions take 8 ms one by one: nobody else is served meanwhile."""
    monkeypatch.setattr(StreamEdit, "is_in", lambda *_: pytest.fail("it is looked at"))
    stale = json.dumps([{"lod": 0, "min": [0, 0, 0], "max": [0, 0, 0]}]).encode()
    edits = tuple(StreamEdit(revision, b"[]", stale, CELLS) for revision in range(1, 257))
    regions = frozenset(Region(Box((x, 0, 0), (x, 9, 9)), 20) for x in range(1000, 1064))
    assert edits_in(edits, regions) == ()
