"""What the checks of the house read and how they answer.

A check is a pure function over the path and the text of a file. It returns findings, each of which begins with
`path:line`; that makes it easy to feed it a bad example and see it fail.
"""

import ast
import asyncio
import subprocess
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

ROOT = Path(__file__).parents[2]

Function = ast.FunctionDef | ast.AsyncFunctionDef
FUNCTION = (ast.FunctionDef, ast.AsyncFunctionDef)

DICTATED = frozenset(name for name in dir(asyncio.Protocol) if not name.startswith("_"))
"""Names of methods that a protocol of asyncio dictates and explains: `data_received`, `connection_lost`, ..."""


def texts(*patterns: str) -> dict[str, str]:
    """Return path and text of each file that matches one of git's `patterns`: tracked, or new and not ignored."""
    command = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard", "--", *patterns]
    listed = subprocess.run(command, cwd=ROOT, check=True, stdout=subprocess.PIPE).stdout.decode()
    files = {path: ROOT / path for path in listed.split("\0") if path}
    contents = {path: file.read_bytes() for path, file in files.items() if file.is_file()}
    return {path: content.decode() for path, content in contents.items() if b"\0" not in content}


def holds(check: Callable[[str, str], Iterable[str]], *patterns: str) -> None:
    """Assert that `check` finds nothing in all the files that `patterns` match."""
    __tracebackhide__ = True
    nothing([finding for path, text in texts(*patterns).items() for finding in check(path, text)])


def nothing(findings: list[str]) -> None:
    """Assert that there are no findings; the message has a line for each, however many there are."""
    __tracebackhide__ = True
    assert not findings, "\n".join(["", *findings])


def functions(text: str) -> Iterator[Function]:
    """Yield every function of a source, methods and nested ones too."""
    return (node for node in ast.walk(ast.parse(text)) if isinstance(node, FUNCTION))


def module(path: str) -> str:
    """Return the dotted name of the module at `path`; a package's is that of its `__init__`."""
    return path.removesuffix(".py").removesuffix("/__init__").replace("/", ".")
