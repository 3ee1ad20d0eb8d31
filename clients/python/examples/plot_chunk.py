"""One chunk, drawn by matplotlib. Run it whole, or cell by cell where an editor knows `# %%`.

python plot_chunk.py --url http://127.0.0.1:8000 --output chunk.png
"""

# %% What there is to choose.
import argparse
import sys

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.colors import LightSource

from chunkserver_client import Client

parser = argparse.ArgumentParser(description="Draws one chunk.")
parser.add_argument("--url", default="http://127.0.0.1:8000", help="of the server")
parser.add_argument("--output", default="chunk.png", help="a picture, in a format that its name tells")
parser.add_argument("--seed", type=int, default=42)
parser.add_argument("--recipe", default="arches")
parser.add_argument("--key", type=int, nargs=4, default=(1, 0, 0, 0), metavar=("LOD", "X", "Y", "Z"))
options = parser.parse_args()

# %% Ask for the chunk. Its arrays are views into the answer.
with Client(options.url) as client:
    world = client.seed(options.seed, options.recipe)
    mesh = client.chunk(world, options.key)

print(f"{mesh.key}: {len(mesh.positions):,} vertices, {len(mesh.triangles):,} triangles, {mesh.content}")

if mesh.is_empty:
    sys.exit(f"nothing to draw: the chunk is all {mesh.content}")

# %% Metres from the chunk's low corner. matplotlib has z up: (x, y, z) becomes (x, -z, y), which mirrors nothing.
metres = mesh.positions_in_metres(origin=mesh.place.corner)
points = np.stack([metres[:, 0], -metres[:, 2], metres[:, 1]], axis=1)
normals = mesh.unit_normals()[mesh.triangles].mean(axis=1)
normals = np.stack([normals[:, 0], -normals[:, 2], normals[:, 1]], axis=1)
normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-6)

# %% Colours by height, light from the front and the left.
heights = points[mesh.triangles, 2].mean(axis=1)
colours = plt.get_cmap("gist_earth")(0.25 + 0.6 * (heights - heights.min()) / max(np.ptp(heights), 1.0))
shade = np.clip(normals @ LightSource(azdeg=230, altdeg=40).direction, 0, 1)
colours[:, :3] *= (0.45 + 0.75 * shade)[:, None]
colours = colours.clip(0, 1)

# %% The surface, and how steep it is from above.
figure = plt.figure(figsize=(12, 5.4), layout="constrained")
figure.suptitle(f"{options.recipe}, seed {world.seed}, chunk {tuple(mesh.key)}: {len(mesh.triangles):,} triangles")
scene = figure.add_subplot(1, 2, 1, projection="3d", computed_zorder=False)
surface = scene.plot_trisurf(*points.T, triangles=mesh.triangles, shade=False, linewidth=0.3)
surface.set(facecolors=colours, edgecolors=colours)
scene.set(xlabel="x [m]", ylabel="-z [m]", zlabel="y [m]")
scene.set_box_aspect(np.ptp(points, axis=0), zoom=0.95)
scene.view_init(elev=28, azim=-60)

above = figure.add_subplot(1, 2, 2)
steepness = np.degrees(np.arccos(normals[:, 2].clip(-1, 1)))
upward = steepness < 90
drawn = above.tripcolor(points[:, 0], points[:, 1], mesh.triangles[upward], facecolors=steepness[upward], cmap="magma")
drawn.set(clim=(0, 90), rasterized=True)
above.set(aspect="equal", xlabel="x [m]", ylabel="-z [m]", title="from above")
figure.colorbar(drawn, ax=above, label="steepness [degrees]", shrink=0.85)

# %% Keep it.
figure.savefig(options.output, dpi=150)
print(f"drawn: {options.output}")
