"""Two results side by side, and whether the second keeps its budgets.

A budget is `METRIC=BOUND`. A bound with a sign and a percent is relative to the first result: `p99=+20%` lets p99
grow by a fifth, `rate=-5%` lets the rate fall by a twentieth. Any other number is absolute: `errors=0`, `p99=250` (ms).
"""

import re
from collections.abc import Callable, Mapping, Sequence
from typing import Final, NamedTuple

from chunkserver_loadtest.errors import BadBudget
from chunkserver_loadtest.result import Result, Stream

BUDGET: Final = re.compile(r"([a-z0-9_.]+)=([+-]?\d+(?:\.\d+)?)(%?)")

Bound = tuple[float, bool]
"""A number, and whether it is a share of the first result."""


class Metric(NamedTuple):
    """A figure of a result; of some it is None. falls: it is better when it is lower."""

    unit: str
    falls: bool
    value: Callable[[Result], float | None]


METRICS: Final[dict[str, Metric]] = {
    "p50": Metric("ms", True, lambda result: result.latency.all.p50),
    "p90": Metric("ms", True, lambda result: result.latency.all.p90),
    "p99": Metric("ms", True, lambda result: result.latency.all.p99),
    "p99.9": Metric("ms", True, lambda result: result.latency.all.p99_9),
    "max": Metric("ms", True, lambda result: result.latency.all.max),
    "service_p50": Metric("ms", True, lambda result: result.service.all.p50),
    "service_p99": Metric("ms", True, lambda result: result.service.all.p99),
    "rate": Metric("1/s", False, lambda result: result.throughput.answered),
    "errors": Metric("", True, lambda result: result.counts.failed),
    "unsent": Metric("", True, lambda result: result.counts.unsent),
    "bytes": Metric("MB/s", False, lambda result: result.throughput.bytes / 1e6),
    "told_p50": Metric("ms", True, lambda result: _of_stream(result, lambda stream: stream.told.p50)),
    "told_p99": Metric("ms", True, lambda result: _of_stream(result, lambda stream: stream.told.p99)),
    "last_p50": Metric("ms", True, lambda result: _of_stream(result, lambda stream: stream.last.p50)),
    "last_p99": Metric("ms", True, lambda result: _of_stream(result, lambda stream: stream.last.p99)),
    "left_out": Metric("", True, lambda result: _of_stream(result, lambda stream: stream.stale + stream.resync)),
    "refused": Metric("", True, lambda result: _of_stream(result, lambda stream: sum(stream.refused.values()))),
    "welcomed_p99": Metric("ms", True, lambda result: _of_cut(result, lambda stream: stream.welcomed.p99)),
    "back_p50": Metric("ms", True, lambda result: _of_cut(result, lambda stream: stream.back.p50)),
    "back_p99": Metric("ms", True, lambda result: _of_cut(result, lambda stream: stream.back.p99)),
    "all_back": Metric("ms", True, lambda result: _of_cut(result, lambda stream: max(stream.all_back))),
}
"""What can be compared."""


class Line(NamedTuple):
    """A metric of both results. bound: what the budget lets the second one be, if it has one; kept: whether it is."""

    name: str
    unit: str
    before: float
    after: float
    bound: float | None
    kept: bool

    @property
    def change(self) -> str:
        """By how much the second differs, in percent."""
        if self.before == self.after:
            return "="
        return f"{(self.after / self.before - 1) * 100:+.1f} %" if self.before else "from 0"


def compare(before: Result, after: Result, budgets: Sequence[str]) -> list[Line]:
    """Return a line for each metric that both have. Raises BadBudget, which names it, if a budget cannot be read."""
    bounds = read_budgets(budgets)
    lines = [_line(name, before, after, bounds.get(name)) for name in METRICS]
    return [line for line in lines if line is not None]


def broken(result: Result, budgets: Mapping[str, Bound]) -> list[str]:
    """Return what a result breaks of the budgets, a sentence each. Raises BadBudget for a figure that it lacks."""
    lines = [_line(name, result, result, bound) for name, bound in budgets.items()]
    return [
        f"{line.name} is {line.after:,.2f}, the budget {line.bound:,.2f}"
        for line in lines
        if line is not None and line.bound is not None and not line.kept
    ]


def read_budgets(budgets: Sequence[str], *, alone: bool = False) -> dict[str, Bound]:
    """Return the bounds of metrics. alone: there is one result, and none to compare it with.

    Raises BadBudget, which names it, if one cannot be read.
    """
    bounds = dict(_read(budget) for budget in budgets)
    if len(bounds) < len(budgets):
        raise BadBudget(f"a metric has two budgets: {', '.join(budgets)}")
    if alone and (relative := [name for name, (_, is_share) in bounds.items() if is_share]):
        raise BadBudget(f"the budget of {', '.join(relative)} is in percent: of one result there is nothing to compare")
    return bounds


def differences(before: Result, after: Result) -> list[str]:
    """Return why the two may not be comparable, a sentence each."""
    found = [] if before.profile == after.profile else [f"profile: {before.profile}, then {after.profile}"]
    found += [
        f"{name}: {before.options.get(name)}, then {after.options.get(name)}"
        for name in sorted({*before.options, *after.options} - {"url", "seed"})
        if before.options.get(name) != after.options.get(name)
    ]
    found += [
        f"machine's {name}: {before.machine.get(name)}, then {after.machine.get(name)}"
        for name in ("cpu", "cores")
        if before.machine.get(name) != after.machine.get(name)
    ]
    pairs = (("first", before), ("second", after))
    return found + [f"the generator was the limit of the {which}" for which, one in pairs if one.generator.was_limit]


def _read(budget: str) -> tuple[str, Bound]:
    """Return the metric of a budget, its number, and whether that is a share of the first result."""
    found = BUDGET.fullmatch(budget)
    if not found or found[1] not in METRICS:
        raise BadBudget(
            f"{budget!r} is no budget: METRIC=BOUND, METRIC one of {', '.join(METRICS)}; p99=+20%, errors=0"
        )
    name, number, percent = found.groups()
    signed, falls = number[0] in "+-", METRICS[name].falls
    if signed != bool(percent) or (signed and (number[0] == "+") != falls):
        raise BadBudget(f"{budget!r}: a bound of {name} is a number, or {'+' if falls else '-'}N%")
    return name, (float(number), bool(percent))


def _of_stream(result: Result, value: Callable[[Stream], float]) -> float | None:
    return None if result.stream is None else value(result.stream)


def _of_cut(result: Result, value: Callable[[Stream], float]) -> float | None:
    return value(result.stream) if result.stream and result.stream.all_back else None


def _line(name: str, before: Result, after: Result, budget: Bound | None) -> Line | None:
    metric = METRICS[name]
    first, second = metric.value(before), metric.value(after)
    if first is None or second is None:
        if budget is not None:
            lacking = (before if first is None else after).profile
            raise BadBudget(f"{name} has a budget, and a result of {lacking} has no {name}")
        return None
    if budget is None:
        return Line(name, metric.unit, first, second, None, True)
    number, relative = budget
    bound = first * (1 + number / 100) if relative else number
    return Line(name, metric.unit, first, second, bound, second <= bound if metric.falls else second >= bound)
