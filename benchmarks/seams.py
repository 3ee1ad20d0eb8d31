"""Milliseconds per chunk of 32 cells, with borders to coarser chunks, with skirts, and plain, in one thread.

A mask names the faces whose neighbour is one level coarser. There the next level is sampled too, and transition cells
close the border; skirts are drawn from the chunk alone. How many times the plain chunk it is stands behind each figure.

- One face: each of the six in turn, chunk by chunk. Six faces: the most that there can be. In the cut of an octree it
  is three at most: a chunk's siblings are never coarser.
- Field, mesh, whole chunk: the samples of both levels; the mesh of them, with normals; from the key to native bytes.
- Cut: all that a viewer asks for on its way, as above, empty chunks too, each with the mask that it has there. "Masked"
  is how many have one.
"""

import random
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import Final

from benchmarks.measure import MS, Figure, Line, Scale, beside_first, in_turns, timed
from benchmarks.scenes import SCENES, SEED, SHAPE, Scene, layers, prepare
from benchmarks.skipping import CHUNKS, FLIGHTS, STEPS, Flight, cut
from chunkserver.field import sample
from chunkserver.grid import FACES, MASK_MAX, ChunkKey, coarser_mask
from chunkserver.mesher import extract
from chunkserver.pipeline import SKIRTS, ChunkRequest, build_chunk, build_mesh
from chunkserver.recipe import WorldRecipe, builtin
from chunkserver.samples import Samples

PLACES: Final = (
    SCENES["terrain surface"],
    Scene("caves", "caves", "surface", layers(range(-2, 2), 6)),
    SCENES["planet"],
)

Requests = dict[str, list[ChunkRequest]]
"""Name of a seam -> the same chunks with it."""


def run(scale: Scale) -> Iterator[Line]:
    """Yield three lines per place, of field, mesh and whole chunk, and a line per flight."""
    for scene in PLACES:
        plain = [chunk.request for chunk in prepare(scene, scale.chunks)]
        seams: Requests = {
            "plain": plain,
            "one face": [replace(each, coarser=1 << place % FACES) for place, each in enumerate(plain)],
            "six faces": [replace(each, coarser=MASK_MAX) for each in plain],
            "skirts": [replace(each, seam=SKIRTS) for each in plain],
        }
        without_skirts = {name: requests for name, requests in seams.items() if name != "skirts"}
        yield _line(f"{scene.name}: field", without_skirts, _sample, scale.rounds)
        yield _mesh_line(f"{scene.name}: mesh", seams, scale.rounds)
        yield _line(f"{scene.name}: whole chunk", seams, build_chunk, scale.rounds, _triangles(seams))
    for flight in FLIGHTS:
        plain, masked = cut_requests(flight, CHUNKS * scale.chunks)
        share = 100 * sum(each.coarser > 0 for each in masked) / len(masked)
        yield _line(
            f"cut, {flight.recipe}",
            {"plain": plain, "its own mask": masked},
            build_chunk,
            scale.rounds,
            [Figure("masked", "%", (share,))],
        )


def _line(
    subject: str,
    seams: Requests,
    action: Callable[[ChunkRequest], object],
    rounds: int,
    counts: Sequence[Figure] = (),
) -> Line:
    candidates = {name: timed(action, requests, MS) for name, requests in seams.items()}
    return Line(subject, (*counts, *beside_first(in_turns(candidates, rounds), "ms")))


def _mesh_line(subject: str, seams: Requests, rounds: int) -> Line:
    candidates = {}
    for name, requests in seams.items():
        mesh = partial(extract, skirts=name == "skirts")
        candidates[name] = timed(mesh, [_sample(request) for request in requests], MS)
    return Line(subject, beside_first(in_turns(candidates, rounds), "ms"))


def _sample(request: ChunkRequest) -> Samples:
    return sample(request.recipe, request.key, SHAPE, request.coarser)


def _triangles(seams: Requests) -> list[Figure]:
    """Return how many triangles a chunk has, plain and with each seam."""
    counts = {name: [len(build_mesh(each).triangles) for each in requests] for name, requests in seams.items()}
    return [Figure(f"triangles, {name}", "a chunk", (sum(of) / len(of),)) for name, of in counts.items()]


def cut_requests(flight: Flight, count: int) -> tuple[list[ChunkRequest], list[ChunkRequest]]:
    """Return so many different chunks, in an order without pattern, that a viewer asks for: plain, and with masks."""
    found: dict[ChunkKey, int] = {}
    for step in range(STEPS):
        leaves = set(cut(flight.place(step)))
        found |= {key: coarser_mask(key, leaves) for key in sorted(leaves)}
    recipe = WorldRecipe(SEED, builtin(flight.recipe))
    chosen = random.Random(SEED).sample(list(found.items()), count)
    masked = [ChunkRequest(recipe, key, coarser=mask) for key, mask in chosen]
    return [replace(each, coarser=0) for each in masked], masked
