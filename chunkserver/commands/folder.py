"""The folder of worlds that a command is given, opened for it alone; and the world in it that is named."""

from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Annotated, Final

import typer

from chunkserver.commands.saying import end
from chunkserver.errors import BadParameter, StoreError
from chunkserver.pipeline import generator
from chunkserver.server import Settings
from chunkserver.store import Store
from chunkserver.world import World

IdArgument = Annotated[str, typer.Argument(metavar="ID", help="What URLs call the world: a-z, 0-9, _ and -.")]
JsonOption = Annotated[bool, typer.Option("--json", help="As JSON.")]

WORLDS: Final = "ask it: its worlds are at /v1/worlds, over HTTP"
"""What can be done instead, while a server has the folder."""


def folder_of(settings: Settings) -> Path:
    """Return the folder that is chosen. Raises `BadParameter` if none is."""
    if settings.data is None:
        raise BadParameter("where the worlds are kept is needed: --data DIR")
    return settings.data


@contextmanager
def opened(settings: Settings, instead: str = WORLDS, new: bool = False) -> Iterator[Store]:
    """Open the folder that is chosen. Ends the command if a server runs on it.

    instead: what can be done then, without stopping it.
    new: make the folder if there is none; otherwise `StoreError` is raised.
    """
    folder = folder_of(settings)
    try:
        store = Store(folder) if new else Store.existing(folder)
    except StoreError as error:
        if isinstance(error.__cause__, BlockingIOError):
            end(f"{error.message}. Stop it, or {instead}")
        raise
    with closing(store):
        yield store


def existing(store: Store, name: str) -> World:
    """Return the world of that id. Ends the command if there is none."""
    world = store.catalogue.find(name)
    if world is None:
        end(f"there is no world {name!r} in {store.folder}")
    return world


def check_generator(world: World) -> None:
    """End the command if this version would make other terrain of the world than the one that made it."""
    current = generator(world.recipe)
    if world.generator != current:
        message = f"world {world.id!r} was created by generator {world.generator}, and this version has {current}"
        end(f"{message}, which would make other terrain: `chunkserver migrate` moves the world to it")
