"""Worlds that another version has made move to this version's generator."""

from collections.abc import Callable, Collection
from contextlib import closing
from pathlib import Path

from chunkserver.errors import BadRecipe, StoreError
from chunkserver.recipe import WorldRecipe
from chunkserver.store.catalogue import Catalogue
from chunkserver.store.folder import Store
from chunkserver.world import WORLDS_MAX, World


def migrate(folder: Path, names: Collection[str], generator: Callable[[WorldRecipe], str]) -> list[tuple[World, str]]:
    """Move worlds in a folder to another generator: their terrain is what that makes of the recipe from now on.

    names: their ids; all worlds, if there are none.
    generator: returns the token that a world of this recipe has to have.

    Returns the worlds that had another one, as they are now, each with the token that it had. Epoch and revision stay.
    Raises `StoreError` if a server runs on the folder, if it holds no worlds or not this one, or if a recipe cannot be
    read any more. Then none has been moved.
    """
    with closing(Store.existing(folder)) as store:
        catalogue = store.catalogue
        worlds = [_existing(catalogue, name) for name in names] if names else catalogue.page("", WORLDS_MAX)
        old = {world.id: world.generator for world in worlds if world.generator != generator(world.recipe)}
        catalogue.repin({world.id: _token(world, generator) for world in worlds if world.id in old})
        return [(_existing(catalogue, name), before) for name, before in old.items()]


def _existing(catalogue: Catalogue, name: str) -> World:
    world = catalogue.find(name)
    if world is None:
        raise StoreError(f"there is no world {name!r} in {catalogue.folder}", world=name)
    return world


def _token(world: World, generator: Callable[[WorldRecipe], str]) -> str:
    try:
        _ = world.recipe.expression
    except BadRecipe as error:
        raise StoreError(f"world {world.id!r} has a recipe of which nothing can be made: {error.message}") from error
    return generator(world.recipe)
