"""The result of a run, as a file: JSON with a version, written and read by the types below.

Times are in milliseconds, sizes in bytes, rates in 1/s. A field that is unknown, missing, or of another type is an
error: a result is either understood as a whole or not at all.
"""

import json
import types
import typing
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields, is_dataclass
from pathlib import Path
from typing import Any, Final

from chunkserver_loadtest.errors import BadResult
from chunkserver_loadtest.record import Histogram, Record

SCHEMA: Final = 2
RESULT_BYTES_MAX: Final = 1 << 28
MS: Final = 1e3
CPU_SHARE_MAX: Final = 0.9
LAG_MS_MAX: Final = 2.0
LAG_SHARE_MAX: Final = 0.2
"""Beyond this CPU, or beyond both lags, of which the second is a share of the latency (p99 each), figures are too much
the generator's own."""

Value = str | int | float | bool | list[str] | list[float] | None


@dataclass(frozen=True)
class Percentiles:
    """Of durations, in ms. mean and max are exact, the others right to 0.1 %."""

    count: int
    mean: float
    p50: float
    p90: float
    p99: float
    p99_9: float
    max: float


@dataclass(frozen=True)
class Spread:
    """Durations of all exchanges, and by what they ended with and what they were for.

    by_kind: also the chunks of batches, each until it had come, as `part`.
    """

    all: Percentiles
    by_status: dict[str, Percentiles]
    by_kind: dict[str, Percentiles]


@dataclass(frozen=True)
class Counts:
    """due: requests, of which `answered` had an answer, `unsent` could not be sent within the bounds; the rest failed.

    failed: failures, those of answers included. decoded, compared: bodies that were checked, in full or by digest.
    """

    due: int
    answered: int
    unsent: int
    failed: int
    decoded: int
    compared: int
    in_flight_most: int


@dataclass(frozen=True)
class Throughput:
    """intended: requests that were due, a second. answered: those answered, over the time until the last answer."""

    intended: float
    answered: float
    bytes: float


@dataclass(frozen=True)
class Failed:
    """How often something was wrong, and the first example of it."""

    count: int
    path: str
    detail: str


@dataclass(frozen=True)
class Generator:
    """What the generator itself took. lag: how late it sent what was due, where a connection was free.

    was_limit: it was short of CPU or late, so that figures may be its own and not the server's.
    """

    cpu_share: float
    cpu_us: float
    lag: Percentiles
    was_limit: bool


@dataclass(frozen=True)
class Row:
    """One second of the run."""

    second: int
    due: int
    answered: int
    failed: int
    unsent: int
    bytes: int
    in_flight: int
    p50: float
    p99: float
    max: float


@dataclass(frozen=True)
class Stream:
    """What a storm has beside answers.

    acknowledged: edits, those out of figures too; duplicates: of them, those answered on a later connection; nacks: by
        type of problem. missed, late: tellings, of which `told.count` came. strange: edits that others sent.
    silent, gone: subscribers that read nothing, and those of them that the server let go. lost: other peers.
    stale, resync: messages that stood for edits. connects: that were tried; refused: of those, by why.
    told, last: from an edit's answer until each subscriber was told, and until the last of them was.
    welcomed: of each peer that was cut, from when all came back until it was welcome. back: of each subscriber of them,
        until it knew everything. all_back: of each cut, until all knew everything, ms.
    """

    editors: int
    subscribers: int
    silent: int
    gone: int
    lost: int
    acknowledged: int
    duplicates: int
    nacks: dict[str, int]
    missed: int
    late: int
    strange: int
    stale: int
    resync: int
    connects: int
    refused: dict[str, int]
    told: Percentiles
    last: Percentiles
    welcomed: Percentiles
    back: Percentiles
    all_back: list[float]


@dataclass(frozen=True)
class Result:
    """A whole run. seconds: from the start to the last answer. stream: of a storm."""

    schema: int
    profile: str
    options: dict[str, Value]
    machine: dict[str, str]
    generator_token: str
    seconds: float
    counts: Counts
    throughput: Throughput
    latency: Spread
    service: Spread
    failures: dict[str, Failed]
    generator: Generator
    series: list[Row]
    stream: Stream | None = None


def percentiles(histogram: Histogram) -> Percentiles:
    """Return what a result says of durations."""
    p50, p90, p99, p99_9 = (histogram.quantile(share) * MS for share in (0.5, 0.9, 0.99, 0.999))
    mean = histogram.total / histogram.count * MS if histogram.count else 0.0
    return Percentiles(histogram.count, mean, p50, p90, p99, p99_9, histogram.highest * MS)


def summarise(
    record: Record,
    profile: str,
    options: Mapping[str, Value],
    machine: Mapping[str, str],
    generator_token: str,
    intended_seconds: float,
    cpu_seconds: float,
    checked: tuple[int, int],
    stream: Stream | None = None,
) -> Result:
    """Return the result of a run whose record is complete. checked: bodies that were decoded, and compared."""
    record.close()
    seconds = max(record.ended_last - record.started, 1e-9)
    due, answered, unsent, failed = record.due_count, record.answered_count, record.unsent_count, record.failed_count
    counts = Counts(due, answered, unsent, failed, *checked, record.in_flight_most)
    latency = _spread(record, record.latency, record.parts)
    return Result(
        SCHEMA,
        profile,
        dict(options),
        dict(machine),
        generator_token,
        seconds,
        counts,
        Throughput(counts.due / intended_seconds, counts.answered / seconds, record.bytes / seconds),
        latency,
        _spread(record, record.service, {}),
        {kind: Failed(one.count, one.path, one.detail) for kind, one in record.failures.items()},
        _generator(record, latency.all, seconds, cpu_seconds),
        [_row(record, number) for number in sorted(record.seconds)],
        stream,
    )


def save(result: Result, path: Path) -> None:
    """Write a result."""
    path.write_text(json.dumps(asdict(result), indent=1) + "\n")


def load(path: Path) -> Result:
    """Read a result. Raises BadResult, which names the field, if the file is none of this version."""
    try:
        if path.stat().st_size > RESULT_BYTES_MAX:
            raise BadResult(f"{path} has more than {RESULT_BYTES_MAX} bytes")
        tree = json.loads(path.read_text())
    except (OSError, ValueError) as error:
        raise BadResult(f"{path} is no result: {error}") from None
    schema = tree.get("schema") if isinstance(tree, dict) else None
    if schema != SCHEMA:
        raise BadResult(f"{path} has schema {schema!r}: this version reads {SCHEMA}")
    return typing.cast("Result", _built(Result, tree, str(path)))


def _spread(record: Record, histograms: Mapping[tuple[str, str], Histogram], parts: Mapping[str, Histogram]) -> Spread:
    everything, of_parts = Histogram(), Histogram()
    for histogram in histograms.values():
        everything.merge(histogram)
    for histogram in parts.values():
        of_parts.merge(histogram)
    kinds, statuses = (record.totals(histograms, place) for place in (0, 1))
    by_kind = {kind: percentiles(histogram) for kind, histogram in kinds.items()}
    if of_parts.count:
        by_kind["part"] = percentiles(of_parts)
    return Spread(percentiles(everything), {name: percentiles(one) for name, one in statuses.items()}, by_kind)


def _generator(record: Record, latency: Percentiles, seconds: float, cpu_seconds: float) -> Generator:
    share, lag = cpu_seconds / seconds, percentiles(record.lag)
    each = cpu_seconds / max(record.answered_count, 1) * 1e6
    late = lag.p99 > max(LAG_MS_MAX, LAG_SHARE_MAX * latency.p99)
    return Generator(share, each, lag, late or share > CPU_SHARE_MAX)


def _row(record: Record, number: int) -> Row:
    one = record.seconds[number]
    times = (one.p50 * MS, one.p99 * MS, one.longest * MS)
    return Row(number, one.due, one.answered, one.failed, one.unsent, one.bytes, one.in_flight, *times)


def _built(kind: Any, tree: Any, where: str) -> Any:
    """Return a value of type `kind` from what JSON has for it."""
    if is_dataclass(kind):
        return _built_fields(kind, tree, where)
    origin, arguments = typing.get_origin(kind), typing.get_args(kind)
    if origin in (typing.Union, types.UnionType):
        return _built_any(arguments, tree, where)
    if not _is(origin or kind, tree):
        raise BadResult(f"{where} is {str(tree)[:80]!r}: {getattr(kind, '__name__', kind)} is expected")
    if origin is dict:
        return {name: _built(arguments[1], one, f"{where}.{name}") for name, one in tree.items()}
    if origin is list:
        return [_built(arguments[0], one, f"{where}[{number}]") for number, one in enumerate(tree)]
    return float(tree) if kind is float else tree


def _is(kind: Any, tree: Any) -> bool:
    """Tell whether JSON has a value of that type: an integer is a float too, a truth value is no number."""
    return isinstance(tree, (int, float) if kind is float else kind) and (kind is bool or not isinstance(tree, bool))


def _built_any(kinds: tuple[Any, ...], tree: Any, where: str) -> Any:
    for kind in kinds:
        try:
            return _built(kind, tree, where)
        except BadResult:
            continue
    raise BadResult(f"{where} is {str(tree)[:80]!r}: none of its types")


def _built_fields(kind: Any, tree: Any, where: str) -> Any:
    hints = typing.get_type_hints(kind)
    names = {field.name for field in fields(kind)}
    if not isinstance(tree, dict) or tree.keys() != names:
        wrong = sorted(names.symmetric_difference(tree)) if isinstance(tree, dict) else "no object"
        raise BadResult(f"{where} has other fields than {kind.__name__}: {wrong}")
    return kind(**{name: _built(hints[name], tree[name], f"{where}.{name}") for name in names})
