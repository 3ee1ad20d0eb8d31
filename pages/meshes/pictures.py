"""Every picture of meshes in the docs, a row each, and the page that shows them: docs/meshes.md."""

from typing import Final, NamedTuple

from chunkserver.grid import ChunkKey
from pages.grounds import GRASS, RUST, Ground
from pages.light import Light
from pages.meshes.chunks import Seam, around, box, rings
from pages.meshes.drawing import View
from pages.scenes import Camera, Point

HALF: Final = (640, 400)
THIRD: Final = (426, 400)
WIDE: Final = (1280, 640)
LOW: Final = (1280, 360)


class Panel(NamedTuple):
    """A view and what is written in its corner; `{triangles}` and `{chunks}` stand for how many there are."""

    label: str
    view: View


class Picture(NamedTuple):
    """One picture, docs/pictures/meshes/{name}.jpg: panels side by side, so many to a row, and what is seen in it."""

    name: str
    title: str
    caption: str
    panels: tuple[Panel, ...]
    columns: int = 1


def _camera(eye: Point, target: Point, size: tuple[int, int], across: float = 45.0) -> Camera:
    return Camera(eye, target, across=across, width=size[0], height=size[1])


_CLAY: Final = Ground(
    low=(0.34, 0.27, 0.20), high=(0.36, 0.29, 0.22), steep=(0.29, 0.215, 0.155), hidden=(0.2, 0.16, 0.13)
)
_RED: Final = Ground(
    low=(0.26, 0.16, 0.085),
    high=(0.42, 0.21, 0.105),
    steep=(0.45, 0.17, 0.07),
    hidden=(0.25, 0.10, 0.05),
    change=(-70, 40),
)
_MORNING: Final = Light(azimuth=50, elevation=30)

_LEVEL: Final = View(
    "terrain",
    (),
    _camera((46, 46, 62), (4, -4, 0), HALF, 50),
    "lods",
    _MORNING,
    lines=("triangles",),
)
_RIMS: Final = View(
    "terrain",
    rings((0, 1, 2), 2, -32, 32),
    _camera((60, 75, 165), (0, -10, 10), LOW, 58),
    "lods",
    _MORNING,
    lines=("triangles", "rims"),
)
_BORDER: Final = View(
    "hills",
    box(1, (-2, -1, 1), (0, 1, 2)) + box(2, (-1, -1, 1), (0, 1, 2)),
    _camera((-80, 8, 92), (-84, -11, 128), THIRD, 34),
    _CLAY,
    Light(azimuth=-60, elevation=35),
)
_SEAMS: Final[tuple[Seam, ...]] = ("none", "skirts", "transitions")
_NEAR: Final = View(
    "terrain", box(0, (-1, -1, -1), (2, 1, 2)), _camera((40, 34, 56), (12, 0, 10), THIRD, 22), _CLAY, _MORNING
)

PICTURES: Final = (
    Picture(
        "canyon",
        "Terrain",
        "One level of detail, 12 × 20 chunks in three layers. Each chunk was made alone; nothing was welded or "
        "smoothed afterwards, and no seam shows. Triangles are drawn where they are large enough to be seen.",
        (
            Panel(
                "canyon · LOD 1 · {chunks} chunks · {triangles} triangles",
                View(
                    "canyon",
                    box(1, (-6, -2, -15), (6, 1, 5)),
                    _camera((0, 70, 260), (0, -36, -60), WIDE, 55),
                    _RED,
                    Light(azimuth=40, elevation=30, haze=1500),
                    lines=("triangles",),
                ),
            ),
        ),
    ),
    Picture(
        "chunk",
        "A chunk",
        "The chunk in the middle as triangles, its neighbours in grey. White lines are the borders, where neighbours "
        "have the same vertices, to the bit, and the same normals.",
        (
            Panel(
                "canyon · LOD 1 · chunk (-1, -1, 1) and its neighbours",
                View(
                    "canyon",
                    box(1, (-3, -2, -1), (2, 1, 3)),
                    _camera((40, 75, 260), (-32, -34, 84), WIDE, 40),
                    "chunks",
                    _MORNING,
                    lines=("triangles", "borders"),
                    focus=ChunkKey(1, -1, -1, 1),
                ),
            ),
        ),
    ),
    Picture(
        "levels",
        "Levels of detail",
        "The same place at four levels. A level has cells twice as wide as the one before, and about a quarter of "
        "its triangles. What it cannot show, like the caves from LOD 2 on, has faded out instead of breaking into "
        "speckles.",
        tuple(
            Panel(f"LOD {lod} · cells of {1 << lod} m", _LEVEL._replace(keys=box(lod, (-r, -r, -r), (r, r, r))))
            for lod, r in ((0, 4), (1, 2), (2, 1), (3, 1))
        ),
        columns=2,
    ),
    Picture(
        "seams",
        "Where levels meet",
        "A border between LOD 1, in front, and LOD 2, shaded and as wireframe. Left nothing closes it (`seam=none`): "
        "the levels have fields of their own, and the backdrop shows where these disagree. In the middle skirts: the "
        "border of each chunk is drawn out into the rock, and covers the gap; [skirts.md](skirts.md) counts what they "
        "leave. Right transitions: the last row of cells of the finer chunk leads over to the coarser one, and nothing "
        "is open.",
        tuple(
            Panel(f"{seam} · hills", view._replace(seam=seam))
            for view in (_BORDER, _BORDER._replace(tint="lods", lines=("triangles",)))
            for seam in _SEAMS
        ),
        columns=3,
    ),
    Picture(
        "rims",
        "Open edges",
        "Levels side by side, welded by exact equality. Red are the edges that stay open. Above `seam=none`: between "
        "chunks of one level there are none, between levels there are. Below transitions: none is left but around all "
        "that is drawn.",
        tuple(Panel(f"{seam} · terrain · LOD 0 to 2", _RIMS._replace(seam=seam)) for seam in ("none", "transitions")),
    ),
    Picture(
        "normals",
        "Normals",
        "Left with a normal per triangle, in the middle with the normals of the mesh, right these normals themselves, "
        "x y z as red green blue.",
        (
            Panel("normals of triangles", _NEAR._replace(flat=True)),
            Panel("normals of the mesh", _NEAR),
            Panel("x y z as red green blue", _NEAR._replace(tint="normals")),
        ),
        columns=3,
    ),
    Picture(
        "caves",
        "Caves",
        "A piece of terrain from the side, cut off at the faces of its chunks. Seen from the rock, which is dark here, "
        "caves are bubbles and tubes; some of them open into the day.",
        (
            Panel(
                "terrain · LOD 0 · {triangles} triangles",
                View(
                    "terrain",
                    box(0, (-2, -2, -2), (2, 1, 2)),
                    _camera((85, 20, 110), (0, -22, 0), WIDE, 50),
                    GRASS,
                    _MORNING,
                    lines=("borders",),
                ),
            ),
        ),
    ),
    Picture(
        "planet",
        "A planet",
        "There is no map projection: the chunks of a planet are cubes like all others. White lines are their borders.",
        (
            Panel(
                "planet · LOD 1 · {chunks} chunks · {triangles} triangles",
                View(
                    "planet",
                    box(1, (-4, -4, -4), (4, 4, 4)),
                    _camera((330, 330, 660), (0, 0, 0), WIDE, 62),
                    RUST._replace(radius=200.0),
                    Light(azimuth=30, elevation=25),
                    lines=("borders",),
                ),
            ),
        ),
    ),
    Picture(
        "planet-levels",
        "A planet at four levels",
        "A planet of radius 800. The chunks near one place are fine, and the farther they are the coarser: LOD 1 is "
        "green, 2 blue, 3 violet, 4 red. Caves are seen at LOD 1, relief at all. All chunks that touch differ by one "
        "level at most, each is asked for with the mask of its coarser neighbours, and the whole is closed.",
        (
            Panel(
                "planet · LOD 1 to 4 · {chunks} chunks · {triangles} triangles",
                View(
                    {"builtin": "planet", "radius": 800},
                    around((-250, 500, 560), (1, 2, 3, 4), 2),
                    _camera((500, 1500, 2300), (0, 0, 0), WIDE, 68),
                    "lods",
                    Light(azimuth=120, elevation=35),
                    lines=("triangles", "borders"),
                ),
            ),
        ),
    ),
)
