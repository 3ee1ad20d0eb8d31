"""What one sees while a load runs: a table that is drawn anew on a terminal, else a line now and then.

Drawing takes milliseconds, in which nothing would be sent. So the terminal is another process's: `python -m
chunkserver_loadtest.live` reads snapshots from its standard input, one JSON line each, and draws them.
"""

import json
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Final

from rich.console import Console
from rich.live import Live
from rich.table import Table

from chunkserver_loadtest.runs import Snapshot

DRAWS_PER_SECOND: Final = 2
END_SECONDS_MAX: Final = 5.0


def line(snapshot: Snapshot) -> str:
    """Return a snapshot as one line."""
    parts = [
        f"{snapshot.seconds:6.1f} s",
        f"{snapshot.rate:8.0f}/s",
        f"{snapshot.megabytes_per_second:7.1f} MB/s",
        f"{snapshot.in_flight:5} in flight",
        f"p50 {snapshot.p50:.2f}  p99 {snapshot.p99:.2f}  max {snapshot.longest:.1f} ms",
        " ".join(f"{status}:{count}" for status, count in sorted(snapshot.statuses.items())),
    ]
    if snapshot.unsent:
        parts.append(f"{snapshot.unsent} unsent")
    if snapshot.failed:
        parts.append(f"{snapshot.failed} FAILED")
    return "  ".join(parts)


def table(snapshot: Snapshot) -> Table:
    """Return a snapshot as a table."""
    grid = Table.grid(padding=(0, 2))
    grid.add_column(style="dim", justify="right")
    grid.add_column()
    share = min(snapshot.seconds / snapshot.seconds_planned, 1.0)
    bar = "━" * round(30 * share)
    grid.add_row("time", f"[cyan]{bar:<30}[/] {snapshot.seconds:.0f} of {snapshot.seconds_planned:.0f} s")
    grid.add_row("rate", f"{snapshot.rate:,.0f}/s   {snapshot.megabytes_per_second:,.1f} MB/s")
    grid.add_row("requests", f"{snapshot.due:,} due, {snapshot.answered:,} answered, {snapshot.in_flight:,} in flight")
    times = f"p50 {snapshot.p50:.2f}   p99 [bold]{snapshot.p99:.2f}[/]   max {snapshot.longest:.1f} ms"
    grid.add_row("latency", f"{times}   [dim]sent late by {snapshot.lag_p99:.2f} ms (p99)[/]")
    grid.add_row("answers", "   ".join(f"{status} {count:,}" for status, count in sorted(snapshot.statuses.items())))
    if snapshot.unsent:
        grid.add_row("unsent", f"[yellow]{snapshot.unsent:,}[/]")
    for kind, what in snapshot.failures.items():
        grid.add_row("[red]failed[/]", f"[red]{kind}[/] {what.replace('[', '(')}")
    return grid


@contextmanager
def view(console: Console) -> Iterator[Callable[[Snapshot], None]]:
    """Yield what is to be told of snapshots, while a run goes on."""
    if not console.is_terminal:
        yield lambda snapshot: print(line(snapshot), file=console.file, flush=True)
        return
    command = [sys.executable, "-m", "chunkserver_loadtest.live"]
    with subprocess.Popen(command, stdin=subprocess.PIPE, text=True) as drawing:
        assert drawing.stdin is not None
        pipe = drawing.stdin

        def tell(snapshot: Snapshot) -> None:
            with suppress(BrokenPipeError):  # a view that is gone is no reason to end
                pipe.write(json.dumps(snapshot._asdict()) + "\n")
                pipe.flush()

        try:
            yield tell
        finally:
            with suppress(BrokenPipeError):
                pipe.close()
            drawing.wait(END_SECONDS_MAX)


def main() -> None:
    """Draw what comes on the standard input, until it ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the run, whose end is ours
    console = Console(stderr=True)
    with Live(console=console, auto_refresh=False, transient=True) as drawn:
        for told in sys.stdin:
            drawn.update(table(Snapshot(**json.loads(told))), refresh=True)


if __name__ == "__main__":
    main()
