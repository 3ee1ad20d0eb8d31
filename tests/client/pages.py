"""The worked examples of docs/wire: their bytes, and what the pages say that they are."""

import json
import re
from pathlib import Path
from typing import Any, Final

WIRE: Final = Path(__file__).parents[2] / "docs/wire"
NATIVE: Final = (WIRE / "native-v1.md").read_text(encoding="utf-8")
BATCH: Final = (WIRE / "batch-v1.md").read_text(encoding="utf-8")


def hexdump(page: str, name: str) -> bytes:
    """Return the bytes of the one block that is fenced as ```hex name."""
    (dump,) = re.findall(rf"^```hex {name}\n(.*?)^```$", page, re.DOTALL | re.MULTILINE)
    return bytes.fromhex("".join(row.split(maxsplit=1)[1] for row in dump.splitlines()))


def stated(page: str, name: str) -> dict[str, Any]:
    """Return the JSON of the one block that is fenced as ```json name."""
    (text,) = re.findall(rf"^```json {name}\n(.*?)^```$", page, re.DOTALL | re.MULTILINE)
    found: dict[str, Any] = json.loads(text)
    return found
