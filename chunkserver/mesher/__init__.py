"""Where is the surface: from one chunk's samples to its mesh. One table, a row per mesher."""

from chunkserver.mesher.table import MESHER_DEFAULT, MESHERS, extract

__all__ = ["MESHERS", "MESHER_DEFAULT", "extract"]
