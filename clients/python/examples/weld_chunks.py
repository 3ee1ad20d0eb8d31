"""A box of chunks, welded without a tolerance, handed to trimesh, drawn by pyvista. With cells, as `plot_chunk.py`.

python weld_chunks.py --url http://127.0.0.1:8000 --output moon.png
"""

# %% What there is to choose.
import argparse
from itertools import product
from typing import Any

import numpy as np
import pyvista
import trimesh

from chunkserver_client import Client

parser = argparse.ArgumentParser(description="Welds a moon from its chunks.")
parser.add_argument("--url", default="http://127.0.0.1:8000", help="of the server")
parser.add_argument("--output", default="moon.png", help="a picture: .png")
parser.add_argument("--radius", type=int, default=90, help="of the moon, in voxels: 64 or more")
parser.add_argument("--pixels", type=int, default=1000, help="of the picture, on each side")
options = parser.parse_args()

# %% A recipe of our own, and all the chunks that the moon can reach. The batch gives each as soon as it is ready.
with Client(options.url) as client:
    recipe = client.post_recipe({"builtin": "moon", "radius": options.radius})
    world = client.seed(7, recipe.digest)
    reach = -(-options.radius * 5 // 4 // world.chunk_cells)
    keys = [(0, x, y, z) for x, y, z in product(range(-reach, reach), repeat=3)]
    meshes = [mesh for mesh in client.chunks(world, keys) if not mesh.is_empty]

print(f"{len(keys)} chunks, {len(meshes)} with a surface")

# %% Weld. The same point has the same integers in every chunk, so equality is enough: no tolerance, nothing is rounded.
starts = np.cumsum([0] + [len(mesh.positions) for mesh in meshes[:-1]])
points = np.concatenate([mesh.lattice_positions() for mesh in meshes])
triangles = np.concatenate([mesh.triangles + np.int64(start) for mesh, start in zip(meshes, starts, strict=True)])
normals = np.concatenate([mesh.unit_normals() for mesh in meshes])
points, first, welded = np.unique(points, axis=0, return_index=True, return_inverse=True)
metres = points * (world.voxel_size * world.chunk_cells / 32768)

# %% Is there a hole? In a closed surface each edge is walked once in each direction.
moon = trimesh.Trimesh(metres, welded.reshape(-1)[triangles], vertex_normals=normals[first], process=False)
print(f"{len(normals):,} vertices welded to {len(metres):,}; {len(moon.faces):,} triangles")
print(f"watertight: {moon.is_watertight}; volume: {moon.volume:,.0f} cubic metres")

# %% Draw it, without a window. The normals are the server's: smooth over the borders of chunks.
surface = pyvista.PolyData.from_regular_faces(metres, moon.faces)
surface.point_data["Normals"] = normals[first]
surface["height"] = np.linalg.norm(metres, axis=1)
plotter: Any = pyvista.Plotter(off_screen=True, window_size=[options.pixels] * 2, lighting="none")
plotter.set_background("#0b0d12")
plotter.add_light(pyvista.Light(position=(-4, 3, 3), intensity=1.0, light_type="scene light"))
plotter.add_light(pyvista.Light(position=(3, -1, 2), color="#8090b0", intensity=0.12, light_type="scene light"))
plotter.add_mesh(surface, scalars="height", cmap="gray", ambient=0.03, smooth_shading=True, show_scalar_bar=False)
plotter.camera_position = [(0, 0.35, 1), (0, 0, 0), (0, 1, 0)]
plotter.reset_camera()
plotter.camera.zoom(1.4)
plotter.enable_anti_aliasing("ssaa")
plotter.screenshot(options.output)
plotter.close()
print(f"drawn: {options.output}")
