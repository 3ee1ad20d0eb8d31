"""Everything that can go wrong, drawn once. Knows no HTTP: `server.problems` maps each class to a status.

    ChunkError
    ├── BadRequest            the caller's input; the same input fails again
    │   ├── BadKey            a chunk key outside the world
    │   ├── BadRecipe         a recipe that does not exist, parse, or stay inside its limits
    │   ├── BadStroke         an edit that cannot be read, or passes a limit
    │   └── BadParameter      any other value: a mask, a format, a size that is not built
    ├── WireError             bytes or a mesh that the wire format cannot hold
    ├── StoreError            what is kept on disk cannot be read or written
    │   ├── StoreFull         there is no room for more, on the disk or by a limit
    │   └── WorldGone         an edit for a world that is not kept here, or not any more
    ├── BadSetting            what an operator has chosen cannot be
    └── Unavailable           nothing is wrong with the request; it may be sent again
        ├── WorkerLost        the request ended more than one worker process
        ├── Overloaded        too much waits already: for the workers, or for the log of edits
        └── DeadlinePassed    the answer was not ready in time

Every error carries the values it speaks of in `values`, so that a machine can read what the message says.
"""


class ChunkError(Exception):
    """Root of the tree. `values` maps names to the offending values."""

    def __init__(self, message: str, **values: object) -> None:
        super().__init__(message)
        self.message = message
        self.values = values

    def __reduce__(self) -> tuple[object, ...]:
        """Errors cross the pipe between a worker and the server: keep the values when pickled."""
        return _rebuild, (type(self), self.message, self.values)


def _rebuild(kind: type[ChunkError], message: str, values: dict[str, object]) -> ChunkError:
    return kind(message, **values)


class BadRequest(ChunkError):
    """The caller's input is wrong; the same input fails again."""


class BadKey(BadRequest):
    """A chunk key outside the world."""


class BadRecipe(BadRequest):
    """A recipe that does not exist, does not parse or passes a limit."""

    @classmethod
    def at(cls, path: str, expected: str, **values: object) -> "BadRecipe":
        """Return the error that says what is wrong with the node at `path`, as the user would write it: `a.b`."""
        return cls(f"recipe: at {path or 'the root'}: {expected}", path=path, expected=expected, **values)


class BadStroke(BadRequest):
    """An edit that cannot be read, or passes a limit."""

    @classmethod
    def at(cls, path: str, expected: str, **values: object) -> "BadStroke":
        """Return the error that says what is wrong at `path`, as the user would write it: `strokes.3.radius`."""
        return cls(f"edit: at {path}: {expected}", path=path, expected=expected, **values)


class BadParameter(BadRequest):
    """A parameter that is malformed or names something that is not built."""


class WireError(ChunkError):
    """Bytes, or a mesh, that the wire format cannot hold."""


class StoreError(ChunkError):
    """What is kept on disk cannot be read or written, or is not ours. Nothing was changed."""


class StoreFull(StoreError):
    """There is no room for more, on the disk or by a limit. Nothing was changed."""


class WorldGone(StoreError):
    """An edit for a world that is not kept here, or not any more. Nothing was changed."""


class BadSetting(ChunkError):
    """A setting that is unknown or cannot be what it is. The message has a line for each."""


class Unavailable(ChunkError):
    """Nothing is wrong with the request; it may be sent again later."""


class WorkerLost(Unavailable):
    """The request was being built when a worker process ended, twice."""


class Overloaded(Unavailable):
    """Too much waits already: for the workers, or for the log of edits."""


class DeadlinePassed(Unavailable):
    """The answer was not ready in time."""
