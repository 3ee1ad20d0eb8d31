"""What it takes until a page shows its world: how much comes over the network, never how long that takes."""

from typing import Final

from tests.browser.conftest import Play
from tests.serving import Server

BYTES_MAX: Final = 1_000_000
"""Of the page and all that comes until `continents` is shown from orbit; 650 kB today."""
REQUESTS_MAX: Final = 20
"""Until then, besides those that are sent again and again; 9 today."""
API: Final = "/v1/"
POLLED: Final = "/v1/worlds"


def test_a_first_view_is_small(play: Play, server: Server):
    found = play("firstView", server)
    assert found["received"] >= found["chunks"] > 20
    asked = [path for path, _ in found["answers"] if path != POLLED]
    assert len(asked) <= REQUESTS_MAX, asked
    page = sum(size for path, size in found["answers"] if not path.startswith(API))
    assert page > 100_000
    assert found["bytes"] > 100_000
    assert page + found["bytes"] <= BYTES_MAX, (found["bytes"], found["answers"])
