import json
import time
from contextlib import closing

import numpy as np
import pytest

from chunkserver.edits import Bricks, Edit
from chunkserver.recipe import WorldRecipe, builtin
from chunkserver.store import Store
from chunkserver.world import World
from tests.unit.commands.typed import refused, run

CELLS, LODS = 16, 3


def ball(x, y=0.0, z=0.0, **more):
    return {"op": "carve", "shape": "sphere", "center": [x, y, z], "radius": 4, **more}


def text(*strokes, **more):
    return json.dumps({"strokes": strokes, **more})


@pytest.fixture
def folder(tmp_path):
    """A folder with one world."""
    options = ("--recipe", "plane", "--cells", CELLS, "--lods", LODS)
    assert run("world", "create", "w", *options, "--data", tmp_path / "d").exit_code == 0
    return tmp_path / "d"


def edit(folder, *words, piped=None):
    ended = run("edit", "w", *(words or ("-",)), "--data", folder, piped=piped)
    assert (ended.exit_code, ended.stderr) == (0, ""), ended.output
    return ended.stdout


def logged(folder):
    """Return the strokes and the answer of each edit that the log has."""
    with closing(Store(folder)) as store:
        return [(json.loads(one.strokes), json.loads(one.stale)) for one in store.log.read(*_first(store))]


def _first(store):
    return store.catalogue.find("w").epoch, 0


def test_one_edit_may_have_many_lines(folder, tmp_path):
    file = tmp_path / "dig.json"
    file.write_text(json.dumps(json.loads(text(ball(0), ball(9, op="fill"))), indent=4))
    assert edit(folder, file) == "w: revision 1, 2 strokes\n"
    assert edit(folder, file) == "w: revision 2, 2 strokes\n"
    strokes = [json.loads(Edit.of([ball(0), ball(9, op="fill")]).source)] * 2
    assert [found for found, _ in logged(folder)] == strokes


def test_many_edits_are_a_line_each(folder):
    piped = "\n".join([text(ball(0)), "", text(ball(9), ball(18)), text(ball(27)), ""])
    assert edit(folder, piped=piped) == "w: revisions 1 to 3, 4 strokes\n"
    assert edit(folder, piped=text(ball(3))) == "w: revision 4, 1 stroke\n"


def test_what_is_told_is_what_a_server_answers(folder):
    lines = [
        json.loads(line)
        for line in edit(folder, "-", "--json", piped=f"{text(ball(0))}\n{text(ball(0, 900))}").splitlines()
    ]
    assert [{name: line[name] for name in ("revision", "duplicate")} for line in lines] == [
        {"revision": "1", "duplicate": False},
        {"revision": "2", "duplicate": False},
    ]
    assert [line["stale"] for line in lines] == [stale for _, stale in logged(folder)]
    assert lines[0]["stale"]
    assert lines[1]["stale"] == [], "a carve in open air"


def test_what_was_dug_before_counts_for_what_is_filled_next(folder):
    fill = text(ball(0, -50, op="fill"))
    assert json.loads(edit(folder, "-", "--json", piped=fill))["stale"] == [], "all of it is rock already"
    edit(folder, piped=text(ball(0, -50)))
    assert json.loads(edit(folder, "-", "--json", piped=fill))["stale"]


def test_what_has_a_key_is_applied_once(folder):
    piped = f"{text(ball(0))}\n{text(ball(9))}"
    assert edit(folder, "-", "--key", "dig", piped=piped) == "w: revisions 1 to 2, 2 strokes\n"
    assert edit(folder, "-", "--key", "dig", piped=piped) == "w: 2 edits had been applied before\n"
    more = f"{piped}\n{text(ball(18))}\n{text(ball(27), key='own')}"
    assert (
        edit(folder, "-", "--key", "dig", piped=more)
        == "w: revisions 3 to 4, 2 strokes; 2 edits had been applied before\n"
    )
    assert edit(folder, piped=text(ball(27), key="own")) == "w: 1 edit had been applied before\n"
    assert edit(folder, piped=text(ball(18), key="dig-3")) == "w: 1 edit had been applied before\n"
    said = refused(2, "edit", "w", "-", "--key", "dig", "--data", folder, piped=text(ball(1)))
    assert said == "-, line 1: key 'dig' was used for another body"
    assert len(logged(folder)) == 4


@pytest.mark.parametrize(
    ("piped", "said"),
    [
        (text(ball(0, radius=-1)), "-, line 1: edit: at strokes.0.radius: "),
        (f"{text(ball(0))}\n{text(ball(0), ball(0, op='melt'))}", "-, line 2: edit: at strokes.1.op: "),
        (text(), "-, line 1: edit: at strokes: should be a list of 1 to 1000 strokes"),
        ('{"strokes": [}', "-: this is no JSON: "),
        ("[" * 100_000, "-: this is no JSON: "),
        (f"{text(ball(0))}\n{{", "-, line 2: this is no JSON: "),
        ("[]", "-, line 1: an edit is an object with strokes, and perhaps a key; this is 'list'"),
        (text(ball(0), color="red"), "this is 'strokes, color'"),
        (text(ball(0), key="a b"), "-, line 1: key is 'a b'; it has 1 to 128 visible ASCII characters"),
        (text(ball(0), key=7), "key is '7'"),
    ],
)
def test_what_cannot_be_is_named_with_its_line_and_ends_it(folder, piped, said):
    told = refused(2, "edit", "w", "-", "--data", folder, piped=piped)
    assert said in told
    before = piped.count("\n")
    assert told.endswith("; what is before it was applied: revision 1, 1 stroke") is bool(before)
    assert len(logged(folder)) == before


def test_a_file_without_edits_is_said_to_be_one(folder, tmp_path):
    (tmp_path / "empty").write_text("\n\n")
    assert refused(1, "edit", "w", tmp_path / "empty", "--data", folder) == f"{tmp_path / 'empty'} has no edit in it"
    assert "cannot be read" in refused(1, "edit", "w", tmp_path / "none", "--data", folder)


@pytest.mark.parametrize("lines", [("x" * 200,), ("{", "x" * 90, "x" * 90), (text(ball(0)), "x" * 200)])
def test_a_file_is_read_no_further_than_an_edit_may_be_long(folder, monkeypatch, lines):
    monkeypatch.setattr("chunkserver.commands.edit.EDIT_BYTES_MAX", 150)
    assert "more than 150 bytes" in refused(1, "edit", "w", "-", "--data", folder, piped="\n".join(lines))


def test_while_a_server_runs_http_is_the_way(folder):
    with closing(Store(folder)):
        said = refused(1, "edit", "w", "-", "--data", folder, piped=text(ball(0)))
    assert said.startswith(f"{folder} is in use: another server runs on it")
    assert "POST /v1/worlds/w/edits" in said
    assert logged(folder) == []


def test_a_world_of_another_generator_is_left_alone(tmp_path):
    with closing(Store(tmp_path / "d")) as store:
        recipe = WorldRecipe(0, builtin("plane"))
        store.catalogue.create(World(id="w", recipe=recipe, recipe_name="plane", generator="0123"))
    said = refused(1, "edit", "w", "-", "--data", tmp_path / "d", piped=text(ball(0)))
    assert "0123" in said
    assert "chunkserver migrate" in said
    assert "'z'" in refused(1, "edit", "z", "-", "--data", tmp_path / "d", piped="")


def test_many_edits_are_folded_on_the_way(folder, monkeypatch):
    folded = list[int]()
    apply = Bricks.apply

    def counted(bricks, edits, *given):
        folded.append(len(edits))
        return apply(bricks, edits, *given)

    for warming in ("make_ready", "warm_edits"):  # which edits a world of its own
        monkeypatch.setattr(f"chunkserver.commands.edit.{warming}", lambda: None)
    monkeypatch.setattr(Bricks, "apply", counted)
    edit(folder, piped="\n".join(text(ball(x, 0)) for x in range(150)))
    assert folded == [64, 64]
    folded.clear()
    edit(folder, piped=text(ball(7)))
    assert folded == [64, 64, 22], "what the log has is folded first"


def test_edits_of_a_file_are_what_the_same_edits_are_elsewhere(folder):
    rng = np.random.default_rng(3)
    strokes = [ball(*map(float, rng.uniform(-20, 20, 3)), op=op) for op in ("carve", "fill") * 10]
    edit(folder, piped="\n".join(map(text, strokes)))
    assert [found for found, _ in logged(folder)] == [json.loads(Edit.of([stroke]).source) for stroke in strokes]


def test_a_long_file_that_is_no_edit_is_refused_soon(folder):
    """Its lines are put together without a copy of all before them for each."""
    said, begun = "it is a text\n", time.perf_counter()
    assert "this is no JSON" in refused(2, "edit", "w", "-", "--data", folder, piped="x\n" * 300_000)
    assert "and its first line is no edit" in refused(1, "edit", "w", "-", "--data", folder, piped=said * 700_000)
    assert time.perf_counter() - begun < 10.0
