"""Commands that are imported when they are asked for, and failures that are one line.

`chunkserver --help` and `recipe list` need neither Numba nor the web stack, which take seconds to import. So imports
are delayed in one place, `load`: the only one that `tests/house` allows.

Exit codes: 0; 1, it could not be done; 2, what was asked for cannot be; 130, Ctrl-C. If nobody reads a pipe any more,
nothing is said.
"""

import importlib
import sys
from collections.abc import Iterator, Mapping
from types import ModuleType
from typing import Any, ClassVar, Final

import typer
import typer.core
import typer.main

from chunkserver.commands.saying import FAILED, MISUSED
from chunkserver.errors import BadRequest, BadSetting, ChunkError

ROOM: Final = "chunkserver.commands"


def load(module: str) -> ModuleType:
    """Import a module of ours by its whole name: for what only some calls of a command need, and takes long."""
    return importlib.import_module(module)


class _Loaded(Mapping[str, Any]):
    """Commands by name, each made when it is looked up, from `app` in the module of that name."""

    def __init__(self, names: Mapping[str, str]) -> None:
        self._names = names

    def __getitem__(self, name: str) -> Any:
        if name not in self._names:
            raise KeyError(name)
        command = typer.main.get_command(load(f"{ROOM}.{name}").app)
        command.name = name
        return command

    def __iter__(self) -> Iterator[str]:
        return iter(self._names)

    def __len__(self) -> int:
        return len(self._names)


class Commands(typer.core.TyperGroup):
    """The program. A subclass has the table: `names` maps each command to the line that `--help` has for it."""

    names: ClassVar[Mapping[str, str]] = {}

    def __init__(self, **attributes: Any) -> None:
        super().__init__(**attributes)
        self.commands = _Loaded(self.names)  # type: ignore[assignment]

    def list_commands(self, ctx: Any) -> list[str]:
        """Return the names, without a look at the commands."""
        del ctx
        return list(self.names)

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write the list of `--help`, from the table alone."""
        self._list_only()
        super().format_commands(ctx, formatter)

    def shell_complete(self, ctx: Any, incomplete: str) -> Any:
        """Return what the shell may go on with, from the table alone."""
        self._list_only()
        return super().shell_complete(ctx, incomplete)

    def _list_only(self) -> None:
        self.commands = {name: typer.core.TyperCommand(name, help=line) for name, line in self.names.items()}

    def main(self, *arguments: Any, **options: Any) -> Any:
        """Run what is typed, then end. A fault of ours has its traceback; all else is one line."""
        try:
            code = super().main(*arguments, **{**options, "standalone_mode": False})
        except typer.TyperException as error:
            _end(_sentence(error), error.exit_code)
        except typer.Abort:
            _end("given up", FAILED)
        except (BadRequest, BadSetting) as error:
            _end(error.message, MISUSED)
        except ChunkError as error:
            _end(error.message, FAILED)
        sys.exit(code)


def _sentence(error: typer.TyperException) -> str:
    """Return what was typed wrong in one line, and where help is. What is longer is help itself."""
    text = error.format_message().replace("Value error, ", "")
    if "\n" in text:
        return text
    cause: Any = error.__cause__  # pydantic's, if a value has the wrong type: its text may not name the value
    value = repr(cause.errors()[0]["input"]) if hasattr(cause, "errors") else ""
    given = "" if value in text else f", not {value}"
    context: Any = getattr(error, "ctx", None)
    see = f": see {context.command_path} --help" if context else ""
    return f"{text.rstrip('.')}{given}{see}"


def _end(why: str, code: int) -> None:
    typer.echo(why, err=True)
    sys.exit(code)
