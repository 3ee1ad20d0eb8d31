"""To be woken at a moment, to some 50 us.

The timers of an event loop count milliseconds: too coarse for requests that are due at a rate, and for answers that
take less than one. Linux has a timer that is a file: the loop waits for it as for a socket, and sleeps meanwhile.
"""

import asyncio
import ctypes
import os
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Final, Protocol

_ABSOLUTE: Final = 1
"""TFD_TIMER_ABSTIME of timerfd_create(2): a moment of the clock, which is that of `time.perf_counter`."""
_NANOSECONDS: Final = 1_000_000_000


class Alarm(Protocol):
    """Calls back once at each moment that it was last set to."""

    def set(self, moment: float) -> None:
        """Ring at `moment`, of `time.perf_counter`, and not at any that was set before. At once if it is past."""

    def close(self) -> None:
        """Never ring again."""


def alarm(ring: Callable[[], None]) -> Alarm:
    """Return an alarm of the running event loop that calls `ring`: a timer file if the system has one."""
    return _TimerFile(ring) if sys.platform == "linux" else _LoopTimer(ring)


class _Spec(ctypes.Structure):
    _fields_ = (
        ("interval_seconds", ctypes.c_long),
        ("interval_nanoseconds", ctypes.c_long),
        ("seconds", ctypes.c_long),
        ("nanoseconds", ctypes.c_long),
    )


class _TimerFile:
    def __init__(self, ring: Callable[[], None]) -> None:
        self._libc = ctypes.CDLL(None, use_errno=True)
        self._file = self._libc.timerfd_create(time.CLOCK_MONOTONIC, os.O_NONBLOCK | os.O_CLOEXEC)
        if self._file < 0:
            raise OSError(ctypes.get_errno(), "timerfd_create")
        self._ring = ring
        self._loop = asyncio.get_running_loop()
        self._loop.add_reader(self._file, self._rang)

    def set(self, moment: float) -> None:
        seconds, nanoseconds = divmod(max(1, int(moment * _NANOSECONDS)), _NANOSECONDS)  # all zero would mean never
        self._libc.timerfd_settime(
            self._file, _ABSOLUTE, ctypes.byref(_Spec(seconds=seconds, nanoseconds=nanoseconds)), None
        )

    def close(self) -> None:
        self._loop.remove_reader(self._file)
        os.close(self._file)

    def _rang(self) -> None:
        with suppress(BlockingIOError):  # it was set anew since the loop saw it ring
            os.read(self._file, 8)
            self._ring()


class _LoopTimer:
    def __init__(self, ring: Callable[[], None]) -> None:
        self._ring = ring
        self._loop = asyncio.get_running_loop()
        self._timer: asyncio.TimerHandle | None = None

    def set(self, moment: float) -> None:
        self.close()
        self._timer = self._loop.call_later(max(0.0, moment - time.perf_counter()), self._ring)

    def close(self) -> None:
        if self._timer:
            self._timer.cancel()
