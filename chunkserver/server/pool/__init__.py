"""Chunks that are not there yet: a bounded queue in an order, and worker processes that may die."""

from chunkserver.server.pool.job import URGENCY_DEFAULT, BuildFault
from chunkserver.server.pool.pool import LIMITS_DEFAULT, Limits, Pool
from chunkserver.server.pool.tally import Tally

__all__ = ["LIMITS_DEFAULT", "URGENCY_DEFAULT", "BuildFault", "Limits", "Pool", "Tally"]
