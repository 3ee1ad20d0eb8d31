"""Two versions in turns: what is called a difference, and that each side measures its own version."""

import itertools
import signal
from contextlib import contextmanager
from pathlib import Path

import pytest

from benchmarks import compare
from benchmarks.measure import TINY
from benchmarks.remote import JOBS, ROOT, remote

JOB = "hills: field"


def test_interval_is_the_whole_range_of_few_values():
    assert compare.interval([3.0, 1.0, 2.0]) == (1.0, 3.0)
    assert compare.interval([1.5]) == (1.5, 1.5)


def test_interval_leaves_out_what_it_may():
    """Of 15 values 3 lie below the median in 1.8 % of cases and 2 in 0.4 %: at both ends 0.7 % with 2 left out."""
    assert compare.interval([float(value) for value in range(15)]) == (2.0, 12.0)


@pytest.mark.parametrize(
    ("ratios", "said"),
    [
        ([1.3, 1.2, 1.25], "faster"),
        ([0.8, 0.7, 0.9], "slower"),
        ([1.3, 1.2, 0.99], ""),
        ([1.01, 1.015, 1.012], ""),
        ([0.99, 0.985, 0.999], ""),
    ],
)
def test_a_difference_is_one_in_all_pairs_and_more_than_the_least(ratios, said):
    assert compare.verdict(ratios) == said


def test_table_shows_who_is_faster(monkeypatch):
    starts = itertools.count()

    class Side:
        def __init__(self, milliseconds: float) -> None:
            self.milliseconds = milliseconds

        def turn(self, _job: str) -> float:
            return self.milliseconds

    @contextmanager
    def pretend(_chunks: int, checkout: Path, cache_dir: Path):
        assert cache_dir != checkout
        yield Side(1.0 if checkout == ROOT else 3.0)
        next(starts)

    monkeypatch.setattr(compare, "remote", pretend)
    lines = list(compare.compare("HEAD", None, JOB, TINY, pairs=2))
    assert lines[-3:] == [
        "|  | HEAD, ms | checkout, ms | times as fast | difference |",
        "| --- | ---: | ---: | ---: | --- |",
        "| hills: field | 3.00 | 1.00 | 3.00 (3.00-3.00) | faster |",
    ]
    assert next(starts) == 4, "each side of each pair is a process of its own, and is ended"


def test_what_there_is_not_is_named():
    with pytest.raises(ValueError, match="'no-such-commit' cannot be compared"):
        list(compare.compare("no-such-commit", None, "", TINY))
    with pytest.raises(ValueError, match="no job has 'no such job'"):
        list(compare.compare("HEAD", None, "no such job", TINY))


def test_a_side_measures_the_version_that_was_unpacked(tmp_path):
    folder = compare._unpack("HEAD", tmp_path / "version")
    with remote(TINY.chunks, folder, tmp_path / "compiled") as side:
        assert Path(side.package) == folder / "chunkserver"
        child = side.child
    assert child.poll() == -signal.SIGKILL
    with remote(TINY.chunks) as side:
        assert Path(side.package) == ROOT / "chunkserver"
        assert side.turn(JOB) > 0


def test_a_side_that_ends_is_an_error_not_a_wait():
    with remote(TINY.chunks) as side:
        side.child.kill()
        with pytest.raises(RuntimeError, match="ended with exit code -9"):
            side.turn(JOB)


def test_jobs_are_of_every_scene_and_stage():
    assert JOB in JOBS
    assert len(JOBS) == len(set(JOBS)) == 30
