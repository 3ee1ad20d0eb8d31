"""What is in the file of worlds: what each format of it added to the one before.

A file has the formats' statements behind it, up to its own. A newer server runs those that are missing, in one
transaction, when it opens the file; an older one refuses it.
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
)
FORMAT: Final = len(FORMATS)
