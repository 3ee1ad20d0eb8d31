"""What is made of a trace of the browser, on one written by hand: times in microseconds, as there."""

import json
from typing import Any

import pytest

from benchmarks.trace import PASSED, PROCESSOR, main_thread, read

US = 1e-6


def span(name: str, begin: int, end: int, thread: int = 7) -> dict[str, Any]:
    """Of a thread that has its core half of the time."""
    times = {"ts": begin, "dur": end - begin, "tts": begin // 2, "tdur": (end - begin) // 2}
    return {"name": name, "ph": "X", "pid": 3, "tid": thread, **times}


def render(begin: int, end: int) -> list[dict[str, Any]]:
    marks = {"render": begin, "rendered": end}
    return [{"name": name, "ph": "I", "pid": 3, "tid": 7, "ts": at, "tts": at // 2} for name, at in marks.items()]


TRACE = [
    {"name": "thread_name", "ph": "M", "ts": 0, "pid": 3, "tid": 7},
    span("RunTask", 1000, 1500),  # a frame with 200 of rendering
    span("FireAnimationFrame", 1010, 1400),
    *render(1100, 1300),
    span("RunTask", 1600, 1650),  # a message, and a task within it
    span("RunTask", 1610, 1640),
    span("RunTask", 1700, 1800, thread=8),  # of another thread
    span("RunTask", 2000, 2600),  # a frame with two renderings
    span("FireAnimationFrame", 2001, 2590),
    *render(2100, 2150),
    *render(2200, 2500),
    span("RunTask", 3000, 3100),
    span("FireAnimationFrame", 3001, 3002),
]


def test_a_frame_has_all_tasks_until_the_next_less_rendering():
    thread = main_thread(TRACE, PASSED)
    assert len(thread.frames) == 3
    assert thread.beside_rendering() == pytest.approx([350 * US, 250 * US])


def test_the_time_of_the_thread_is_another():
    assert main_thread(TRACE, PROCESSOR).beside_rendering() == pytest.approx([175 * US, 125 * US])


def test_a_task_counts_less_its_rendering():
    tasks = main_thread(TRACE, PASSED).tasks_beside_rendering()
    assert tasks == pytest.approx([300 * US, 50 * US, 250 * US, 100 * US])


def test_order_in_the_trace_does_not_matter():
    assert main_thread(TRACE[::-1], PASSED) == main_thread(TRACE, PASSED)


def test_two_animation_frames_of_one_task_are_one():
    thread = main_thread([*TRACE, span("FireAnimationFrame", 1450, 1460)], PASSED)
    assert thread.beside_rendering() == pytest.approx([350 * US, 250 * US])


def test_a_trace_without_a_picture_is_refused(tmp_path):
    path = tmp_path / "trace.json"
    path.write_text(json.dumps({"traceEvents": [event for event in TRACE if event["name"] != "render"]}))
    with pytest.raises(ValueError, match="no mark render"):
        read(path, PASSED)
