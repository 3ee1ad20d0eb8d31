"""The fade rule: whole from 8 steps, gone at 4, nothing at LOD 0."""

import pytest

from chunkserver.field.levels import weight


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
