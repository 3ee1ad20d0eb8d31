"""From a request to the bytes of a chunk. The page to read first.

    request          -> field.sample_near_surface              -> mesher.extract -> wire.encode -> bytes
    request + deltas -> field.sample          -> deltas.add_to -> mesher.extract -> wire.encode -> bytes

A chunk that bounds of the field, and of its deltas, prove to be all air or all rock is not sampled.

Pure: the same request and deltas give the same bytes in a worker process, in a test, on any machine.
"""

import hashlib
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Final, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from chunkserver.edits import Deltas
from chunkserver.errors import BadParameter
from chunkserver.field import prove, sample, sample_near_surface
from chunkserver.geometric_error import geometric_error
from chunkserver.grid import CELLS_DEFAULT, ChunkKey, ChunkShape
from chunkserver.kernel import SOURCES_DIGEST
from chunkserver.mesh import EMPTY, Content, Mesh
from chunkserver.mesher import MESHER_DEFAULT, MESHERS, extract
from chunkserver.recipe import WorldRecipe
from chunkserver.samples import Samples
from chunkserver.wire import Encoding, Placement, check_encodable, encode

SEAM_OF_LEVELS: Final = "transitions"
"""The seam that fits a chunk to coarser neighbours."""
SKIRTS: Final = "skirts"
"""The seam for clients that cannot name their neighbours' level."""
SEAMS_BUILT: Final = (SEAM_OF_LEVELS, SKIRTS, "none")
SEAM_DEFAULT: Final = SEAM_OF_LEVELS
STAGES: Final = ("field", "mesh", "encode")
"""In this order. A chunk that is proved to be empty has no mesh stage."""
GENERATOR_BYTES: Final = 8


@dataclass(frozen=True, slots=True)
class ChunkRequest:
    """Everything that a pristine chunk's bytes depend on, and nothing else. Hashable; cheap to send in a pickle.

    coarser: mask of the faces whose neighbour is one LOD coarser, bits -x +x -y +y -z +z = 1 2 4 8 16 32: the chunk is
        fitted to them.
    revision: the chunk's own last edit, 0 for a pristine chunk.
    voxel_size: metres.
    """

    recipe: WorldRecipe
    key: ChunkKey
    cells: int = CELLS_DEFAULT
    voxel_size: float = 1.0
    mesher: str = MESHER_DEFAULT
    coarser: int = 0
    seam: str = SEAM_DEFAULT
    revision: int = 0
    encoding: Encoding = field(default_factory=Encoding)

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle plain values: a fifth of the time that a dataclass takes by itself."""
        recipe = self.recipe
        rest = self.cells, self.voxel_size, self.mesher, self.coarser, self.seam, self.revision
        return _request, (recipe.seed, recipe.source, tuple(self.key), rest, tuple(self.encoding))


def _request(seed: int, source: str, key: Any, rest: Any, encoding: Any) -> ChunkRequest:
    values: tuple[Any, ...] = (WorldRecipe(seed, source), ChunkKey(*key), *rest, Encoding(*encoding))
    return ChunkRequest(*values)


class Edited(NamedTuple):
    """What makes an edited chunk of a pristine one: the deltas of its world at the revision that its request names.

    arena: (slots, deltas of a brick) int32, C order: where the bricks lie that `deltas` read.
    """

    arena: NDArray[np.int32]
    deltas: Deltas


@dataclass(frozen=True, slots=True)
class Chunk:
    """One finished chunk: what it is made of, its bytes in the requested encoding, the last edit that is in them."""

    content: Content
    body: bytes
    revision: int = 0


def generator(recipe: WorldRecipe) -> str:
    """Return the generator token: the same token means the same pristine bytes for the same request.

    A digest of the sources that shape a chunk and of the recipe; never of the machine.
    """
    named = f"{SOURCES_DIGEST} {recipe.digest}".encode()
    return hashlib.blake2b(named, digest_size=GENERATOR_BYTES).hexdigest()


def check_request(request: ChunkRequest) -> None:
    """Raise `BadKey` or `BadParameter` that names the value, unless `request` is one that is built.

    The recipe alone is not looked into: `build_chunk` refuses one that needs too many registers or is not finite.
    """
    if request.mesher not in MESHERS:
        raise BadParameter(f"mesher is {request.mesher!r}; built are {sorted(MESHERS)}", mesher=request.mesher)
    if request.seam not in SEAMS_BUILT:
        raise BadParameter(f"seam is {request.seam!r}; built are {list(SEAMS_BUILT)}", seam=request.seam)
    if request.coarser and request.seam != SEAM_OF_LEVELS:
        message = f"coarser is {request.coarser}; it needs seam={SEAM_OF_LEVELS}, and seam is {request.seam!r}"
        raise BadParameter(message, coarser=request.coarser, seam=request.seam)
    check_encodable(_placement(request), request.encoding)


def build_chunk(
    request: ChunkRequest, stage: Callable[[str], object] = lambda _: None, edited: Edited | None = None
) -> Chunk:
    """Return the chunk that `request` names. An empty chunk is no error.

    stage: called with the name of each of `STAGES` when it begins. What it raises ends the build.
    edited: the deltas of the chunk, with the mask that it asks for; None for a chunk that no edit has reached.

    Raises what `check_request` raises, and `BadRecipe` for a recipe that needs too many registers or is not finite.
    """
    mesh = build_mesh(request, stage, edited)
    stage("encode")
    return Chunk(mesh.content, encode(mesh, _placed(request), request.encoding, is_checked=True), request.revision)


def build_mesh(
    request: ChunkRequest, stage: Callable[[str], object] = lambda _: None, edited: Edited | None = None
) -> Mesh:
    """Return what `build_chunk` encodes: the mesh, its normals of the kind that the encoding has. Raises the same."""
    check_request(request)
    stage("field")
    shape = ChunkShape(request.cells, MESHERS[request.mesher].apron)
    proven = prove(request.recipe, request.key, shape, request.coarser)
    if proven and _stays(proven, edited):
        return EMPTY[proven]
    samples = _sampled(request, shape, edited)
    stage("mesh")
    return extract(samples, request.mesher, request.encoding.normals, request.seam == SKIRTS)


def _stays(pristine: Literal["air", "rock"], edited: Edited | None) -> bool:
    """Return whether a chunk that is all air or all rock still is when its deltas are added."""
    low, high = edited.deltas.range if edited else (0, 0)
    return low >= 0 if pristine == "air" else high <= 0


def _sampled(request: ChunkRequest, shape: ChunkShape, edited: Edited | None) -> Samples:
    """Return all that the mesh depends on. Deltas are added to every sample; skirts go down into the rock."""
    every = edited is not None or request.seam == SKIRTS
    samples = (sample if every else sample_near_surface)(request.recipe, request.key, shape, request.coarser)
    if edited is not None:
        edited.deltas.add_to(samples, edited.arena)
    return samples


def _placed(request: ChunkRequest) -> Placement:
    """Return the placement with the error that chunks of this recipe and level have: the first time that takes ms."""
    return _placement(request, geometric_error(request.recipe, request.key.lod) * request.voxel_size)


def _placement(request: ChunkRequest, *error: float) -> Placement:
    return Placement(request.key, request.cells, request.voxel_size, request.revision, request.coarser, *error)
