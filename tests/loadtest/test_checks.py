"""Wrong answers are found, whatever their status says."""

import gzip
import itertools
import json
import struct

import pytest
from backports import zstd

from chunkserver_loadtest.checks import KINDS, Checker, Fault
from chunkserver_loadtest.exchange import Answer, Exchange, Request
from chunkserver_loadtest.generator import Limits
from chunkserver_loadtest.profiles import Options
from chunkserver_loadtest.result import Result
from chunkserver_loadtest.runs import Plan, run
from chunkserver_loadtest.storms import LOSSES
from chunkserver_loadtest.world import World
from tests.loadtest.stub import KEY, MEDIA_TYPE, OK, TAG, Pieces, Reply, answer, answering, descriptor, example, path

FILE = example("std")
OTHER = FILE[:8] + struct.pack("<q", 77) + FILE[16:]
PROBLEM = {"etag": "", "content_type": "application/problem+json", "chunk_content": ""}
REFUSAL = answer("503 Service Unavailable", b"{}", retry_after="1", **PROBLEM)

WORLD = World(
    path="/v1/seeds/42?recipe=terrain",
    generator="stub",
    chunk_url="/v1/seeds/42/chunks/{lod}/{x}/{y}/{z}{extension}?recipe=terrain",
    extension=".mesh",
    format="mesh",
    media_type=MEDIA_TYPE,
    cells=32,
    voxel_size=0.5,
    lods=3,
    low=(-(1 << 40),) * 3,
    high=(1 << 40,) * 3,
)
REQUEST = WORLD.request(KEY, "cold", "identity")


def result_of(reply: Reply, **options: float) -> Result:
    """Return the result of a short run of `warm-hot` whose only chunk is KEY."""

    def replied(head: str) -> Pieces:
        if "/chunks/" not in head:
            return descriptor()
        answered = reply(head)
        assert isinstance(answered, bytes | list)
        return answered

    at = tuple((place + 0.5) * 32 for place in KEY[1:])
    plan_options = Options(rate=100, hot=1, at=(at[0], at[1], at[2]), revalidate=options.get("revalidate", 0.0))
    with answering(replied) as server:
        limits = Limits(seconds=0.1, connections=2, timeout=0.4)
        return run(Plan(server.url, WORLD.path, "warm-hot", plan_options, limits), lambda _: None)


def chunk(head: str) -> bytes:
    """Return the right answer to any request: the example, under the key that is asked for."""
    lod, x, y, z = map(int, path(head).partition(".mesh")[0].split("/")[-4:])
    content = bytearray(FILE)
    struct.pack_into("<3q", content, 8, x, y, z)
    content[62] = lod
    return bytes(content)


def test_right_answers_have_no_faults():
    result = result_of(lambda head: answer("200 OK", chunk(head)))
    assert result.failures == {}
    assert result.counts.answered == 10
    assert result.counts.decoded == 2
    assert result.counts.compared == 10


def after_the_first(right: Reply, wrong: Reply) -> Reply:
    """Return what answers the two requests that prime the hot set rightly, and all later ones wrongly."""
    asked = itertools.count()
    return lambda head: right(head) if next(asked) < 2 else wrong(head)


def right(head: str) -> bytes:
    return answer("200 OK", chunk(head))


EACH: dict[str, Reply] = {
    "other-chunk": lambda _head: answer("200 OK", OTHER),
    "bad-chunk": lambda head: answer("200 OK", chunk(head)[:-16]),
    "no-tag": lambda head: answer("200 OK", chunk(head), etag=""),
    "wrong-type": lambda head: answer("200 OK", chunk(head), content_type="text/html"),
    "wrong-header": lambda head: answer("200 OK", chunk(head), chunk_content="air"),
    "bad-coding": lambda head: answer("200 OK", chunk(head), content_encoding="gzip"),
    "uninvited-304": lambda _head: answer("304 Not Modified"),
    "wrong-status": lambda _head: answer("404 Not Found", b"{}", **PROBLEM),
    "refused": lambda _head: REFUSAL,
    "bad-refusal": lambda _head: answer("503 Service Unavailable", b"no", content_type="text/html"),
    "other-tag": lambda head: answer("200 OK", chunk(head), etag='"another"'),
    "other-bytes": lambda head: answer("200 OK", chunk(head)[:-1] + b"\1"),
    "timeout": lambda head: answer("200 OK", chunk(head), length="10000"),
    "extra-bytes": lambda head: answer("200 OK", chunk(head), length=str(len(FILE) - 1)),
    "cut": lambda head: [answer("200 OK", chunk(head))[:-1], b""],
    "closed": lambda _head: b"",
    "malformed-http": lambda _head: b"220 ready\r\n\r\n",
}
AT_FIRST = ("other-chunk", "bad-chunk", "no-tag", "wrong-type", "wrong-header", "bad-coding")
"""What is found when a URL is answered for the first time; the others in later answers too."""


@pytest.mark.parametrize("kind", EACH)
def test_a_wrong_answer_is_found_and_counted_with_an_example(kind):
    wrong = EACH[kind]
    result = result_of(wrong if kind in AT_FIRST else after_the_first(right, wrong))
    assert set(result.failures) == {kind}
    assert result.failures[kind].count >= 2
    assert "/chunks/" in result.failures[kind].path
    assert result.failures[kind].detail
    assert result.counts.failed == result.failures[kind].count


def test_every_kind_is_known():
    elsewhere = {"no-connection", "too-large", "bad-batch"}
    of_storms = {"nack", "peer-lost", *LOSSES.values()}  # test_storms has each of them
    of_edits = {f"edit-{what}" for what in ("missed", "late", "strange", "changed", "doubled", "lost")}
    assert set(EACH) | elsewhere | of_storms | of_edits == set(KINDS)


def test_a_304_that_was_asked_for_is_right():
    result = result_of(after_the_first(right, lambda _head: answer("304 Not Modified")), revalidate=1.0)
    assert result.failures == {}
    assert result.latency.by_status["304"].count == 10


def test_a_304_with_another_tag_is_wrong():
    wrong = after_the_first(right, lambda _head: answer("304 Not Modified", etag='"another"'))
    assert set(result_of(wrong, revalidate=1.0).failures) == {"other-tag"}


def fault_of(checker: Checker, request: Request, given: Answer) -> str:
    try:
        checker.check(request, given)
    except Fault as fault:
        return fault.kind
    return ""


def given(body: bytes, *, status: int = 200, tag: str = TAG, content: str = "surface", coding: str = "") -> Answer:
    told = {"etag": tag, "content-type": MEDIA_TYPE, "chunk-content": content, "content-encoding": coding}
    return Answer(status, "".join(f"\r\n{name}: {value}" for name, value in told.items()).encode(), (body,))


def test_a_coding_is_undone():
    request = REQUEST._replace(coding="gzip")
    right, cut = gzip.compress(FILE), gzip.compress(FILE)[:-20]
    assert fault_of(Checker(WORLD), request, given(right, coding="gzip")) == ""
    assert fault_of(Checker(WORLD), request, given(cut, coding="gzip")) == "bad-coding"
    assert fault_of(Checker(WORLD), request, given(b"no gzip", coding="gzip")) == "bad-coding"


@pytest.mark.parametrize(("coding", "compress"), [("gzip", gzip.compress), ("zstd", zstd.compress)])
def test_a_coding_is_undone_to_its_last_byte(coding, compress):
    """The end of a gzip file is a checksum: all of the chunk is there without it."""
    request, whole = REQUEST._replace(coding=coding), compress(FILE)
    assert fault_of(Checker(WORLD), request, given(whole, coding=coding)) == ""
    for wrong in (whole[:-1], whole[:-8], whole + b"more"):
        assert fault_of(Checker(WORLD), request, given(wrong, coding=coding)) == "bad-coding"


def test_a_bomb_is_not_unpacked():
    bomb = gzip.compress(bytes((1 << 26) + 1), compresslevel=1)
    request = REQUEST._replace(coding="gzip")
    assert fault_of(Checker(WORLD), request, given(bomb, coding="gzip")) == "too-large"


def test_a_204_says_what_it_is_empty_of():
    assert fault_of(Checker(WORLD), REQUEST, given(b"", status=204, content="air")) == ""
    assert fault_of(Checker(WORLD), REQUEST, given(b"", status=204)) == "wrong-header"


def test_the_same_url_in_another_coding_has_another_tag():
    checker = Checker(WORLD)
    zipped = given(gzip.compress(FILE), coding="gzip", tag='"zipped"')
    assert fault_of(checker, REQUEST, given(FILE)) == ""
    assert fault_of(checker, REQUEST._replace(coding="gzip"), zipped) == ""
    assert fault_of(checker, REQUEST, given(FILE)) == ""


def test_a_share_of_later_answers_is_compared():
    checker = Checker(WORLD, share=0.25)
    faults = [fault_of(checker, REQUEST, given(FILE if not number else OTHER)) for number in range(401)]
    assert faults.count("other-bytes") == checker.compared == pytest.approx(100, abs=40)
    assert checker.decoded == 1


def frame(
    index: int, body: bytes = b"", status: int = 200, content: int = 3, tag: bytes = TAG.strip('"').encode()
) -> bytes:
    head = struct.pack("<IIHBBIQ32sQ", len(body), index, status, content, 0, 0, 7, tag, 0)
    return head + body + bytes(-len(body) % 16)


def batch(*frames: bytes, count: int | None = None) -> bytes:
    told = len(frames) if count is None else count
    end = struct.pack("<IIHBBIQ32sQ", 0, 0xFFFFFFFF, 200, 0, 0, told, 0, b"", 0)
    return struct.pack("<4sHHQ", b"CHNB", 1, 64, 0) + b"".join(frames) + end


EMPTY = (2, 0, 9, 0)
BATCH = WORLD.batch((KEY, EMPTY), (0.5, 1.0, 2.0), "identity", 1)
AIR = frame(1, status=204, content=1)


def test_a_batch_is_asked_for_as_the_interface_has_it():
    assert BATCH.path == "/v1/seeds/42/chunks?recipe=terrain"
    asked = {"chunks": [list(KEY), list(EMPTY)], "viewer": [0, 1, 2], "format": "mesh", "coding": "identity"}
    assert json.loads(BATCH.body) == asked


def exchange_of(stream: bytes) -> Exchange:
    arrivals = [(len(stream) // 2, 1.0), (len(stream), 2.0)]
    return Exchange(BATCH, 0.0, 0.0, 2.0, given(stream), received=len(stream), arrivals=arrivals)


@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
def test_a_batch_is_checked_chunk_by_chunk(order):
    frames = [frame(0, FILE), AIR]
    checker = Checker(WORLD)
    parts = list(checker.check_batch(exchange_of(batch(*(frames[place] for place in order)))))
    assert {part.status for part in parts} == {"200", "204"}
    assert [part.arrived for part in parts] == sorted(part.arrived for part in parts)
    assert parts[-1].arrived == 2.0
    assert checker.decoded == 1


@pytest.mark.parametrize(
    ("stream", "kind"),
    [
        (batch(frame(0, OTHER), AIR), "other-chunk"),
        (batch(frame(0, FILE[:-16]), AIR), "bad-chunk"),
        (batch(frame(0, FILE)), "bad-batch"),
        (batch(frame(0, FILE), frame(0, FILE)), "bad-batch"),
        (batch(frame(0, FILE), frame(2, FILE)), "bad-batch"),
        (batch(frame(0, FILE), AIR, count=3), "bad-batch"),
        (batch(frame(0, FILE), AIR)[:-64], "bad-batch"),
        (batch(frame(0, FILE), AIR)[:-80], "bad-batch"),
        (batch(frame(0, FILE), AIR) + b"more", "bad-batch"),
        (b"CHNK" + bytes(100), "bad-batch"),
        (b"", "bad-batch"),
        (batch(frame(0, FILE, tag=b""), AIR), "no-tag"),
        (batch(frame(0, FILE), frame(1, b"{}", status=503, content=0)), "refused"),
        (batch(frame(0, FILE), frame(1, b"{}", status=422, content=0)), "wrong-status"),
        (batch(frame(0, FILE, content=1), AIR), "wrong-header"),
        (batch(frame(0, FILE), frame(1, status=304)), "wrong-status"),
    ],
)
def test_a_wrong_batch_is_found(stream, kind):
    with pytest.raises(Fault) as raised:
        list(Checker(WORLD).check_batch(exchange_of(stream)))
    assert raised.value.kind == kind


def test_the_stub_answers_with_the_example_of_the_page():
    assert OK.endswith(FILE)
    assert len(FILE) == 208
