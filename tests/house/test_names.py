"""Words that say nothing: docs/CONVENTIONS.md, "Names". Whole words only: `metadata` and `database` are fine."""

import ast
import re
from collections.abc import Iterator
from pathlib import PurePath

from tests.house.checkout import DICTATED, FUNCTION, holds

BANNED = {"util", "utils", "helper", "helpers", "common", "misc", "base", "core", "manager", "handler", "data", "info"}

WORD = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|\d+")


def fault(name: str, verb_first: bool) -> str | None:
    """Return what is wrong with a name, or None. `verb_first`: it is a function's, so `process` may open it."""
    words = [word.lower() for word in WORD.findall(name)]
    if name in DICTATED or not words:
        return None
    if banned := [word for word in words if word in BANNED]:
        return f"{banned[0]!r} says nothing"
    if "process" in words[1 if verb_first else 0 :]:
        return "'process' as a noun means two things: say worker"
    if words[0] == "do" and len(words) > 1:
        return "'do_' says nothing: functions are verbs already"
    if words[-1] == "fast":
        return "'_fast' names no idea: say what makes it fast"
    return None


def empty_names(path: str, text: str) -> Iterator[str]:
    named = [(1, name, False) for name in PurePath(path).with_suffix("").parts]
    named += [
        (node.lineno, node.name, isinstance(node, FUNCTION))
        for node in ast.walk(ast.parse(text))
        if isinstance(node, (*FUNCTION, ast.ClassDef))
    ]
    for line, name, verb_first in named:
        if wrong := fault(name, verb_first):
            yield f"{path}:{line}: {name}: {wrong}"


def test_names_say_something():
    holds(empty_names, "chunkserver/*.py", "benchmarks/*.py", "clients/*.py", "pages/*.py")


def test_finds_an_empty_name():
    for path in ("chunkserver/utils.py", "chunkserver/core/cell.py", "chunkserver/field/noise_fast.py"):
        assert list(empty_names(path, "")), path
    for source in (
        "def do_sample(): ...",
        "def sample_fast(): ...",
        "def worker_process(): ...",
        "async def load_data(): ...",
        "class EditManager: ...",
        "class HTTPHandler: ...",
        "class Grid:\n    def base(self): ...",
    ):
        assert list(empty_names("chunkserver/grid.py", source)), source


def test_leaves_a_good_name_alone():
    for source in ("def process_edits(): ...", "class Metadata: ...", "def rebase(): ...", "def data_received(): ..."):
        assert not list(empty_names("chunkserver/__main__.py", source)), source
