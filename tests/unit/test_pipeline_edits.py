"""Chunks of a world with edits: the bytes of their edited samples, and which of them need not be sampled."""

from dataclasses import replace

import numpy as np
import pytest

from chunkserver import pipeline
from chunkserver.edits import Bricks, Deltas, Edit
from chunkserver.edits.boxes import Box
from chunkserver.field import sample
from chunkserver.geometric_error import geometric_error
from chunkserver.grid import ChunkKey, ChunkShape
from chunkserver.mesher import extract
from chunkserver.pipeline import SKIRTS, ChunkRequest, Edited, build_chunk, build_mesh
from chunkserver.recipe import WorldRecipe, builtin
from chunkserver.samples import Samples, coarse_box
from chunkserver.wire import Encoding, Placement, encode
from tests.strokes import dense, field_of, no_bricks, random_stroke
from tests.worlds import Densities

ISLANDS = WorldRecipe(42, builtin("floating-islands"))
"""Of pristine chunks only what the mesh reads is sampled."""
PLANE = WorldRecipe(0, builtin("plane"))
CELLS = 16


def request_of(recipe: WorldRecipe, key: ChunkKey, **more) -> ChunkRequest:
    return ChunkRequest(recipe, key, CELLS, revision=5, **more)


def edited_of(bricks: Bricks, request: ChunkRequest) -> Edited:
    return Edited(bricks.arena.deltas, Deltas.of(bricks, request.key, ChunkShape(request.cells), request.coarser))


def added(recipe: WorldRecipe, bricks: Bricks, key: ChunkKey, coarser: int) -> Samples:
    """Return the samples of an edited chunk, the deltas read brick by brick."""
    samples = sample(recipe, key, ChunkShape(CELLS), coarser)
    _add(bricks, key.lod, [CELLS * at - 1 for at in key[1:]], samples.density)
    if samples.coarse is not None:
        low = coarse_box(CELLS, coarser).low
        _add(bricks, key.lod + 1, [CELLS // 2 * at + by for at, by in zip(key[1:], low, strict=True)], samples.coarse)
    return samples


def _add(bricks: Bricks, lod: int, low: list[int], density: Densities) -> None:
    (x, y, z), (planes, rows, width) = low, density.shape
    deltas = dense(bricks, lod, Box((x, y, z), (x + width - 1, y + planes - 1, z + rows - 1)))
    density[...] = (density.astype(np.float64) + deltas / 1024).astype(np.float32)


def ball(op: str, *center: float, radius: float = 6.0) -> Edit:
    return Edit.of([{"op": op, "shape": "sphere", "center": list(center), "radius": radius}])


@pytest.mark.parametrize("recipe", [ISLANDS, WorldRecipe(7, builtin("terrain"))])
@pytest.mark.parametrize("more", [{}, {"coarser": 1}, {"coarser": 42}, {"seam": SKIRTS}])
def test_a_chunk_is_made_of_its_edited_samples(recipe, more, rng):
    strokes = [random_stroke(rng, tuple(rng.uniform(-24, 24, 3)), float(rng.uniform(3, 9))) for _ in range(12)]
    bricks = no_bricks().apply([Edit.of(strokes)], 5, field_of(recipe))
    surfaces = 0
    for key in (ChunkKey(lod, x, y, z) for lod in (0, 1) for x in (-1, 0) for y in (-1, 0) for z in (-1, 0)):
        request = request_of(recipe, key, **more)
        mesh = extract(added(recipe, bricks, key, request.coarser), skirts="seam" in more)
        error = geometric_error(recipe, key.lod)
        placement = Placement(key, CELLS, 1.0, 5, request.coarser, error)
        chunk = build_chunk(request, edited=edited_of(bricks, request))
        assert (chunk.content, chunk.body) == (mesh.content, encode(mesh, placement, Encoding()))
        assert chunk.revision == 5
        surfaces += chunk.content == "surface"
    assert surfaces > 2


def test_what_no_edit_has_changed_is_as_it_was():
    bricks = no_bricks().apply([ball("carve", 8, -8, 8)], 5, field_of(PLANE))
    for recipe, key in (
        (PLANE, ChunkKey(0, 5, -1, 0)),
        (PLANE, ChunkKey(0, 5, -3, 0)),
        (ISLANDS, ChunkKey(0, 9, 0, 9)),
    ):
        request = request_of(recipe, key)
        assert build_chunk(request, edited=edited_of(bricks, request)).body == build_chunk(request).body


@pytest.mark.parametrize(
    ("op", "y", "content", "is_sampled"),
    [
        ("carve", 40, "air", False),
        ("fill", 40, "surface", True),
        ("fill", -40, "rock", False),
        ("carve", -40, "surface", True),
    ],
)
def test_only_deltas_that_may_cross_the_surface_have_a_proven_chunk_sampled(op, y, content, is_sampled, monkeypatch):
    """An edit inside a chunk that is proven empty appears."""
    bricks = no_bricks().apply([ball(op, 8, y, 8), ball(op, 8, y + 3, 8)], 5, field_of(PLANE))
    request = request_of(PLANE, ChunkKey(0, 0, y // CELLS, 0))
    sampled = []

    def noted(*given):
        sampled.append(given)
        return sample(*given)

    monkeypatch.setattr(pipeline, "sample", noted)
    assert build_mesh(request, edited=edited_of(bricks, request)).content == content
    assert bool(sampled) is is_sampled


def test_deltas_of_the_next_level_count_too():
    """A chunk of rock whose own samples no edit has reached, beside a coarser one that an edit has."""
    bricks = no_bricks().apply([ball("carve", 26, -40, 8)], 5, field_of(PLANE))
    keys = [ChunkKey(0, x, -3, 0) for x in range(-1, 4)]
    requests = [replace(request_of(PLANE, key), coarser=mask) for key in keys for mask in range(64)]
    for request in requests:
        deltas = edited_of(bricks, request).deltas
        assert deltas.range == (
            min(deltas.own.low, deltas.coarse.low if deltas.coarse else 0),
            max(deltas.own.high, deltas.coarse.high if deltas.coarse else 0),
        )
        mesh = extract(added(PLANE, bricks, request.key, request.coarser))
        assert build_mesh(request, edited=edited_of(bricks, request)).content == mesh.content
