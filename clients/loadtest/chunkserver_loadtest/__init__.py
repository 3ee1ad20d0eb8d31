"""Load tests of chunkserver."""

__version__ = "0.1.0"
