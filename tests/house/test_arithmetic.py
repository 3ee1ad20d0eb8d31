"""What compiled code may compute with: docs/CONVENTIONS.md, "Numbers". A libm gives other bits on another machine."""

import ast
from collections.abc import Iterator

from tests.house.checkout import Function, functions, holds

COMPILERS = {"kernel", "inlined", "spliced"}
LIBRARIES = {"np", "numpy", "math"}
ALLOWED = {
    *("sqrt", "floor", "empty"),
    *("float32", "float64", "int8", "int32", "int64", "uint8", "uint16", "uint32", "uint64"),
}
"""What compiled code may take from numpy. Of these only sqrt and floor compute, and IEEE 754 says what."""


def is_compiled(function: Function) -> bool:
    return any(isinstance(by, ast.Name) and by.id in COMPILERS for by in function.decorator_list)


def taken(text: str) -> set[str]:
    """Return the names that a source takes out of a library: compiled code would call them bare."""
    origins = [node for node in ast.walk(ast.parse(text)) if isinstance(node, ast.ImportFrom)]
    return {alias.asname or alias.name for node in origins if node.module in LIBRARIES for alias in node.names}


def fault(node: ast.AST, bare: set[str]) -> str | None:
    """Return what in a node is not exact on every machine, or None. `bare`: the names that are libm's."""
    match node:
        case ast.Attribute(value=ast.Name(id="math" | "np" | "numpy" as library), attr=name):
            return None if library != "math" and name in ALLOWED else f"{library}.{name}"
        case ast.BinOp(op=ast.Pow()) | ast.AugAssign(op=ast.Pow()):
            return "**"
        case ast.Name(id=name) if name in bare:
            return name
    return None


def inexact(path: str, text: str) -> Iterator[str]:
    bare = taken(text) | {"pow"}
    for function in filter(is_compiled, functions(text)):
        for node in ast.walk(function):
            if wrong := fault(node, bare):
                yield f"{path}:{function.lineno}: {function.name} uses {wrong}: only + - * /, sqrt, floor, casts"


def test_compiled_code_calls_no_libm():
    holds(inexact, "chunkserver/*.py")


def test_finds_what_is_inexact():
    for body in ("np.sin(x)", "np.power(x, 3)", "np.exp(x)", "math.sqrt(x)", "x**2", "pow(x, 2)", "numpy.cos(x)"):
        for compiler in COMPILERS:
            found = list(inexact("a.py", f"@{compiler}\ndef f(x):\n    return {body}"))
            assert len(found) == 1, body
            assert found[0].startswith("a.py:2: f uses "), body
    assert list(inexact("a.py", "@kernel\ndef f(x):\n    x **= 2"))
    assert list(inexact("a.py", "from math import sin as wave\n@kernel\ndef f(x):\n    return wave(x)"))


def test_leaves_what_is_exact_alone():
    assert not list(inexact("a.py", "@kernel\ndef f(x):\n    return np.floor(np.sqrt(np.float32(x)))"))
    assert not list(inexact("a.py", "@kernel\ndef f(x):\n    return np.empty(3, np.uint32)"))
    assert not list(inexact("a.py", "def f(x):\n    return math.sin(x) ** 2"))


def rounded_sums(path: str, text: str) -> Iterator[str]:
    """Since Python 3.12 `sum` of floats is compensated: other bits than before. Counting what is true is none."""
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "sum":
            counted = node.args[0].elt if isinstance(node.args[0], ast.GeneratorExp) else None
            if not (isinstance(counted, ast.Compare) or (isinstance(counted, ast.Call) and _is_test(counted))):
                yield f"{path}:{node.lineno}: sum() of floats is not the same in every Python: use math.fsum"


def _is_test(call: ast.Call) -> bool:
    return isinstance(call.func, ast.Name) and call.func.id == "isinstance"


def test_what_makes_a_world_is_summed_exactly():
    holds(rounded_sums, "chunkserver/field/*.py", "chunkserver/recipe/*.py", "chunkserver/edits/*.py")


def test_finds_a_sum_of_floats():
    assert list(rounded_sums("a.py", "total = sum(x * x for x in v)"))
    assert list(rounded_sums("a.py", "mean = sum(v) / len(v)"))
    assert not list(rounded_sums("a.py", "n = sum(x > 0 for x in v) + sum(isinstance(x, int) for x in v)"))
