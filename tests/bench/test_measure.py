"""The frame of the benchmarks: turns, spreads, and how they are written."""

from functools import partial

import pytest

from benchmarks.jobs import Job
from benchmarks.measure import Figure, Line, beside_first, in_turns, spread, timed
from benchmarks.report import MARK, number, rewrite, section


def test_candidates_take_turns_and_each_begins_one_round():
    order: list[str] = []

    def take(name: str) -> int:
        order.append(name)
        return len(order)

    results = in_turns({name: partial(take, name) for name in ("a", "b", "c")}, rounds=3)
    assert "".join(order) == "abc" + "bca" + "cab" + "abc"
    assert results == {"a": [6, 8, 10], "b": [4, 9, 11], "c": [5, 7, 12]}


def test_timed_gives_every_item_once():
    seen: list[int] = []
    turn = timed(seen.append, range(5), 1e3)
    assert turn() >= 0
    assert seen == [0, 1, 2, 3, 4]


def test_spread_is_median_and_quartiles():
    assert spread([5, 1, 3, 2, 4]) == (3, 2, 4)
    assert spread([7]) == (7, 7, 7)


def test_ratio_is_peer_over_ours():
    ours, peer = beside_first({"ours": [1.0, 2.0], "peer": [3.0, 8.0]}, "ms")
    assert (ours.ratios, peer.ratios) == ((), (3.0, 4.0))


def test_numbers_have_three_digits():
    assert [number(value) for value in (0, 0.0123, 1.5, 12.34, 123.4, 4567)] == [
        "0",
        "0.0123",
        "1.50",
        "12.3",
        "123",
        "4,567",
    ]


def test_section_has_a_column_per_figure():
    lines = [
        Line("here", (Figure("ours", "ms", (1.0, 2.0, 3.0)), Figure("peer", "ms", (4.0, 4.0, 4.0), (4.0, 2.0, 1.5)))),
        Line("there", (Figure("ours", "ms", (1.5,)),)),
    ]
    assert section(Job("job", "Title", "Note.\n", lambda _: lines), lines).splitlines() == [
        "## Title",
        "",
        "Note.",
        "",
        "|  | ours, ms | peer, ms |",
        "| --- | ---: | ---: |",
        "| here | 2.00 (1.50-2.50) | 4.00 = 2.00x (1.75-3.00) |",
        "| there | 1.50 |  |",
    ]


def test_page_without_a_mark_is_left_alone(tmp_path):
    page = tmp_path / "page.md"
    page.write_text("By hand.\n")
    with pytest.raises(ValueError, match="no line"):
        rewrite(page, "new")
    assert page.read_text() == "By hand.\n"
    page.write_text(f"By hand.\n{MARK}\nold")
    rewrite(page, "new")
    assert page.read_text() == f"By hand.\n{MARK}\n\nnew"
