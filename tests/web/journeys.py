"""Ways through worlds, and what the Python client shows on them: the web client has to show the same."""

from collections.abc import Iterable
from typing import Any, Final

import numpy as np

from chunkserver_client import ChunkRange, FittedChunk, LevelOfDetail, Selection, redraws, swaps
from chunkserver_client.ladder import rungs
from tests.client.worlds import VOXELS_MAX, world

FRAMES: Final = 6


def journeys(rng: np.random.Generator, count: int) -> list[dict[str, Any]]:
    """Return so many journeys, as what JSON can say."""
    return [_journey(rng) for _ in range(count)]


def _journey(rng: np.random.Generator) -> dict[str, Any]:
    lods, cells = int(rng.integers(1, 7)), int(rng.choice([16, 32, 64]))
    side = cells << lods - 1
    errors = None if rng.random() < 0.5 else rng.uniform(0, 2.0**lods, lods).tolist()
    far = int(rng.choice([0, VOXELS_MAX // 2, -VOXELS_MAX + side, VOXELS_MAX - 2 * side]))
    low = [far + int(at) for at in rng.integers(-side, side, 3)]
    high = [first + int(many) for first, many in zip(low, rng.integers(1, 2 * side, 3), strict=True)]
    reach, chunks_max = int(rng.integers(1, 2 * side)), int(rng.choice([64, 100, 300, 16384]))
    error_pixels = float(rng.choice([10.0, 24.0, 60.0]))
    levels = LevelOfDetail(
        world(lods, cells, errors),
        error_pixels=error_pixels,
        reach=reach,
        chunks_max=chunks_max,
        box=((low[0], low[1], low[2]), (high[0], high[1], high[2])),
    )
    lod = int(rng.integers(0, lods))
    at = np.array(low) + rng.uniform(-side, 2 * side, 3)
    corner = [int(place) >> lod for place in at // cells]
    stale = ChunkRange(
        lod, (corner[0] - 1, corner[1] - 1, corner[2] - 1), (corner[0] + 1, corner[1] + 1, corner[2] + 1)
    )
    frames: list[dict[str, Any]] = []
    selection: Selection | None = None
    for _ in range(FRAMES):
        before = selection
        velocity = (rng.normal(0, 1, 3) * rng.choice([0, 0, 40, side])).tolist()
        selection = levels.select(at, velocity, before)
        steps = [] if before is None else swaps(before.chunks, selection.chunks)
        frames.append(
            {
                "position": at.tolist(),
                "velocity": velocity,
                "chunks": _rows(selection.chunks),
                "coarsened": selection.coarsened,
                "swaps": [_rows(step.old | step.new) for step in steps],
                "redraws": [_rows(group) for group in redraws(selection.chunks, [stale])],
            }
        )
        at = at + rng.normal(0, 1, 3) * rng.choice([0, 1, 3, cells, side])
    view = {
        "errorPixels": error_pixels,
        "reach": reach,
        "chunksMax": chunks_max,
        "box": {"low": low, "high": high},
    }
    sharpness = float(rng.uniform(1, 300))
    steps_down = rungs(cells, errors or [0.25 * 2.0**lod for lod in range(lods)], sharpness, reach)
    ladder = {"sharpness": sharpness, "rungs": [[rung.reach, rung.split] for rung in steps_down]}
    ranges = {"lod": stale.lod, "low": stale.low, "high": stale.high}
    return {
        "lods": lods,
        "cells": cells,
        "errors": errors,
        "view": view,
        "frames": frames,
        "stale": ranges,
        "ladder": ladder,
    }


def _rows(chunks: Iterable[FittedChunk]) -> list[list[int]]:
    return sorted(map(list, chunks))
