"""The same profiles for Locust, whose users take turns: each sends its next request when it has its answer.

    locust -f clients/loadtest/locustfile.py --headless -u 8 -t 10s -H http://127.0.0.1:8000 FlyThrough

So figures are those of a closed loop. Content is checked as by `chunkserver-loadtest`: what is wrong is a failure, and
makes the exit code 1. Any host may be named: Locust asks nobody whether it is this machine.
"""

import itertools
import threading
import time
from argparse import ArgumentParser
from collections.abc import Iterator
from typing import Any, ClassVar, Final

from locust import FastHttpUser, constant_throughput, events, task

from chunkserver_loadtest.checks import Checker, Fault
from chunkserver_loadtest.exchange import Answer, Request
from chunkserver_loadtest.profiles import PROFILES, Due, Options, flight
from chunkserver_loadtest.target import resolve
from chunkserver_loadtest.world import World, describe, world_path

REQUESTS_PER_SECOND: Final = 20
"""Of a user that does not fly; one with a slow answer sends fewer."""


def add_options(parser: ArgumentParser) -> None:
    """Say which world, and which seed the load has."""
    parser.add_argument("--world", default="", help="id of a world; without one a seed's is asked for")
    parser.add_argument("--world-seed", type=int, default=42)
    parser.add_argument("--recipe", default="terrain")
    parser.add_argument("--load-seed", type=int, default=0)


events.init_command_line_parser.add_listener(add_options)  # type: ignore[no-untyped-call]  # locust has no type for it


class Shared:
    """What all users know, read when the first of them starts; the others wait for it."""

    reading: ClassVar = threading.Lock()  # of gevent: locust puts its own in place of all locks
    world: ClassVar[World | None] = None
    checker: ClassVar[Checker]
    options: ClassVar[Options]
    cold: ClassVar[Iterator[Due]]
    viewers: ClassVar[Iterator[int]] = itertools.count()

    @classmethod
    def learn(cls, user: FastHttpUser) -> World:
        """Return the world, whose descriptor is asked for once."""
        with cls.reading:
            if cls.world is None:
                given = user.environment.parsed_options
                path = world_path(given.world, given.world_seed, given.recipe)
                cls.world = describe(resolve(user.host or "", allow_remote=True), path, "mesh", {})
                cls.checker, cls.options = Checker(cls.world), Options(given.load_seed)
                cls.cold = PROFILES["cold-unique"].schedule(cls.world, cls.options, ())
            return cls.world


class Viewer(FastHttpUser):
    """What all users do: ask, and check what comes."""

    abstract = True

    def on_start(self) -> None:
        """Learn which world it is."""
        self.world = Shared.learn(self)

    def ask(self, request: Request) -> Answer | None:
        """Send a request, and report what is wrong with its answer. Returns it, or None if there was none."""
        fields = {"Accept-Encoding": "identity"}
        if request.etag:
            fields["If-None-Match"] = request.etag
        if request.urgency is not None:
            fields["Priority"] = f"u={request.urgency}"
        with self.client.get(request.path, headers=fields, name=request.kind, catch_response=True) as response:
            if not response.status_code:
                return None
            answer = Answer(response.status_code, _head(response.headers), (response.content or b"",))
            try:
                Shared.checker.check(request, answer)
                response.success()
            except Fault as fault:
                response.failure(f"{fault.kind}: {fault.detail}")
            return answer


class ColdUnique(Viewer):
    """Chunks that nobody has asked for."""

    wait_time = constant_throughput(REQUESTS_PER_SECOND)

    @task
    def ask_next(self) -> None:
        """Ask for one."""
        self.ask(next(Shared.cold)[1])


class WarmHot(Viewer):
    """The same chunks again and again, some of them with their tags."""

    wait_time = constant_throughput(REQUESTS_PER_SECOND)

    def on_start(self) -> None:
        """Ask for each once."""
        super().on_start()
        asked = PROFILES["warm-hot"].prime(self.world, Shared.options)
        primed = [(request, answer) for request in asked if (answer := self.ask(request))]
        self.requests = PROFILES["warm-hot"].schedule(self.world, Shared.options, primed)

    @task
    def ask_again(self) -> None:
        """Ask for one of them."""
        self.ask(next(self.requests)[1])


class FlyThrough(Viewer):
    """A viewer that flies, and asks for what comes into its view, as soon as the one before is there."""

    def on_start(self) -> None:
        """Take off."""
        super().on_start()
        self.started = time.perf_counter()
        self.flight = flight(self.world, Shared.options, next(Shared.viewers))

    @task
    def fly_on(self) -> None:
        """Ask for the next chunk."""
        due, request = next(self.flight)
        time.sleep(max(0.0, self.started + due - time.perf_counter()))  # gevent's, by locust: others go on
        self.ask(request)


def _head(headers: Any) -> bytes:
    return "".join(f"\r\n{name}: {value}" for name, value in headers.items()).encode()
