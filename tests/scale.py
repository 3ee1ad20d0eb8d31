"""How much of a long test to run."""

import os

TORTURE = os.environ.get("CHUNKSERVER_TORTURE") == "1"


def count(torture: int) -> int:
    """Return `torture` under `make torture` and one hundredth of it, at least 1, in `make test`."""
    return torture if TORTURE else max(1, torture // 100)
