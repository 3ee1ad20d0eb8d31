"""What both clients are made of."""

import re
import ssl
from typing import Final
from urllib.parse import urlsplit

import httpx2

from chunkserver_client.cache import AnswerCache
from chunkserver_client.calls import Calls
from chunkserver_client.coding import CODINGS, Coding
from chunkserver_client.exchange import Exchange
from chunkserver_client.retry import Retry
from chunkserver_client.version import __version__

CACHE_BYTES: Final = 1 << 26
READY_SECONDS: Final = 120.0
"""The first start of a version compiles its kernels."""
TIMEOUT: Final = httpx2.Timeout(connect=5.0, read=40.0, write=10.0, pool=40.0)
"""A server waits up to 30 s before it gives a chunk up."""
USER_AGENT: Final = f"chunkserver-client/{__version__}"

_KEY: Final = re.compile("[!-~]+")


def calls_of(retry: Retry | None, cache_bytes: int, coding: Coding, timeout: httpx2.Timeout) -> Calls:
    """Return the calls of a client. Raises `ValueError` for what makes no client."""
    if coding not in CODINGS:
        raise ValueError(f"coding is {coding!r}: there are {CODINGS}")
    seconds = (timeout.connect, timeout.read, timeout.write, timeout.pool)
    if timeout.read is None or None in seconds:
        raise ValueError(f"{timeout}: a client that waits for ever is none")
    return Calls(Exchange(retry or Retry(), AnswerCache(cache_bytes), timeout.read), coding)


def tls_of(url: str, tls: ssl.SSLContext | None) -> ssl.SSLContext | bool:
    """Return whom to trust: without TLS nobody, because loading the default's authorities takes a tenth of a second.

    Raises `ValueError` if `url` is not one of http or https.
    """
    scheme = urlsplit(url).scheme
    if scheme not in ("http", "https"):
        raise ValueError(f"url is {url!r}: expected http://... or https://...")
    return tls or (True if scheme == "https" else ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT))


def headers_of(api_key: str | None, coding: Coding) -> dict[str, str]:
    """Return the headers of every request. Raises `ValueError`, without the key, for one that no header can have."""
    if api_key is not None and not _KEY.fullmatch(api_key):
        raise ValueError("api_key has to be visible ASCII characters: no blank, no line break, and not nothing")
    key = {} if api_key is None else {"authorization": f"Bearer {api_key}"}
    return {"user-agent": USER_AGENT, "accept-encoding": coding, **key}
