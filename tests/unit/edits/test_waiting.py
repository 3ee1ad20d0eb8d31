"""Edits that wait: their boxes in order, and never fewer bricks than they want."""

from collections import deque

import numpy as np

from chunkserver.edits import waiting as waiting_file
from chunkserver.edits.cubes import Cubes
from chunkserver.edits.pyramid import bricks_met
from chunkserver.edits.waiting import Waiting

LODS = 6


def wanted(boxes: np.ndarray) -> int:
    return len(bricks_met(boxes, np.arange(LODS)).keys)


def test_boxes_stay_in_order_and_bricks_are_never_too_few(rng):
    waiting = Waiting(LODS)
    edits: deque[np.ndarray] = deque()
    seen: list[tuple[np.ndarray, np.ndarray]] = []
    was_exact = 0
    for turn in range(600):
        kind = rng.choice(["add", "add", "add", "leave", "drop", "count"]) if edits else "add"
        if kind == "add":
            low = rng.integers(-60, 60, (int(rng.integers(0, 4)), 3))
            boxes = np.stack([low, low + rng.integers(0, 20, low.shape)], axis=1)
            edits.append(boxes)
            waiting.add(boxes, wanted(boxes))
        elif kind == "leave":
            first = edits.popleft()
            waiting.leave(first, wanted(first))
        elif kind == "drop":
            number = int(rng.integers(len(edits)))
            gone = edits[number]
            del edits[number]
            waiting.drop(wanted(gone), list(edits))
        else:
            news = waiting.bricks != wanted(np.concatenate(edits))
            waiting.count()
            was_exact += news and waiting.bricks == wanted(np.concatenate(edits))
        if turn % 200 == 199:
            while edits:
                first = edits.popleft()
                waiting.leave(first, wanted(first))
        there = np.concatenate([np.empty((0, 2, 3), np.int64), *edits])
        assert np.array_equal(waiting.boxes, there)
        assert waiting.bricks >= wanted(there)
        assert edits or waiting.bricks == 0
        seen.append((waiting.boxes, there))
    assert was_exact > 20
    assert all(np.array_equal(then, there) for then, there in seen), "who has boxes goes on reading them"


def test_a_brick_that_many_want_counts_once_when_it_matters():
    waiting, box = Waiting(LODS), np.array([[[0, 0, 0], [15, 15, 15]]])
    for _ in range(100):
        waiting.add(box, wanted(box))
    assert waiting.bricks == 100 * wanted(box)
    waiting.count()
    assert waiting.bricks == wanted(box)


def test_counting_takes_little(monkeypatch):
    waiting, box = Waiting(LODS), np.array([[[0, 0, 0], [15, 15, 15]]])
    counted: list[int] = []

    def met(boxes: np.ndarray, lods: np.ndarray) -> Cubes:
        counted.append(len(boxes))
        return bricks_met(boxes, lods)

    monkeypatch.setattr(waiting_file, "COUNTED_MAX", 10)
    monkeypatch.setattr(waiting_file, "bricks_met", met)
    for _ in range(12):
        waiting.add(box, 1)
    waiting.count()
    assert counted == [], "too many"
    for _ in range(2):
        waiting.leave(box, 1)
    for _ in range(3):
        waiting.count()
    assert counted == [10], "nothing has changed since"
