"""Every picture in the docs, a row each: a new one is a new row, and `python -m pages picture-NAME` draws it alone."""

from typing import Final, NamedTuple

from pages.grounds import ALPINE, GRASS, ROCK, RUST, Ground
from pages.light import Light
from pages.renderer import Look
from pages.scenes import Camera, Extent

PLANET_RADIUS: Final = 200.0
WIDE: Final = (1280, 720)
MIDDLE: Final = (960, 540)
SMALL: Final = (640, 360)


class View(NamedTuple):
    """One picture: docs/recipes/pictures/{name}.jpg.

    recipe: what a user may post: the name of a built-in, or `{"builtin": name, ...}`.
    """

    name: str
    recipe: str | dict[str, object]
    camera: Camera
    light: Light
    ground: Ground
    extent: Extent
    look: Look = "ground"
    seed: int = 42


def _camera(eye: tuple[float, float, float], target: tuple[float, float, float], size: tuple[int, int]) -> Camera:
    return Camera(eye, target, width=size[0], height=size[1])


_VALLEY: Final = View(
    "terrain",
    "terrain",
    _camera((240, 16, -100), (200, 10, -130), WIDE),
    Light(azimuth=-100, elevation=30, haze=1400),
    GRASS,
    Extent(far=2500, floor=-24),
)
_BALL: Final = View(
    "sphere",
    "sphere",
    _camera((108, 72, 132), (0, 0, 0), SMALL),
    Light(azimuth=10, elevation=40, haze=5000),
    ROCK,
    Extent(far=400),
)

_SEA: Final = Ground(
    low=(0.02, 0.16, 0.19),
    high=(0.10, 0.15, 0.045),
    steep=(0.30, 0.27, 0.22),
    hidden=(0.20, 0.18, 0.15),
    change=(-6, 6),
)
_OCEANS: Final = _SEA._replace(
    low=(0.012, 0.055, 0.12), high=(0.12, 0.145, 0.055), steep=(0.26, 0.22, 0.17), change=(-12, 10), radius=10_000.0
)
_RED: Final = Ground(
    low=(0.26, 0.16, 0.085),
    high=(0.42, 0.21, 0.105),
    steep=(0.45, 0.17, 0.07),
    hidden=(0.25, 0.10, 0.05),
    change=(-70, 40),
)
_SAND: Final = Ground(
    low=(0.45, 0.33, 0.20), high=(0.42, 0.30, 0.20), steep=(0.38, 0.20, 0.16), hidden=(0.20, 0.10, 0.10), slope=0.8
)
_DUST: Final = Ground(
    low=(0.17, 0.165, 0.16),
    high=(0.27, 0.265, 0.26),
    steep=(0.20, 0.195, 0.19),
    hidden=(0.10, 0.10, 0.10),
    change=(-20, 20),
    radius=400.0,
)
_CONCRETE: Final = Ground(
    low=(0.14, 0.14, 0.15), high=(0.42, 0.40, 0.37), steep=(0.38, 0.35, 0.31), hidden=(0.2, 0.2, 0.2), change=(1, 9)
)
_INSIDE: Final = Ground(
    low=(0.19, 0.155, 0.12),
    high=(0.19, 0.155, 0.12),
    steep=(0.20, 0.17, 0.13),
    hidden=(0.065, 0.10, 0.03),
    radius=640.0,
)
"""What is "hidden" on a ball is the land on the inside of a ring."""

_SHAPES: Final[dict[str, object]] = {
    "op": "max",
    "a": {
        "op": "smooth_min",
        "a": {
            "op": "smooth_min",
            "a": {"op": "y"},
            "b": {"op": "sphere", "center": [0, 12, 0], "radius": 24},
            "radius": 16,
        },
        "b": {"op": "torus", "center": [0, 14, 0], "radius": 48, "tube": 6},
        "radius": 16,
    },
    "b": {"op": "multiply", "a": {"op": "capsule", "a": [0, 40, 0], "b": [0, 16, 0], "radius": 12}, "b": -1},
}
_TERRACES: Final[dict[str, object]] = {
    "op": "heightfield",
    "height": {
        "op": "remap",
        "points": [[-0.4, -20], [-0.12, -16], [-0.04, 0], [0.08, 3], [0.14, 16], [0.26, 19], [0.34, 38], [0.6, 44]],
        "a": {
            "op": "warp",
            "a": {"op": "fbm2", "frequency": 0.006, "octaves": 5},
            "x": {"op": "multiply", "a": {"op": "fbm2", "frequency": 0.01, "octaves": 3, "salt": 1}, "b": 30},
            "z": {"op": "multiply", "a": {"op": "fbm2", "frequency": 0.01, "octaves": 3, "salt": 2}, "b": 30},
        },
    },
}
_TOWERS: Final[dict[str, object]] = {
    "op": "min",
    "a": {"op": "y"},
    "b": {
        "op": "repeat",
        "period": [56, 0, 56],
        "mean": 16,
        "a": {
            "op": "select",
            "by": {"op": "random", "salt": 3},
            "below": {
                "op": "add",
                "a": {"op": "sphere", "radius": 16},
                "b": {"op": "multiply", "a": {"op": "random", "salt": 2}, "b": 3},
            },
            "above": {
                "op": "warp",
                "a": {"op": "box", "half_extents": [10, 40, 10], "rounding": 2},
                "y": {"op": "add", "a": {"op": "multiply", "a": {"op": "random", "salt": 1}, "b": 20}, "b": 20},
            },
        },
    },
}
"""The recipes of the guide, as they stand there (`tests/contract/test_recipe_guide.py`)."""

VIEWS: Final = (
    _VALLEY,
    _VALLEY._replace(name="terrain-levels", look="levels", extent=Extent(far=2500, floor=-24, cell_pixels=12)),
    View(
        "terrain-cave",
        "terrain",
        _camera((144.3, 6.5, -248.4), (131, 0.5, -259), WIDE),
        Light(azimuth=75, elevation=38, haze=1400),
        GRASS,
        Extent(far=1500, floor=-24),
    ),
    View(
        "hills",
        {"builtin": "hills", "relief": 60},
        _camera((0, 50, 0), (100, 37, 60), WIDE),
        Light(azimuth=130, elevation=30, haze=1200),
        ALPINE,
        Extent(far=3000, floor=-70),
    ),
    View(
        "planet",
        "planet",
        Camera((0, 250, 920), (0, 0, 0), across=50),
        Light(azimuth=40, elevation=25, space=True),
        RUST._replace(radius=PLANET_RADIUS),
        Extent(far=1400, floor=-30, radius=PLANET_RADIUS),
    ),
    View(
        "planet-ground",
        "planet",
        Camera((0, 222, 30), (60, 184, -40), up=(0.0, 1.0, 0.1)),
        Light(azimuth=60, elevation=35, space=True),
        RUST._replace(radius=PLANET_RADIUS),
        Extent(far=800, floor=-30, radius=PLANET_RADIUS),
    ),
    _BALL,
    _BALL._replace(name="sphere-normals", look="normals"),
    View(
        "islands",
        "islands",
        _camera((0, 110, -260), (200, 0, 200), MIDDLE),
        Light(azimuth=150, elevation=32, haze=2500),
        _SEA,
        Extent(far=3500, floor=-30),
    ),
    View(
        "canyon",
        "canyon",
        _camera((140, 40, 120), (235, -40, -110), MIDDLE),
        Light(azimuth=-20, elevation=32, haze=2500),
        _RED,
        Extent(far=2500, floor=-90),
    ),
    View(
        "floating-islands",
        "floating-islands",
        _camera((-20, 70, -330), (80, 10, 0), MIDDLE),
        Light(azimuth=-140, elevation=35, haze=1300),
        GRASS._replace(change=(-10000, -9000)),
        Extent(far=1500, floor=-600, cell_pixels=3.5),
    ),
    View(
        "arches",
        "arches",
        _camera((0, 50, -150), (100, 20, 100), MIDDLE),
        Light(azimuth=-160, elevation=25, haze=1400),
        _SAND,
        Extent(far=2000, floor=-40),
    ),
    View(
        "moon",
        "moon",
        Camera((0, 420, 1120), (0, 0, 0), across=50, width=MIDDLE[0], height=MIDDLE[1]),
        Light(azimuth=28, elevation=20, space=True),
        _DUST,
        Extent(far=1600, floor=-110, radius=400.0),
    ),
    View(
        "city",
        "city",
        _camera((44, 150, -330), (110, 60, 0), MIDDLE),
        Light(azimuth=170, elevation=32, haze=1200),
        _CONCRETE,
        Extent(far=2000, floor=-4),
    ),
    View(
        "spires",
        "spires",
        _camera((0, 90, -150), (100, 60, 100), MIDDLE),
        Light(azimuth=-150, elevation=28, haze=900),
        GRASS._replace(slope=0.6),
        Extent(far=1800, floor=-50),
    ),
    View(
        "ring",
        "ring",
        Camera((0, 20, -575), (300, -10, -470), up=(0, 0, 1), across=95, width=MIDDLE[0], height=MIDDLE[1]),
        Light(azimuth=70, elevation=50, haze=20000),
        _INSIDE,
        Extent(far=1600),
    ),
    View(
        "continents",
        "continents",
        Camera((9400, 7800, 27000), (0, 0, 0), across=62, width=MIDDLE[0], height=MIDDLE[1]),
        Light(azimuth=60, elevation=30, space=True),
        _OCEANS,
        Extent(far=40_000, floor=-330, radius=10_000.0),
    ),
    View(
        "guide-shapes",
        _SHAPES,
        _camera((70, 62, 100), (0, 8, 0), SMALL),
        Light(azimuth=10, elevation=35, haze=2000),
        _SAND,
        Extent(far=900, floor=-4),
    ),
    View(
        "guide-terraces",
        _TERRACES,
        _camera((0, 110, 0), (150, 20, 150), SMALL),
        Light(azimuth=120, elevation=30, haze=1500),
        GRASS,
        Extent(far=1500, floor=-40),
    ),
    View(
        "guide-city",
        _TOWERS,
        _camera((28, 90, -150), (80, 20, 60), SMALL),
        Light(azimuth=160, elevation=35, haze=900),
        _CONCRETE,
        Extent(far=1000, floor=-4),
    ),
)
