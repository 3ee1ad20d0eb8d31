"""A path tracer for chunks: sun with shadows, light from the sky and from the ground, haze, film. Needs no GPU.

The tracing is Mitsuba's, on the CPU; its background is left out, so that sky and haze are added here, exactly.
"""

from itertools import product
from typing import Final, Literal

import mitsuba
import numpy as np
from numpy.typing import NDArray

from chunkserver.grid import POSITION_HIGH, POSITION_LOW, ChunkKey, ChunkShape
from chunkserver.mesh import Mesh
from pages.grounds import LEVELS, Ground, texture
from pages.light import Light, film
from pages.scenes import Camera, Scene, Vector

Look = Literal["ground", "levels", "normals"]
Image = NDArray[np.uint8]
Triangles = NDArray[np.uint32]

SHAPE: Final = ChunkShape()
RAYS_A_PIXEL: Final = 9
BOUNCES: Final = 3
SKY_ROWS: Final = 512
SKIRT_CELLS: Final = 1.5
"""How far the open edges of a chunk are drawn down into the rock: levels meet without a crack."""
SMOOTHED: Final = (1, 2)
"""Distances in pixels over which the noise of few rays is averaged away."""
NEIGHBOURS: Final = tuple(shift for shift in product((-1, 0, 1), repeat=2) if shift != (0, 0))
ALIKE_DISTANCE: Final = 0.02
ALIKE_NORMAL: Final = 32
ALIKE_SEEN: Final = 0.05
ALIKE_LIGHT: Final = 1.5
DARK: Final = 0.01
"""How much alike two pixels are that share their light: in relative distance, slope, share of ground, brightness."""
LINES_FINER: Final = 2
"""Pixels of the picture of triangle numbers per pixel, each way: how thin a drawn edge is."""
LINE_LIGHT: Final = 0.35

NEAREST: Final = 0.1
FURTHEST: Final = 1e7
"""Voxels from the eye between which anything is seen."""

mitsuba.set_variant("scalar_rgb")


def render(
    scene: Scene, camera: Camera, light: Light, ground: Ground, look: Look = "ground", rays: int = RAYS_A_PIXEL
) -> Image:
    """Return a picture, (height, width, 3) uint8 sRGB.

    scene: chunks with float32 normals, placed exactly by their keys. An empty scene is a picture of the sky.
    look: the ground's colours; a colour per level with every triangle's edges; or the normals, x y z as red green blue.
    rays: per pixel, a square number.
    """
    surface = mitsuba.load_dict({"type": "scene", **_surface(scene, camera, ground, look), **_lights(camera, light)})
    red_green_blue, seen, distance, normal = _trace(surface, camera, rays)
    red_green_blue = _smoothed(red_green_blue, seen, distance, normal)
    if look == "normals":
        return np.round(255 * (0.5 + 0.5 * normal * seen)).astype(np.uint8)
    if look == "levels":
        red_green_blue *= 1 - (1 - LINE_LIGHT) * _lines(surface, camera)
    towards, up = _towards(camera), np.asarray(camera.up) / np.linalg.norm(camera.up)
    if look == "ground":
        points = towards * distance[..., None] + camera.eye
        red_green_blue *= texture(points, np.maximum(distance, 1e-3) * camera.pixel, light.to_sun())
    hazy = light.through_air(red_green_blue / np.maximum(seen, 1e-6), distance, towards, up)
    return film(hazy * seen + light.sky(towards, up) * (1 - seen))


def _trace(surface: mitsuba.Scene, camera: Camera, rays: int) -> tuple[Vector, Vector, Vector, Vector]:
    """Return light (H, W, 3), the share of rays that met ground (H, W, 1), its distance (H, W), its normal (H, W, 3).

    The light is that of the rays which met ground, times their share.
    """
    path = {"type": "path", "max_depth": BOUNCES, "hide_emitters": True}
    integrator = mitsuba.load_dict({"type": "aov", "aovs": "far:depth,up:sh_normal", "light": path})
    sensor = _sensor(camera, 1, {"type": "multijitter", "sample_count": rays})
    planes = np.array(mitsuba.render(surface, sensor=sensor, integrator=integrator), np.float64)
    seen = np.clip(planes[..., 3:4], 0, 1)
    some = np.maximum(seen, 1e-6)
    return planes[..., :3], seen, planes[..., 4] / some[..., 0], planes[..., 5:8] / some


def _smoothed(light: Vector, seen: Vector, distance: Vector, normal: Vector) -> Vector:
    """Return the light without the noise of few rays: means over neighbours that show much the same place."""
    for spacing in SMOOTHED:
        total, weights = light.copy(), np.ones(seen.shape)
        for shift in NEIGHBOURS:
            there = tuple(spacing * step for step in shift)
            other, other_seen, other_distance, other_normal = (
                np.roll(plane, there, axis=(0, 1)) for plane in (light, seen, distance, normal)
            )
            further = (other_distance - distance) / (ALIKE_DISTANCE * distance + 1e-6)
            turned = np.clip(np.einsum("ijk,ijk->ij", normal, other_normal), 0, 1)
            brighter = np.log((other.sum(axis=-1) + DARK) / (light.sum(axis=-1) + DARK))
            alike = (np.exp(-(further**2) - ALIKE_LIGHT * np.abs(brighter)) * turned**ALIKE_NORMAL)[..., None]
            alike *= np.abs(other_seen - seen) < ALIKE_SEEN
            total += alike * other
            weights += alike
        light = total / weights
    return light


def _lines(surface: mitsuba.Scene, camera: Camera) -> Vector:
    """Return how much of each pixel, (H, W, 1), is covered by edges: there the triangle's number changes."""
    sampler = {"type": "stratified", "sample_count": 1, "jitter": False}
    integrator = mitsuba.load_dict({"type": "aov", "aovs": "number:prim_index"})
    planes = np.array(mitsuba.render(surface, sensor=_sensor(camera, LINES_FINER, sampler), integrator=integrator))
    number = planes[..., -1]
    edge = np.zeros(number.shape, np.float64)
    edge[:, :-1] = number[:, 1:] != number[:, :-1]
    edge[:-1] = np.maximum(edge[:-1], number[1:] != number[:-1])
    fine = edge.reshape(camera.height, LINES_FINER, camera.width, LINES_FINER)
    return np.asarray(fine.mean(axis=(1, 3))[..., None])


def _sensor(camera: Camera, finer: int, sampler: dict[str, object]) -> mitsuba.Sensor:
    """Return the camera at the origin: the scene is moved there, so that float32 is enough anywhere."""
    ahead, up = camera.axes()[2], camera.axes()[1]
    film_ = {"type": "hdrfilm", "width": camera.width * finer, "height": camera.height * finer}
    film_ |= {"pixel_format": "rgba", "rfilter": {"type": "box"}, "component_format": "float32"}
    where = mitsuba.ScalarTransform4f().look_at(origin=[0, 0, 0], target=ahead.tolist(), up=up.tolist())
    lens = {"type": "perspective", "fov": camera.across, "near_clip": NEAREST, "far_clip": FURTHEST}
    sensor: mitsuba.Sensor = mitsuba.load_dict({**lens, "to_world": where, "film": film_, "sampler": sampler})
    return sensor


def _lights(camera: Camera, light: Light) -> dict[str, object]:
    """Return the sky with the sun in it as a picture of all directions: rows from y up to down, columns around y."""
    up = np.asarray(camera.up) / np.linalg.norm(camera.up)
    down, around = ((np.arange(rows) + 0.5) * np.pi / SKY_ROWS for rows in (SKY_ROWS, 2 * SKY_ROWS))
    down, around = np.meshgrid(down, around, indexing="ij")
    towards = np.stack([np.sin(down) * np.sin(around), np.cos(down), -np.sin(down) * np.cos(around)], axis=-1)
    sky = light.ambient(towards, up, np.sin(down) * (np.pi / SKY_ROWS) ** 2)
    return {"sky": {"type": "envmap", "bitmap": mitsuba.Bitmap(sky.astype(np.float32))}}


def _surface(scene: Scene, camera: Camera, ground: Ground, look: Look) -> dict[str, object]:
    """Return all chunks as one shape, moved so that the eye is the origin."""
    if not scene:
        return {}
    parts = [_placed(key, mesh, camera) for key, mesh in scene]
    starts = np.cumsum([0, *(len(points) for points, _, _ in parts)])
    points, normals = (np.concatenate([part[i] for part in parts]) for i in range(2))
    triangles = np.concatenate([part[2] + start for part, start in zip(parts, starts, strict=False)])
    if look == "levels":
        lods = np.repeat([key.lod for key, _ in scene], np.diff(starts))
        colours = LEVELS[lods % len(LEVELS)]
    else:
        colours = ground.colours(points + camera.eye, normals)
    return {"ground": _shape(points, normals, triangles, np.clip(colours, 0, 1))}


def _shape(points: Vector, normals: Vector, triangles: Triangles, colours: Vector) -> mitsuba.Mesh:
    properties = mitsuba.Properties()
    colour = {"type": "mesh_attribute", "name": "vertex_color"}
    properties["bsdf"] = mitsuba.load_dict({"type": "twosided", "lit": {"type": "diffuse", "reflectance": colour}})
    shape = mitsuba.Mesh("ground", len(points), len(triangles), has_vertex_normals=True, props=properties)
    shape.add_attribute("vertex_color", 3, colours.astype(np.float32).reshape(-1))  # type: ignore[arg-type]  # takes arrays
    arrays = mitsuba.traverse(shape)
    arrays["vertex_positions"] = points.astype(np.float32).reshape(-1)
    arrays["vertex_normals"] = normals.astype(np.float32).reshape(-1)
    arrays["faces"] = triangles.astype(np.uint32).reshape(-1)
    arrays.update()
    return shape


def _placed(key: ChunkKey, mesh: Mesh, camera: Camera) -> tuple[Vector, Vector, Triangles]:
    """Return points in voxels from the eye, unit normals and triangles of a chunk and of its skirts."""
    cells = (mesh.positions[:, :3].astype(np.float64) - POSITION_LOW) / SHAPE.units_per_cell
    points = (np.array(key.low_corner(SHAPE.cells)) - camera.eye) + cells * key.step
    normals = mesh.normals[:, :3].astype(np.float64)
    edges = _open_edges(mesh)
    rim, number = np.unique(edges, return_inverse=True)
    low, high = edges[:, 0], edges[:, 1]
    low_under, high_under = (len(points) + number.reshape(-1, 2)).T
    walls = np.concatenate([np.stack([high, low, low_under], 1), np.stack([high, low_under, high_under], 1)])
    under = points[rim] - SKIRT_CELLS * key.step * normals[rim]
    return (
        np.concatenate([points, under]),
        np.concatenate([normals, normals[rim]]),
        np.concatenate([mesh.triangles, walls.astype(np.uint32)]),
    )


def _open_edges(mesh: Mesh) -> NDArray[np.int64]:
    """Return the edges (E, 2) in the chunk's faces, as their one triangle walks them."""
    walked = np.concatenate([mesh.triangles[:, [i, (i + 1) % 3]] for i in range(3)]).astype(np.int64)
    place = mesh.positions[:, :3]
    on_face = (place == POSITION_LOW).astype(np.int8) + 2 * (place == POSITION_HIGH).astype(np.int8)
    first, second = on_face[walked[:, 0]], on_face[walked[:, 1]]
    return np.asarray(walked[((first == second) & (first > 0)).any(axis=1)])


def _towards(camera: Camera) -> Vector:
    """Return the direction, (H, W, 3), in which each pixel looks."""
    right, up, ahead = camera.axes()
    across = (np.arange(camera.width) + 0.5 - camera.width / 2) * camera.pixel
    upwards = (camera.height / 2 - np.arange(camera.height) - 0.5) * camera.pixel
    towards = ahead + across[None, :, None] * right + upwards[:, None, None] * up
    unit: Vector = towards / np.linalg.norm(towards, axis=-1, keepdims=True)
    return unit
