"""Nodes that are distances: in voxels, negative inside, worked out in float64 and rounded to float32 once.

Shapes stand upright at their centre; `translate`, `rotate`, `scale` and `repeat` move them.
"""

from typing import ClassVar, Literal, Self

from pydantic import model_validator

from chunkserver.recipe.node import Facts, Length, LengthOrZero, Node, Number, Point

_SHRINKS = "{}; it shrinks, and is gone"


class Shape(Node):
    """What shapes share: how deep inside a point can be, and so the feature size."""

    def depth(self) -> float:
        """Return the largest distance from the surface inside, voxels. Twice that is the feature size."""
        raise NotImplementedError


class Sphere(Shape):
    """Distance to a sphere."""

    facts: ClassVar = {"sphere": Facts("|p - center| - radius", "≥ -radius", 0.9, _SHRINKS.format("2 radius"))}
    op: Literal["sphere"] = "sphere"
    center: Point = (0.0, 0.0, 0.0)
    radius: Length

    def depth(self) -> float:
        """Return the radius."""
        return self.radius


class Box(Shape):
    """Distance to a box along the axes, its edges rounded by `rounding` (which does not make it larger)."""

    facts: ClassVar = {
        "box": Facts(
            "|max(q, 0)| + min(max(q_x, q_y, q_z), 0) - rounding, where q = |p - center| - half_extents + rounding",
            "≥ -min(half_extents)",
            1.6,
            _SHRINKS.format("2 min(half_extents)"),
        )
    }
    op: Literal["box"] = "box"
    center: Point = (0.0, 0.0, 0.0)
    half_extents: tuple[Length, Length, Length]
    rounding: LengthOrZero = 0.0

    @model_validator(mode="after")
    def _check_rounding(self) -> Self:
        if self.rounding > min(self.half_extents):
            raise ValueError("the rounding should be at most the smallest half extent")
        return self

    def depth(self) -> float:
        """Return the smallest half extent, rounded as the distance in the middle is."""
        return (min(self.half_extents) - self.rounding) + self.rounding


class Capsule(Shape):
    """Distance to a capsule: all points nearer than `radius` to the segment from a to b."""

    facts: ClassVar = {
        "capsule": Facts(
            "|p - a - t (b - a)| - radius, where t = clamp((p - a) · (b - a) / |b - a|², 0, 1)",
            "≥ -radius",
            1.6,
            _SHRINKS.format("2 radius"),
        )
    }
    op: Literal["capsule"] = "capsule"
    a: Point
    b: Point
    radius: Length

    def depth(self) -> float:
        """Return the radius."""
        return self.radius


class Torus(Shape):
    """Distance to a torus around the y axis through its centre: a ring of `radius`, as thick as 2 `tube`."""

    facts: ClassVar = {
        "torus": Facts(
            "√((√(d_x² + d_z²) - radius)² + d_y²) - tube, where d = p - center",
            "≥ -tube",
            1.6,
            _SHRINKS.format("2 tube"),
        )
    }
    op: Literal["torus"] = "torus"
    center: Point = (0.0, 0.0, 0.0)
    radius: Length
    tube: Length

    def depth(self) -> float:
        """Return the radius of the tube."""
        return self.tube


class Cylinder(Shape):
    """Distance to a cylinder along the y axis through its centre, 2 `half_height` high."""

    facts: ClassVar = {
        "cylinder": Facts(
            "|max(q, 0)| + min(max(q_r, q_y), 0), where q = (√(d_x² + d_z²) - radius, |d_y| - half_height)",
            "≥ -min(radius, half_height)",
            1.6,
            _SHRINKS.format("2 min(radius, half_height)"),
        )
    }
    op: Literal["cylinder"] = "cylinder"
    center: Point = (0.0, 0.0, 0.0)
    radius: Length
    half_height: Length

    def depth(self) -> float:
        """Return the smaller of radius and half height."""
        return min(self.radius, self.half_height)


class Plane(Node):
    """Distance to a plane: rock on the side that the normal points away from. The normal may have any length."""

    facts: ClassVar = {"plane": Facts("p · normal / |normal| - offset", "any", 0.7)}
    op: Literal["plane"] = "plane"
    normal: Point = (0.0, 1.0, 0.0)
    offset: Number = 0.0

    @model_validator(mode="after")
    def _check_normal(self) -> Self:
        if max(map(abs, self.normal)) < 2.0**-20:
            raise ValueError("the normal should have a component of at least 2**-20")
        return self
