"""What is solid: a recipe is flattened to a tape, and one compiled interpreter samples it on the lattice."""

from chunkserver.field.compiling import compile_beside, compile_interpreter
from chunkserver.field.sampling import densities, prove, sample, sample_near_surface

__all__ = ["compile_beside", "compile_interpreter", "densities", "prove", "sample", "sample_near_surface"]
