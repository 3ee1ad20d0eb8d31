"""The pictures of a run, drawn from its JSON: SVG with its text as text, the same bytes for the same run.

They stand on white, so that they can be read on a dark page too.
"""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, Literal, NamedTuple

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

Run = Mapping[str, Any]
"""What `report.as_json` writes, parsed."""
Table = dict[str, dict[str, dict[str, Any]]]
"""Subject -> name of a figure -> the figure."""

STYLE: Final = {
    "svg.fonttype": "none",
    "svg.hashsalt": "chunkserver",
    "font.family": "sans-serif",
    "font.size": 9,
    "text.color": "#222222",
    "axes.labelcolor": "#222222",
    "axes.edgecolor": "#888888",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.axisbelow": True,
    "axes.titlesize": 10,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "xtick.color": "#444444",
    "ytick.color": "#444444",
    "grid.color": "#e4e4e4",
    "legend.frameon": False,
    "figure.facecolor": "white",
    "figure.constrained_layout.use": True,
}
OURS: Final = "#0b63b0"
PEERS: Final = ("#e08a1e", "#8a8a8a", "#b04a8f", "#3a9a73")
"""Told apart with any kind of colour vision."""
ENDS: Final = {"lw": 0.8, "ecolor": "#333333"}
"""How quartiles are drawn on a bar."""
WIDTH: Final = 7.2
"""Inches."""
BEHIND: Final = "behind a bar: how many times ours it is"
METADATA: Final = {"Date": None, "Creator": None}


class Picture(NamedTuple):
    """The picture of one job. alternative: what it shows, for those who do not see it."""

    alternative: str
    plot: Callable[[Table], Figure]


def draw(run: Run, folder: Path) -> dict[str, Path]:
    """Write the pictures of the jobs that `run` has into `folder`; return job -> file."""
    folder.mkdir(parents=True, exist_ok=True)
    written = {}
    for job in run["jobs"]:
        if job["name"] in PICTURES:
            path = folder / f"{job['name']}.svg"
            with mpl.rc_context(STYLE):  # type: ignore[arg-type]
                PICTURES[job["name"]].plot(table(job)).savefig(path, metadata=METADATA)
            written[job["name"]] = path
    return written


def link(job: str, path: str) -> str:
    """Return the Markdown of a job's picture."""
    return f"![{PICTURES[job].alternative}]({path})"


def table(job: Mapping[str, Any]) -> Table:
    """Return a job's figures by subject and name."""
    return {line["subject"]: {figure["name"]: figure for figure in line["figures"]} for line in job["lines"]}


def _bars(axes: Axes, lines: Table, names: Mapping[str, str], unit: str) -> None:
    """Draw a group of horizontal bars per subject, with quartiles: names: figure -> colour. Ratios stand behind."""
    height = 0.8 / len(names)
    for place, (name, colour) in enumerate(names.items()):
        found = [(at, line[name]) for at, line in enumerate(lines.values()) if name in line]
        at = [subject + (place + 0.5) * height - 0.4 for subject, _ in found]
        figures = [figure for _, figure in found]
        widths, ends = [figure["median"] for figure in figures], _quartiles(figures)
        axes.barh(at, widths, height * 0.92, color=colour, label=name, xerr=ends, error_kw=ENDS)
        for y, figure in zip(at, figures, strict=True):
            if figure["ratio"]:
                times = f"{figure['ratio']['median']:.2g}x"
                axes.annotate(times, (figure["high"], y), (4, 0), textcoords="offset points", va="center", fontsize=7)
    axes.set_yticks(range(len(lines)), list(lines))
    axes.invert_yaxis()
    axes.set_xlabel(unit)
    axes.margins(x=0.08)
    axes.grid(axis="x")
    axes.tick_params(axis="y", length=0)


def _quartiles(figures: Sequence[Mapping[str, float]]) -> tuple[list[float], list[float]]:
    """Return how far the quartiles are below and above the medians."""
    return [each["median"] - each["low"] for each in figures], [each["high"] - each["median"] for each in figures]


def _colours(lines: Table, besides: Sequence[str] = ()) -> dict[str, str]:
    """Return a colour per figure: ours, then the peers in the order of the table. Raises ValueError if they run out."""
    names = dict.fromkeys(name for line in lines.values() for name in line if name not in ("chunkserver", *besides))
    return {"chunkserver": OURS, **dict(zip(names, PEERS[: len(names)], strict=True))}


def _extraction(lines: Table) -> Figure:
    figure = Figure((WIDTH, 4.2))
    colours = _colours(lines, ["triangles"])
    _bars(figure.add_subplot(), lines, colours, f"ms a chunk; {BEHIND}")
    return _with_legend(figure)


def _noise(lines: Table) -> Figure:
    figure = Figure((WIDTH, 5.2))
    _bars(figure.add_subplot(), lines, _colours(lines), f"ns a sample, 2-D: a column; {BEHIND}")
    return _with_legend(figure)


def _with_legend(figure: Figure) -> Figure:
    """Put the legend of the first axes above all of them."""
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper left", ncols=len(labels), columnspacing=1.2, handlelength=1.2)
    return figure


_STAGES: Final = {"field": OURS, "mesh, normals": PEERS[0], "encode native": PEERS[3]}


def _stages(lines: Table) -> Figure:
    figure = Figure((WIDTH, 2.9))
    axes = figure.add_subplot()
    starts = [0.0] * len(lines)
    for stage, colour in _STAGES.items():
        widths = [line[stage]["median"] for line in lines.values()]
        axes.barh(range(len(lines)), widths, 0.6, left=starts, color=colour, label=stage)
        starts = [start + width for start, width in zip(starts, widths, strict=True)]
    whole = [line["whole chunk, native"]["median"] for line in lines.values()]
    axes.plot(whole, range(len(lines)), "|", color="#111111", markersize=18, markeredgewidth=2, label="whole chunk")
    axes.set_yticks(range(len(lines)), list(lines))
    axes.invert_yaxis()
    axes.set_xlabel("ms a chunk; the stages one by one, and all of them at once")
    axes.grid(axis="x")
    axes.tick_params(axis="y", length=0)
    return _with_legend(figure)


_SERVERS: Final = {"chunkserver": "", "bare ASGI": ", bare ASGI", "FastAPI": ", FastAPI"}
_COLOURS: Final = dict(zip(_SERVERS, (OURS, PEERS[1], PEERS[0]), strict=True))
_KINDS: Final = {"60 KB\nout of memory": "warm", "304": "304"}


def _requests(lines: Table) -> Figure:
    figure = Figure((WIDTH, 2.6))
    many, one = figure.subplots(1, 2)
    _bars(many, _servers(lines, "16 connections", "requests"), _COLOURS, "requests a second,\n16 connections")
    _bars(one, _servers(lines, "1 connection", "median"), _COLOURS, "ms until an answer, median,\none connection")
    one.set_yticklabels([])
    return _with_legend(figure)


def _servers(lines: Table, connections: str, name: str) -> Table:
    """Return one figure of each server, by kind of request and server, without its ratio."""
    return {
        label: {
            server: {**lines[f"{kind}{suffix}, {connections}"][name], "ratio": None}
            for server, suffix in _SERVERS.items()
        }
        for label, kind in _KINDS.items()
    }


_SIZES: Final = {"16 cells": PEERS[0], "32 cells": OURS, "64 cells": PEERS[3]}
_LINES: Final[dict[str, Literal["-", "--"]]] = {"whole chunk, native": "-", "mesh, normals": "--"}


def _growth(lines: Table) -> Figure:
    figure = Figure((WIDTH, 3.4))
    surface, nodes = figure.subplots(1, 2)
    for size, colour in _SIZES.items():
        points = [line for subject, line in lines.items() if subject.startswith(size)]
        for stage, style in _LINES.items():
            _curve(surface, [(p["triangles"]["median"], p[stage]) for p in points], colour, style)
    surface.set(xscale="log", yscale="log", xlabel="triangles a chunk", title="More surface")
    handles = [Line2D([], [], color=colour, label=size) for size, colour in _SIZES.items()]
    handles += [Line2D([], [], color="#555555", linestyle=style, label=name) for name, style in _LINES.items()]
    surface.legend(handles=handles, fontsize=7, loc="upper left")
    counted = [(float(subject.split()[0]), line) for subject, line in lines.items() if subject.endswith("nodes")]
    for name, colour in (("field", PEERS[0]), ("whole chunk, native", OURS)):
        _curve(nodes, [(count, line[name]) for count, line in counted], colour, "-", name)
    nodes.set(xscale="log", yscale="log", xlabel="nodes of the recipe", title="More recipe")
    nodes.legend(fontsize=7, loc="upper left")
    for axes in (surface, nodes):
        axes.grid(which="major")
        axes.set_ylabel("ms a chunk")
        axes.xaxis.set_major_formatter("{x:,g}")
        axes.yaxis.set_major_formatter("{x:g}")
    return figure


def _curve(
    axes: Axes, points: Sequence[tuple[float, Mapping[str, float]]], colour: str, style: str, label: str = ""
) -> None:
    """Draw medians with their quartiles."""
    x, figures = [place for place, _ in points], [figure for _, figure in points]
    y, ends = [figure["median"] for figure in figures], _quartiles(figures)
    axes.errorbar(x, y, ends, color=colour, linestyle=style, marker="o", markersize=3, linewidth=1.4, label=label)


PICTURES: Final = {
    "stages": Picture("A bar per kind of place: milliseconds of field, mesh and encoding", _stages),
    "extraction": Picture("Bars: milliseconds of our extraction beside VTK, skimage and PyMCubes", _extraction),
    "noise": Picture("Bars: nanoseconds a sample of our noises beside pyfastnoiselite and opensimplex", _noise),
    "growth": Picture("Milliseconds against triangles for three sizes of chunk, and against nodes", _growth),
    "service": Picture("Bars: requests a second and latency beside a bare ASGI application and FastAPI", _requests),
}
