"""How commands talk: results on stdout, all else on stderr; colours, tables and bars on a terminal alone."""

import json
import sys
from collections.abc import Iterable, Iterator, Sequence
from typing import Any, Final, NoReturn, TypeVar

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

FAILED: Final = 1
"""Exit code: it could not be done."""
MISUSED: Final = 2
"""Exit code: what is asked for cannot be."""

_Item = TypeVar("_Item")


def end(why: str, code: int = FAILED) -> NoReturn:
    """Say why on stderr, and end."""
    typer.echo(why, err=True)
    raise typer.Exit(code)


def say_json(value: Any) -> None:
    """Print one JSON value."""
    typer.echo(json.dumps(value, indent=2, allow_nan=False))


def say_table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
    """Print rows under their heads: wrapped to the terminal; else a line each, which a script can read."""
    lines = [list(row) for row in rows]
    if sys.stdout.isatty():
        table = Table(*head, box=None, pad_edge=False, header_style="bold")
        for line in lines:
            table.add_row(*line)
        Console(markup=False, highlight=False).print(table)
        return
    widths = [max(map(len, column)) for column in zip(head, *lines, strict=True)]
    for line in [list(head), *lines]:
        typer.echo("  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)).rstrip())


def with_bar(what: str, items: Iterable[_Item], count: int) -> Iterator[_Item]:
    """Yield the items. A bar on stderr says how far it is, if that is a terminal; it is gone in the end."""
    if not sys.stderr.isatty():
        yield from items
        return
    columns = (TextColumn(what), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as progress:
        yield from progress.track(items, total=count)


def counted(count: int, noun: str) -> str:
    """Return "1 chunk", "2,000 chunks"."""
    return f"{count:,} {noun}{'' if count == 1 else 's'}"
