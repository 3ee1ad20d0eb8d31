"""Load tests of chunkserver: an open loop, profiles of what clients ask for, answers that are checked."""

__version__ = "0.1.0"
