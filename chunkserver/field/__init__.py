"""What is solid: a recipe is flattened to a tape, and one compiled interpreter samples it on the lattice."""

from chunkserver.field.sampling import prove, sample

__all__ = ["prove", "sample"]
