"""What it takes until a page shows its world: how much comes over the network, never how long that takes."""

from typing import Final

from tests.browser.conftest import Play
from tests.serving import Server

BYTES_MAX: Final = 600_000
"""Of the page and all answers until `planet` is shown from orbit; 390 kB today."""
REQUESTS_MAX: Final = 20
"""Until then, besides those that are sent again and again; 9 today."""
POLLED: Final = "/v1/worlds"
CHUNKS: Final = "/v1/seeds/42/chunks"


def test_a_first_view_is_small(play: Play, server: Server):
    found = play("firstView", server)
    assert found["received"] >= found["chunks"] > 20
    asked = [path for path, _ in found["answers"] if path != POLLED]
    assert CHUNKS in asked
    assert len(asked) <= REQUESTS_MAX, asked
    assert sum(size for _, size in found["answers"]) <= BYTES_MAX, found["answers"]
