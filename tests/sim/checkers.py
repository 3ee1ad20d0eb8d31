"""What the stream guarantees, each looked for in what has happened: docs/wire/edit_v1.md, "What is guaranteed".

A checker returns a line for each violation.
"""

from collections.abc import Callable, Iterator
from itertools import groupby, pairwise
from typing import Any

from chunkserver_client.stream import ChunkRange, Region
from chunkserver_client.stream.messages import Ack, Edits, Nack, Progress, Resync, Stale, Welcome
from tests.sim.log import Entry, ranges_of
from tests.sim.player import Heard, Player
from tests.sim.run import Run
from tests.sim.terrain import CELLS

PROGRESS_SECONDS = 1.0
LATENESS_SECONDS = 0.2
"""Of a message on a wire, and of the tick that sends it."""

Checker = Callable[[Run], Iterator[str]]


def heard(run: Run) -> Iterator[tuple[Player, Heard]]:
    """Yield what each player heard, in order."""
    for player in run.players:
        for one in player.heard:
            yield player, one


def entries(run: Run, one: Heard, low: int, high: int) -> list[Entry]:
    """Return the edits of a world in (low, high]."""
    return run.logs[one.epoch].entries[low:high] if one.epoch is not None else []


def expected(run: Run, player: Player, one: Heard, low: int, high: int) -> list[Entry]:
    """Return the edits of others in (low, high] that are in the regions in force."""
    found = entries(run, one, low, high)
    return [entry for entry in found if entry.client != player.name and is_in(entry, one.regions)]


def is_in(entry: Entry, regions: tuple[Region, ...]) -> bool:
    """Return whether an edit may have changed a chunk that matters in one of the regions."""
    return any(
        found.lod <= region.lod
        and found.low[0] * side <= region.high[0]
        and region.low[0] <= (found.high[0] + 1) * side
        for found in ranges(entry)
        for side in (CELLS << found.lod,)
        for region in regions
    )


def ranges(entry: Entry) -> list[ChunkRange]:
    """Return what an edit makes stale."""
    found = [each for stroke in entry.strokes for each in ranges_of(stroke)]
    return [ChunkRange(each["lod"], tuple(each["min"]), tuple(each["max"])) for each in found]


def covers(told: tuple[ChunkRange, ...], entry: Entry) -> bool:
    """Return whether ranges hold all that an edit makes stale."""
    return all(
        any(big.lod == each.lod and big.low[0] <= each.low[0] and each.high[0] <= big.high[0] for big in told)
        for each in ranges(entry)
    )


def reached(message: Any) -> int | None:
    """Return the revision that a message leads to."""
    return message.revision if isinstance(message, Edits | Stale | Progress | Resync) else None


def ordered(run: Run) -> Iterator[str]:
    """Edits come in the order of their revisions, and what is known never goes back."""
    last: dict[tuple[str, str | None], int] = {}
    for player, one in heard(run):
        if isinstance(one.message, Edits):
            revisions = [edit.revision for edit in one.message.edits]
            before = last.get((player.name, one.epoch), 0)
            if any(a >= b for a, b in pairwise([before, *revisions])):
                yield f"{player.name} at {one.at:.3f}: {revisions} after {before}"
            last[player.name, one.epoch] = max(before, *revisions)
        if (revision := reached(one.message)) is not None and revision < one.known:
            yield f"{player.name} at {one.at:.3f}: back to {revision} from {one.known}"


def unique(run: Run) -> Iterator[str]:
    """No edit comes twice, and none of one's own comes at all: that is answered."""
    seen: set[tuple[str, str | None, int]] = set()
    for player, one in heard(run):
        for edit in one.message.edits if isinstance(one.message, Edits) else ():
            entry = entries(run, one, edit.revision - 1, edit.revision)[0]
            if (player.name, one.epoch, edit.revision) in seen or entry.client == player.name:
                yield f"{player.name} at {one.at:.3f}: {edit.revision} once more"
            seen.add((player.name, one.epoch, edit.revision))


def reliable(run: Run) -> Iterator[str]:
    """Of what a message leads up to, no edit is missing, or `stale` has its chunks."""
    for player, one in heard(run):
        match one.message:
            case Edits(after, revision, edits):
                missing = {entry.revision for entry in expected(run, player, one, after, revision)}
                missing -= {edit.revision for edit in edits}
                if missing:
                    yield f"{player.name} at {one.at:.3f}: {sorted(missing)} missing in ({after}, {revision}]"
            case Stale(told, revision):
                for entry in expected(run, player, one, one.known, revision):
                    if not covers(told, entry):
                        yield f"{player.name} at {one.at:.3f}: chunks of {entry.revision} missing in stale {revision}"


def atomic(run: Run) -> Iterator[str]:
    """An edit comes as a whole: all of its strokes, and in the same message all of its chunks."""
    for player, one in heard(run):
        match one.message:
            case Edits(_, _, edits, stale):
                for edit in edits:
                    entry = entries(run, one, edit.revision - 1, edit.revision)[0]
                    if edit.strokes != entry.strokes or not covers(stale, entry):
                        yield f"{player.name} at {one.at:.3f}: only a part of {edit.revision}"


def resumable(run: Run) -> Iterator[str]:
    """Each message goes on where the one before ended, on another connection too, unless that is below the floor."""
    for player, one in heard(run):
        match one.message:
            case Edits(after):
                if after != one.known:
                    yield f"{player.name} at {one.at:.3f}: goes on at {after}, and {one.known} is known"
            case Resync(floor):
                if floor <= one.known:
                    yield f"{player.name} at {one.at:.3f}: resync at floor {floor}, and {one.known} is known"


def bookmarkable(run: Run) -> Iterator[str]:
    """`progress` comes every second, and has no edit before it that did not come, or was not answered."""
    answered: dict[str, set[tuple[str | None, int]]] = {player.name: set() for player in run.players}
    for player, one in heard(run):
        match one.message:
            case Ack(seq):
                answered[player.name].add((one.epoch, seq))
            case Progress(revision):
                for entry in expected(run, player, one, one.known, revision):
                    yield f"{player.name} at {one.at:.3f}: progress {revision} without {entry.revision}"
            case Stale() | Resync():
                answered[player.name].update((one.epoch, seq) for seq in player.sent.get(one.epoch or "", ()))
        if isinstance(one.message, Edits | Progress):
            for entry in entries(run, one, one.known, one.message.revision):
                if entry.client == player.name and (one.epoch, entry.seq) not in answered[player.name]:
                    yield f"{player.name} at {one.at:.3f}: {entry.revision} is its own and not answered"
    yield from silent(run)


def silent(run: Run) -> Iterator[str]:
    """Yield each second in which a player that reads heard nothing of a revision."""
    for player in run.players:
        words = [one for one in player.heard if reached(one.message) is not None or isinstance(one.message, Welcome)]
        for number, on_one in groupby(words, lambda one: one.connection):
            times = [*(one.at for one in on_one), player.ends.get(number, run.seconds)]
            for start, end in pairwise(times):
                was_slow = any(low <= end and start <= high + LATENESS_SECONDS for low, high in player.slow)
                if end - start > PROGRESS_SECONDS + LATENESS_SECONDS and not was_slow:
                    yield f"{player.name} at {end:.3f}: nothing since {start:.3f}"


def durable(run: Run) -> Iterator[str]:
    """What was acknowledged is in the log, once, as it was sent; what was refused is not there."""
    for player, one in heard(run):
        sent = player.sent.get(one.epoch or "", {})
        match one.message:
            case Ack(seq, revision, _, stale) if stale is not None:
                found = entries(run, one, revision - 1, revision)
                if not found or found[0][1:] != (sent[seq], player.name, seq) or not covers(stale, found[0]):
                    yield f"{player.name} at {one.at:.3f}: {seq} is acknowledged as {revision}, which has {found}"
            case Nack(seq):
                if any(entry[2:] == (player.name, seq) for entry in run.logs[one.epoch or ""].entries):
                    yield f"{player.name} at {one.at:.3f}: {seq} is refused, and written"
    for log in run.logs.values():
        names = [(entry.client, entry.seq) for entry in log.entries if entry.client is not None]
        if len(names) != len(set(names)):
            yield f"{log.epoch}: an edit is written twice"


def converged(run: Run) -> Iterator[str]:
    """In the end everybody has heard everything, and shows it."""
    if not run.is_settled:
        yield f"not settled: {[vars(player.session) for player in run.players]}"
        return
    log = run.logs[run.epoch]
    for player in run.players:
        for key, revision in player.shown.items():
            last = log.last(key.lod, key.x)
            if revision != last and any(region.holds(key, CELLS) for region in player.session.regions):
                yield f"{player.name} shows {key} as of {revision}, and {last} is the last"


GUARANTEES: dict[str, Checker] = {
    "ordered": ordered,
    "unique": unique,
    "reliable": reliable,
    "atomic": atomic,
    "resumable": resumable,
    "bookmarkable": bookmarkable,
    "durable": durable,
    "converged": converged,
}
