"""Who asks for what, and when: one row a profile. All of it follows from the seed."""

import heapq
import itertools
import math
import random
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, Literal, NamedTuple

from chunkserver_loadtest.errors import BadOption
from chunkserver_loadtest.exchange import Answer, Key, Request
from chunkserver_loadtest.flight import path, urgency, views
from chunkserver_loadtest.world import World

Arrivals = Literal["constant", "poisson"]
Due = tuple[float, Request]

CODINGS: Final = ("identity", "gzip", "zstd")
LAYERS: Final = (-1, 0)
"""Of chunks, around the height that is asked for: the surface of `terrain` crosses both."""
BATCH_MAX: Final = 1_024
RATE_MAX: Final = 1e6
VIEWERS_MAX: Final = 1_000
REACH_MAX: Final = 8
HOT_MAX: Final = 10_000
SPREAD_MAX: Final = 1 << 20
SPEED_MIN: Final = 1.0
"""Voxels a second. While a slower viewer is followed to its next chunk nothing would be sent."""
SPEED_MAX: Final = 1e5
FLIGHT_CHUNKS_MAX: Final = 1_000_000
"""Of one viewer, which remembers each: then it has seen enough."""
JOIN_SECONDS: Final = 0.25
"""Between the first request of a viewer and that of the next one."""
EDITORS_MAX: Final = 10_000
SUBSCRIBERS_MAX: Final = 50_000
STROKES_MAX: Final = 500
"""Of an edit: more would not be sure to have room in a frame."""
GROUND_MAX: Final = 1e6
MISSED_MAX: Final = 100_000
CUTS_MAX: Final = 1_000
CANDIDATES: Final = 2
"""Times the hot set: what is asked for to find as many chunks with a surface."""


@dataclass(frozen=True)
class Options:
    """What a profile may be told.

    rate: requests or edits a second, and how they arrive (`arrivals`); a flight has its own times.
    at: voxels, where the load is. spread: chunks, how far around it. viewers, speed (voxels/s), altitude (voxels above
    `at`), lods, reach: of flights. batch: chunks of one; 0 asks for each alone. hot: chunks of the hot set, of which a
    share `revalidate` is asked for with its tag. codings: taken in turns.

    Of storms: editors, subscribers, a share of whom is `silent`; strokes of an edit; ground: voxels, a side of what is
    edited; look: voxels, a side of where a subscriber looks, 0 for everywhere; missed: edits while all are away; cuts.

    Raises BadOption if one is out of its range.
    """

    seed: int = 0
    rate: float = 100.0
    arrivals: Arrivals = "constant"
    at: tuple[float, float, float] = (0.0, 0.0, 0.0)
    spread: int = 512
    viewers: int = 4
    speed: float = 40.0
    altitude: float = 24.0
    lods: int = 4
    reach: int = 1
    batch: int = 0
    hot: int = 64
    revalidate: float = 0.25
    codings: tuple[str, ...] = ("identity",)
    editors: int = 10
    subscribers: int = 100
    silent: float = 0.0
    strokes: int = 1
    ground: float = 512.0
    look: float = 0.0
    missed: int = 100
    cuts: int = 1

    def __post_init__(self) -> None:
        ranges: dict[str, tuple[float, float]] = {
            "rate": (1e-3, RATE_MAX),
            "spread": (1, SPREAD_MAX),
            "viewers": (1, VIEWERS_MAX),
            "speed": (SPEED_MIN, SPEED_MAX),
            "altitude": (-1e9, 1e9),
            "lods": (1, 21),
            "reach": (1, REACH_MAX),
            "batch": (0, BATCH_MAX),
            "hot": (1, HOT_MAX),
            "revalidate": (0, 1),
            "editors": (1, EDITORS_MAX),
            "subscribers": (0, SUBSCRIBERS_MAX),
            "silent": (0, 1),
            "strokes": (1, STROKES_MAX),
            "ground": (1, GROUND_MAX),
            "look": (0, GROUND_MAX),
            "missed": (0, MISSED_MAX),
            "cuts": (1, CUTS_MAX),
        }
        for name, (least, most) in ranges.items():
            if not least <= getattr(self, name) <= most:
                raise BadOption(f"{name} is {getattr(self, name)}: {least:g} to {most:g}")
        if not all(abs(at) <= 2**40 for at in self.at):
            raise BadOption(f"at is {self.at}: within 2^40 voxels of the origin")
        if wrong := set(self.codings) - set(CODINGS):
            raise BadOption(f"coding is {', '.join(sorted(wrong))}: {', '.join(CODINGS)}")

    def chance(self, *names: object) -> random.Random:
        """Return random numbers of this seed for one purpose."""
        return random.Random("/".join(map(str, (self.seed, *names))))


Primed = Sequence[tuple[Request, Answer]]


class Profile(NamedTuple):
    """A kind of load.

    prime: what is asked for once, before the clock starts. schedule: what is due when, in the knowledge of what came.
    paced: whether `rate` counts.
    """

    summary: str
    schedule: Callable[[World, Options, Primed], Iterator[Due]]
    prime: Callable[[World, Options], Iterable[Request]] = lambda _world, _options: ()
    paced: bool = True


def arrivals(options: Options) -> Iterator[float]:
    """Yield the seconds at which requests arrive, without end: evenly, or each whenever it likes."""
    if options.arrivals == "constant":
        return (number / options.rate for number in itertools.count())
    chance = options.chance("arrivals")
    return itertools.accumulate(chance.expovariate(options.rate) for _ in itertools.count())


def columns(options: Options, cells: int) -> Iterator[Key]:
    """Yield each chunk of two layers around `at` once, in an order without a pattern: column c is c * odd + shift."""
    chance = options.chance("columns")
    side = 2 * options.spread
    factor = next(f for f in iter(lambda: chance.randrange(1, side * side + 1), None) if math.gcd(f, side * side) == 1)
    shift = chance.randrange(side * side)
    x, y, z = (math.floor(at / cells) for at in options.at)
    for number in range(side * side):
        row, column = divmod((number * factor + shift) % (side * side), side)
        for layer in LAYERS:
            yield 0, x + column - options.spread, y + layer, z + row - options.spread


def _cold(world: World, options: Options, _primed: Primed) -> Iterator[Due]:
    asked = (key for key in columns(options, world.cells) if world.has(key))
    codings = itertools.cycle(options.codings)
    requests = (world.request(key, "cold", coding) for key, coding in zip(asked, codings, strict=False))
    return zip(arrivals(options), requests, strict=False)


def _hot(world: World, options: Options) -> Iterator[Request]:
    asked = (key for key in columns(options, world.cells) if world.has(key))
    hot = list(itertools.islice(asked, CANDIDATES * options.hot))
    return (world.request(key, "prime", coding) for key in hot for coding in options.codings)


def _warm(_world: World, options: Options, primed: Primed) -> Iterator[Due]:
    """Ask again for what came with a surface, or if nothing had one for whatever came."""
    found = [(request, answer) for request, answer in primed if answer.status == 200] or list(primed)
    hot = found[: options.hot * len(options.codings)]
    if not hot:
        raise BadOption("nothing of the hot set was answered")
    chance = options.chance("hot")
    for due in arrivals(options):
        request, answer = chance.choice(hot)
        if chance.random() < options.revalidate:
            yield due, request._replace(kind="revalidate", etag=answer.text(b"etag"))
        else:
            yield due, request._replace(kind="warm")


def _fly(world: World, options: Options, _primed: Primed) -> Iterator[Due]:
    flights = (flight(world, options, number) for number in range(options.viewers))
    return heapq.merge(*flights, key=lambda due: due[0])


def flight(world: World, options: Options, number: int) -> Iterator[Due]:
    """Yield what one viewer asks for, each chunk once; its first view is of kind `arrive`, what is new later `fly`.

    It ends when what comes into view is no chunk of the world any more: the viewer has left it.
    """
    chance = options.chance("viewer", number)
    spread = options.spread * world.cells
    x, y, z = options.at
    start = (x + chance.uniform(-spread, spread), y + options.altitude, z + chance.uniform(-spread, spread))
    codings, asked = itertools.cycle(options.codings), 0
    for view in views(path(chance, start, options.speed), world.cells, min(options.lods, world.lods), options.reach):
        due = number * JOIN_SECONDS + view.seconds
        missing = [key for key in view.missing if world.has(key)]
        if not missing:
            return
        for first in range(0, len(missing), options.batch or 1):
            keys = tuple(missing[first : first + (options.batch or 1)])
            hurry = urgency(keys[0], view.viewer, world.cells)
            coding = next(codings)
            if options.batch:
                yield due, world.batch(keys, view.viewer, coding, hurry)
            else:
                yield due, world.request(keys[0], "fly" if view.seconds else "arrive", coding, hurry)
        asked += len(missing)
        if asked > FLIGHT_CHUNKS_MAX:
            return


PROFILES: Final[Mapping[str, Profile]] = {
    "cold-unique": Profile("each chunk is asked for once: nothing can come from a cache", _cold),
    "warm-hot": Profile("a small set of chunks, again and again, a share of them with their tags", _warm, _hot),
    "fly-through": Profile("viewers fly over terrain and ask for what comes into view", _fly, paced=False),
}
"""Every profile. A new one is one row, and the functions that it names."""
