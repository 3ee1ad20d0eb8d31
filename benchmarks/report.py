"""A run as a page of Markdown, and as JSON."""

import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from benchmarks.jobs import Job
from benchmarks.measure import Figure, Line, Spread, spread

Results = Mapping[Job, Sequence[Line]]

MARK: Final = '<!-- what follows is written by `make bench ARGS="--page docs/performance.md"` -->'


def markdown(facts: Mapping[str, str], results: Results) -> str:
    """Return the page of a run: its preface and each job's section."""
    return "\n".join([preface(facts), *(section(job, lines) for job, lines in results.items())])


def preface(facts: Mapping[str, str]) -> str:
    """Return what the figures were measured on."""
    return "\n".join(["## The machine", "", *(f"- {name}: {value}" for name, value in facts.items()), ""])


def section(job: Job, lines: Sequence[Line]) -> str:
    """Return one job's heading, note and table: a line per subject, a column per figure."""
    columns = list(dict.fromkeys((figure.name, figure.unit) for line in lines for figure in line.figures))
    head = ["", *(f"{name}, {unit}" for name, unit in columns)]
    rows = [[line.subject, *_cells(line, columns)] for line in lines]
    table = [_row(head), _row(["---", *("---:" for _ in columns)]), *map(_row, rows)]
    return "\n".join([f"## {job.title}", "", job.note.strip(), "", *table, ""])


def _cells(line: Line, columns: Iterable[tuple[str, str]]) -> list[str]:
    by_name = {(figure.name, figure.unit): figure for figure in line.figures}
    return [_cell(by_name[column]) if column in by_name else "" for column in columns]


def _row(cells: Iterable[str]) -> str:
    return f"| {' | '.join(cells)} |"


def _cell(figure: Figure) -> str:
    """Return median (quartiles), or for a peer: median = times ours (quartiles of that)."""
    value = spread(figure.rounds)
    if figure.ratios:
        return f"{number(value.median)} = {_with_quartiles(spread(figure.ratios), 'x')}"
    return _with_quartiles(value, "") if len(figure.rounds) > 1 else number(value.median)


def _with_quartiles(values: Spread, unit: str) -> str:
    return f"{number(values.median)}{unit} ({number(values.low)}-{number(values.high)})"


def number(value: float) -> str:
    """Return three significant digits, without an exponent."""
    return f"{value:,.0f}" if value == 0 or abs(value) >= 100 else f"{value:#.3g}".rstrip(".")


def as_json(facts: Mapping[str, str], results: Results) -> str:
    """Return everything, each round's value included."""
    jobs = [{"name": job.name, "title": job.title, "lines": list(map(_line, lines))} for job, lines in results.items()]
    return json.dumps({"machine": dict(facts), "jobs": jobs}, indent=1) + "\n"


def _line(line: Line) -> dict[str, Any]:
    return {"subject": line.subject, "figures": list(map(_figure, line.figures))}


def _figure(figure: Figure) -> dict[str, Any]:
    ratio = spread(figure.ratios)._asdict() if figure.ratios else None
    values = {"rounds": figure.rounds, "ratios": figure.ratios}
    return {"name": figure.name, "unit": figure.unit, **spread(figure.rounds)._asdict(), "ratio": ratio, **values}


def rewrite(page: Path, text: str) -> None:
    """Replace what stands below the mark on `page`. Raises ValueError if the page has no mark."""
    above, mark, _ = page.read_text().partition(MARK)
    if not mark:
        raise ValueError(f"{page} has no line {MARK}")
    page.write_text(f"{above}{mark}\n\n{text}")
