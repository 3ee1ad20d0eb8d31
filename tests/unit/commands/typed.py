"""What is typed, in this process: the whole command line, without the price of a new Python."""

from functools import cache
from typing import Any

from typer.testing import CliRunner

from chunkserver.__main__ import app
from chunkserver.worker import warm


def run(*arguments: object, piped: str | bytes | None = None, **environment: str) -> Any:
    """Return how `chunkserver` ended with these arguments: exit_code, stdout, stderr, exception."""
    _compile()
    return CliRunner().invoke(app, [str(argument) for argument in arguments], input=piped, env=environment)


def refused(code: int, *arguments: object, piped: str | bytes | None = None) -> str:
    """Return the one line that a command says of why it ends with `code`. Nothing is on stdout, and no traceback."""
    ended = run(*arguments, piped=piped)
    assert (ended.exit_code, ended.stdout) == (code, ""), (ended.exit_code, ended.output, ended.exception)
    assert ended.stderr.endswith("\n")
    assert ended.stderr.count("\n") == 1, ended.stderr
    assert isinstance(ended.exception, SystemExit)
    return str(ended.stderr[:-1])


@cache
def _compile() -> None:
    """Without compiled code the first command would say on stderr that it compiles."""
    warm()
