"""Runs the benchmarks and prints their tables as Markdown."""

import argparse
from pathlib import Path

from benchmarks import machine, report
from benchmarks.jobs import JOBS, Job
from benchmarks.measure import FULL, TINY, Line


def arguments() -> argparse.Namespace:
    """Return what the command line says; ends the program if that makes no sense."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    parser.add_argument("--only", action="append", choices=list(JOBS), metavar="NAME", help=f"of {', '.join(JOBS)}")
    parser.add_argument("--tiny", action="store_true", help="try everything out; the figures mean nothing")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write every round of everything here")
    parser.add_argument("--page", type=Path, metavar="FILE", help="replace what stands below the mark on this page")
    return parser.parse_args()


def main() -> None:
    """Run the jobs in the order of their table, and print each as soon as it is done."""
    chosen = arguments()
    scale = TINY if chosen.tiny else FULL
    facts = machine.facts(scale)
    print(report.preface(facts), flush=True)
    results: dict[Job, list[Line]] = {}
    for name in chosen.only or JOBS:
        job = JOBS[name]
        results[job] = list(job.run(scale))
        print(report.section(job, results[job]), flush=True)
    if chosen.json:
        chosen.json.write_text(report.as_json(facts, results))
    if chosen.page:
        report.rewrite(chosen.page, report.markdown(facts, results))


if __name__ == "__main__":
    main()
