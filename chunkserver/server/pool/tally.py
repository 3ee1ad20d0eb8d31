"""What the pool counts. Plain numbers, to be read whenever metrics are asked for."""

from dataclasses import dataclass, field
from typing import Final

from chunkserver.pipeline import STAGES
from chunkserver.server.histogram import Histogram

QUEUE: Final = "queue"
BUILD: Final = "build"


@dataclass(slots=True)
class Tally:
    """Counts from the start of the pool on; one event loop owns it.

    done: chunks that workers built. failed: errors that workers answered.
    refused: jobs turned away because the queue was full. expired: jobs whose deadline passed.
    retried: jobs given to another worker because theirs was lost.
    lost: workers that ended while they belonged to the pool. hung: those of them that we killed as they took too long.
    recycled: workers replaced because their memory had grown.
    seconds: by stage: from the request until a worker gets it ("queue"), as that worker tells ("field", "mesh",
        "encode"), and from giving it to a worker until its answer ("build").
    """

    done: int = 0
    failed: int = 0
    refused: int = 0
    expired: int = 0
    retried: int = 0
    lost: int = 0
    hung: int = 0
    recycled: int = 0
    seconds: dict[str, Histogram] = field(
        default_factory=lambda: {stage: Histogram() for stage in (QUEUE, *STAGES, BUILD)}
    )
