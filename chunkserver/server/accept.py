"""What a request would like: content negotiation over the tables of formats and codings, and how urgent it is."""

import re
from collections.abc import Iterable, Iterator
from typing import Final

from chunkserver.server.pool import URGENCY_DEFAULT

RANGES_MAX: Final = 32
"""Media ranges, or codings, of one request that are read; the rest is ignored."""

_URGENCY: Final = re.compile(rb"(?:^|,)\s*u=([0-7])\s*(?:,|;|$)")


def preferred(accept: Iterable[str], offered: Iterable[str]) -> str:
    """Return the media type of `offered` that the `Accept` fields like best.

    accept: the request's `Accept` fields, each a comma-separated list of media ranges with optional q-values.
    offered: media types, in the server's own order.

    The highest q wins; at equal q the type that is named more exactly; then the server's order. An `Accept` that fits
    nothing gets the first type all the same: the answer says what it is, and a mesh is more use than an error.
    """
    ranges = list(_ranges(accept))
    return max(offered, key=lambda media_type: _liking(media_type, ranges))


def preferred_coding(accept_encoding: Iterable[str], offered: Iterable[str]) -> str:
    """Return the content coding of `offered` that the `Accept-Encoding` fields like best (RFC 9110, 12.5.3).

    offered: names of codings, in the server's own order; the last one is sent to a client that names none of them.

    The highest q wins, then the server's order. What is not named is not liked, and `*` is all that is not named.
    """
    ranges = dict(_ranges(accept_encoding))
    *coded, plain = offered
    liking = {name: ranges.get(name, ranges.get("*", 0.0)) for name in coded}
    best = max(coded, key=lambda name: liking[name])
    return best if liking[best] > 0 and liking[best] >= ranges.get(plain, 0.0) else plain


def urgency(priority: bytes | None) -> int:
    """Return how urgent a request is, 0 (most) to 7, by its `Priority` field (RFC 9218)."""
    named = _URGENCY.search(priority) if priority else None
    return int(named[1]) if named else URGENCY_DEFAULT


def _liking(media_type: str, ranges: list[tuple[str, float]]) -> tuple[float, int]:
    """Quality of `media_type`, and how exactly it was named; the most exact range that fits decides its quality."""
    fitting = {media_type: 3, media_type.partition("/")[0] + "/*": 2, "*/*": 1}
    exactness, quality = max(((fitting[name], q) for name, q in ranges if name in fitting), default=(0, 0.0))
    return quality, exactness if quality else 0


def _ranges(accept: Iterable[str]) -> Iterator[tuple[str, float]]:
    for item in ",".join(accept).split(",", RANGES_MAX)[:RANGES_MAX]:
        name, *parameters = (part.strip().lower() for part in item.split(";"))
        quality = next((text[2:].strip() for text in parameters if text.startswith("q=")), "1")
        try:
            yield name, min(max(float(quality), 0.0), 1.0)
        except ValueError:
            continue
