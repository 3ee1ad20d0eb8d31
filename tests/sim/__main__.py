"""Show what happens in the run of a seed: `python -m tests.sim SEED`."""

import sys

from tests.sim.checkers import GUARANTEES
from tests.sim.player import Heard, Player
from tests.sim.run import play


def line(player: Player, one: Heard) -> str:
    """Return one message in a line."""
    kind = type(one.message).__name__.lower()
    return f"{one.at:7.3f} {player.name} #{one.connection} {one.epoch} {one.known:4d} {kind} {tuple(one.message)}"


run = play(int(sys.argv[1]))
heard = sorted(((one, player) for player in run.players for one in player.heard), key=lambda both: both[0].at)
lines = [line(player, one) for one, player in heard]
lines += [f"{name}: {found}" for name, check in GUARANTEES.items() for found in check(run)]
sys.stdout.write("\n".join(lines) + "\n")
