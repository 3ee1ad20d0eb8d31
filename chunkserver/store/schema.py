"""What is in the file of worlds: what each format of it added to the one before.

A file has the formats' statements behind it, up to its own. A newer server runs those that are missing, in one
transaction, when it opens the file; an older one refuses it.

    worlds         id -> what the world is, and its epoch
    logs           epoch -> number of the world, its floor and its foundation, how many clients and keys it knows, and
                   up to which revision edits were made in another generator's terrain
    edits          world, revision -> an edit
    clients        world, client -> highest seq of the edits that were swept away, and its revision
    keys           world, revision -> the newest keys, each with its answer; stale stands in the edit until that goes
    foundations    number -> world and revision of a foundation: the one that the log names, or one that is none
    parts          foundation, name -> a part of it
    unswept        world -> one that may have rows to which nothing refers any more

A log comes and goes with its world, by triggers: nobody has to think of it. What hangs on a log that goes is left to be
swept away; a number is not used again.
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
    foundation INTEGER, clients INTEGER NOT NULL DEFAULT 0, keys INTEGER NOT NULL DEFAULT 0,
    migrated INTEGER NOT NULL DEFAULT 0
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
    world INTEGER NOT NULL, revision INTEGER NOT NULL, key TEXT NOT NULL, digest BLOB NOT NULL, stale BLOB,
    PRIMARY KEY (world, revision), UNIQUE (world, key)
) STRICT, WITHOUT ROWID;
CREATE TABLE foundations (
    number INTEGER PRIMARY KEY AUTOINCREMENT, world INTEGER NOT NULL, revision INTEGER NOT NULL, UNIQUE (world, number)
) STRICT;
CREATE TABLE parts (
    foundation INTEGER NOT NULL, name BLOB NOT NULL, content BLOB NOT NULL, UNIQUE (foundation, name)
) STRICT;
CREATE TABLE unswept (world INTEGER PRIMARY KEY) STRICT;
CREATE VIEW tails AS SELECT
    logs.world, epoch, floor, foundation, coalesce(foundations.revision, 0) AS founded, clients, keys,
    max(floor, coalesce((SELECT max(revision) FROM edits WHERE edits.world = logs.world), 0)) AS revision
FROM logs LEFT JOIN foundations ON number = foundation;
INSERT INTO logs (epoch) SELECT epoch FROM worlds ORDER BY id;
CREATE TRIGGER world_comes AFTER INSERT ON worlds BEGIN INSERT OR IGNORE INTO logs (epoch) VALUES (new.epoch); END;
CREATE TRIGGER world_goes AFTER DELETE ON worlds BEGIN DELETE FROM logs WHERE epoch = old.epoch; END;
CREATE TRIGGER log_goes AFTER DELETE ON logs BEGIN INSERT OR IGNORE INTO unswept (world) VALUES (old.world); END;
""",
)
FORMAT: Final = len(FORMATS)
