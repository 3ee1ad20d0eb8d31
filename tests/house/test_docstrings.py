"""Whatever is public says what it is. What a docstring has to say, no test can check: docs/CONVENTIONS.md, "Docstrings
of public functions".
"""

import ast
from collections.abc import Iterator

from tests.house.checkout import DICTATED, FUNCTION, holds


def public(body: list[ast.stmt]) -> Iterator[ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef]:
    """Yield the public functions and classes in a body, and those in the bodies of these classes."""
    for node in body:
        if isinstance(node, (*FUNCTION, ast.ClassDef)) and not node.name.startswith("_"):
            if node.name not in DICTATED:
                yield node
            if isinstance(node, ast.ClassDef):
                yield from public(node.body)


def silent(path: str, text: str) -> Iterator[str]:
    tree = ast.parse(text)
    if ast.get_docstring(tree) is None:
        yield f"{path}:1: the module has no docstring"
    for node in public(tree.body):
        if ast.get_docstring(node) is None:
            yield f"{path}:{node.lineno}: {node.name} has no docstring"


def test_what_is_public_has_a_docstring():
    holds(silent, "chunkserver/*.py")


def test_finds_what_is_silent():
    assert list(silent("a.py", "class A:\n    '''A.'''\n    def f(self): ...\n    def _g(self): ...")) == [
        "a.py:1: the module has no docstring",
        "a.py:3: f has no docstring",
    ]
    assert not list(silent("a.py", "'''A.'''\nclass _A:\n    def f(self): ..."))
    assert not list(silent("a.py", "'''A.'''\nclass A:\n    '''A.'''\n    def connection_lost(self, error): ..."))
    assert not list(silent("a.py", "'''A.'''\ndef f():\n    '''F.'''\n    def g(): ..."))
