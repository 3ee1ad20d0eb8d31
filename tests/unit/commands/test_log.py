import hashlib
import json
import re
import sqlite3
from contextlib import closing

import pytest

from chunkserver.commands import log_file
from chunkserver.commands.editing import EditedWorld
from chunkserver.grid import ChunkKey
from chunkserver.server import Settings
from chunkserver.store import Draft, Store
from chunkserver.store.sqlite import FILE_NAME
from chunkserver.store.writer import Writer
from tests.unit.commands.edited import ball, dig, found, logged, plane, text
from tests.unit.commands.typed import refused, run


@pytest.fixture
def folder(tmp_path):
    """A folder with one world and twelve edits."""
    plane(tmp_path / "d")
    dig(tmp_path / "d", 12)
    return tmp_path / "d"


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """The lines of such a world, exported."""
    folder = tmp_path_factory.mktemp("exported") / "d"
    plane(folder)
    dig(folder, 12)
    return exported(folder)


def said(folder, *words, piped=None):
    ended = run("log", *words, "--data", folder, piped=piped)
    assert (ended.exit_code, ended.stderr) == (0, ""), ended.output
    return ended.stdout


def exported(folder, name="w"):
    """Return the lines of an exported world."""
    ended = run("log", "export", name, "-", "--data", folder)
    assert ended.exit_code == 0, ended.output
    return ended.stdout.splitlines(keepends=True)


def ended(lines):
    """Return the lines with an end that fits them."""
    parts = sum('"part"' in line for line in lines)
    digest = hashlib.blake2b("".join(lines).encode(), digest_size=16).hexdigest()
    end = {"parts": parts, "edits": len(lines) - 1 - parts, "digest": digest}
    return [*lines, json.dumps({"end": end}) + "\n"]


def shown(folder, name="w"):
    return json.loads(run("world", "show", name, "--data", folder, "--json").stdout)


def test_the_last_edits_are_listed_in_short(folder):
    delta = {"op": "delta", "min": [-3, 4, 5], "size": [1, 2, 1], "values": "AAAAAAEAAAA="}
    capsule = {"op": "add", "shape": "capsule", "a": [0, 0, 0], "b": [1.26, 2, 3], "radius": 2.5, "strength": 1}
    box = {"op": "smooth", "shape": "box", "center": [0, 0, 0], "half_extents": [1, 2, 3], "strength": 1}
    piped = "\n".join([text(delta), text(capsule, ball(0), ball(0)), text(box)])
    run("edit", "w", "-", "--data", folder, piped=piped)
    head, *rows = [re.split("  +", line) for line in said(folder, "show", "w", "--limit", 4).splitlines()]
    assert head == ["revision", "strokes", "stale"]
    assert [row[:2] for row in rows] == [
        ["12", "carve sphere (33, 0, -11), radius 4, and 1 stroke more"],
        ["13", "delta of 1 x 2 x 1 from (-3, 4, 5)"],
        ["14", "add capsule (0, 0, 0) to (1.3, 2, 3), radius 2.5, and 2 strokes more"],
        ["15", "smooth box (0, 0, 0), half extents (1, 2, 3)"],
    ]
    assert all(re.fullmatch(r"\d+ chunks?", row[2]) for row in rows)
    assert len(said(folder, "show", "w").splitlines()) == 1 + 15
    assert [line.split()[0] for line in said(folder, "show", "w", "--after", 3, "--limit", 2).splitlines()[1:]] == [
        "4",
        "5",
    ]
    assert said(folder, "show", "w", "--after", 15).splitlines() == ["revision  strokes  stale"]


def test_all_of_it_as_json(folder):
    told = json.loads(said(folder, "show", "w", "--after", 10, "--json"))
    world = shown(folder)
    assert {name: told[name] for name in told if name != "edits"} == {
        "world": "w",
        "epoch": world["epoch"],
        "revision": "12",
        "floor": "0",
    }
    assert told["edits"] == [
        {"revision": str(revision), "strokes": json.loads(strokes), "stale": json.loads(stale)}
        for revision, strokes, stale in logged(folder)[10:]
    ]


def test_who_has_sent_an_edit_is_told(folder):
    with closing(Store(folder)) as store:
        world = store.catalogue.find("w")
        assert world is not None
        draft = Draft(
            epoch=world.epoch,
            digest=b"",
            strokes=b'[{"op":"x","shape":"y","center":[],"radius":1}]',
            stale=b"[]",
            client="ann",
            seq=7,
        )
        store.log.append([draft])
    assert said(folder, "show", "w", "--limit", 1).splitlines()[1].endswith("0 chunks  ann 7")
    (edit,) = json.loads(said(folder, "show", "w", "--limit", 1, "--json"))["edits"]
    assert (edit["client"], edit["seq"]) == ("ann", 7)
    assert '"client":"ann","seq":7,' in exported(folder)[-2]


@pytest.mark.parametrize("words", [("--limit", 0), ("--limit", 10_001)])
def test_a_limit_that_cannot_be_is_refused(folder, words):
    assert f"limit is {words[1]}" in refused(2, "log", "show", "w", *words, "--data", folder)


def test_below_the_floor_there_are_no_edits_to_show(folder):
    found(folder, 4, 9)
    assert [line.split()[0] for line in said(folder, "show", "w").splitlines()] == ["revision", *map(str, range(5, 13))]
    assert "edits up to 4" in refused(2, "log", "show", "w", "--after", 3, "--data", folder)


@pytest.mark.parametrize("foundations", [(), (5,), (4, 9), (3, 12)])
def test_what_is_exported_is_imported_elsewhere(folder, tmp_path, foundations):
    found(folder, *foundations)
    file = tmp_path / "w.ndjson"
    told = said(folder, "export", "w", file)
    start = foundations[-1] if len(foundations) > 1 else 0
    behind = " behind a foundation" if start else ""
    assert told == f"{file}: w at revision 12, {12 - start} edit{'' if start == 11 else 's'}{behind}\n"
    other = tmp_path / "other"
    assert said(other, "import", file).startswith("w is created at revision 12, epoch ")
    assert said(other, "import", file, "--id", "copy").startswith("copy is created at revision 12, epoch ")
    first, second, third = (shown(where, name) for where, name in ((folder, "w"), (other, "w"), (other, "copy")))
    assert len({world["epoch"] for world in (first, second, third)}) == 3
    alike = ("revision", "seed", "recipe", "generator", "voxel_size", "lods", "chunk_cells")
    assert all(first[name] == second[name] == third[name] for name in alike)
    assert [edit for edit in logged(folder) if edit[0] > start] == logged(other)
    assert run("verify", "--data", other).exit_code == 0
    assert exported(other)[1:-1] == exported(folder)[1:-1]
    dig(other, 1, first=12)
    dig(folder, 1, first=12)
    assert logged(other)[-1] == logged(folder)[-1], "what comes next has the same effect"


def test_the_same_world_is_not_imported_twice(folder):
    lines = exported(folder)
    before = shown(folder)
    assert "there is a world 'w' already: --id" in refused(
        1, "log", "import", "-", "--data", folder, piped="".join(lines)
    )
    assert shown(folder) == before
    assert "id is 'W'" in refused(2, "log", "import", "-", "--id", "W", "--data", folder, piped="".join(lines))


def test_a_world_of_another_generator_is_imported_only_if_that_is_said(folder):
    first, *rest = exported(folder)
    current = shown(folder)["generator"]
    lines = ended([first.replace(current, "0123"), *rest[:-1]])
    told = refused(1, "log", "import", "-", "--id", "b", "--data", folder, piped="".join(lines))
    assert "0123" in told
    assert "--other-terrain" in told
    said(folder, "import", "-", "--id", "b", "--other-terrain", piped="".join(lines))
    assert shown(folder, "b")["generator"] == current


def test_edits_that_are_imported_into_other_terrain_reach_what_they_change_there(tmp_path):
    """A carve in what was air, and is rock in the new terrain: it told nothing then."""
    plane(tmp_path / "d")
    run("edit", "w", "-", "--data", tmp_path / "d", piped=text(ball(0, 40)))
    first, *rest = exported(tmp_path / "d")
    assert '"stale":[]' in rest[0]
    header = json.loads(first)
    higher = {"op": "subtract", "a": {"op": "y"}, "b": 60}
    header["world"] |= {"generator": "0123", "recipe": higher}
    lines = ended([json.dumps(header) + "\n", *rest[:-1]])
    other, third = tmp_path / "other", tmp_path / "third"
    said(other, "import", "-", "--other-terrain", piped="".join(lines))
    said(third, "import", "-", piped="".join(exported(other)))
    for folder in (other, third):
        assert "1 edit worked out again" in run("verify", "--data", folder).stdout
        with closing(Store(folder)) as store:
            world = store.catalogue.find("w")
            assert world is not None
            edited = EditedWorld(store, world, Settings())
            assert list(edited.replay()) == [1]
            keys = [ChunkKey(0, 0, 2, 0), ChunkKey(0, 0, 9, 0)]
            assert [edited.history.last_edit(key) for key in keys] == [1, 0]


def change(lines, number, old, new):
    assert old in lines[number]
    return [*lines[:number], lines[number].replace(old, new, 1), *lines[number + 1 :]]


TAMPERED = {
    "cut at a line": lambda lines: lines[:-1],
    "cut in a line": lambda lines: [*lines[:-1], lines[-1][:20]],
    "cut in an edit": lambda lines: [*lines[:5], lines[5][:40]],
    "only the header": lambda lines: lines[:1],
    "a stroke": lambda lines: change(lines, 3, '"radius":4.0', '"radius":5.0'),
    "what was stale": lambda lines: change(lines, 3, '"lod":0', '"lod":1'),
    "an edit less": lambda lines: [*lines[:3], *lines[4:]],
    "the last edit less": lambda lines: [*lines[:-2], lines[-1]],
    "an edit twice": lambda lines: [*lines[:3], lines[2], *lines[3:]],
    "the last edit less, and an end that fits": lambda lines: ended(lines[:-2]),
    "a name": lambda lines: change(lines, 0, '"recipe_name":"plane"', '"recipe_name":"terrain"'),
    "more behind it": lambda lines: [*lines, lines[1]],
}


@pytest.mark.parametrize("name", TAMPERED)
def test_a_file_that_is_torn_or_tampered_with_makes_no_world(whole, tmp_path, name):
    lines = TAMPERED[name](whole)
    told = refused(2, "log", "import", "-", "--data", tmp_path / "e", piped="".join(lines))
    assert re.match(r"-, line \d+: ", told), told
    with closing(Store(tmp_path / "e")) as store:
        assert len(store.catalogue) == 0
        while store.log.sweep():
            pass
    with closing(sqlite3.connect(tmp_path / "e" / FILE_NAME)) as left:
        tables = ("logs", "edits", "keys", "clients", "parts", "foundations", "unswept")
        assert [left.execute(f"SELECT count(*) FROM {table}").fetchone() for table in tables] == [(0,)] * len(tables)


def without(name):
    return lambda line: {key: value for key, value in line.items() if key != name}


def within_world(**members):
    return lambda line: line | {"world": line["world"] | members}


@pytest.mark.parametrize(
    ("number", "alter", "why"),
    [
        (0, lambda _: [], "this is no JSON object"),
        (0, lambda line: line | {"chunkserver_log": 2}, "chunkserver_log is 2; this version reads 1"),
        (0, lambda _: {"strokes": []}, "chunkserver_log is None"),
        (0, within_world(id="A/b"), "id is 'A/b'"),
        (0, within_world(lods=0), "lods is 0"),
        (0, within_world(lods="3"), "lods is '3'"),
        (0, within_world(chunk_cells=True), "chunk_cells is True"),
        (0, within_world(voxel_size=None), "voxel_size is None"),
        (0, within_world(seed=str(1 << 64)), "seed"),
        (0, within_world(seed="1e3"), "1e3"),
        (0, within_world(recipe={"op": "melt"}), "recipe: at the root"),
        (0, without("revision"), "KeyError 'revision'"),
        (0, lambda line: line | {"foundation": "13"}, "foundation is 13, migrated 0, and revision 12"),
        (0, lambda line: line | {"migrated": "13"}, "migrated 13, and revision 12"),
        (0, lambda line: line | {"migrated": 3}, "'3' is no decimal number"),
        (0, lambda line: line | {"foundation": "3"}, "the foundation is 3, and 0 parts are before this"),
        (0, lambda line: line | {"revision": "9"}, "the file is not what was written"),
        (2, lambda line: line | {"revision": 2}, "revision is 2; the next one is 2"),
        (2, lambda line: line | {"strokes": []}, "edit: at strokes: should be a list"),
        (2, lambda line: line | {"strokes": [ball(0, radius=-1)]}, "edit: at strokes.0.radius"),
        (2, lambda line: line | {"stale": {}}, "stale is {}"),
        (2, lambda line: line | {"stale": [{"lod": 3, "min": [0, 0, 0], "max": [0, 0, 0]}]}, "no edit makes stale"),
        (2, lambda line: line | {"stale": [{"lod": 0, "min": [0, 0, 0], "max": [0, -1, 0]}]}, "no edit makes stale"),
        (2, lambda line: line | {"stale": [{"lod": 0, "min": [0, 0], "max": [0, 0]}]}, "no edit makes stale"),
        (2, lambda line: line | {"stale": [{"lod": 0, "min": [0, 0, 0], "max": [9**6] * 3}]}, "no edit makes stale"),
        (2, lambda line: line | {"stale": [{"lod": 0, "min": [9**20] * 3, "max": [9**20] * 3}]}, "no edit makes stale"),
        (2, lambda line: line | {"stale": [{"lod": 0.0, "min": [0, 0, 0], "max": [0, 0, 0]}]}, "no edit makes stale"),
        (2, lambda _: {"part": "", "content": ""}, "revision is None; the next one is 2"),
    ],
)
def test_what_cannot_be_is_named_with_its_line(whole, tmp_path, number, alter, why):
    lines = whole[:-1]
    lines[number] = json.dumps(alter(json.loads(lines[number]))) + "\n"
    told = refused(2, "log", "import", "-", "--data", tmp_path / "e", piped="".join(ended(lines)))
    assert told.startswith("-, line ")
    assert why in told


@pytest.mark.parametrize("line", [{"part": "?", "content": ""}, {"part": "QQ=="}, {"part": 3, "content": ""}])
def test_a_part_that_is_none_is_named(folder, tmp_path, line):
    found(folder, 4, 9)
    first, second, *rest = exported(folder)[:-1]
    lines = ended([first, second, json.dumps(line) + "\n", *rest])
    told = refused(2, "log", "import", "-", "--data", tmp_path / "e", piped="".join(lines))
    assert told.startswith("-, line 3: this is no part of a foundation")


def test_what_cannot_be_written_makes_no_world(whole, tmp_path, monkeypatch):
    """Half of it is there, and nobody finds it."""
    monkeypatch.setattr("chunkserver.commands.log.WRITTEN_AT_ONCE_MAX", 3)
    written = Writer.submit

    def submit(writer, draft):
        if b"33.0" in draft.strokes:
            raise OSError("the power is gone")
        return written(writer, draft)

    monkeypatch.setattr("chunkserver.store.writer.Writer.submit", submit)
    ended = run("log", "import", "-", "--data", tmp_path / "e", piped="".join(whole))
    assert isinstance(ended.exception, OSError)
    with closing(sqlite3.connect(tmp_path / "e" / FILE_NAME)) as left:
        assert left.execute("SELECT count(*) FROM edits").fetchone() == (11,)
    assert run("world", "list", "--data", tmp_path / "e").stdout.count("\n") == 1
    monkeypatch.setattr("chunkserver.store.writer.Writer.submit", written)
    said(tmp_path / "e", "import", "-", piped="".join(whole))
    assert exported(tmp_path / "e")[1:-1] == whole[1:-1]


def test_a_line_is_read_no_further_than_an_edit_may_be_long(tmp_path, monkeypatch):
    monkeypatch.setattr("chunkserver.commands.log.LINE_BYTES_MAX", 100)
    assert "more than 100 bytes" in refused(1, "log", "import", "-", "--data", tmp_path, piped="x" * 200)


def test_what_is_exported_is_written_as_a_whole_or_not_at_all(folder, tmp_path, monkeypatch):
    file = tmp_path / "w.ndjson"
    file.write_text("before")
    monkeypatch.setattr(log_file.LogWriter, "end", lambda _: 1 / 0)
    assert isinstance(run("log", "export", "w", file, "--data", folder).exception, ZeroDivisionError)
    assert file.read_text() == "before"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["d", "w.ndjson"]
    assert "is a folder" in refused(1, "log", "export", "w", tmp_path, "--data", folder)


def test_an_export_takes_the_place_of_no_file_of_the_folder_itself(folder, tmp_path):
    (tmp_path / "link.ndjson").symlink_to(folder / "worlds.sqlite")
    before = (folder / "worlds.sqlite").read_bytes()
    for file in (folder / "worlds.sqlite", tmp_path / "link.ndjson"):
        assert "is the server's own" in refused(1, "log", "export", "w", file, "--data", folder)
    assert (folder / "worlds.sqlite").read_bytes() == before


@pytest.mark.parametrize("words", [("show", "w"), ("export", "w", "-"), ("import", "-")])
def test_while_a_server_runs_it_says_what_else_to_do(folder, whole, words):
    with closing(Store(folder)):
        told = refused(1, "log", *words, "--data", folder, piped="".join(whole))
    assert told.startswith(f"{folder} is in use: another server runs on it. Stop it, or ")


@pytest.mark.parametrize("words", [("show", "z"), ("export", "z", "-")])
def test_an_unknown_world_is_named(folder, words):
    assert "'z'" in refused(1, "log", *words, "--data", folder)
