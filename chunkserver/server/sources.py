"""Where settings come from: flags, then variables, then a file, then defaults. What none of them knows is refused.

--port 8001    CHUNKSERVER_PORT=8001    port = 8001    8000
    flags   >       variables        >     a file   >  defaults
"""

import difflib
import os
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from pydantic import ValidationError
from pydantic_core import ErrorDetails
from pydantic_settings import EnvSettingsSource, TomlConfigSettingsSource

from chunkserver.errors import BadSetting
from chunkserver.server.settings import PREFIX, Settings

CONFIG: Final = f"{PREFIX}CONFIG"
"""Names the file."""
OTHER_VARIABLES: Final = (CONFIG, f"{PREFIX}CACHE_DIR")
"""What is no setting of a server: the file, and where compiled code lives."""
DEFAULT: Final = "default"
VALUE_CHARS_MAX: Final = 100
"""Of a bad value that is repeated."""


def choose(flags: Mapping[str, object], config: Path | None = None) -> tuple[Settings, dict[str, str]]:
    """Return what the command line, the environment and a file say together; and of each setting where it comes from:
    a flag, a variable, a key in a file, or `DEFAULT`.

    flags: by the names of settings. config: the file; None if a variable may name it.

    Raises `BadSetting`, whose message has a line for each fault: it names the flag, the variable or the key.
    """
    known = [*OTHER_VARIABLES, *map(variable, Settings.model_fields)]
    _refuse_unknown((name for name in os.environ if name.startswith(PREFIX)), known, "variable")
    named = os.environ.get(CONFIG)
    file = config or (Path(named) if named else None)
    values: dict[str, Any] = {}
    origins = dict.fromkeys(Settings.model_fields, DEFAULT)
    for layer, spelled in (
        (_read(file) if file else {}, lambda name: f"{name} in {file}"),
        (EnvSettingsSource(Settings)(), variable),
        (flags, flag),
    ):
        values |= layer
        origins |= {name: spelled(name) for name in layer}
    try:
        return Settings(**values), origins
    except ValidationError as error:
        raise BadSetting("\n".join(_sentence(fault, origins) for fault in error.errors())) from None


def variable(name: str) -> str:
    """Return the variable of the setting `name`."""
    return PREFIX + name.upper()


def flag(name: str) -> str:
    """Return the flag of the setting `name`."""
    return f"--{name.replace('_', '-')}"


def _read(file: Path) -> dict[str, Any]:
    try:
        with file.open("rb"):
            found = TomlConfigSettingsSource(Settings, file)()
    except OSError as error:
        raise BadSetting(f"{file} cannot be read: {error.strerror}", file=str(file)) from error
    except ValueError as error:
        raise BadSetting(f"{file} is no TOML: {error}", file=str(file)) from error
    _refuse_unknown(found, list(Settings.model_fields), f"setting in {file}")
    return found


def _refuse_unknown(names: Iterable[str], known: Sequence[str], what: str) -> None:
    unknown = sorted(set(names) - set(known))
    if unknown:
        sentences = (f"there is no {what} named {name}{_nearest(name, known)}" for name in unknown)
        raise BadSetting("\n".join(sentences), names=unknown)


def _nearest(name: str, known: Sequence[str]) -> str:
    found = difflib.get_close_matches(name, known, 1)
    return f"; is {found[0]} meant?" if found else ""


def _sentence(fault: ErrorDetails, origins: Mapping[str, str]) -> str:
    """Return what is wrong with which value. A key is not repeated: by mistake it may be the secret itself."""
    why = str(fault.get("ctx", {}).get("error", fault["msg"]))
    if not fault["loc"]:
        return why  # about settings that do not agree with each other
    name = str(fault["loc"][0])
    value = "" if Settings.model_fields[name].repr is False else f" is {fault['input']!r:.{VALUE_CHARS_MAX}}"
    return f"{origins[name]}{value}: {why[:1].lower()}{why[1:]}"
