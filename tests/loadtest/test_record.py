"""Percentiles and bounds of what is written down."""

import numpy as np
import pytest

from chunkserver_loadtest.exchange import Answer, Exchange, Request
from chunkserver_loadtest.record import DURATION_MAX, MARKS, OPEN_SECONDS_MAX, Histogram, Record
from tests.scale import count

SHARES = (0.0, 0.01, 0.25, 0.5, 0.9, 0.99, 0.999, 1.0)


def filled(durations: np.ndarray) -> Histogram:
    histogram = Histogram()
    for duration in durations:
        histogram.add(float(duration))
    return histogram


@pytest.mark.parametrize("shape", ["exponential", "lognormal", "uniform"])
def test_quantiles_are_those_of_the_sorted_durations(rng, shape):
    durations = 1e-3 * getattr(rng, shape)(size=count(2_000_000))
    durations = np.maximum(durations, 1e-6)
    histogram = filled(durations)
    for share in SHARES:
        exact = np.quantile(durations, share, method="inverted_cdf")
        assert histogram.quantile(share) == pytest.approx(exact, rel=1e-3), share
    assert histogram.quantile(1.0) == histogram.highest == durations.max()
    assert histogram.total == pytest.approx(durations.sum())


def test_a_small_count_is_exact_at_its_ends():
    histogram = filled(np.array([1.0, 2.0, 3.0, 4.0]))
    assert [histogram.quantile(share) for share in (0, 0.5, 0.99, 1)] == pytest.approx([1.0, 2.0, 4.0, 4.0], rel=1e-3)
    assert Histogram().quantile(0.5) == 0.0


def test_histograms_add_up(rng):
    left, right = rng.exponential(size=500), rng.exponential(size=300)
    added = filled(left)
    added.merge(filled(right))
    both = filled(np.concatenate([left, right]))
    assert [added.quantile(share) for share in SHARES] == [both.quantile(share) for share in SHARES]
    assert (added.count, added.highest, added.lowest) == (both.count, both.highest, both.lowest)


def test_whatever_comes_there_are_not_more_counts():
    histogram = filled(np.concatenate([np.geomspace(1e-12, 1e9, count(2_000_000)), [0.0, -1.0]]))
    assert len(histogram._counts) <= 33 * MARKS / 2
    assert histogram.highest == pytest.approx(1e9)
    assert histogram.quantile(0.5) <= DURATION_MAX


def ended(record: Record, moment: float) -> Exchange:
    exchange = Exchange(Request("/"), moment, moment, moment + 0.01, Answer(200, b"", ()))
    record.due(exchange, False, 1)
    record.ended(exchange)
    return exchange


def test_of_a_long_run_few_seconds_have_a_histogram():
    record = Record()
    record.begun(100.0)
    for second in range(1000):
        ended(record, 100.0 + second)
        assert sum(one.latency.count > 0 for one in record.seconds.values()) <= OPEN_SECONDS_MAX
    record.close()
    assert len(record.seconds) == 1000
    assert all(one.p50 == pytest.approx(0.01, rel=1e-3) for one in record.seconds.values())


def test_what_waits_for_a_connection_is_not_the_generators_lag():
    record = Record()
    record.begun(0.0)
    for waits in (False, True):
        record.due(Exchange(Request("/"), due=1.0, sent=1.0 + 5 * waits), waits, 1)
    assert (record.due_count, record.lag.count, record.lag.highest) == (2, 1, 0.0)


def test_failures_keep_one_example_of_each_kind():
    record = Record()
    record.begun(0.0)
    for number in range(100):
        record.fail(ended(record, number / 10), "cut", f"number {number} " + "x" * 1000)
    assert record.failed_count == 100
    assert record.failures["cut"].detail.startswith("number 0 ")
    assert len(record.failures["cut"].detail) <= 300
    assert record.seconds[3].failed == 10
