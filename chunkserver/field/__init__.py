"""What is solid: a recipe is flattened to a tape, and one compiled interpreter samples it on the lattice."""

from chunkserver.field import compiling
from chunkserver.field.ground import Ground
from chunkserver.field.sampling import densities, prove, sample, sample_near_surface

__all__ = ["Ground", "compiling", "densities", "prove", "sample", "sample_near_surface"]
