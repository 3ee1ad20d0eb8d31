"""Where tests get chunks from: worlds of recipes, and grids of made-up densities, cut into chunks."""

from collections.abc import Iterable, Iterator
from itertools import product

import numpy as np
from numpy.typing import NDArray

from chunkserver.field import sample
from chunkserver.grid import APRON_DEFAULT, ChunkKey, ChunkShape
from chunkserver.mesh import Mesh, NormalKind
from chunkserver.mesher import extract
from chunkserver.recipe import WorldRecipe
from chunkserver.samples import Samples

Densities = NDArray[np.float32]
Corner = tuple[int, int, int]

SMALLEST = ChunkShape(16)
"""Enough for whatever does not depend on size."""


def chunk_mesh(recipe: WorldRecipe, key: ChunkKey, cells: int = 32, normals: NormalKind = "int8") -> Mesh:
    """Return the mesh of one chunk of a world."""
    return extract(sample(recipe, key, ChunkShape(cells)), normals=normals)


def keys(lod: int, low: Corner, high: Corner) -> list[ChunkKey]:
    """Return the keys of a box of chunks, `high` excluded."""
    return [ChunkKey(lod, *place) for place in product(*map(range, low, high))]


def box_of_chunks(
    recipe: WorldRecipe, lod: int, low: Corner, high: Corner, cells: int = 32
) -> Iterator[tuple[ChunkKey, Mesh]]:
    """Yield the chunks of a box, `high` excluded."""
    return ((key, chunk_mesh(recipe, key, cells)) for key in keys(lod, low, high))


def grid_mesh(density: Densities, normals: NormalKind = "int8") -> Mesh:
    """Return the mesh of a grid of samples, apron included: a cube, axes (y, z, x)."""
    cells = len(density) - 1 - 2 * APRON_DEFAULT
    return extract(Samples(ChunkShape(cells), np.ascontiguousarray(density, np.float32)), normals=normals)


def one_chunk(density: Densities) -> list[tuple[ChunkKey, Mesh]]:
    """Return a grid of samples as a box of a single chunk."""
    return [(ChunkKey(0, 0, 0, 0), grid_mesh(density))]


def cut(density: Densities, cells: int, normals: NormalKind = "int8") -> Iterator[tuple[ChunkKey, Mesh]]:
    """Yield the chunks of a grid of samples, apron included, that is a whole number of chunks a side."""
    width = cells + 1 + 2 * APRON_DEFAULT
    for x, y, z in product(range(len(density) // cells), repeat=3):
        here = density[y * cells :, z * cells :, x * cells :][:width, :width, :width]
        yield ChunkKey(0, x, y, z), grid_mesh(here, normals)


def in_air(density: Densities) -> Densities:
    """Return the samples with air all around: on the chunk's outer corners and beyond, so that no surface leaves it."""
    closed = np.abs(density) + np.float32(1)
    inner = (slice(APRON_DEFAULT + 1, -APRON_DEFAULT - 1),) * 3
    closed[inner] = density[inner]
    return closed


def white_noise(rng: np.random.Generator, side: int) -> Densities:
    """Return samples that have nothing to do with each other."""
    return rng.uniform(-1, 1, (side, side, side)).astype(np.float32)


def integers(rng: np.random.Generator, side: int) -> Densities:
    """Return small integers, so that many samples are exactly at the isovalue, and some of those are -0.0."""
    whole = rng.integers(-2, 3, (side, side, side)).astype(np.float32)
    return np.asarray(np.where(rng.random(whole.shape) < 0.5, -whole, whole))


def extremes(rng: np.random.Generator, side: int) -> Densities:
    """Return samples of all magnitudes that float32 has below the field's limit, subnormal ones too."""
    magnitude = np.ldexp(rng.uniform(1, 2, (side, side, side)), rng.integers(-149, 16, (side, side, side)))
    return np.asarray(magnitude * rng.choice([-1, 1], magnitude.shape), np.float32)


def smooth(rng: np.random.Generator, side: int) -> Densities:
    """Return a few waves in random directions, longer than four cells."""
    waves = rng.normal(size=(4, 3))
    waves *= rng.uniform(0.5, 1.5, (4, 1)) / np.linalg.norm(waves, axis=1)[:, None]
    phases = rng.uniform(0, 2 * np.pi, (4, 1, 1, 1))
    along = np.tensordot(waves, np.indices((side,) * 3), axes=1)
    return np.asarray(np.sin(along + phases).sum(axis=0), np.float32)


GRIDS = {"white noise": white_noise, "integers": integers, "extremes": extremes, "smooth": smooth}


def total(trees: Iterable[object]) -> object:
    """Return the recipe that is the balanced sum of others."""
    level = list(trees)
    while len(level) > 1:
        pairs = zip(level[::2], level[1::2], strict=False)
        level = [{"op": "add", "a": a, "b": b} for a, b in pairs] + level[len(level) // 2 * 2 :]
    return level[0]


def crowded() -> object:
    """Return a recipe within all limits that needs too many registers.

    Both ends of a clamp are constants, worked out before the first plane and kept to the last.
    """
    chains: list[object] = []
    for chain in range(16):
        tree: object = {"op": "y"}
        for link in range(55):
            tree = {"op": "clamp", "a": tree, "low": -1 - chain - link / 64, "high": 1 + chain + link / 64}
        chains.append(tree)
    return total(chains)
