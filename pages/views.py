"""Every picture in the docs, a row each: a new one is a new row, and `python -m pages picture-NAME` draws it alone."""

from typing import Final, NamedTuple

from pages.grounds import ALPINE, GRASS, ROCK, RUST, Ground
from pages.light import Light
from pages.renderer import Look
from pages.scenes import Camera, Extent

PLANET_RADIUS: Final = 200.0
WIDE: Final = (1280, 720)
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

VIEWS: Final = (
    _VALLEY,
    _VALLEY._replace(name="terrain-levels", look="levels", extent=Extent(far=2500, floor=-24, cell_pixels=12)),
    View(
        "terrain-cave",
        "terrain",
        _camera((70, 8.5, -1), (60.5, 4.2, -13.5), WIDE),
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
)
