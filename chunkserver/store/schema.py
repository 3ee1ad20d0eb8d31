"""What is in the file of worlds: what each format of it added to the one before.

A file has the formats' statements behind it, up to its own. A newer server runs those that are missing, in one
transaction, when it opens the file; an older one refuses it.

    worlds         id -> what the world is, and its epoch
    logs           epoch -> number of the world, the floor that its foundation reaches to, how many clients it knows
    edits          world, revision -> an edit above the floor
    clients        world, client -> highest seq up to the floor, and its revision
    keys           world, number -> the newest keys, each with its answer; stale stands in the edit until that goes
    foundations    world, name -> a part of what the edits up to the floor have made

A log comes and goes with its world, by triggers: nobody has to think of it.
"""

from typing import Final

APPLICATION_ID: Final = 0x43484E4B
"""In the header of the file: no other program's file is taken for ours."""

FORMATS: Final = (
    """
CREATE TABLE worlds (
    id TEXT PRIMARY KEY, epoch TEXT NOT NULL, seed INTEGER NOT NULL, source TEXT NOT NULL, recipe_name TEXT NOT NULL,
    voxel_size REAL NOT NULL, lods INTEGER NOT NULL, chunk_cells INTEGER NOT NULL, generator TEXT NOT NULL,
    created TEXT NOT NULL
) STRICT, WITHOUT ROWID;
""",
    """
CREATE TABLE logs (
    world INTEGER PRIMARY KEY AUTOINCREMENT, epoch TEXT NOT NULL UNIQUE, floor INTEGER NOT NULL DEFAULT 0,
    clients INTEGER NOT NULL DEFAULT 0
) STRICT;
CREATE TABLE edits (
    world INTEGER NOT NULL, revision INTEGER NOT NULL, client TEXT, seq INTEGER, digest BLOB NOT NULL,
    strokes BLOB NOT NULL, stale BLOB NOT NULL, PRIMARY KEY (world, revision)
) STRICT, WITHOUT ROWID;
CREATE UNIQUE INDEX edits_by_client ON edits (world, client, seq) WHERE client IS NOT NULL;
CREATE TABLE clients (
    world INTEGER NOT NULL, client TEXT NOT NULL, seq INTEGER, revision INTEGER, PRIMARY KEY (world, client)
) STRICT, WITHOUT ROWID;
CREATE TABLE keys (
    world INTEGER NOT NULL, number INTEGER NOT NULL, key TEXT NOT NULL, digest BLOB NOT NULL,
    revision INTEGER NOT NULL, stale BLOB, PRIMARY KEY (world, number), UNIQUE (world, key)
) STRICT, WITHOUT ROWID;
CREATE TABLE foundations (
    world INTEGER NOT NULL, name BLOB NOT NULL, content BLOB NOT NULL, UNIQUE (world, name)
) STRICT;
CREATE VIEW tails AS SELECT
    world, epoch, floor, clients,
    coalesce((SELECT max(revision) FROM edits WHERE edits.world = logs.world), floor) AS revision
FROM logs;
INSERT INTO logs (epoch) SELECT epoch FROM worlds ORDER BY id;
CREATE TRIGGER world_comes AFTER INSERT ON worlds BEGIN INSERT INTO logs (epoch) VALUES (new.epoch); END;
CREATE TRIGGER world_goes AFTER DELETE ON worlds BEGIN DELETE FROM logs WHERE epoch = old.epoch; END;
CREATE TRIGGER log_goes AFTER DELETE ON logs BEGIN
    DELETE FROM edits WHERE world = old.world;
    DELETE FROM clients WHERE world = old.world;
    DELETE FROM keys WHERE world = old.world;
    DELETE FROM foundations WHERE world = old.world;
END;
""",
)
FORMAT: Final = len(FORMATS)
