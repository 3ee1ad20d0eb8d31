"""The settings as options of commands: one for each, written from what the setting says of itself."""

import inspect
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, Final, Literal, get_args, get_origin

import typer
from pydantic.fields import FieldInfo

from chunkserver.errors import BadSetting
from chunkserver.server import log_format
from chunkserver.server.settings import Settings
from chunkserver.server.sources import CONFIG, choose, flag

MISUSED: Final = 2
"""Exit code: what is asked for cannot be."""

_CONFIG: Final = inspect.Parameter(
    "config",
    inspect.Parameter.KEYWORD_ONLY,
    default=None,
    annotation=Annotated[
        Path | None,
        typer.Option("--config", envvar=CONFIG, metavar="FILE", help="A TOML file with a key for each option here."),
    ],
)


def with_settings(*names: str) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Give a command an option for each setting in `names`, by default for all of them, and `--config`.

    It is called with the settings, where each of them comes from, and the options of its own by their names;
    what it logs is logged as they say.
    """
    options = {
        name: _option(name, field) for name, field in Settings.model_fields.items() if name in names or not names
    }

    def decorate(command: Callable[..., None]) -> Callable[..., None]:
        def run(config: Path | None, **given: Any) -> None:
            flags = {name: given.pop(name) for name in options}
            try:
                chosen = choose({name: value for name, value in flags.items() if value is not None}, config)
            except BadSetting as error:
                typer.echo(error.message, err=True)
                raise typer.Exit(MISUSED) from None
            log_format.install(chosen[0].log_format, chosen[0].log_level)
            command(*chosen, **given)

        own = list(inspect.signature(command).parameters.values())[2:]
        own = [parameter.replace(kind=inspect.Parameter.KEYWORD_ONLY) for parameter in own]
        signature = inspect.Signature([*own, _CONFIG, *options.values()])
        run.__signature__ = signature  # type: ignore[attr-defined]
        run.__annotations__ = {name: parameter.annotation for name, parameter in signature.parameters.items()}
        run.__doc__ = command.__doc__
        return run

    return decorate


def _option(name: str, field: FieldInfo) -> inspect.Parameter:
    """Return a setting's option. Its value is text here: it is read like that of a variable, and means the same."""
    default = field.get_default()
    told = f" [{default}]" if isinstance(default, str | int | float) else ""
    kind: object = str | None
    spelled = flag(name)
    if field.annotation is bool:
        kind, spelled, told = bool | None, f"{spelled}/--no-{spelled[2:]}", ""
    option = typer.Option(spelled, metavar=_metavar(name, field), help=f"{field.description}{told}")
    return inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=None, annotation=Annotated[kind, option])


def _metavar(name: str, field: FieldInfo) -> str | None:
    """Return what stands for a value: its unit, or what there is to choose from."""
    kind = field.annotation
    if kind is bool:
        return None
    if get_origin(kind) is Literal:
        return "|".join(get_args(kind))
    if get_origin(kind) is tuple:
        return "LIST"
    if Path in get_args(kind):
        return "DIR"
    unit = name.rpartition("_")[2].upper()
    return unit if unit in ("BYTES", "SECONDS") else "NUMBER" if kind is int else "TEXT"
