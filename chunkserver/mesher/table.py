"""The meshers that are built: a new one is a file beside this one and a row here."""

from collections.abc import Callable
from typing import Final, NamedTuple

from chunkserver.errors import BadParameter
from chunkserver.mesh import Mesh, NormalKind
from chunkserver.mesher.marching_cubes import APRON, marching_cubes
from chunkserver.mesher.skirts import with_skirts
from chunkserver.samples import Samples


class Mesher(NamedTuple):
    """One way to extract a surface.

    apron: samples it needs around the chunk's corners.
    extract: (samples, normal kind) -> mesh.
    """

    apron: int
    extract: Callable[[Samples, NormalKind], Mesh]


MESHER_DEFAULT: Final = "marching-cubes"
MESHERS: Final[dict[str, Mesher]] = {
    "marching-cubes": Mesher(APRON, marching_cubes),
}


def extract(samples: Samples, mesher: str = MESHER_DEFAULT, normals: NormalKind = "int8", skirts: bool = False) -> Mesh:
    """Return the surface of one chunk, where the density crosses 0, as `Mesh` describes it.

    skirts: draw its border out into the rock, for neighbours of whatever level.

    Raises `BadParameter` for a mesher that is not built, samples with too small an apron, or skirts where coarser
    neighbours are fitted. A chunk without a surface
    is no error: its mesh is `EMPTY["air"]` or `EMPTY["rock"]`.
    """
    if mesher not in MESHERS:
        raise BadParameter(f"mesher is {mesher!r}; built are {sorted(MESHERS)}", mesher=mesher)
    row = MESHERS[mesher]
    if samples.shape.apron < row.apron:
        raise BadParameter(f"apron is {samples.shape.apron}; {mesher} needs {row.apron}", apron=samples.shape.apron)
    if skirts and samples.coarser:
        raise BadParameter(f"coarser is {samples.coarser}; skirts fit neighbours of any level", coarser=samples.coarser)
    mesh = row.extract(samples, normals)
    return with_skirts(mesh, samples) if skirts else mesh
