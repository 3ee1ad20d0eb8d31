"""What kernels are made of: `chunkserver.kernel` names the folder of compiled code after all of it and nothing else."""

import ast
from pathlib import PurePath

from chunkserver.kernel import NOT_COMPILED
from tests.house.checkout import module, texts

COMPILERS = {"kernel", "inlined", "spliced"}


def imports(text: str) -> set[tuple[str, str]]:
    """Return (module, name) of each name that a source imports from a module."""
    origins = [node for node in ast.walk(ast.parse(text)) if isinstance(node, ast.ImportFrom)]
    return {(node.module or "", alias.name) for node in origins for alias in node.names}


def read(text: str, known: set[str]) -> set[str]:
    """Return which of the modules `known` a source reads; of a package from which it takes a module, the module."""
    return {whole if (whole := f"{origin}.{name}") in known else origin for origin, name in imports(text)} & known


def ingredients(sources: dict[str, str]) -> set[str]:
    """Return the modules, among `sources` by dotted name, that those with kernels read, directly or not."""
    reads = {name: read(text, set(sources)) for name, text in sources.items()}
    waiting = {name for name, text in sources.items() if COMPILERS & {taken for _, taken in imports(text)}}
    known: set[str] = set()
    while waiting:
        known |= waiting
        waiting = set().union(*(reads[name] for name in waiting)) - known
    return known


def left_out(names: set[str]) -> list[str]:
    """Return those of `names` that the folder's digest does not cover."""
    paths = [PurePath(path).with_suffix("") for path in NOT_COMPILED if path not in ("__init__.py", "errors.py")]
    return sorted(name for name in names if any(PurePath(*name.split(".")[1:]).is_relative_to(path) for path in paths))


def test_no_kernel_is_made_of_what_its_folder_is_not_named_after():
    sources = {module(path): text for path, text in texts("chunkserver/*.py").items()}
    found = ingredients(sources)
    assert {"chunkserver.field.interpreter", "chunkserver.mesher.marching_cubes", "chunkserver.field.ops"} <= found
    assert not left_out(found)


def test_finds_a_constant_of_a_recipe_in_a_kernel():
    sources = {
        "chunkserver.field.a": "from chunkserver.kernel import kernel\nfrom chunkserver.field.b import LIMIT",
        "chunkserver.field.b": "from chunkserver.recipe import LIMIT",
        "chunkserver.recipe": "",
        "chunkserver.field.c": "from chunkserver.recipe import nodes",
    }
    assert left_out(ingredients(sources)) == ["chunkserver.recipe"]


def test_finds_a_part_of_a_room_that_is_left_out():
    assert left_out({"chunkserver.wire.reading.native", "chunkserver.wire.native"}) == [
        "chunkserver.wire.reading.native"
    ]
