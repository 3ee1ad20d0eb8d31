"""What is typed: a file for each word that may follow `chunkserver`, loaded when it is typed."""

from chunkserver.commands.loading import Commands

__all__ = ["Commands"]
