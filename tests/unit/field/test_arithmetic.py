"""Densities made of densities, each against its formula in numpy's float64."""

import numpy as np
import pytest

from tests.unit.field.chunks import density, lattice

X, Y, Z = ({"op": axis} for axis in "xyz")
ROUNDING = 2.0**-22
"""Of the largest number that goes in: a few roundings of float32."""


@pytest.mark.parametrize("axis", ["x", "y", "z"])
def test_axes(axis):
    assert np.array_equal(density({"op": axis}), lattice()["xyz".index(axis)])


@pytest.mark.parametrize("value", [0, -3.5, 0.1])
def test_constant(value):
    assert np.array_equal(density(value), np.full((19,) * 3, np.float32(value)))


@pytest.mark.parametrize(
    ("name", "of"),
    [("add", np.add), ("subtract", np.subtract), ("multiply", np.multiply), ("min", np.minimum), ("max", np.maximum)],
)
def test_binaries(name, of):
    x, _, z = lattice()
    assert np.array_equal(density({"op": name, "a": X, "b": Z}), of(x, z))


def test_abs_and_clamp():
    x, _, z = lattice()
    assert np.array_equal(density({"op": "abs", "a": X}), np.abs(x))
    assert np.array_equal(density({"op": "clamp", "a": Z, "low": 17.5, "high": 20}), np.clip(z, 17.5, 20))
    assert np.unique(density({"op": "clamp", "a": Z, "low": 3, "high": 3})) == [3]


@pytest.mark.parametrize("radius", [0.001, 4.0, 300.0])
def test_smooth_minimum_and_maximum(radius):
    x, y, _ = lattice()
    rounded = np.maximum(radius - np.abs(x - y), 0) ** 2 / (4 * radius)
    for op, expected in (("smooth_min", np.minimum(x, y) - rounded), ("smooth_max", np.maximum(x, y) + rounded)):
        got = density({"op": op, "a": X, "b": Y, "radius": radius})
        assert np.abs(got - expected).max() <= ROUNDING * max(radius, 32)


def test_a_smooth_minimum_is_the_minimum_where_its_operands_are_far_apart():
    x, y, _ = lattice()
    got = density({"op": "smooth_min", "a": X, "b": Y, "radius": 2})
    apart = np.abs(x - y) >= 2
    assert np.array_equal(got[apart], np.minimum(x, y)[apart])
    assert (got[~apart] < np.minimum(x, y)[~apart]).all()


SELECT = {"op": "select", "by": X, "below": Y, "above": Z}


@pytest.mark.parametrize(("at", "width"), [(-8.0, 10.0), (-8.5, 3.0), (-100.0, 5.0), (0.1, 2.0**-20)])
def test_select_blends(at, width):
    x, y, z = lattice()
    t = np.clip((x - at) / width + 0.5, 0, 1)
    expected = y + t * t * (3 - 2 * t) * (z - y)
    got = density({**SELECT, "at": at, "width": width})
    assert np.abs(got - expected).max() <= 64 * ROUNDING
    assert np.array_equal(got[t == 0], y[t == 0])
    assert np.array_equal(got[t == 1], z[t == 1])


def test_select_without_a_width_is_a_step():
    """Exactly at the threshold it is `above`."""
    x, y, z = lattice()
    assert np.array_equal(density({**SELECT, "at": -8}), np.where(x < -8, y, z))


POINTS = [(-15, 3), (-9.5, 3), (-8, -40), (-7.75, 100), (1, 0.5)]


@pytest.mark.parametrize("points", [POINTS, POINTS[:2], [(-9, 1), (-9 + 2**-20, 2)], [(2, 5), (9, 6)]])
def test_remap_is_the_curve(points):
    x, _, _ = lattice()
    rising, values = zip(*points, strict=True)
    got = density({"op": "remap", "a": X, "points": points})
    highest = max(map(abs, values))
    assert np.abs(got - np.interp(x, rising, values)).max() <= ROUNDING * len(points) * highest
    assert (got[x <= rising[0]] == values[0]).all()


def test_remap_meets_its_knots():
    """And is flat beyond the first and the last of them."""
    for at, to in POINTS:
        assert density({"op": "remap", "a": at, "points": POINTS})[0, 0, 0] == pytest.approx(to, abs=1e-4)
    for at, to in ((-1e6, 3), (1e6, 0.5)):
        assert density({"op": "remap", "a": at, "points": POINTS})[0, 0, 0] == pytest.approx(to, abs=1e-4)


def test_heightfield_is_worked_out_in_float64():
    """At 2^36 voxels up, where float32 has steps of 4096, the height's fraction is still there."""
    up = 2.0**36
    ground = {"op": "heightfield", "height": {"op": "multiply", "a": X, "b": 0.125}}
    x, y, _ = lattice()
    raised = {"op": "translate", "a": {"op": "translate", "a": ground, "offset": [0, up, 0]}, "offset": [0, -up, 0]}
    assert np.array_equal(density(ground), y - x / 8)
    assert np.array_equal(density(raised), y - x / 8)
