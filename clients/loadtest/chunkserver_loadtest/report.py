"""Results as tables."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Final

from rich.console import Group, RenderableType
from rich.markup import escape
from rich.table import Table

from chunkserver_loadtest.compare import Line
from chunkserver_loadtest.result import Percentiles, Result, Stream

CUTS_SHOWN_MAX: Final = 10


def summary(result: Result) -> RenderableType:
    """Return what is said at the end of a run."""
    counts, throughput, generator = result.counts, result.throughput, result.generator
    title = f"[bold]{result.profile}[/], seed {result.options['seed']}, {result.seconds:.1f} s"
    requests = f"{counts.due:,} due, {counts.answered:,} answered, {counts.unsent:,} unsent, {counts.failed:,} failed"
    rates = f"intended {throughput.intended:,.1f}/s, reached {throughput.answered:,.1f}/s"
    checked = f"{counts.decoded:,} bodies decoded, {counts.compared:,} compared with the first of their URL"
    cost = f"{generator.cpu_share:.0%} of a core, {generator.cpu_us:.0f} us a request"
    lag = f"sent late by p50 {generator.lag.p50:.2f}, p99 {generator.lag.p99:.2f} ms"
    facts = Table.grid(padding=(0, 2))
    facts.add_row("requests", requests)
    facts.add_row("rate", f"{rates}, {throughput.bytes / 1e6:,.1f} MB/s, at most {counts.in_flight_most:,} in flight")
    for name, told in _of_stream(result.stream) if result.stream else [("checked", checked)]:
        facts.add_row(name, told)
    facts.add_row("generator", f"{cost}, {lag}")
    if generator.was_limit:
        facts.add_row("", "[yellow]It was the limit: late, or short of CPU. Read the figures as its own.[/]")
    failures = [
        f"[red]{kind}[/] {one.count:,} x, first {escape(one.path)}: {escape(one.detail)}"
        for kind, one in result.failures.items()
    ]
    return Group(title, facts, _times(result), *failures)


def comparison(lines: Sequence[Line], differences: Sequence[str]) -> RenderableType:
    """Return two results side by side."""
    table = Table(box=None, header_style="bold")
    for name in ("metric", "before", "after", "change", "budget", ""):
        table.add_column(name, justify="left" if name == "metric" else "right")
    for line in lines:
        verdict = "" if line.bound is None else "[green]kept[/]" if line.kept else "[red]broken[/]"
        bound = "" if line.bound is None else f"{line.bound:,.2f}"
        name = f"{line.name}, {line.unit}" if line.unit else line.name
        table.add_row(name, f"{line.before:,.2f}", f"{line.after:,.2f}", line.change, bound, verdict)
    return Group(table, *(f"[yellow]{escape(one)}[/]" for one in differences))


def _times(result: Result) -> Table:
    table = Table(box=None, header_style="bold")
    for name in ("ms", "count", "mean", "p50", "p90", "p99", "p99.9", "max"):
        table.add_column(name, justify="left" if name == "ms" else "right")
    _add(table, "[bold]latency (from due)[/]", result.latency.all)
    for names in (result.latency.by_kind, result.latency.by_status):
        for name, one in sorted(names.items()):
            _add(table, f"  {name}", one)
    _add(table, "service (from sent)", result.service.all)
    if (stream := result.stream) is not None and stream.told.count:
        _add(table, "told (from the answer)", stream.told)
        _add(table, "  the last of an edit", stream.last)
    if stream is not None and stream.all_back:
        _add(table, "welcome again", stream.welcomed)
        _add(table, "  and caught up", stream.back)
    return table


def _of_stream(stream: Stream) -> Iterator[tuple[str, str]]:
    """Yield the lines of a storm."""
    crowd = f"{stream.editors:,} editors, {stream.subscribers:,} subscribers"
    if stream.silent:
        crowd += f", of whom {stream.silent:,} never read: {stream.gone:,} were let go"
    yield "crowd", crowd
    again = f", {stream.duplicates:,} of them on a later connection" if stream.duplicates else ""
    yield "edits", f"{stream.acknowledged:,} acknowledged{again}; refused: {_counts(stream.nacks)}"
    wrong = f"{stream.missed:,} missed, {stream.late:,} late, {stream.strange:,} strange"
    yield "told", f"{stream.told.count:,} times, {wrong}; left out by {stream.stale:,} stale, {stream.resync:,} resync"
    yield "connections", f"{stream.connects:,} tried; refused: {_counts(stream.refused)}; {stream.lost:,} peers lost"
    if stream.all_back:
        times = ", ".join(f"{milliseconds:,.0f}" for milliseconds in stream.all_back[:CUTS_SHOWN_MAX])
        yield "cuts", f"{len(stream.all_back):,}; all were back and caught up after {times} ms"


def _counts(counts: Mapping[str, int]) -> str:
    return ", ".join(f"{count:,} x {escape(name)}" for name, count in sorted(counts.items())) or "none"


def _add(table: Table, name: str, one: Percentiles) -> None:
    times = (one.mean, one.p50, one.p90, one.p99, one.p99_9, one.max)
    table.add_row(name, f"{one.count:,}", *(f"{time:,.2f}" for time in times))
