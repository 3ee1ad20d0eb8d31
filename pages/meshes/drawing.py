"""A view of meshes to an image: colours, lines and light of all that is seen, on a plain backdrop."""

from collections.abc import Sequence
from typing import Final, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from chunkserver.grid import ChunkKey
from chunkserver.recipe import WorldRecipe, canonical
from chunkserver_client import ChunkMesh
from pages.grounds import Ground
from pages.light import Light, film
from pages.meshes.chunks import Seam, served
from pages.meshes.raster import Plane, Stage
from pages.meshes.shading import lit
from pages.meshes.surface import Surface, facets, joined
from pages.scenes import Camera

Vectors = NDArray[np.float64]
Image = NDArray[np.uint8]
Colour = tuple[int, int, int]
Lines = Literal["triangles", "borders", "rims"]


class Pen(NamedTuple):
    """How lines are drawn: sRGB, opacity, pixels of the image."""

    colour: Colour
    strength: float
    width: float


Tint = Ground | Literal["lods", "chunks", "normals"]

FINER: Final = 2
"""Pixels that are drawn per pixel of the image, each way."""
LINES: Final[dict[Lines, Pen]] = {
    "triangles": Pen((34, 36, 46), 0.42, 0.9),
    "borders": Pen((255, 250, 240), 0.9, 1.6),
    "rims": Pen((226, 32, 44), 1.0, 3.0),
}
LINES_APART: Final = (1.5, 7.0)
"""Pixels between the lines of a cell: at the first they are gone, from the second on they have their full strength."""
LINE_LIFT: Final = 3.0
"""How far lines are moved from the surface towards the eye: so many times the width of a pixel there."""
LODS: Final = np.array(
    [(0.50, 0.37, 0.20), (0.13, 0.36, 0.30), (0.11, 0.24, 0.46), (0.36, 0.18, 0.42), (0.45, 0.20, 0.16)]
)
"""A colour per LOD; coarser ones start again. Linear."""
FOCUS: Final = (0.78, 0.36, 0.10)
NEIGHBOURS: Final = np.array([(0.19, 0.20, 0.22), (0.13, 0.15, 0.18), (0.17, 0.155, 0.15), (0.23, 0.23, 0.22)])
"""What a chunk of its own colour has around it. Linear."""
UNDERSIDE: Final = (0.065, 0.07, 0.09)
"""The rock's side of the surface, which no place in a world's air can see. Linear."""
BACKDROP: Final = ((198, 212, 226), (243, 239, 231))
"""Top and bottom of what is behind everything. sRGB."""
NIGHT: Final = ((10, 11, 18), (24, 26, 38))
"""The same where there is no air."""


class View(NamedTuple):
    """What is looked at, from where and how.

    recipe: what a user may post. keys: chunks, of one or several levels.
    tint: a kind of ground; a colour per level; a colour per chunk; or the normals' x y z as red green blue, unlit.
    flat: triangles have their own normals instead of those of the mesh.
    lines: edges of triangles; edges in the faces of chunks; edges that are open in the welded whole.
    focus: a chunk: it alone has edges of triangles, and a colour of its own with the tint "chunks".
    seam: how borders between levels are closed.
    """

    recipe: str | dict[str, object]
    keys: tuple[ChunkKey, ...]
    camera: Camera
    tint: Tint
    light: Light = Light()
    flat: bool = False
    lines: tuple[Lines, ...] = ()
    focus: ChunkKey | None = None
    seam: Seam = "transitions"
    seed: int = 42


def draw(view: View, meshes: Sequence[ChunkMesh] | None = None) -> Image:
    """Return the picture, (H, W, 3) uint8 sRGB.

    meshes: what to draw instead of `view.keys` as served, of one world with voxel size 1.
    Raises `ValueError` if there is no surface to draw, and `RuntimeError` if the system has no OpenGL.
    """
    if meshes is None:
        meshes = served(WorldRecipe(view.seed, canonical(view.recipe)), view.keys, view.seam)
    surface = joined(meshes)
    colours = _tinted(view, surface, meshes)
    index, normals = facets(surface) if view.flat else (np.arange(len(surface.points)), surface.normals)
    triangles = np.arange(len(index)).reshape(-1, 3) if view.flat else surface.triangles
    camera, low, high = view.camera, surface.points.min(axis=0), surface.points.max(axis=0)
    centre, radius = (low + high) / 2, float(np.linalg.norm(high - low)) / 2
    with Stage(camera.width * FINER, camera.height * FINER, centre, surface.points[index], triangles) as stage:
        lines = _add_lines(stage, view, surface, meshes)
        stage.look(camera)
        seen = _seen(stage, normals, colours[index], lines)
        fine = _composed(seen, _light_on(stage, seen, view, centre, radius), view)
    blocks = fine.reshape(camera.height, FINER, camera.width, FINER, 3)
    return np.asarray(np.round(blocks.mean(axis=(1, 3))), np.uint8)


class Seen(NamedTuple):
    """What each drawn pixel shows, (H, W, ...): where nothing is, the distance is infinite.

    distance: voxels along the view. normals: unit, to the side that is seen. colours: linear. lines: strengths, 0 to 1.
    """

    distance: Plane
    normals: Plane
    colours: Plane
    lines: dict[Lines, Plane]


def _seen(stage: Stage, normals: Vectors, colours: Vectors, lines: Sequence[Lines]) -> Seen:
    under = np.broadcast_to(UNDERSIDE, colours.shape)
    toned = stage.colours_seen(np.sqrt(colours), np.sqrt(under))  # square roots: dark colours keep their steps
    turned = 2 * stage.colours_seen(0.5 + 0.5 * normals, 0.5 - 0.5 * normals) - 1
    turned /= np.maximum(np.linalg.norm(turned, axis=-1, keepdims=True), 1e-6)
    return Seen(stage.distance_seen(), turned, toned**2, {name: stage.lines_seen(name) for name in lines})


def _light_on(stage: Stage, seen: Seen, view: View, centre: Vectors, radius: float) -> Plane:
    """Return the light on what each pixel shows, (H, W, 3) linear."""
    camera = view.camera
    there = np.isfinite(seen.distance)
    rows, columns = (places.astype(np.float32) for places in np.nonzero(there))
    right, up, ahead = camera.axes().astype(np.float32)
    across = ((columns + 0.5) / FINER - camera.width / 2) * np.float32(camera.pixel)
    above = (camera.height / 2 - (rows + 0.5) / FINER) * np.float32(camera.pixel)
    towards = ahead + across[:, None] * right + above[:, None] * up
    points = towards * seen.distance[there][:, None] + (camera.eye - centre).astype(np.float32)
    upwards = np.asarray(camera.up) / np.linalg.norm(camera.up)
    light = np.zeros(seen.normals.shape, np.float32)
    to_eye = -towards / np.linalg.norm(towards, axis=1, keepdims=True)
    light[there] = lit(stage, points, seen.normals[there], to_eye, view.light, upwards, radius)
    return light


def _composed(seen: Seen, light: Plane, view: View) -> Plane:
    """Return what pixels look like, (H, W, 3) sRGB: lit, hazy, with lines, before the backdrop."""
    there = np.isfinite(seen.distance)
    image = _backdrop(there.shape, NIGHT if view.light.space else BACKDROP)
    if view.tint == "normals":
        shown = 127.5 + 127.5 * seen.normals[there]
    else:
        shown = film((seen.colours[there] * light[there]).astype(np.float64)).astype(np.float32)
    for name, strength in seen.lines.items():
        shown += strength[there][:, None] * (np.array(LINES[name].colour, np.float32) - shown)
    left = np.exp(-((seen.distance[there] / view.light.haze) ** 1.5))[:, None]
    image[there] += left * (shown - image[there])
    return image


def _backdrop(size: tuple[int, ...], ends: tuple[Colour, Colour]) -> Plane:
    share = np.linspace(0, 1, size[0], dtype=np.float32)[:, None, None]
    top, bottom = np.array(ends, np.float32)
    return np.repeat(top + share * (bottom - top), size[1], axis=1)


def _tinted(view: View, surface: Surface, meshes: Sequence[ChunkMesh]) -> Vectors:
    """Return the colour of each vertex, (V, 3) linear."""
    if isinstance(view.tint, Ground):
        return np.clip(view.tint.colours(surface.points, surface.normals), 0, 1)
    keys = [mesh.key for mesh in meshes]
    if view.tint == "chunks":
        own = [
            FOCUS if tuple(key) == view.focus else NEIGHBOURS[(key.x + 2 * key.y + 3 * key.z) % len(NEIGHBOURS)]
            for key in keys
        ]
    else:
        own = [LODS[key.lod % len(LODS)] for key in keys]
    return np.array(own, np.float64)[surface.chunk]


def _add_lines(stage: Stage, view: View, surface: Surface, meshes: Sequence[ChunkMesh]) -> list[Lines]:
    """Put the lines of a view on the stage; return those that there are."""
    ahead = (surface.points - view.camera.eye) @ view.camera.axes()[2]
    apart = surface.step / np.maximum(ahead, 1e-6) / view.camera.pixel
    legible = np.clip((apart - LINES_APART[0]) / (LINES_APART[1] - LINES_APART[0]), 0, 1)
    edges = {"triangles": surface.triangle_edges, "borders": surface.border_edges, "rims": surface.rim_edges}
    if view.focus is not None:
        own = np.array([tuple(mesh.key) == view.focus for mesh in meshes])[surface.chunk]
        edges["triangles"] = edges["triangles"][own[edges["triangles"][:, 0]]]
    lifted = view.camera.eye + (surface.points - view.camera.eye) * (1 - LINE_LIFT * view.camera.pixel)
    names = [name for name in view.lines if len(edges[name])]
    for name in names:
        strengths = LINES[name].strength * (legible if name == "triangles" else np.ones(len(legible)))
        stage.add_lines(name, lifted, edges[name], strengths, LINES[name].width * FINER)
    return names
