"""The table of jobs. A new benchmark is one file and one row here."""

from collections.abc import Callable, Iterable
from types import ModuleType
from typing import Final, NamedTuple

from benchmarks import (
    cores,
    edit_log,
    edit_stages,
    edited,
    editing,
    extraction,
    growth,
    levels,
    noise,
    overload,
    pool,
    replay,
    seams,
    service,
    skipping,
    stages,
    startup,
    stream,
    tape,
    viewer,
    whole,
)
from benchmarks.measure import Line, Scale


class Job(NamedTuple):
    """One benchmark.

    note: what is measured and what is not, in Markdown: it stands above the table.
    run: yields the lines of the table.
    """

    name: str
    title: str
    note: str
    run: Callable[[Scale], Iterable[Line]]


def _job(title: str, module: ModuleType) -> Job:
    """Return the job of a module: its docstring is the note, its `run` does it."""
    return Job(module.__name__.rpartition(".")[2], title, module.__doc__ or "", module.run)


JOBS: Final = {
    job.name: job
    for job in (
        _job("A chunk by stages", stages),
        _job("Extraction with normals from ready samples", extraction),
        _job("Noise", noise),
        _job("A whole chunk", whole),
        _job("A tape beside functions written by hand", tape),
        _job("Chunks that need not be sampled", skipping),
        _job("Borders between levels", seams),
        _job("Cost against surface and recipe", growth),
        _job("Coarse levels", levels),
        _job("Two processes", cores),
        _job("Workers", pool),
        _job("Requests", service),
        _job("Overload", overload),
        _job("Edited chunks", edited),
        _job("An edit by stages", edit_stages),
        _job("The log of edits", edit_log),
        _job("Edits over HTTP", editing),
        _job("The stream of edits", stream),
        _job("A start with a long log", replay),
        _job("Start and memory", startup),
        _job("The viewer", viewer),
    )
}
