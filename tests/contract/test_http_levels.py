"""Borders over HTTP: worlds of one level and of several, in every size of chunk and every format, without a hole."""

import httpx2
import numpy as np
import pytest

from chunkserver.grid import CELLS_BUILT
from chunkserver_client import Client
from tests.octrees import random_octree
from tests.surfaces import assert_closed, edges_of, weld
from tests.worlds import keys

FORMATS = ["mesh", "glb"]
HILLS = {"op": "add", "a": {"op": "y"}, "b": {"op": "multiply", "a": {"op": "gradient3", "frequency": 0.05}, "b": 10}}
"""Hills of ten voxels or so."""


@pytest.fixture
def client(server):
    with Client(server.url) as client:
        yield client


@pytest.fixture
def world(client):
    """Creates a world, under the test's own name; it is deleted at the end."""
    made = []

    def create(lods, cells, recipe):
        made.append(client.create_world(f"w{lods}-{cells}", 3, recipe, lods=lods, chunk_cells=cells))
        return made[-1]

    yield create
    for one in made:
        client.delete_world(one.id)


def fetched(client, world, rows, **options):
    """Return all chunks of a batch, welded."""
    return weld([(mesh.key, mesh) for mesh in client.chunks(world, rows, **options)])


@pytest.mark.parametrize("form", FORMATS)
@pytest.mark.parametrize("cells", CELLS_BUILT)
def test_a_world_of_a_single_level_is_closed(client, world, cells, form):
    ball = world(1, cells, {"op": "sphere", "radius": 0.9 * cells})
    assert (ball.lods, ball.chunk_cells, ball.coarser) == (1, cells, (0,))
    surface = fetched(client, ball, keys(0, (-1,) * 3, (1,) * 3), format=form)
    _, walks, balance = edges_of(surface)
    assert (walks == 2).all()
    assert not balance.any()
    volume = np.linalg.det(surface.points[surface.triangles].astype(float)).sum() / 6
    assert volume == pytest.approx(4 / 3 * np.pi * (0.9 * 32768) ** 3, rel=0.01)


@pytest.mark.parametrize("form", FORMATS)
@pytest.mark.parametrize("cells", CELLS_BUILT)
def test_one_batch_has_a_closed_selection_of_levels(client, world, cells, form):
    hills = world(3, cells, HILLS)
    tree = random_octree(np.random.default_rng(1), 3, 0.3, (-1, -1, -1))
    rows = [(*key, tree.coarser(key)) for key in sorted(tree.leaves)]
    assert {row[0] for row in rows} == {0, 1, 2}
    assert_closed(fetched(client, hills, rows, format=form))
    with pytest.raises(AssertionError, match="open edges"):
        assert_closed(fetched(client, hills, [row[:4] for row in rows], format=form))


@pytest.mark.parametrize(
    ("lods", "lod", "query", "detail"),
    [
        (1, 0, "coarser=1", "coarser is 1; nothing is coarser than lod 0 in this world"),
        (3, 2, "coarser=32", "coarser is 32; nothing is coarser than lod 2 in this world"),
        (3, 0, "coarser=64", "coarser is 64; it lies in [0, 63]"),
        (3, 0, "coarser=5&seam=skirts", "coarser is 5; it needs seam=transitions, and seam is 'skirts'"),
        (3, 0, "coarser=5&seam=none", "coarser is 5; it needs seam=transitions, and seam is 'none'"),
        (3, 0, "seam=walls", "seam is 'walls'; built are ['transitions', 'skirts', 'none']"),
        (1, 1, "", "lod is 1; this world has 0 to 0"),
    ],
)
@pytest.mark.parametrize("cells", CELLS_BUILT)
def test_what_cannot_be_is_refused_and_named(server, world, cells, lods, lod, query, detail):
    path = world(lods, cells, "plane").path
    alone = httpx2.get(f"{server.url}{path}/chunks/{lod}/0/0/0?{query}")
    batch = httpx2.post(f"{server.url}{path}/chunks?{query}", json={"chunks": [[lod, 0, 0, 0]]})
    for answer in (alone, batch):
        assert answer.status_code == 422
        assert answer.json()["detail"].endswith(detail)
        name, _, value = (query.split("&")[0] or f"lod={lod}").partition("=")
        assert str(answer.json()[name]) == value
