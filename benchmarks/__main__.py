"""Runs the benchmarks and prints their tables as Markdown; compares two versions; draws the pictures of a run."""

import argparse
import json
import os
import sys
from collections.abc import Iterable
from pathlib import Path

from benchmarks import machine, pictures, report
from benchmarks.compare import compare
from benchmarks.jobs import JOBS, Job
from benchmarks.measure import FULL, TINY, Line


def arguments() -> argparse.Namespace:
    """Return what the command line says; ends the program if that makes no sense."""
    usage = "python -m benchmarks [OPTION ...] | compare BASE [HEAD] | draw FILE FOLDER"
    parser = argparse.ArgumentParser(prog="python -m benchmarks", usage=usage, description=__doc__)
    parser.add_argument("--only", action="append", choices=list(JOBS), metavar="NAME", help=f"of {', '.join(JOBS)}")
    parser.add_argument("--tiny", action="store_true", help="try everything out; the figures mean nothing")
    parser.add_argument("--rounds", type=int, metavar="N", help=f"of candidates in turns; {FULL.rounds} if left out")
    parser.add_argument(
        "--log-strokes", type=int, metavar="N", help=f"in the log of `replay`; {FULL.log_strokes} if left out"
    )
    parser.add_argument("--json", type=Path, metavar="FILE", help="write every round of everything here")
    parser.add_argument("--page", type=Path, metavar="FILE", help="replace what stands below the mark on this page")
    parser.add_argument("--pictures", type=Path, metavar="FOLDER", help="draw the run's pictures here")
    commands = parser.add_subparsers(
        dest="command", metavar="COMMAND", title="instead of a run", prog="python -m benchmarks"
    )
    two = commands.add_parser("compare", help="two versions in turns: which differences are outside of the noise")
    two.add_argument("base", metavar="BASE", help="a commit")
    two.add_argument("head", metavar="HEAD", nargs="?", help="another; what lies in the checkout if left out")
    two.add_argument("--jobs", default="", metavar="TEXT", help="those with this text in their name; all if left out")
    draw = commands.add_parser("draw", help="the pictures of a run that was written with --json")
    draw.add_argument("run", type=Path, metavar="FILE")
    draw.add_argument("folder", type=Path, metavar="FOLDER")
    chosen = parser.parse_args()
    for name in ("rounds", "log_strokes"):
        value = getattr(chosen, name)
        if value is not None and value < 1:
            parser.error(f"--{name.replace('_', '-')} is {value}; it is 1 or more")
    return chosen


def main() -> None:
    """Do what the command line says."""
    chosen = arguments()
    if chosen.command is None:
        run(chosen)
        return
    try:
        for line in _compare(chosen) if chosen.command == "compare" else _draw(chosen):
            print(line, flush=True)
    except (OSError, ValueError) as error:
        sys.exit(str(error))


def _compare(chosen: argparse.Namespace) -> Iterable[str]:
    return compare(chosen.base, chosen.head, chosen.jobs)


def _draw(chosen: argparse.Namespace) -> Iterable[str]:
    return map(str, pictures.draw(json.loads(chosen.run.read_text()), chosen.folder).values())


def run(chosen: argparse.Namespace) -> None:
    """Run the jobs in the order of their table, and print each as soon as it is done."""
    scale = TINY if chosen.tiny else FULL
    asked = {"rounds": chosen.rounds, "log_strokes": chosen.log_strokes}
    scale = scale._replace(**{name: value for name, value in asked.items() if value is not None})
    facts = machine.facts(scale)
    print(report.preface(facts), flush=True)
    results: dict[Job, list[Line]] = {}
    for name in chosen.only or JOBS:
        job = JOBS[name]
        results[job] = list(job.run(scale))
        print(report.section(job, results[job]), flush=True)
    print(report.targets(results))
    text = report.as_json(facts, results)
    if chosen.json:
        chosen.json.write_text(text)
    drawn = pictures.draw(json.loads(text), chosen.pictures) if chosen.pictures else {}
    if chosen.page:
        links = {name: pictures.link(name, os.path.relpath(path, chosen.page.parent)) for name, path in drawn.items()}
        report.rewrite(chosen.page, report.markdown(facts, results, links))


if __name__ == "__main__":
    main()
