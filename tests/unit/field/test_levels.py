"""The fade rule: whole from 8 steps, gone at 4, nothing at LOD 0; what each kind of feature fades to."""

import numpy as np
import pytest

from chunkserver.field.levels import weight
from chunkserver.grid import ChunkKey
from tests.unit.field.chunks import density, lattice


@pytest.mark.parametrize(
    ("size", "lod", "expected"),
    [
        (0.001, 0, 1.0),
        (16.0, 1, 1.0),
        (15.0, 1, 0.875),
        (12.0, 1, 0.5),
        (8.0, 1, 0.0),
        (7.9, 1, 0.0),
        (20.0, 2, 0.25),
        (2.0**23, 20, 1.0),
        (2.0**22, 20, 0.0),
    ],
)
def test_a_feature_is_whole_from_eight_steps_and_gone_at_four(size, lod, expected):
    assert weight(size, lod) == expected


def test_a_feature_never_grows_with_the_level():
    for size in (3.0, 20.0, 50.0, 1e6):
        weights = [weight(size, lod) for lod in range(21)]
        assert weights == sorted(weights, reverse=True)
        assert weights[0] == 1.0


SPHERE = {"op": "sphere", "radius": 6}
CELLS = {"op": "cellular2", "frequency": 1 / 12, "jitter": 1}
EACH = ChunkKey(1, 0, 0, 0)


def test_a_shape_shrinks_evenly():
    """12 voxels across, a sphere has half its weight at LOD 1: half its depth is lost. At LOD 2 nothing is inside."""
    x, y, z = lattice(EACH)
    assert np.allclose(density(SPHERE, EACH), np.sqrt(x * x + y * y + z * z) - 3)
    assert density(SPHERE, ChunkKey(2, 0, 0, 0)).min() == 0
    assert density(SPHERE, ChunkKey(3, 0, 0, 0)).min() == 0


@pytest.mark.parametrize(
    ("shape", "depth"),
    [
        ({"op": "box", "half_extents": [90, 6, 40], "rounding": 2}, 6),
        ({"op": "capsule", "a": [0, 0, 0], "b": [50, 0, 0], "radius": 6}, 6),
        ({"op": "torus", "radius": 40, "tube": 6}, 6),
        ({"op": "cylinder", "radius": 40, "half_height": 6}, 6),
        ({"op": "cylinder", "radius": 6, "half_height": 60}, 6),
    ],
)
def test_shapes_shrink_by_how_thin_they_are(shape, depth):
    whole = density({"op": "translate", "a": shape, "offset": [0, 0, 0]}, ChunkKey(0, 0, 0, 0))[1::2, 1::2, 1::2]
    halved = density(shape, EACH)[1:10, 1:10, 1:10]
    assert np.allclose(halved - whole, depth / 2)


def test_noise_fades_towards_its_mean():
    for tree, mean in ((CELLS, 0.3825 + 0.0480), ({"op": "gradient3", "frequency": 1 / 12}, 0.0)):
        fine = density(tree, ChunkKey(0, 0, 0, 0))[1::2, 1::2, 1::2]
        assert np.allclose(density(tree, EACH)[1:10, 1:10, 1:10], (fine + mean) / 2, atol=1e-6)
        assert np.unique(density(tree, ChunkKey(2, 0, 0, 0))) == [np.float32(mean)]


@pytest.mark.parametrize(("op", "mean"), [("ridged2", 1 - 2 * 0.2533), ("billow2", 2 * 0.2533 - 1)])
def test_the_octaves_of_a_ridge_fade_one_by_one(op, mean):
    """12 and 6 voxels large: at LOD 1 half of the first is left and none of the second."""
    fine = {"op": op, "frequency": 1 / 12, "octaves": 1}
    both = {**fine, "octaves": 2}
    first = density(fine, ChunkKey(0, 0, 0, 0))[1::2, 1::2, 1::2]
    expected = 2 / 3 * (first + mean) / 2 + 1 / 3 * mean
    assert np.allclose(density(both, EACH)[1:10, 1:10, 1:10], expected, atol=1e-6)
    assert np.allclose(density(both, ChunkKey(2, 0, 0, 0)), mean, atol=1e-6)


def test_a_repetition_fades_towards_what_its_node_says():
    lattice_of_spheres = {"op": "repeat", "a": {"op": "x"}, "period": [12, 0, 24], "mean": 5}
    fine = density(lattice_of_spheres, ChunkKey(0, 0, 0, 0))[1::2, 1::2, 1::2]
    assert np.allclose(density(lattice_of_spheres, EACH)[1:10, 1:10, 1:10], (fine + 5) / 2)
    assert np.unique(density(lattice_of_spheres, ChunkKey(2, 0, 0, 0))) == [5]


@pytest.mark.parametrize(
    "larger",
    [
        {"op": "scale", "a": SPHERE, "factor": 4},
        {"op": "scale", "a": SPHERE, "factor": [8, 4, 5]},
        {"op": "detail", "a": {"op": "sphere", "radius": 24}, "factor": 1},
        {"op": "detail", "a": {"op": "scale", "a": {"op": "sphere", "radius": 12}, "factor": 4}, "factor": 1 / 2},
    ],
)
def test_scale_and_detail_change_the_size_of_features(larger):
    """All are 48 voxels large, or are to be taken so: whole at LOD 2, half gone at LOD 3, gone at LOD 4."""
    whole = [density(larger, ChunkKey(lod, 0, 0, 0))[1, 1, 1] for lod in range(5)]
    assert whole == [whole[0]] * 3 + [whole[0] / 2, 0]


def test_detail_keeps_a_feature_a_level_longer():
    kept = {"op": "detail", "a": SPHERE, "factor": 2}
    assert density(kept, EACH)[1, 1, 1] == -6
    assert density(kept, ChunkKey(2, 0, 0, 0))[1, 1, 1] == -3
