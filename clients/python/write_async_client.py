"""Writes `async_client.py`, which is `client.py` in other words: both have one line a call, and the same docstrings.

python clients/python/write_async_client.py
"""

import re
from pathlib import Path
from typing import Final

PACKAGE: Final = Path(__file__).parent / "chunkserver_client"
BLOCKING: Final = PACKAGE / "client.py"
ASYNC: Final = PACKAGE / "async_client.py"

RULES: Final = (
    (
        r"The client that blocks\. `async_client\.py` has the same for the event loop\.",
        "The client for the event loop: `write_async_client.py` makes it of `client.py`.",
    ),
    (r"class Client:", "class AsyncClient:"),
    (r"in a `with` statement", "in an `async with` statement"),
    (r"from chunkserver_client\.blocking_stream import EditStream\n", ""),
    (r"import Address", "import Address, AsyncEditStream"),
    (r"\bEditStream", "AsyncEditStream"),
    (r"BlockingCall", "AsyncCall"),
    (r"httpx2\.(Client|BaseTransport)", lambda found: f"httpx2.Async{found[1]}"),
    (r"import Iterable, Iterator, Sequence", "import AsyncIterator, Iterable, Sequence"),
    (r"-> Iterator\[", "-> AsyncIterator["),
    (r"    def (?!__init__|chunks\(|edits\(|stream\()", "    async def "),
    (r"__(enter|exit)__", r"__a\1__"),
    (r"self\._http\.close\(\)", "await self._http.aclose()"),
    (r"\b(self\.close|self\._run|call\.\w+)\(", r"await \1("),
)


def asynchronous(source: str) -> str:
    """Return the source of the asynchronous client, given that of the one that blocks."""
    for pattern, replacement in RULES:
        source = re.sub(pattern, replacement, source)
    return source


if __name__ == "__main__":
    ASYNC.write_text(asynchronous(BLOCKING.read_text(encoding="utf-8")), encoding="utf-8")
