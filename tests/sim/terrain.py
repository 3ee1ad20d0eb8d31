"""A world that is a row of chunks. A stroke is `{"op": "dig", "at": x}`; one `at` None changes nothing."""

import json
from typing import Any, Final

CELLS: Final = 32
CHUNKS: Final = 8
"""Of LOD 0, along x; half as many of LOD 1."""
LODS: Final = (0, 1)


def told(values: list[Any]) -> bytes:
    return json.dumps(values, separators=(",", ":")).encode()
