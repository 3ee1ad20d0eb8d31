"""Two clients, one logic; and no client is related to the server."""

import ast
import inspect
import subprocess
import sys
from pathlib import Path

import pytest

import chunkserver_client
from chunkserver_client import AsyncClient, AsyncEditStream, Client, EditStream

ROOT = Path(__file__).parents[2]
WRITER = ROOT / "clients/python/write_async_client.py"
SOURCES = sorted([*(ROOT / "clients").rglob("*.py"), *(ROOT / "tests/client").rglob("*.py")])


def imported(source: str) -> set[str]:
    """Return the top-level packages that a source imports, wherever in it."""
    nodes = list(ast.walk(ast.parse(source)))
    names = [alias.name for node in nodes if isinstance(node, ast.Import) for alias in node.names]
    names += [node.module or "." for node in nodes if isinstance(node, ast.ImportFrom)]
    return {name.partition(".")[0] for name in names}


@pytest.mark.parametrize("path", SOURCES, ids=[str(path.relative_to(ROOT)) for path in SOURCES])
def test_clients_and_their_tests_never_import_the_server(path: Path):
    assert "chunkserver" not in imported(path.read_text(encoding="utf-8"))


def test_an_import_is_found():
    for source in (
        "import chunkserver.grid",
        "def f():\n    from chunkserver import mesh",
        "import os, chunkserver as c",
    ):
        assert "chunkserver" in imported(source)
    assert imported("import chunkserver_client\nfrom chunkserver_client import Client") == {"chunkserver_client"}


def test_the_package_loads_without_the_server():
    code = "import sys, chunkserver_client; sys.exit(any(n.split('.')[0] == 'chunkserver' for n in sys.modules))"
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60)


def test_the_async_client_is_what_the_rules_make_of_the_other():
    package = ROOT / "clients/python/chunkserver_client"
    written = package / "async_client.py"
    before = written.read_text(encoding="utf-8")
    code = f"import runpy, sys; sys.stdout.write(runpy.run_path({str(WRITER)!r})['asynchronous'](sys.stdin.read()))"
    source = (package / "client.py").read_bytes()
    made = subprocess.run([sys.executable, "-c", code], input=source, stdout=subprocess.PIPE, check=True, timeout=60)
    assert made.stdout.decode() == before


def test_both_clients_have_the_same_methods():
    names = {name for name in vars(Client) if not name.startswith("_")}
    assert names == {name for name in vars(AsyncClient) if not name.startswith("_")}
    assert len(names) == 17
    for name in names:
        one, other = getattr(Client, name), getattr(AsyncClient, name)
        assert inspect.getdoc(one) == inspect.getdoc(other)
        assert list(inspect.signature(one).parameters) == list(inspect.signature(other).parameters)
        assert inspect.iscoroutinefunction(other) or name in ("chunks", "edits", "stream")


def test_both_streams_have_the_same_methods():
    names = {name for name in vars(EditStream) if not name.startswith("_")}
    assert names == {name for name in vars(AsyncEditStream) if not name.startswith("_")} - {"submit"}
    for name in names - {"edit", "close"}:
        one, other = getattr(EditStream, name), getattr(AsyncEditStream, name)
        assert inspect.getdoc(one) == inspect.getdoc(other)
        if callable(one):
            assert inspect.signature(one) == inspect.signature(other)


def test_everything_that_is_exported_is_there_and_says_what_it_is():
    for name in chunkserver_client.__all__:
        found = getattr(chunkserver_client, name)
        assert isinstance(found, str) or inspect.getdoc(found)
