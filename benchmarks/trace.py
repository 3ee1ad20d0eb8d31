"""What a trace of Chromium says of a page's main thread: the JSON that the browser's own tracing writes.

A frame of the main thread is from the start of a task with an animation frame to the start of the next such task. It
has all tasks in between: timers, messages, garbage collection and what the browser does itself are in it.
"""

import itertools
import json
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

BEGINS: Final = "render"
ENDS: Final = "rendered"
"""The marks between which a page draws."""

_TASK: Final = "RunTask"
_FRAME: Final = "FireAnimationFrame"
_MARK, _COMPLETE = "I", "X"
_MICROSECONDS: Final = 1e-6


class Clock(NamedTuple):
    """Names in the trace of when something began, and of how long it took."""

    at: str
    took: str


PASSED: Final = Clock("ts", "dur")
"""The time that has passed, with what the thread has waited for a core."""
PROCESSOR: Final = Clock("tts", "tdur")
"""The thread's own time."""


class Span(NamedTuple):
    """A part of time, in seconds of one of the browser's clocks."""

    begin: float
    end: float

    @property
    def seconds(self) -> float:
        """How long it is."""
        return self.end - self.begin


class Thread(NamedTuple):
    """What a page's main thread did, each in order and without overlaps.

    tasks: all of them. frames: the tasks in which an animation frame is. renders: what the page has marked as that.
    """

    tasks: tuple[Span, ...]
    frames: tuple[Span, ...]
    renders: tuple[Span, ...]

    def beside_rendering(self) -> list[float]:
        """Return, for each frame but the last, the seconds of its tasks less those of rendering."""
        begins = [frame.begin for frame in self.frames]
        periods = [Span(*period) for period in itertools.pairwise(begins)]
        busy, drawing = _within(periods, self.tasks), _within(periods, self.renders)
        return [task - render for task, render in zip(busy, drawing, strict=True)]

    def tasks_beside_rendering(self) -> list[float]:
        """Return the seconds of each task less those of rendering in it."""
        drawing = _within(self.tasks, self.renders)
        return [task.seconds - render for task, render in zip(self.tasks, drawing, strict=True)]


def read(path: Path, clock: Clock) -> Thread:
    """Return the main thread of the page that has marked its rendering. Raises ValueError if there is none."""
    return main_thread(json.loads(path.read_bytes())["traceEvents"], clock)


def main_thread(events: Sequence[dict[str, Any]], clock: Clock) -> Thread:
    """Return the main thread of the page that has marked its rendering. Raises ValueError if there is none."""
    marked = next((event for event in events if event["name"] == BEGINS and event["ph"] == _MARK), None)
    if marked is None:
        raise ValueError(f"the trace has no mark {BEGINS}: nothing was drawn")
    thread = marked["pid"], marked["tid"]
    # the task in which tracing began has no time of its thread
    own = [event for event in events if (event["pid"], event["tid"]) == thread and clock.at in event]

    def moments(name: str, phase: str) -> list[float]:
        return sorted(event[clock.at] * _MICROSECONDS for event in own if (event["name"], event["ph"]) == (name, phase))

    tasks = _disjoint(_span(event, clock) for event in own if (event["name"], event["ph"]) == (_TASK, _COMPLETE))
    frames = dict.fromkeys(_holding(tasks, moments(_FRAME, _COMPLETE)))
    renders = zip(moments(BEGINS, _MARK), moments(ENDS, _MARK), strict=False)
    return Thread(tasks, tuple(frames), _disjoint(Span(*render) for render in renders))


def _span(event: dict[str, Any], clock: Clock) -> Span:
    begin: float = event[clock.at] * _MICROSECONDS
    return Span(begin, begin + event.get(clock.took, 0) * _MICROSECONDS)


def _disjoint(spans: Iterable[Span]) -> tuple[Span, ...]:
    """Return them in order; one that begins within another, a nested task, is left out."""
    found: list[Span] = []
    for span in sorted(spans, key=lambda each: (each.begin, -each.end)):
        if not found or span.begin >= found[-1].end:
            found.append(span)
    return tuple(found)


def _holding(tasks: Sequence[Span], moments: Sequence[float]) -> Iterable[Span]:
    """Yield the task that each moment, of moments in order, is in."""
    at = 0
    for moment in moments:
        while at < len(tasks) and tasks[at].end <= moment:
            at += 1
        if at < len(tasks) and tasks[at].begin <= moment:
            yield tasks[at]


def _within(periods: Sequence[Span], spans: Sequence[Span]) -> list[float]:
    """Return how many seconds of `spans` are in each period; both in order, neither overlapping itself."""
    found, at = [], 0
    for period in periods:
        while at < len(spans) and spans[at].end <= period.begin:
            at += 1
        seconds, here = 0.0, at
        while here < len(spans) and spans[here].begin < period.end:
            seconds += min(spans[here].end, period.end) - max(spans[here].begin, period.begin)
            here += 1
        found.append(seconds)
    return found
