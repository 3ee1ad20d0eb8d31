"""The viewer in headless Chromium, without a graphics card, against a server with two workers that has built nothing.

All of it shares the cores of the machine: the server, its workers, the browser, and the software that draws. The window
is of 1280 x 720, by which levels are chosen; its canvas has a quarter of the pixels each way.

- Page: what the browser is sent before it talks to the server, compressed: the page, its scripts and styles.
- First view: the page opened without a link, `continents` from orbit. Until something of it is drawn, and until all
  that is wanted is; "received" is the page and all answers.
- Fly-through: fifteen seconds over `terrain`, straight on, some 37 voxels a second, while chunks come. As if there were
  a graphics card, WebGL's calls that draw do nothing. From the browser's own trace: all tasks of the page's main
  thread from one animation frame to the next, timers, messages and garbage collection too, less the time in three.js's
  `render`. It is the thread's own time; "passed" is with what it has waited for a core that the others had.
- A long task takes more than 50 ms, with all waiting, beside `render`. They are counted over all rounds, of which there
  are three at most. What the longest task takes of the thread's own time is another figure.
"""

import json
import statistics
import subprocess
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import httpx2

from benchmarks.measure import MS, Figure, Line, Scale, in_turns
from benchmarks.trace import PASSED, PROCESSOR, Thread, read
from chunkserver.server.viewer import FOLDER
from chunkserver.worker import warm
from tests.serving import Server, serving

WORKERS: Final = 2
ROUNDS_MAX: Final = 3
FLIGHT_TIMES: Final = 3.0
"""How long a flight is, in the seconds of a load."""
FLIGHT_SECONDS_MIN: Final = 3.0
"""However little is offered: a browser has to get some frames done."""
RUN_SECONDS_MAX: Final = 300.0
LONG_TASK_SECONDS: Final = 0.05
KILOBYTE: Final = 1000

PAGE: Final = "page"
FIRST_VIEW: Final = "first view, continents"
FLIGHT: Final = "fly-through, terrain"
LONG_TASKS: Final = ("long tasks", "tasks")
DRIVER: Final = Path(__file__).with_name("flight.mjs")

Figures = Mapping[tuple[str, str], float]


def run(scale: Scale) -> Iterator[Line]:
    """Yield a line for the page, for a first view and for a flight."""
    seconds = max(FLIGHT_TIMES * scale.load_seconds, FLIGHT_SECONDS_MIN)
    warm()
    rounds = in_turns({"round": lambda: _round(seconds)}, min(scale.rounds, ROUNDS_MAX), uncounted=0)["round"]
    for subject in rounds[0]:
        yield _line(subject, [each[subject] for each in rounds])


def _line(subject: str, rounds: Sequence[Figures]) -> Line:
    """Return a line of all rounds; what is counted is the sum of them, so that none is hidden by the others."""
    found = []
    for column in rounds[0]:
        values = tuple(each[column] for each in rounds)
        found.append(Figure(*column, (sum(values),) if column == LONG_TASKS else values))
    return Line(subject, tuple(found))


def _round(seconds: float) -> dict[str, Figures]:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        with serving(folder / "log", "--workers", str(WORKERS)) as server:
            page = _page_bytes(server)
            seen = _driven(server, folder, seconds)
        traces = {name: [read(folder / f"{name}.json", clock) for clock in (PASSED, PROCESSOR)] for name in seen}
    first = seen["start"]
    passed, beside = (sorted(thread.beside_rendering()) for thread in traces["flight"])
    return {
        PAGE: {("compressed", "kB"): page / KILOBYTE},
        FIRST_VIEW: {
            ("first picture", "s"): first["first"],
            ("full view", "s"): first["full"],
            ("received", "kB"): (page + first["bytes"]) / KILOBYTE,
            ("requests", ""): first["requests"],
            ("chunks", ""): first["chunks"],
            **_long_tasks(*traces["start"]),
        },
        FLIGHT: {
            ("chunks", ""): seen["flight"]["chunks"],
            ("frames", "1/s"): (len(beside) + 1) / seconds,
            ("mean", "ms a frame"): statistics.fmean(beside) * MS,
            ("median", "ms a frame"): statistics.median(beside) * MS,
            ("95 %", "ms a frame"): _quantile(beside, 0.95) * MS,
            ("99 %", "ms a frame"): _quantile(beside, 0.99) * MS,
            ("most", "ms a frame"): beside[-1] * MS,
            ("95 %, passed", "ms a frame"): _quantile(passed, 0.95) * MS,
            **_long_tasks(*traces["flight"]),
        },
    }


def _quantile(values: Sequence[float], share: float) -> float:
    return values[min(int(share * len(values)), len(values) - 1)]


def _long_tasks(passed: Thread, own: Thread) -> Figures:
    """Return how many there are, and what the longest task takes: with its waiting, and of the thread's own time."""
    tasks = passed.tasks_beside_rendering()
    return {
        LONG_TASKS: sum(task > LONG_TASK_SECONDS for task in tasks),
        ("longest", "ms"): max(tasks) * MS,
        ("longest, own time", "ms"): max(own.tasks_beside_rendering()) * MS,
    }


def _page_bytes(server: Server) -> int:
    """Return the bytes of all that the viewer is, as they are sent."""
    with httpx2.Client(base_url=server.url, headers={"Accept-Encoding": "gzip"}) as client:
        paths = ["/", *(f"/{path.relative_to(FOLDER)}" for path in FOLDER.glob("assets/*"))]
        return sum(int(client.get(path).raise_for_status().headers["content-length"]) for path in paths)


def _driven(server: Server, folder: Path, seconds: float) -> dict[str, Any]:
    command = ["node", str(DRIVER), server.url, str(folder), str(seconds)]
    ran = subprocess.run(
        command, stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=RUN_SECONDS_MAX, check=False
    )
    if ran.returncode:
        raise RuntimeError(f"{DRIVER.name} ended with {ran.returncode}:\n{ran.stderr}")
    found: dict[str, Any] = json.loads(ran.stdout)
    return found
