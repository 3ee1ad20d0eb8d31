"""chunkserver: the tile server for 3D worlds."""

__version__ = "0.1.0"
