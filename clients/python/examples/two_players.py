"""Two players in one world: each digs, and each is told what the other one has dug and which chunks to draw anew.

python two_players.py --url http://127.0.0.1:8000

Stop the server in the middle and start it again with the same `--data`: nothing is lost, and nothing is dug twice.
"""

import argparse
import math
import secrets
import threading
import time

from chunkserver_client import ChunkKey, Client, Edits, EditStream, Refresh, WorldDescriptor

parser = argparse.ArgumentParser(description="Two players dig in one world.")
parser.add_argument("--url", default="http://127.0.0.1:8000", help="of the server")
parser.add_argument("--edits", type=int, default=20, help="of each player")
parser.add_argument("--seconds", type=float, default=0.1, help="between two edits of a player")
options = parser.parse_args()

both = threading.Barrier(2)  # who comes later is not told what was dug before
KEYS = [ChunkKey(0, x, y, z) for x in (-1, 0) for y in (-1, 0) for z in (-1, 0)]


def dig(stream: EditStream, radius: float) -> None:
    """Dig along a circle; the radius is in voxels."""
    answers = []
    for number in range(options.edits):
        angle = math.tau * number / options.edits
        place = (radius * math.cos(angle), -2.0, radius * math.sin(angle))
        answers.append(stream.edit([{"op": "carve", "shape": "sphere", "center": place, "radius": 3.0}]))
        time.sleep(options.seconds)
    for answer in answers:
        answer.result()


def look_on(client: Client, world: WorldDescriptor, stream: EditStream) -> str:
    """Fetch what changes, until there are all edits of both."""
    told, fetched = 0, 0
    for event in stream:
        if isinstance(event, Edits):
            told += len(event.edits)
        elif isinstance(event, Refresh):
            meshes = list(client.chunks(world, event.keys, min_revision=event.revision))
            fetched += len(meshes)  # a game draws these now, all at once
            stream.shown(event)
        if stream.revision >= 2 * options.edits and stream.are_chunks_current:
            break
    return f"{told} edits of others, {fetched} chunks fetched, known up to revision {stream.revision}"


def play(client: Client, world: WorldDescriptor, name: str, radius: float) -> None:
    """Be one player: one thread digs, this one looks on."""
    with client.stream(world, name) as stream:
        stream.show(*KEYS)
        both.wait(10.0)
        digging = threading.Thread(target=dig, args=(stream, radius))
        digging.start()
        seen = look_on(client, world, stream)
        digging.join()
    print(f"{name}: {seen}")


with Client(options.url) as client:
    world = client.create_world(f"players-{secrets.token_hex(4)}", seed=42, recipe="hills", lods=3)
    players = [
        threading.Thread(target=play, args=(client, world, name, r)) for name, r in (("ann", 12.0), ("bob", 20.0))
    ]
    for player in players:
        player.start()
    for player in players:
        player.join()
    print(f"{len(list(client.edits(world)))} edits in the log")
    client.delete_world(world.id)
