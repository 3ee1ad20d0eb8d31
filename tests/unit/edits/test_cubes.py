"""Cubes that boxes meet are found as by hand, and joined to boxes that do not overlap."""

from itertools import product

import numpy as np
import pytest

from chunkserver.edits import cubes as cubes_file
from chunkserver.edits.cubes import joined, met

FAR = 1 << 39


def random_boxes(rng: np.random.Generator, count: int, middle: int):
    low = middle + rng.integers(-40, 40, (count, 3))
    return np.stack([low, low + rng.integers(-1, 30, (count, 3))], axis=1)


def places(box, bits: int):
    """Return the cubes of a box, (y, z, x); none if it has no point."""
    if (box[0] > box[1]).any():
        return []
    x, y, z = (range(int(low) >> bits, (int(high) >> bits) + 1) for low, high in zip(*box, strict=True))
    return [(a, b, c) for b, c, a in product(y, z, x)]


@pytest.mark.parametrize("middle", [0, FAR, -FAR])
@pytest.mark.parametrize("room", [1, 8])
def test_cubes_are_found_once(room, middle, rng, monkeypatch):
    """room: whether the first guess of how many there are is too small."""
    monkeypatch.setattr(cubes_file, "_ROOM", room)
    boxes, groups = random_boxes(rng, 80, middle), rng.integers(0, 3, 80)
    found = met(groups, boxes, 4)
    wanted = [[(int(group), *place) for place in places(box, 4)] for group, box in zip(groups, boxes, strict=True)]
    keys = found.places()
    assert keys == list(dict.fromkeys(key for of_box in wanted for key in of_box))
    assert [keys[number] for number in found.grids] == [key for of_box in wanted for key in of_box]
    assert [len(of_box) for of_box in wanted] == np.diff([*found.starts, len(found.grids)]).tolist()
    for key, part in zip(keys, found.parts(4), strict=True):
        first = 16 * np.array(key[1:])
        those = [box for box, of_box in zip(boxes, wanted, strict=True) if key in of_box]
        assert part[0].tolist() == np.maximum(np.min([box[0] for box in those], axis=0), first).tolist()
        assert part[1].tolist() == np.minimum(np.max([box[1] for box in those], axis=0), first + 15).tolist()


def test_joined_boxes_have_each_cube_once(rng):
    found = met(rng.integers(0, 2, 30), random_boxes(rng, 30, -5), 3)
    boxes = joined(found.keys)
    inside = [(int(box[0]), *place) for box in boxes for place in places(np.array([box[1:4], box[4:7]]), 0)]
    assert sorted(inside) == sorted(found.places())
    assert len(boxes) < 0.5 * len(inside)
    assert boxes[:, 0].tolist() == sorted(boxes[:, 0].tolist())


def test_one_row_is_one_box():
    cubes = np.array([[0, x, 0, 0] for x in (3, 1, 2)])
    assert joined(cubes).tolist() == [[0, 1, 0, 0, 3, 0, 0]]
