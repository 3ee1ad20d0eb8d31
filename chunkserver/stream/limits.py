"""What the stream of edits is bounded by: docs/wire/edit_v1.md has the same table."""

from typing import Final

FRAME_BYTES_MAX: Final = 1 << 16
"""Of a message, in either direction."""
NAME_CHARS_MAX: Final = 128
"""Of a client's name."""
SEQ_MAX: Final = (1 << 53) - 1
"""The largest integer that JSON carries everywhere."""
REVISION_MAX: Final = (1 << 63) - 1
REGIONS_MAX: Final = 64
"""Of one connection."""
PLACE_MAX: Final = 1 << 40
"""Voxels: of the corners of a region."""
LODS_MAX: Final = 21
"""Levels that a world may have."""
INFLIGHT_MAX: Final = 64
"""Edits of one connection that are not answered: beyond that, nothing is read from it."""
RANGES_MAX: Final = 256
"""Ranges of chunks in one message: beyond that, they are joined level by level."""

QUEUE_BYTES_MAX: Final = 1 << 18
"""That wait to be sent on one connection. No more edits are put there; answers, which are few, still are."""
RECENT_EDITS_MAX: Final = 4096
RECENT_BYTES_MAX: Final = 16 << 20
"""Of the last edits of a world, which are kept for all who read it."""
REPLAYED_AT_ONCE_MAX: Final = 256
"""Edits that are read from the log together, for one connection."""
REPLAYED_MAX: Final = 10_000
"""Edits that one connection gets from the log: who has missed more fetches chunks instead."""

TICK_SECONDS: Final = 0.02
"""Edits of others are sent together so often."""
PROGRESS_SECONDS: Final = 0.5
"""After so long without another word of a revision, `progress` has it."""
HELLO_SECONDS: Final = 5.0
"""Until `hello` has to be there."""
SEND_SECONDS: Final = 5.0
"""A peer that takes nothing for so long, while something waits for it, is dropped."""
PING_SECONDS: Final = 3.0
"""Between an answer to a ping, or the opening, and the next ping."""
PONG_SECONDS: Final = 6.0
"""Until a ping is answered that the peer's system has taken. Else a peer that does not read is not seen for as long as
its system has room."""
GONE_SECONDS: Final = 10.0
"""After which a peer is dropped that does not read, whoever of all these sees it."""
BEHIND_SECONDS: Final = 2.0
"""A peer that is behind for so long is told which chunks are stale, and no more of the edits."""

assert PING_SECONDS + max(SEND_SECONDS, PONG_SECONDS) < GONE_SECONDS
assert 2 * PROGRESS_SECONDS <= 1.0, "at least once a second, also when a tick is late"

LIMITS: Final = {
    "frame_bytes": FRAME_BYTES_MAX,
    "inflight": INFLIGHT_MAX,
    "regions": REGIONS_MAX,
}
"""What `welcome` tells."""
