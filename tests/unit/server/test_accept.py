import pytest

from chunkserver.server.accept import RANGES_MAX, preferred, preferred_coding, urgency

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


OFFERED = ("zstd", "gzip", "identity")


@pytest.mark.parametrize(
    ("fields", "coding"),
    [
        ([], "identity"),
        ([""], "identity"),
        (["gzip"], "gzip"),
        (["gzip, deflate, br, zstd"], "zstd"),
        (["gzip", "zstd"], "zstd"),
        (["GZIP;q=0.5, zstd;q=0.4"], "gzip"),
        (["br"], "identity"),
        (["*"], "zstd"),
        (["zstd;q=0, *"], "gzip"),
        (["gzip;q=0"], "identity"),
        (["gzip;q=0.5, identity"], "identity"),
        (["identity;q=0.5, gzip;q=0.5"], "gzip"),
        (["identity;q=0"], "identity"),
        (["gzip;q=nonsense"], "identity"),
        ([",".join(["br"] * 100) + ", gzip"], "identity"),
    ],
)
def test_the_coding_that_is_liked_best(fields, coding):
    assert preferred_coding(fields, OFFERED) == coding


@pytest.mark.parametrize(
    ("field", "urgent"),
    [
        (None, 3),
        (b"", 3),
        (b"u=0", 0),
        (b"u=7, i", 7),
        (b"i, u=1", 1),
        (b"i,u=5", 5),
        (b"u=8", 3),
        (b"u=12", 3),
        (b"u=-1", 3),
        (b"xu=1", 3),
    ],
)
def test_urgency(field, urgent):
    assert urgency(field) == urgent
