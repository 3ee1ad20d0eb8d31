"""Who may import whom: docs/ARCHITECTURE.md, "What may see what"."""

import ast
import graphlib
from collections.abc import Iterator
from typing import NamedTuple

from tests.house.checkout import functions, holds, module, nothing, texts

PACKAGE = "chunkserver"

LINES = (
    ("errors", "kernel", "zstd"),
    ("grid", "memory"),
    ("recipe", "mesh", "samples"),
    ("world",),
    ("field", "edits", "mesher", "wire", "store", "stream"),
    ("geometric_error",),
    ("pipeline",),
    ("worker",),
    ("server",),
    ("commands",),
    ("__main__",),
)
"""A line sees the lines above it here; the names on one line do not see each other."""

HEIGHT = {unit: height for height, line in enumerate(LINES) for unit in line}

OUTSIDE = ("server", "commands", "__main__")
ONLY_IN = {
    **dict.fromkeys(("asyncio", "fastapi", "starlette", "uvicorn", "httpx", "httpx2", "typer"), OUTSIDE),
    **dict.fromkeys(("pydantic", "pydantic_core"), ("recipe", "edits", "server")),
    **dict.fromkeys(("numba", "llvmlite"), ("kernel",)),
    "apsw": ("store",),
    **dict.fromkeys(("lmdb", "prometheus_client", "pydantic_settings"), ("server",)),
    **dict.fromkeys(("backports", "compression"), ("zstd",)),
    **dict.fromkeys(("rich", "trimesh"), ("commands",)),
    "importlib": ("commands",),
}
"""A third party's module -> the only ones of ours that may import it."""

EXPORTS_MAX = 6


class Import(NamedTuple):
    line: int
    module: str
    name: str | None
    """What is taken out of the module; None for `import module`."""


def imports(text: str) -> Iterator[Import]:
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Import):
            yield from (Import(node.lineno, alias.name, None) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            origin = "." * node.level + (node.module or "")
            yield from (Import(node.lineno, origin, alias.name) for alias in node.names)


def unit(dotted: str) -> str:
    """Return the name in LINES of a module of ours; "" for the package's own `__init__`."""
    return dotted.partition(".")[2].partition(".")[0]


def target(found: Import) -> str:
    """Return the module that an import reaches: `from chunkserver import grid` means `chunkserver.grid`."""
    return f"{PACKAGE}.{found.name}" if found.module == PACKAGE and found.name in HEIGHT else found.module


def wrong_imports(path: str, text: str) -> Iterator[str]:
    here = unit(module(path))
    if here and here not in HEIGHT:
        yield f"{path}:1: {here} stands on no line: give it a place in LINES"
        return
    for found in imports(text):
        there, outer = target(found), found.module.split(".")[0]
        if found.module.startswith("."):
            yield f"{path}:{found.line}: a relative import hides which line it crosses"
        elif here not in ONLY_IN.get(outer, (here,)):
            yield f"{path}:{found.line}: {outer} may be imported in {' and '.join(ONLY_IN[outer])} only"
        elif outer == PACKAGE and unit(there) not in ("", here):
            if not here or HEIGHT[here] <= HEIGHT.get(unit(there), len(LINES)):
                yield f"{path}:{found.line}: {here or PACKAGE} may not see {unit(there)}"
            elif there.count(".") > 1:
                yield f"{path}:{found.line}: {there} is inside {unit(there)}: import from {PACKAGE}.{unit(there)}"


def exports(text: str) -> list[str]:
    for node in ast.parse(text).body:
        if isinstance(node, ast.Assign) and any(isinstance(to, ast.Name) and to.id == "__all__" for to in node.targets):
            return list(ast.literal_eval(node.value))
    return []


def too_many_exports(path: str, text: str) -> Iterator[str]:
    names = exports(text)
    if len(names) > EXPORTS_MAX:
        yield f"{path}:1: {len(names)} exported names: at most {EXPORTS_MAX} make a deep module"


def unexported_imports(sources: dict[str, str]) -> list[str]:
    """Return each import of a name that the package it is taken from does not export."""
    exported = {module(path): exports(text) for path, text in sources.items() if path.endswith("/__init__.py")}
    return [
        f"{path}:{found.line}: {found.module} does not export {found.name}"
        for path, text in sources.items()
        for found in imports(text)
        if unit(found.module) not in ("", unit(module(path)))
        if found.name and found.name not in exported.get(found.module, (found.name,))
    ]


def hidden_imports(path: str, text: str) -> Iterator[str]:
    for function in functions(text):
        for node in ast.walk(function):
            if isinstance(node, ast.Import | ast.ImportFrom):
                yield f"{path}:{node.lineno}: import inside {function.name}: a circle in disguise"


def circles(sources: dict[str, str]) -> list[str]:
    """Return a circle of imports among `sources`, or nothing."""
    modules = {module(path): text for path, text in sources.items()}
    graph = {
        name: {
            inner if (inner := f"{found.module}.{found.name}") in modules else found.module for found in imports(text)
        }
        for name, text in modules.items()
    }
    try:
        graphlib.TopologicalSorter(graph).prepare()
    except graphlib.CycleError as error:
        return [f"a circle of imports: {' <- '.join(error.args[1])}"]
    return []


def own_import(path: str, text: str) -> Iterator[str]:
    for found in imports(text):
        if found.module.split(".")[0] == PACKAGE:
            yield f"{path}:{found.line}: a client reads docs/wire, it never imports {PACKAGE}"


def test_imports_point_down():
    holds(wrong_imports, "chunkserver/*.py")


def test_packages_are_deep():
    holds(too_many_exports, "chunkserver/*/__init__.py")


def test_packages_share_only_what_they_export():
    nothing(unexported_imports(texts("chunkserver/*.py")))


def test_no_import_hides_in_a_function():
    holds(hidden_imports, "chunkserver/*.py")


def test_no_circles():
    nothing(circles(texts("chunkserver/*.py")))


def test_clients_stand_alone():
    holds(own_import, "clients/*.py")


def found_in(path: str, text: str) -> list[str]:
    return list(wrong_imports(path, text))


def test_finds_an_import_upwards():
    assert found_in("chunkserver/grid.py", "from chunkserver.field import sample") == [
        "chunkserver/grid.py:1: grid may not see field"
    ]
    assert found_in("chunkserver/grid.py", "from chunkserver import field")
    assert found_in("chunkserver/grid.py", "import chunkserver.field")
    assert found_in("chunkserver/__init__.py", "from chunkserver.grid import ChunkKey")
    assert not found_in("chunkserver/field/noise.py", "from chunkserver.grid import ChunkKey")
    assert not found_in("chunkserver/server/app.py", "from chunkserver import __version__")


def test_finds_an_import_sideways():
    assert found_in("chunkserver/wire/gltf.py", "import os\nfrom chunkserver.mesher import extract") == [
        "chunkserver/wire/gltf.py:2: wire may not see mesher"
    ]


def test_finds_a_module_without_a_line():
    assert found_in("chunkserver/cache.py", "") == [
        "chunkserver/cache.py:1: cache stands on no line: give it a place in LINES"
    ]


def test_finds_a_relative_import():
    assert found_in("chunkserver/field/noise.py", "from . import shapes")


def test_finds_an_import_past_the_root():
    assert found_in("chunkserver/pipeline.py", "from chunkserver.field.noise import fbm") == [
        "chunkserver/pipeline.py:1: chunkserver.field.noise is inside field: import from chunkserver.field"
    ]
    assert not found_in("chunkserver/field/shapes.py", "from chunkserver.field.noise import fbm")


def test_finds_a_third_party_in_the_wrong_place():
    assert found_in("chunkserver/pipeline.py", "import asyncio") == [
        "chunkserver/pipeline.py:1: asyncio may be imported in server and commands and __main__ only"
    ]
    assert found_in("chunkserver/worker.py", "from starlette.responses import Response")
    assert found_in("chunkserver/field/noise.py", "from numba import njit")
    assert not found_in("chunkserver/recipe/world.py", "import pydantic")


def test_finds_too_many_exports():
    names = [f"name{number}" for number in range(EXPORTS_MAX + 1)]
    assert list(too_many_exports("chunkserver/field/__init__.py", f"__all__ = {names}"))
    assert not list(too_many_exports("chunkserver/field/__init__.py", f"__all__ = {names[1:]}"))


def test_finds_an_unexported_import():
    sources = {
        "chunkserver/field/__init__.py": '__all__ = ["sample"]',
        "chunkserver/field/noise.py": "from chunkserver.field import levels",
        "chunkserver/pipeline.py": "from chunkserver.field import noise, sample",
    }
    assert unexported_imports(sources) == ["chunkserver/pipeline.py:1: chunkserver.field does not export noise"]


def test_finds_a_hidden_import():
    assert list(hidden_imports("chunkserver/grid.py", "def f():\n    import os")) == [
        "chunkserver/grid.py:2: import inside f: a circle in disguise"
    ]


def test_finds_a_circle():
    circle = {
        "chunkserver/a/__init__.py": "from chunkserver.a.b import f",
        "chunkserver/a/b.py": "from chunkserver.a import g",
    }
    assert "chunkserver.a.b <- chunkserver.a" in circles(circle)[0]
    assert not circles({**circle, "chunkserver/a/b.py": "from chunkserver.a import c", "chunkserver/a/c.py": ""})


def test_finds_a_client_that_imports_the_server():
    assert list(own_import("clients/python/reader.py", "from chunkserver.wire import decode"))
