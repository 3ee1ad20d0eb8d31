import pytest

from chunkserver.server.accept import RANGES_MAX, preferred

NATIVE, GLB = "application/vnd.chunkserver.mesh", "model/gltf-binary"


@pytest.mark.parametrize(
    ("accept", "expected"),
    [
        ([], NATIVE),
        (["*/*"], NATIVE),
        ([GLB], GLB),
        (["Model/GLTF-Binary"], GLB),
        (["model/*"], GLB),
        ([f"{GLB}, */*"], GLB),
        ([f"{GLB};q=0.5, */*;q=0.8"], NATIVE),
        ([f"{NATIVE};q=0.4, {GLB} ; Q=0.5"], GLB),
        ([f"{GLB};q=0, */*"], NATIVE),
        ([f"{NATIVE};q=0, */*"], GLB),
        ([f"{GLB};q=0, {NATIVE};q=0"], NATIVE),
        (["text/html, application/xhtml+xml, image/*;q=0.8"], NATIVE),
        (["text/html", GLB], GLB),
        ([f"{GLB};q=often"], NATIVE),
        ([f"{GLB};q=nan"], NATIVE),
        ([f"{GLB};q=9, {NATIVE};q=1"], NATIVE),
        ([",,;;=,"], NATIVE),
        (["text/html," * RANGES_MAX + GLB], NATIVE),
    ],
)
def test_the_format_that_is_liked_best(accept, expected):
    assert preferred(accept, [NATIVE, GLB]) == expected


def test_the_servers_own_order_decides_between_equals():
    assert preferred([], [GLB, NATIVE]) == GLB
