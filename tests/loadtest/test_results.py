"""Results as files, and what `compare` says of two of them."""

import dataclasses
import json

import pytest

from chunkserver_loadtest.compare import METRICS, compare, differences
from chunkserver_loadtest.errors import BadBudget, BadResult
from chunkserver_loadtest.exchange import Answer, Exchange, Request
from chunkserver_loadtest.record import Record
from chunkserver_loadtest.result import Result, Value, load, save, summarise


def result_with(
    latency: float, failures: int = 0, rate: float = 100.0, cpu_seconds: float = 0.1, lag: float = 0.0
) -> Result:
    """Return the result of 100 requests that all took so many seconds. lag: how late each was sent."""
    record = Record()
    record.begun(50.0)
    for number in range(100):
        due = 50.0 + number / rate
        exchange = Exchange(Request("/"), due, due + lag, due + latency, Answer(200, b"", ()), received=1000)
        record.due(exchange, False, 1)
        record.ended(exchange)
        if number < failures:
            record.fail(exchange, "other-chunk", "it is another one")
    options: dict[str, Value] = {
        "seed": 1,
        "codings": ["identity"],
        "at": [0.0, 1.0],
        "rate": rate,
        "closed": False,
        "world": "/v1/seeds/1",
    }
    return summarise(record, "warm-hot", options, {"cpu": "one"}, "token", 1.0, cpu_seconds, (3, 4))


def test_a_result_reads_back_as_it_was(tmp_path):
    result = result_with(0.01, failures=2)
    save(result, tmp_path / "result.json")
    assert load(tmp_path / "result.json") == result
    tree = json.loads((tmp_path / "result.json").read_text())
    assert tree["schema"] == 2
    assert tree["latency"]["by_status"]["200"]["p99_9"] == pytest.approx(10, rel=1e-3)
    assert tree["failures"]["other-chunk"] == {"count": 2, "path": "/", "detail": "it is another one"}
    assert [row["answered"] for row in tree["series"]] == [99, 1]


def change(*path: str, value: object = None) -> dict[str, object]:
    """Return a result's tree with one field changed; removed if it is to be None."""
    tree = dataclasses.asdict(result_with(0.01))
    inside = tree
    for name in path[:-1]:
        inside = inside[name]
    if value is None:
        del inside[path[-1]]
    else:
        inside[path[-1]] = value
    return tree


@pytest.mark.parametrize(
    ("tree", "where"),
    [
        (change("counts", "due"), "counts has other fields than Counts: .'due'"),
        (change("counts", "due", value="many"), "counts.due is 'many': int"),
        (change("counts", "due", value=True), "counts.due is 'True'"),
        (change("generator", "was_limit", value=1), "was_limit is '1': bool"),
        (change("latency", "all", value=3), "latency.all has other fields"),
        (change("series", value=[{}]), r"series\[0\] has other fields"),
        (change("options", "seed", value={}), "options.seed is '{}': none of its types"),
        (change("schema", value=1), "schema 1: this version reads 2"),
        (change("more", value=1), "has other fields than Result: .'more'"),
        ([], "schema None"),
    ],
)
def test_a_file_that_is_no_result_is_refused(tmp_path, tree, where):
    (tmp_path / "result.json").write_text(json.dumps(tree))
    with pytest.raises(BadResult, match=where):
        load(tmp_path / "result.json")


@pytest.mark.parametrize("content", [None, b"", b"{", b"\xff\xff"])
def test_what_cannot_be_read_is_no_result(tmp_path, content):
    if content is not None:
        (tmp_path / "result.json").write_bytes(content)
    with pytest.raises(BadResult, match="is no result"):
        load(tmp_path / "result.json")


@pytest.mark.parametrize(
    ("after", "budget", "kept"),
    [
        (result_with(0.0119), "p99=+20%", True),
        (result_with(0.0121), "p99=+20%", False),
        (result_with(0.005), "p99=+0%", True),
        (result_with(0.0199), "p50=20", True),
        (result_with(0.0201), "p50=20", False),
        (result_with(0.01), "errors=0", True),
        (result_with(0.01, failures=1), "errors=0", False),
        (result_with(0.01, failures=1), "errors=+50%", False),
        (result_with(0.01, rate=96.0), "rate=-5%", True),
        (result_with(0.01, rate=90.0), "rate=-5%", False),
        (result_with(0.01, rate=90.0), "rate=95", False),
        (result_with(0.01, rate=300.0), "rate=95", True),
    ],
)
def test_a_budget_is_kept_or_broken(after, budget, kept):
    lines = compare(result_with(0.01), after, [budget])
    assert [line.kept for line in lines if line.bound is not None] == [kept]
    assert [line.name for line in lines] == list(METRICS)[:11], "what storms alone have is left out"


@pytest.mark.parametrize(
    "budget", ["p99", "p98=+5%", "p99=20%", "p99=+20", "p99=-20%", "rate=+5%", "p99=", "errors=none", "p99=+20%x"]
)
def test_a_budget_that_says_nothing_is_refused(budget):
    with pytest.raises(BadBudget, match=r"p9|rate|errors"):
        compare(result_with(0.01), result_with(0.01), [budget])


def test_a_metric_has_one_budget():
    with pytest.raises(BadBudget, match="two budgets"):
        compare(result_with(0.01), result_with(0.01), ["p99=+20%", "p99=30"])


@pytest.mark.parametrize(
    ("lag", "latency", "was_limit"), [(0.0019, 0.002, False), (0.003, 0.014, True), (0.003, 0.016, False)]
)
def test_a_generator_is_the_limit_if_it_is_late_beside_the_latency(lag, latency, was_limit):
    assert result_with(latency, lag=lag).generator.was_limit is was_limit


def test_what_cannot_be_compared_is_said():
    assert differences(result_with(0.01), result_with(0.02)) == []
    assert differences(result_with(0.01), result_with(0.01, rate=50.0)) == ["rate: 100.0, then 50.0"]
    late = result_with(0.01, cpu_seconds=5.0)
    assert late.generator.was_limit
    assert differences(result_with(0.01), late) == ["the generator was the limit of the second"]
