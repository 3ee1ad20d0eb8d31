"""docs/wire/edit_v1.md: its limits and codes are those of both sides."""

import re
from pathlib import Path
from typing import Final

from chunkserver.server import share
from chunkserver.server.stream_protocol import PIECES_MAX
from chunkserver.stream import closing, limits
from chunkserver_client.stream import messages, session

PAGE: Final = (Path(__file__).parents[2] / "docs/wire/edit_v1.md").read_text()


def rows(heading: str) -> dict[str, list[str]]:
    """Return the rows of the first table behind a text: the first cell of each, and the others."""
    table = PAGE.partition(heading)[2].partition("\n|")[2].partition("\n\n")[0]
    cells = [[cell.strip() for cell in line.strip("|").split("|")] for line in table.splitlines()]
    return {first: rest for first, *rest in cells[2:]}


def test_the_page_has_the_limits():
    told = {
        name: re.findall(r"[\d,]+", cells[0])[0].replace(",", "")
        for name, cells in rows("falls below the floor meanwhile").items()
    }
    assert told == {
        "a frame": str(limits.FRAME_BYTES_MAX),
        "pieces of a frame: what RFC 6455 calls fragments": str(PIECES_MAX),
        "`client`, `epoch`": str(limits.NAME_CHARS_MAX),
        "edits without an answer, on a connection": str(limits.INFLIGHT_MAX),
        "regions of a connection": str(limits.REGIONS_MAX),
        "ranges of an edit, of `stale`, of `ack`": str(limits.RANGES_MAX),
        "strokes of an edit": "1000",
        "bytes that wait for one connection": str(limits.QUEUE_BYTES_MAX),
        "a peer's share of the server's time": f"{100 * share.OWN_SHARE:g}",
        "recent edits, kept for all": str(limits.RECENT_EDITS_MAX),
        "a catch-up": str(limits.REPLAYED_MAX),
        "until `hello`": f"{limits.HELLO_SECONDS:g}",
        "until something is taken": f"{limits.SEND_SECONDS:g}",
        "until a ping is answered": f"{limits.PONG_SECONDS:g}",
    }
    assert f"and {1000 * share.BURST_SECONDS:g} ms at once" in PAGE
    assert (share.REST, "five times as" in PAGE, "a fifth for all" in PAGE) == (5.0, True, True)
    assert messages.FRAME_BYTES_MAX == limits.FRAME_BYTES_MAX
    assert messages.REGIONS_MAX == limits.REGIONS_MAX


def test_the_page_has_the_codes():
    table = rows("## How it ends")
    known = {close.code for close in vars(closing).values() if isinstance(close, closing.Close)}
    assert {int(code) for code in table} == known | {1009, 1012, closing.MALFORMED, closing.OUT_OF_ORDER}
    final = {int(code) for code, cells in table.items() if cells[1] == "no"}
    assert final == session.FINAL_CODES - {4403, 4422}, "those are of upgrades that are refused alone"
