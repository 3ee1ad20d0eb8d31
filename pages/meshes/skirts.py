"""What skirts cover, and where they show: pixels of views of several levels, without skirts, with them, and closed.

A ray through a pixel begins in the air. In a closed surface the first thing that it meets, if any, is a front: the side
that faces the air. So two kinds of pixel are wrong:

- a **hole** shows nothing, or the rock's side of the surface, where the closed surface of the same chunks (transitions)
  shows a front, in this pixel and in the eight around it: a silhouette may lie a pixel aside. The front of a skirt
  covers it, the back does not.
- a **wall** shows a skirt, from either side, where without skirts a front is seen behind it, or where the closed
  surface is elsewhere: more than OFF_VOXELS nearer or farther, or nowhere at all.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_erosion, binary_fill_holes

from chunkserver.recipe import WorldRecipe, canonical
from chunkserver_client import ChunkMesh
from pages.meshes.chunks import Corner, around, served
from pages.meshes.raster import Plane, Stage
from pages.scenes import Camera, Point

Mask = NDArray[np.bool_]

SAME_VOXELS: Final = 0.05
"""What is no farther apart along the view is one thing: a fold of the surface, the upper edge of a skirt."""
OFF_VOXELS: Final = 2.0
"""What the levels of these views may disagree by."""
FULL: Final = (640, 400)
SEED: Final = 42

PAGE: Final = Path("skirts.md")
HEAD: Final = """\
<!-- Written by `python -m pages skirts`: change pages/meshes/skirts.py, not this page. -->
# What skirts cover

`seam=skirts` is for clients that do not know their neighbours' level ([api.md](api.md#borders)). What it covers, and
where it shows itself, is counted here in pixels: views of 640 × 400 of chunks of several levels, finer ones nearer to
one place, without skirts, with them, and closed by transitions.

A ray through a pixel begins in the air. In a closed surface the first thing that it meets, if any, is a front: the side
that faces the air.

- A **hole** is a pixel that shows nothing, or the rock's side of the surface, where the closed surface of the same
  chunks shows a front, in this pixel and in the eight around it: a silhouette may lie a pixel aside. A skirt covers it
  with its own front alone, as for clients that draw one side.
- A **wall** is a pixel that shows a skirt, from either side, where a front would be seen without it, or where the
  closed surface is more than 2 voxels nearer or farther, or nowhere. Nearer than 0.05 voxels is the same place.
- **Background** are pixels of the closed surface itself that show nothing and have surface all around, **folds** those
  that show the rock's side of it: where a rasteriser rounds, or a border between levels leans over.

Where levels are two apart, no transitions close them: holes are counted where chunks of all levels would show a front,
from eyes that see no sky, and walls are those that hide a front.

A skirt ends where it would leave the rock that its own chunk knows of. Its neighbour may know better: at the edges of a
chunk, fins as high as the levels disagree can stand before a gap.

| view | pixels of surface | background, folds | holes without | holes with skirts | walls | in 10,000 | triangles |
|---|---|---|---|---|---|---|---|
"""
ROW: Final = (
    "| {name} | {land} | {background}, {folds} | {holes_without} | {holes_with} | {walls} | {share} | +{more} |\n"
)


class Lookout(NamedTuple):
    """Chunks of several levels and the eyes that look at them.

    middle, lods, reach: as for `around`. eyes: from where and whither, voxels. Where `lods` leaves levels out, borders
    are two levels apart, no transitions close them, and walls are only those that hide the surface.
    """

    name: str
    recipe: str
    middle: Corner
    lods: tuple[int, ...]
    reach: int
    eyes: tuple[tuple[Point, Point], ...]


class Figures(NamedTuple):
    """Pixels of all views of a lookout together, and triangles.

    land: pixels that show the closed surface. background: those that show nothing in the closed surface and have land
    all around. folds: those that show the rock's side of it: edge-on, where places of pixels are rounded.
    """

    land: int
    background: int
    folds: int
    holes_without: int
    holes_with: int
    walls: int
    triangles_without: int
    triangles_with: int


_OVER_HILLS: Final = (
    ((10, 30, 10), (120, -10, 60)),
    ((-20, 45, 0), (-150, -10, 20)),
    ((60, 18, 60), (150, 0, 150)),
    ((0, 160, 0), (100, 0, 0)),
    ((140, 30, -60), (40, 0, 10)),
    ((20, 25, -20), (10, 0, -200)),
)
_OVER_PLANET: Final = (
    ((60, 260, 60), (120, 150, 100)),
    ((60, 250, 60), (0, 170, -40)),
    ((300, 330, 300), (0, 100, 0)),
    ((60, 300, 200), (60, 190, 60)),
    ((200, 240, -100), (40, 150, 0)),
)
_IN_CAVES: Final = (
    ((9, 39, 59), (9, 39, 67)),
    ((-21, 59, -33), (-20, 67, -32)),
    ((-51, -59, -42), (-50, -67, -41)),
    ((9, 30, -59), (9, 30, -67)),
    ((59, 30, 36), (67, 30, 36)),
)
_DOWN_AT_HILLS: Final = (
    ((0, 160, 0), (100, 0, 0)),
    ((-80, 120, -40), (-100, 0, -20)),
    ((80, 100, 80), (100, 0, 60)),
    ((-60, 90, 100), (-20, 0, 120)),
)

LOOKOUTS: Final = (
    Lookout("hills", "hills", (5, 0, 5), (0, 1, 2, 3), 2, _OVER_HILLS),
    Lookout("planet", "planet", (60, 200, 60), (0, 1, 2), 2, _OVER_PLANET),
    Lookout("terrain", "terrain", (5, 0, 5), (0, 1, 2, 3), 2, _OVER_HILLS),
    Lookout("caves", "caves", (0, 0, 0), (0, 1, 2), 2, _IN_CAVES),
    Lookout("hills, two levels apart", "hills", (5, 0, 5), (0, 2), 4, _DOWN_AT_HILLS),
)


def measure(lookout: Lookout, size: tuple[int, int] = FULL) -> Figures:
    """Return what is seen in images of `size`, width and height. Raises what `served` and `Stage` raise."""
    recipe = WorldRecipe(SEED, canonical(lookout.recipe))
    keys = around(lookout.middle, lookout.lods, lookout.reach)
    levels = range(lookout.lods[0], lookout.lods[-1] + 1)
    plain, skirted = served(recipe, keys, "none"), served(recipe, keys, "skirts")
    closed = served(recipe, around(lookout.middle, levels, lookout.reach), "transitions")
    surface = [len(mesh.triangles) for mesh in plain]
    cameras = [Camera(*eye, width=size[0], height=size[1]) for eye in lookout.eyes]
    off = OFF_VOXELS if tuple(levels) == lookout.lods else np.inf
    counts = np.array(
        [
            _counted(*planes, off)
            for planes in zip(
                _looked(plain, cameras),
                _looked(skirted, cameras, surface),
                _looked(closed, cameras),
                strict=True,
            )
        ]
    ).sum(axis=0)
    land, background, folds, without, holes, walls = counts.tolist()
    triangles = sum(len(mesh.triangles) for mesh in skirted)
    return Figures(land, background, folds, without, holes, walls, sum(surface), triangles)


def write_skirts(docs: Path) -> Path:
    """Measure all lookouts, in a minute or two, write the page of their figures and return its path."""
    rows = [ROW.format(name=lookout.name, **_shown(measure(lookout))) for lookout in LOOKOUTS]
    path = docs / PAGE
    path.write_text(HEAD + "".join(rows))
    return path


def _shown(figures: Figures) -> dict[str, str]:
    shown = {name: f"{value:,}" for name, value in figures._asdict().items()}
    more = figures.triangles_with / figures.triangles_without - 1
    return {**shown, "share": f"{1e4 * figures.walls / figures.land:.2f}", "more": f"{100 * more:.1f} %"}


class _Planes(NamedTuple):
    """What a camera sees, (H, W), voxels along the view: of both sides, and of fronts."""

    any: Plane
    front: Plane

    def through(self) -> Mask:
        """Whether there is nothing, or the rock's side of something."""
        return np.asarray(np.isinf(self.any) | (self.front > self.any + SAME_VOXELS))


def _counted(plain: _Planes, skirt: _Planes, closed: _Planes, off: float) -> tuple[int, ...]:
    """Return the pixels of `Figures`, in its order."""
    land, nowhere = ~closed.through(), np.isinf(closed.any)
    seen = skirt.any < plain.any
    holes = binary_erosion(land, np.ones((3, 3))) & plain.through()
    hides = ~(plain.through() & ~nowhere) & (skirt.any < plain.any - SAME_VOXELS)
    elsewhere = np.abs(np.where(seen, skirt.any, 0) - np.where(seen & ~nowhere, closed.any, 0)) > off
    walls = hides | (seen & elsewhere)
    left = holes & ~(skirt.front < plain.any)
    planes = land, binary_fill_holes(~nowhere) & nowhere, ~land & ~nowhere, holes, left, walls
    return tuple(int(plane.sum()) for plane in planes)


def _looked(
    meshes: Sequence[ChunkMesh], cameras: Sequence[Camera], firsts: Sequence[int] | None = None
) -> list[_Planes]:
    """Return what each camera sees of the triangles of all meshes from the first ones on.

    All are moved alike, so that what is in one place stays there.
    """
    starts = np.cumsum([0, *(len(mesh.positions) for mesh in meshes)])[:-1]
    rows = firsts or [0] * len(meshes)
    triangles = [mesh.triangles[row:] + start for mesh, row, start in zip(meshes, rows, starts, strict=True)]
    points = np.concatenate([mesh.positions_in_metres() for mesh in meshes])
    width, height = cameras[0].width, cameras[0].height
    planes = []
    with Stage(width, height, np.zeros(3), points, np.concatenate(triangles)) as stage:
        for camera in cameras:
            stage.look(camera)
            planes.append(_Planes(stage.distance_seen(), stage.distance_seen(fronts_only=True)))
    return planes
