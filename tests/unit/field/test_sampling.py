"""One chunk's samples: noise against numpy, the lattice, far away, what is refused, and what is proved instead."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from numpy.typing import NDArray

from chunkserver.errors import BadKey, BadParameter
from chunkserver.field import densities, prove, sample
from chunkserver.field.flatten import flatten
from chunkserver.field.interpreter import SLAB_POINTS
from chunkserver.field.intervals import bounds, bounds_of_box
from chunkserver.field.noise.names import noise_name
from chunkserver.grid import ChunkKey, ChunkShape
from chunkserver.recipe import WorldRecipe, builtin
from tests.reference import field_oracle
from tests.unit.field.chunks import KEY, SEED, SHAPE, density, lattice, recipe


def noise_of(basis: str, frequency: float, salt: int, octave: int, at: tuple[NDArray[np.float64], ...]):
    offsets, keys = noise_name(SEED, salt, octave)
    points = np.stack([c.ravel() * frequency + offset for c, offset in zip(at, offsets, strict=True)], 1)
    return getattr(field_oracle, basis)(points, keys).reshape(at[0].shape)


def test_simplex3():
    expected = noise_of("simplex3", 0.07, 3, 0, lattice())
    assert np.abs(density({"op": "simplex3", "frequency": 0.07, "salt": 3}) - expected).max() < 3e-6


@pytest.mark.parametrize(("name", "basis"), [("fbm2", "gradient2"), ("fbm3", "simplex3")])
def test_fbm(name, basis):
    node = {"op": name, "frequency": 0.03, "octaves": 3, "lacunarity": 2.5, "gain": 0.4, "salt": 9}
    octaves = [noise_of(basis, 0.03 * 2.5**k, 9, k + 1, lattice()) * 0.4**k for k in range(3)]
    assert np.abs(density(node) - sum(octaves) / (1 + 0.4 + 0.16)).max() < 3e-6


@pytest.mark.parametrize(("value", "expected"), [(1e6, 65536), (-1e6, -65536), (65536, 65536), (-65535, -65535)])
def test_the_field_is_clamped(value, expected):
    assert np.unique(density(value)) == [expected]


@pytest.mark.parametrize("cells", [16, 32, 64])
@pytest.mark.parametrize("apron", [1, 2])
def test_every_chunk_shape(cells, apron):
    shape = ChunkShape(cells, apron)
    x, y, z = lattice(KEY, shape)
    samples = sample(WorldRecipe(0, builtin("sphere", radius=cells)), KEY, shape)
    assert samples.shape == shape
    assert samples.density.shape == (cells + 1 + 2 * apron,) * 3
    assert np.abs(samples.density - (np.sqrt(x * x + y * y + z * z) - cells)).max() < 1e-4


@pytest.mark.parametrize(
    "key",
    [
        ChunkKey(0, 6_400_000 // 32, 0, 0),
        ChunkKey(0, 0, -6_400_000 // 32, -1),
        ChunkKey(0, 6_400_000 * 3 // 5 // 32, 6_400_000 * 4 // 5 // 32, -1),
    ],
)
def test_a_sphere_of_the_size_of_the_earth_is_round(key):
    """Within 1/1024 voxel of the exact distance, worked out in integers: (d - r)(d + r) = d^2 - r^2."""
    radius = 6_400_000
    got = sample(WorldRecipe(0, builtin("sphere", radius=radius)), key, SHAPE._replace(cells=32)).density
    x, y, z = (c.astype(np.int64) for c in lattice(key, ChunkShape(32)))
    square = x * x + y * y + z * z
    exact = (square - radius * radius) / (np.sqrt(square.astype(np.longdouble)) + radius)
    assert np.abs(exact).min() < 1, "the chunk does hold the surface"
    assert np.abs(got - exact).max() < 1 / 1024


@pytest.mark.parametrize(("basis", "name"), [("gradient2", "fbm2"), ("simplex3", "fbm3")])
@pytest.mark.parametrize("far", [0, 2**36, -(2**36), 2**40 - 32])
def test_noise_at_2_to_the_36_is_smooth_to_a_1024th_of_a_voxel(basis, name, far):
    """Noise 24 voxels high. Its offset is split off exactly here: the cell in integers, the fraction of 64 voxels."""
    key, shape = ChunkKey(0, far // 32, 0, -far // 32 - 1), ChunkShape(32)
    got = 24 * density({"op": name, "frequency": 1 / 64, "octaves": 1}, key, shape).astype(np.float64)
    offsets, keys = noise_name(SEED, 0, 1)
    cells, fractions = zip(*(np.divmod(c.ravel(), 64) for c in lattice(key, shape)), strict=True)
    exact = np.stack([f / 64 + offset for f, offset in zip(fractions, offsets, strict=True)], 1)
    expected = 24 * getattr(field_oracle, basis)(exact, keys, np.stack(cells, 1).astype(np.int64))
    assert np.abs(got.ravel() - expected).max() < 1 / 1024
    assert np.ptp(got) > 1, "the noise does vary over the chunk"


@pytest.mark.parametrize("name", ["terrain", "planet"])
def test_one_box_is_bounded_as_many_are(name):
    tape = flatten(WorldRecipe(SEED, builtin(name)), 0).kept
    for low, high in (((-7, 3, 50), (90, 3, 51)), ((-(2**40), -1, 5), (2**40, 2**40, 6))):
        one = bounds_of_box(tape, low, high)
        both = bounds(tape, *np.array([(low, low), (high, high)], float).transpose(0, 2, 1))
        for known in one._fields:
            assert np.array_equal(getattr(one, known)[..., 0], getattr(both, known)[..., 1])


def test_threads_sample_at_once():
    world, shape = WorldRecipe(SEED, builtin("planet")), ChunkShape(32)
    keys = [ChunkKey(0, 6, y, z) for y in range(-2, 2) for z in range(-2, 2)]
    alone = [sample(world, key, shape).density for key in keys]
    with ThreadPoolExecutor(4) as threads:
        together = list(threads.map(lambda key: sample(world, key, shape).density, keys * 4))
    assert all(np.array_equal(found, expected) for found, expected in zip(together, alone * 4, strict=True))


def test_a_world_is_its_seed():
    noises = [sample(WorldRecipe(seed, builtin("caves")), KEY, SHAPE).density for seed in (7, 8, 7)]
    assert np.array_equal(noises[0], noises[2])
    assert not np.array_equal(noises[0], noises[1])


def test_bad_keys_and_shapes_are_refused():
    recipe = WorldRecipe(7, builtin("plane"))
    with pytest.raises(BadKey):
        sample(recipe, ChunkKey(21, 0, 0, 0), SHAPE)
    with pytest.raises(BadKey):
        sample(recipe, ChunkKey(0, 2**36, 0, 0), SHAPE)
    with pytest.raises(BadParameter):
        sample(recipe, KEY, ChunkShape(17))
    with pytest.raises(BadParameter):
        sample(recipe, KEY, ChunkShape(16, 0))


@pytest.mark.parametrize("name", ["terrain", "planet", "city"])
@pytest.mark.parametrize("lod", [0, 3])
def test_densities_at_lattice_points_are_the_samples(name, lod):
    recipe, key = WorldRecipe(7, builtin(name)), ChunkKey(lod, -1, 0, 2)
    samples = sample(recipe, key, ChunkShape(16)).density
    y, z, x = np.indices(samples.shape).reshape(3, -1) - 1
    points = np.array(key.low_corner(16)) + key.step * np.stack((x, y, z), axis=1)
    assert len(points) > 4 * SLAB_POINTS
    order = np.random.default_rng(1).permutation(len(points))
    found = densities(recipe, lod, points[order].astype(np.float64))
    assert np.array_equal(found, samples.reshape(-1)[order])
    assert densities(recipe, lod, np.empty((0, 3))).shape == (0,)


GONE_AT_LOD_1 = {"op": "detail", "a": {"op": "sphere", "radius": 64}, "factor": 1 / 16}
"""A ball of rock at LOD 0; from LOD 1 on there is none."""
BESIDE = {"op": "subtract", "a": {"op": "x"}, "b": 17.5}
"""Rock in all samples of the chunk at the origin, apron included; the next level's reach as far as x = 18."""
ORIGIN, INSIDE = ChunkKey(0, 0, 0, 0), ChunkKey(0, 1, 1, 1)


def inside_out(tree: object) -> object:
    return {"op": "subtract", "a": 0, "b": tree}


@pytest.mark.parametrize(
    ("tree", "key", "mask", "proven"),
    [
        (BESIDE, ORIGIN, 1, True),
        (BESIDE, ORIGIN, 2, False),
        (BESIDE, ORIGIN, 63, False),
        (GONE_AT_LOD_1, INSIDE, 1, False),
        (GONE_AT_LOD_1, INSIDE, 63, False),
    ],
)
def test_a_chunk_is_proved_by_its_own_level_and_the_next(tree, key, mask, proven):
    for world, content in ((recipe(tree), "rock"), (recipe(inside_out(tree)), "air")):
        assert prove(world, key, SHAPE) == content
        assert prove(world, key, SHAPE, mask) == (content if proven else None)
        samples = sample(world, key, SHAPE, mask)
        assert samples.coarse is not None
        assert ((samples.density < 0) == (content == "rock")).all()
        assert ((samples.coarse < 0) == (content == "rock")).all() == proven
