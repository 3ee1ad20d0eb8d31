"""The command line: run a load, compare two results, find the generator's own ceiling."""

import secrets
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Final, NoReturn

import typer
from rich.console import Console

from chunkserver_loadtest import __version__
from chunkserver_loadtest.ceiling import measure
from chunkserver_loadtest.compare import Bound, broken, compare, differences, read_budgets
from chunkserver_loadtest.errors import LoadTestError
from chunkserver_loadtest.generator import Limits
from chunkserver_loadtest.live import DRAWS_PER_SECOND, view
from chunkserver_loadtest.profiles import Arrivals, Options
from chunkserver_loadtest.report import comparison, summary
from chunkserver_loadtest.result import Result, load, save
from chunkserver_loadtest.runs import NAMES, Plan, run
from chunkserver_loadtest.world import world_path

FAILED: Final = 1
MISUSED: Final = 2
"""Exit codes: something failed, or a budget is broken; what is asked for cannot be."""

WIDTH: Final = 160
"""Characters, of an output that is no terminal."""

app = typer.Typer(no_args_is_help=True, rich_markup_mode=None, add_completion=False, pretty_exceptions_enable=False)


def _say_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"chunkserver-loadtest {__version__}")
        raise typer.Exit


@app.callback()
def main(
    _version: Annotated[
        bool, typer.Option("--version", callback=_say_version, is_eager=True, help="Say the version, and end.")
    ] = False,
) -> None:
    """Put a chunkserver under load, and check what it answers."""


@app.command("run")
def run_command(
    profile: Annotated[str, typer.Argument(help=f"One of {', '.join(NAMES)}.")],
    url: Annotated[str, typer.Option(help="Of the server.")] = "http://127.0.0.1:8000",
    world: Annotated[str | None, typer.Option(help="Id of a world; without one a seed's. Storms make one.")] = None,
    world_seed: Annotated[int, typer.Option(help="Seed of the world.")] = 42,
    recipe: Annotated[str, typer.Option(help="Its recipe.")] = "terrain",
    file_format: Annotated[str, typer.Option("--format", help="mesh or glb.")] = "mesh",
    coding: Annotated[
        list[str] | None, typer.Option(help="identity, gzip or zstd; several are taken in turns.")
    ] = None,
    seconds: Annotated[float, typer.Option(help="How long requests are sent.")] = 10.0,
    rate: Annotated[float, typer.Option(help="Requests or edits a second. A flight has its own times.")] = 100.0,
    arrivals: Annotated[Arrivals, typer.Option(help="Evenly, or each whenever it likes.")] = "constant",
    closed: Annotated[bool, typer.Option("--closed", help="A closed loop: no rate, as many as are answered.")] = False,
    connections: Annotated[int, typer.Option(help="Open connections.")] = 32,
    in_flight: Annotated[int, typer.Option(help="Requests that were due and have no answer, at most.")] = 10_000,
    requests: Annotated[int, typer.Option(help="Requests, at most.")] = 1_000_000,
    timeout: Annotated[float, typer.Option(help="Seconds for an answer.")] = 30.0,
    seed: Annotated[int | None, typer.Option(help="Of the load; without one it is drawn, and told.")] = None,
    at: Annotated[tuple[float, float, float], typer.Option(help="Where the load is, in voxels.")] = (0, 0, 0),
    spread: Annotated[int, typer.Option(help="How far around that, in chunks.")] = 512,
    hot: Annotated[int, typer.Option(help="warm-hot: chunks of the hot set.")] = 64,
    revalidate: Annotated[float, typer.Option(help="warm-hot: share of requests with a tag.")] = 0.25,
    viewers: Annotated[int, typer.Option(help="fly-through: how many.")] = 4,
    speed: Annotated[float, typer.Option(help="fly-through: voxels a second.")] = 40.0,
    altitude: Annotated[float, typer.Option(help="fly-through: voxels above --at.")] = 24.0,
    lods: Annotated[int, typer.Option(help="fly-through: levels of detail.")] = 4,
    reach: Annotated[int, typer.Option(help="fly-through: a cube has 2 * (2 * reach + 1) chunks a side.")] = 1,
    batch: Annotated[int, typer.Option(help="fly-through: chunks of a batch; 0 asks for each alone.")] = 0,
    editors: Annotated[int, typer.Option(help="Storms: who edits.")] = 10,
    subscribers: Annotated[int, typer.Option(help="Storms: who is told.")] = 100,
    silent: Annotated[float, typer.Option(help="Storms: share of subscribers that never read.")] = 0.0,
    strokes: Annotated[int, typer.Option(help="Storms: strokes of an edit.")] = 1,
    ground: Annotated[float, typer.Option(help="Storms: a side of what is edited, in voxels.")] = 512.0,
    look: Annotated[float, typer.Option(help="Storms: a side of where each looks, in voxels; 0 is everywhere.")] = 0.0,
    missed: Annotated[int, typer.Option(help="reconnect-storm: edits while all are away.")] = 100,
    cuts: Annotated[int, typer.Option(help="reconnect-storm: how often all are cut.")] = 1,
    check_share: Annotated[float, typer.Option(help="Share of repeated answers whose bodies are compared.")] = 1.0,
    api_key: Annotated[str, typer.Option(envvar="CHUNKSERVER_API_KEY", help="For a server that wants one.")] = "",
    allow_remote: Annotated[bool, typer.Option("--allow-remote", help="Another machine than this one.")] = False,
    budget: Annotated[list[str] | None, typer.Option(help="p99=250 (ms), rate=95, told_p99=80; repeat.")] = None,
    output: Annotated[Path | None, typer.Option(help="Write the result here, as JSON.")] = None,
) -> None:
    """Offer a load at the times at which it is due, check each answer, and say how late answers were.

    The exit code is 1 if anything failed, an answer that did not come, or came wrong; or if a budget is broken.
    """
    load = (secrets.randbits(32) if seed is None else seed, rate, arrivals, at, spread)
    flight = (viewers, speed, altitude, lods, reach, batch)
    warm = (hot, revalidate, tuple(coding or ["identity"]))
    crowd, place = (editors, subscribers, silent, strokes), (ground, look, missed, cuts)
    try:
        options = Options(*(load + flight + warm + crowd + place))
        limits = Limits(seconds, requests, connections, in_flight, timeout)
        path = world_path(world, world_seed, recipe)
        plan = Plan(url, path, profile, options, limits, file_format, closed, check_share, allow_remote, api_key)
        budgets = read_budgets(budget or [], alone=True)
    except LoadTestError as error:
        _end(str(error))
    _run(plan, budgets, output)


@app.command("compare")
def compare_command(
    before: Annotated[Path, typer.Argument(help="A result.")],
    after: Annotated[Path, typer.Argument(help="A later one.")],
    budget: Annotated[list[str] | None, typer.Option(help="p99=+20%, rate=-5%, errors=0, p50=5 (ms); repeat.")] = None,
) -> None:
    """Compare two results. The exit code is 1 if the second breaks a budget."""
    try:
        first, second = load(before), load(after)
        lines = compare(first, second, budget or [])
    except LoadTestError as error:
        _end(str(error))
    _output().print(comparison(lines, differences(first, second)))
    if not all(line.kept for line in lines):
        raise typer.Exit(FAILED)


@app.command("ceiling")
def ceiling_command(
    seconds: Annotated[float, typer.Option(help="For each of the two loops.")] = 5.0,
    connections: Annotated[int, typer.Option(help="Open connections.")] = 32,
    body_bytes: Annotated[int, typer.Option(min=0, max=1 << 24, help="Of each answer.")] = 16_384,
) -> None:
    """Say what this generator can do here, against a server that answers at once. No content is checked."""
    try:
        found = measure(seconds, connections, body_bytes)
    except LoadTestError as error:
        _end(str(error))
    typer.echo(f"closed loop   {found.requests_per_second:,.0f} requests/s, {found.cpu_us:.1f} us of CPU each")
    times = f"p50 {found.latency_p50:.2f}, p99 {found.latency_p99:.2f} ms"
    lag = f"sent late by p50 {found.lag_p50:.2f}, p99 {found.lag_p99:.2f} ms"
    typer.echo(f"open loop     {found.rate:,.0f} requests/s: {times}; {lag}")


def _save(result: Result, path: Path) -> None:
    try:
        save(result, path)
    except OSError as error:
        _end(f"the result cannot be written: {error}")


def _run(plan: Plan, budgets: Mapping[str, Bound], output: Path | None) -> None:
    """Run a plan, say what came of it, and fail if that is not as it has to be."""
    console = Console(stderr=True)
    try:
        with view(console) as tell:
            result = run(plan, tell, 1 / DRAWS_PER_SECOND if console.is_terminal else 1.0)
    except LoadTestError as error:
        _end(str(error))
    _output().print(summary(result))
    if output:
        _save(result, output)
    try:
        over = broken(result, budgets)
    except LoadTestError as error:
        _end(str(error))
    for line in over:
        typer.echo(line, err=True)
    if result.counts.failed or over:
        raise typer.Exit(FAILED)


def _output() -> Console:
    """Return the standard output: as wide as its terminal, or wide enough for the tables."""
    console = Console()
    return console if console.is_terminal else Console(width=WIDTH)


def _end(why: str) -> NoReturn:
    typer.echo(why, err=True)
    raise typer.Exit(MISUSED)


if __name__ == "__main__":
    sys.exit(app())
