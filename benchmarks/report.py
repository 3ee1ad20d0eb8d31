"""A run as a page of Markdown, and as JSON."""

import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from benchmarks.jobs import JOBS, Job
from benchmarks.measure import Figure, Line, Spread, spread
from benchmarks.targets import Target, met

Results = Mapping[Job, Sequence[Line]]

MARK: Final = '<!-- what follows is written by `make bench ARGS="--page docs/performance.md"` -->'


TARGETS_NOTE: Final = """
Each line is one figure of this run beside what it is to become: the peer's time is to be so many times ours, or, where
it says "at most", ours may be so many times the peer's; what is ours itself, so many times the first of its line. Of
two processes the chunks count. Where a unit stands behind the figure, it is the figure itself that is to be so much.
The last column names the target that is reached, if one is.
"""


def markdown(facts: Mapping[str, str], results: Results, pictures: Mapping[str, str]) -> str:
    """Return the page of a run: its preface, each job's section, the targets.

    pictures: name of a job -> the Markdown of its picture, which stands below its table.
    """
    sections = []
    for job, lines in results.items():
        sections.append(section(job, lines))
        if job.name in pictures:
            sections.append(f"{pictures[job.name]}\n")
    return "\n".join([preface(facts), *sections, targets(results)])


def preface(facts: Mapping[str, str]) -> str:
    """Return what the figures were measured on."""
    return "\n".join(["## The machine", "", *(f"- {name}: {value}" for name, value in facts.items()), ""])


def section(job: Job, lines: Sequence[Line]) -> str:
    """Return one job's heading, note and table: a line per subject, a column per figure."""
    columns = list(dict.fromkeys((figure.name, figure.unit) for line in lines for figure in line.figures))
    head = ["", *(", ".join(filter(None, column)) for column in columns)]
    rows = [[line.subject, *_cells(line, columns)] for line in lines]
    table = [row(head), row(["---", *("---:" for _ in columns)]), *map(row, rows)]
    return "\n".join([f"## {job.title}", "", job.note.strip(), "", *table, ""])


def targets(results: Results) -> str:
    """Return the section of the targets whose jobs were run; nothing if there is none."""
    found = met({job.name: lines for job, lines in results.items()})
    if not found:
        return ""
    rows = [_target(target, reached) for target, reached in found]
    head = [row(["job", "", "figure", "must", "aim", "today", "reached"]), row(["---"] * 3 + ["---:"] * 3 + ["---"])]
    return "\n".join(["## Targets", TARGETS_NOTE, *head, *map(row, rows), ""])


def _target(target: Target, reached: float) -> list[str]:
    must = f"{'at most ' if target.at_most else ''}{target.must:,g}"
    verdict = target.verdict(reached)
    figure = ", ".join(filter(None, (target.figure, target.unit)))
    return [JOBS[target.job].title, target.subject, figure, must, f"{target.aim:,g}", number(reached), verdict]


def _cells(line: Line, columns: Iterable[tuple[str, str]]) -> list[str]:
    by_name = {(figure.name, figure.unit): figure for figure in line.figures}
    return [_cell(by_name[column]) if column in by_name else "" for column in columns]


def row(cells: Iterable[str]) -> str:
    """Return one row of a table."""
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
