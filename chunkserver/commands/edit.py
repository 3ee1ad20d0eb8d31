"""`chunkserver edit`: strokes of a file, applied to a world while no server runs on it."""

import json
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Annotated, Any, Final, NamedTuple

import typer

from chunkserver.commands.editing import SETTINGS, EditedWorld
from chunkserver.commands.files import lines
from chunkserver.commands.folder import IdArgument, check_generator, existing, opened
from chunkserver.commands.saying import counted, end, with_bar
from chunkserver.commands.warm import make_ready
from chunkserver.edits import Edit
from chunkserver.errors import BadParameter, BadStroke, ChunkError
from chunkserver.server import Settings, with_settings
from chunkserver.store import Outcome
from chunkserver.worker import warm_edits

app: Final = typer.Typer(add_completion=False, rich_markup_mode=None)

EDIT_BYTES_MAX: Final = 8 << 20
"""Of one edit as JSON: what a server takes."""

_KEY: Final = re.compile("[!-~]{1,128}")
_MEMBERS: Final = {"strokes", "key"}


class _Sent(NamedTuple):
    """An edit of a file. where: in it, for errors. key: its own, if it has one."""

    where: str
    edit: Edit
    key: str | None


@app.command()
@with_settings(*SETTINGS)
def command(
    settings: Settings,
    _origins: Mapping[str, str],
    name: IdArgument,
    file: Annotated[str, typer.Argument(metavar="FILE", help="JSON; - reads what is piped in.")],
    key: Annotated[
        str | None, typer.Option("--key", metavar="TEXT", help="Applied once, however often it is typed.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="What a server would answer, a line for each edit.")] = False,
) -> None:
    """Apply edits to a world: `{"strokes": [...]}`, or a line of that for each of many.

    Each is on the disk before it is told of. With --key the first is known by that, the n-th by KEY-n: when the same is
    typed again, those that are there already are not applied twice. The first that is refused ends it; those before it
    stay.
    """
    with opened(settings, f"post the edits to it: POST /v1/worlds/{name}/edits") as store:
        world = existing(store, name)
        check_generator(world)
        make_ready()
        warm_edits()
        edited = EditedWorld(store, world, settings)
        edited.resume()
        for _ in with_bar("edits", edited.replay(), world.revision - edited.history.revision):
            pass
        told = _Told()
        try:
            for one in _sent(file, key):
                with _at(one.where):
                    outcome = edited.write(one.edit, one.key)
                told.note(one.edit, outcome)
                if as_json:
                    typer.echo(json.dumps(_answer(outcome)))
        except ChunkError as error:
            before = f"; what is before it was applied: {told}" if told.count else ""
            raise type(error)(f"{error.message}{before}", **error.values) from None
    if not told.count:
        end(f"{file} has no edit in it")
    if not as_json:
        typer.echo(f"{name}: {told}")


class _Told:
    """What was written so far, in words. count: how many edits were told of, those that had been there included."""

    def __init__(self) -> None:
        self.count = 0
        self._known = self._strokes = self._first = self._last = 0

    def note(self, edit: Edit, outcome: Outcome) -> None:
        """Count one that is on the disk."""
        self.count += 1
        if outcome.duplicate:
            self._known += 1
        else:
            self._strokes += len(edit.strokes)
            self._first, self._last = self._first or outcome.revision, outcome.revision

    def __str__(self) -> str:
        span = f"revision {self._last}" if self._first == self._last else f"revisions {self._first} to {self._last}"
        parts = [f"{span}, {counted(self._strokes, 'stroke')}"] if self._first else []
        parts += [f"{counted(self._known, 'edit')} had been applied before"] if self._known else []
        return "; ".join(parts)


def _answer(outcome: Outcome) -> dict[str, Any]:
    """Return what a server answers."""
    stale = json.loads(outcome.stale or b"[]")
    return {"revision": str(outcome.revision), "duplicate": outcome.duplicate, "stale": stale}


def _sent(file: str, key: str | None) -> Iterator[_Sent]:
    """Yield the edits of a file. Raises `BadRequest` that says where."""
    for number, (where, value) in enumerate(_values(file), 1):
        with _at(where):
            if not isinstance(value, dict) or not {"strokes"} <= value.keys() <= _MEMBERS:
                shown = ", ".join(value) if isinstance(value, dict) else type(value).__name__
                raise BadStroke(f"an edit is an object with strokes, and perhaps a key; this is {shown[:80]!r}")
            chosen = key if key is None or number == 1 else f"{key}-{number}"
            yield _Sent(where, Edit.of(value["strokes"]), _checked(value.get("key", chosen)))


def _checked(key: object) -> str | None:
    if key is None or (isinstance(key, str) and _KEY.fullmatch(key)):
        return key
    raise BadParameter(f"key is {str(key)[:200]!r}; it has 1 to 128 visible ASCII characters")


def _values(file: str) -> Iterator[tuple[str, Any]]:
    """Yield the JSON values of a file, and where each is. They are a line each; or all of it is one."""
    found = lines(file, EDIT_BYTES_MAX)
    number, text = next(found, (0, b""))
    if not _is_json(text):
        whole = bytearray(text)
        for _, line in found:
            whole += line
            if len(whole) > EDIT_BYTES_MAX:
                end(f"{file} has more than {EDIT_BYTES_MAX:,} bytes, and its first line is no edit")
        if whole:
            yield file, _parsed(file, whole)
        return
    yield f"{file}, line {number}", json.loads(text)
    for number, line in found:
        where = f"{file}, line {number}"
        yield where, _parsed(where, line)


def _is_json(text: bytes) -> bool:
    try:
        json.loads(text)
    except (ValueError, RecursionError):
        return False
    return True


def _parsed(where: str, text: bytes | bytearray) -> Any:
    try:
        return json.loads(text)
    except (ValueError, RecursionError) as error:
        raise BadStroke(f"{where}: this is no JSON: {error}") from None


@contextmanager
def _at(where: str) -> Iterator[None]:
    """Say where, of what goes wrong."""
    try:
        yield
    except ChunkError as error:
        raise type(error)(f"{where}: {error.message}", **error.values) from None
