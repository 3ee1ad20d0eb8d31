import json
import sqlite3
from contextlib import closing
from itertools import product

import numpy as np
import pytest

from chunkserver.commands import verify
from chunkserver.edits import Edit
from chunkserver.edits.boxes import Box
from chunkserver.grid import ChunkKey
from chunkserver.recipe import canonical
from chunkserver.store.sqlite import FILE_NAME
from tests.strokes import delta_of, dense, no_bricks, place, random_stroke
from tests.unit.commands.edited import ball, dig, found, keep, logged, plane, text
from tests.unit.commands.typed import refused, run
from tests.unit.store.worlds import edited


@pytest.fixture
def folder(tmp_path):
    """A folder with one world and twelve edits."""
    plane(tmp_path / "d")
    dig(tmp_path / "d", 12)
    return tmp_path / "d"


def verified(folder, *names):
    ended = run("verify", *names, "--data", folder)
    assert (ended.exit_code, ended.stderr) == (0, ""), ended.output
    return ended.stdout


def test_all_worlds_of_a_folder_or_those_that_are_named(folder):
    plane(folder, "other")
    first, second = verified(folder).splitlines()
    assert first == "other: 0 edits worked out again, they make 0 bricks"
    assert second.startswith("w: 12 edits worked out again, they make ")
    assert verified(folder, "w") == f"{second}\n"
    assert "'z'" in refused(1, "verify", "z", "--data", folder)


def test_what_was_kept_is_compared(folder):
    keep(folder, 7)
    assert verified(folder).endswith("; equal to the snapshot of revision 7\n")
    found(folder, 5)
    said = verified(folder)
    assert said.startswith("w: 12 edits worked out again")
    assert "; equal to the foundation of revision 5; equal to the snapshot of revision 7\n" in said
    found(folder, 9)
    said = verified(folder)
    assert said.startswith("w: 3 edits worked out again")
    assert said.endswith("; the foundation of revision 9 is taken as it is\n"), "the snapshot is older"
    keep(folder, 12)
    assert verified(folder).endswith("; equal to the snapshot of revision 12\n")


def test_a_foundation_of_other_terrain_is_taken_as_it_is(folder, tmp_path):
    """As a server does, though all edits before it can be read."""
    found(folder, 5)
    higher = canonical({"op": "subtract", "a": {"op": "y"}, "b": 60})
    with closing(sqlite3.connect(folder / FILE_NAME)) as file, file:
        file.execute("UPDATE worlds SET source = ?, generator = '0123'", (higher,))
    assert run("migrate", "w", "--data", folder).exit_code == 0
    said = verified(folder)
    assert said.startswith("w: 7 edits worked out again")
    assert said.endswith("; the foundation of revision 5 is taken as it is\n")
    carried = run("log", "export", "w", "-", "--data", folder).stdout
    assert run("log", "import", "-", "--data", tmp_path / "other", piped=carried).exit_code == 0
    assert verified(tmp_path / "other") == said, "with the same bricks"


def brick(parts):
    """Take the first brick away."""
    del parts[min(name for name in parts if name.startswith(b"B"))]


def other_brick(parts):
    first, *_, last = sorted(name for name in parts if name.startswith(b"B"))
    parts[first] = parts[last]


def bounds(parts):
    name = min(name for name in parts if name.startswith(b"B"))
    parts[name] = bytes(8) + parts[name][8:]


def revisions(parts):
    del parts[max(name for name in parts if name.startswith(b"R"))]


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (brick, "has other deltas than the log makes in brick (0, "),
        (other_brick, "has other deltas than the log makes in brick (0, "),
        (bounds, "has other deltas than the log makes in brick (0, "),
        (revisions, "has other revisions than the log in chunks ("),
        (lambda parts: parts.update({b"x": b""}), "cannot be read: "),
    ],
)
def test_a_snapshot_that_is_another_is_named(folder, change, said):
    keep(folder, 12, change)
    assert f"w: the snapshot of revision 12 {said}" in run("verify", "--data", folder).stderr
    assert run("verify", "--data", folder).exit_code == 1


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ("DELETE FROM edits WHERE revision = 4", "w: revision 4 is missing: 5 comes next"),
        ("DELETE FROM edits WHERE revision = 1", "w: revision 1 is missing: 2 comes next"),
        (
            "UPDATE edits SET strokes = x'7b7d' WHERE revision = 3",
            "w: revision 3 cannot be applied: edit: at strokes: ",
        ),
        (
            "UPDATE edits SET strokes = CAST(' ' || CAST(strokes AS TEXT) AS BLOB) WHERE revision = 3",
            "w: revision 3: the strokes are not as an edit",
        ),
        ("UPDATE edits SET stale = x'5b5d' WHERE revision = 3", "w: revision 3 changes chunk (0, 0, -1, "),
        ("UPDATE edits SET stale = x'7b7d5d' WHERE revision = 3", "w: revision 3 cannot be applied: "),
    ],
)
def test_a_log_that_is_damaged_is_named(folder, change, said):
    edited(folder, change)
    assert refused(1, "verify", "--data", folder).startswith(said)


def test_strokes_that_are_others_make_other_deltas(folder):
    keep(folder, 12)
    strokes = Edit.of([ball(6, 0, -2, radius=4.5), ball(6, 6, 0, op="fill")]).source.hex()
    edited(folder, f"UPDATE edits SET strokes = x'{strokes}' WHERE revision = 3")
    assert refused(1, "verify", "--data", folder).startswith("w: the snapshot of revision 12 has other deltas")


def test_each_chunk_that_changes_has_to_be_told(folder):
    """Whichever range of whichever level is left out."""
    (_, _, told) = logged(folder)[0]
    ranges = json.loads(told)
    assert {each["lod"] for each in ranges} == {0, 1, 2}
    for number in range(len(ranges)):
        left = json.dumps(ranges[:number] + ranges[number + 1 :]).encode().hex()
        edited(folder, f"UPDATE edits SET stale = x'{left}' WHERE revision = 1")
        assert "w: revision 1 changes chunk (" in refused(1, "verify", "--data", folder)
    edited(folder, f"UPDATE edits SET stale = x'{told.hex()}' WHERE revision = 1")
    verified(folder)


def test_whatever_is_dug_near_the_surface_is_right(tmp_path, rng):
    plane(tmp_path / "d", recipe="terrain")
    strokes = [random_stroke(rng, (float(x), -2.0, 0.0), float(rng.uniform(2, 9))) for x in rng.uniform(-40, 40, 40)]
    ended = run("edit", "w", "-", "--data", tmp_path / "d", piped="\n".join(map(text, strokes)))
    assert ended.exit_code == 0, ended.output
    verified(tmp_path / "d")


CELLS, LODS = 16, 3
CHUNKS = {lod: 4 >> lod for lod in range(LODS)}
"""How many there are to each side of the origin, of a level."""


def test_the_chunks_that_an_edit_changes_are_found_whatever_they_read(rng):
    """Read as chunks do: their own level with its apron, and the next level as for a mask of all faces."""
    before, field = no_bricks(LODS), lambda box: np.zeros(box.shape, np.float32)
    read, levels = everything_read(before), set()
    for revision in range(1, 7):
        low = place(rng.integers(-24, 24, 3))
        after = before.apply([Edit.of([delta_of(rng, low, (3, 2, 4))])], revision, field)
        changed, read_before, read = {*verify._changed(before, after, CELLS)}, read, everything_read(after)
        assert changed == {key for key in read if read[key] != read_before[key]}
        levels |= {key.lod for key in changed}
        before = after
    assert levels == set(range(LODS))


def everything_read(bricks):
    """Return what each chunk reads."""
    side = CELLS * CHUNKS[0] + 2
    deltas = [dense(bricks, lod, Box((-side,) * 3, (side,) * 3)) for lod in range(LODS)]
    return {
        key: [
            deltas[lod][
                tuple(slice(at * step - 1 + side, at * step + step + 2 + side) for at in (key.y, key.z, key.x))
            ].tobytes()
            for lod, step in ((key.lod, CELLS), (key.lod + 1, CELLS // 2))
            if lod < LODS
        ]
        for key in (
            ChunkKey(lod, *at) for lod in range(LODS) for at in product(range(-CHUNKS[lod], CHUNKS[lod]), repeat=3)
        )
    }


def test_a_snapshot_that_is_ahead_of_the_log_is_named(folder):
    keep(folder, 12)
    edited(folder, "DELETE FROM edits WHERE revision = 12")
    assert refused(1, "verify", "--data", folder) == "w: the snapshot is of revision 12; the log ends at 11"


def test_a_folder_without_worlds_is_left_alone(tmp_path):
    assert FILE_NAME in refused(1, "verify", "--data", tmp_path / "none")
    assert not (tmp_path / "none").exists()
