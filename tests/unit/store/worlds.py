"""Worlds to keep, and what others do to the file that keeps them."""

import apsw
import pytest

from chunkserver.errors import StoreError
from chunkserver.recipe import WorldRecipe, builtin
from chunkserver.store import Store
from chunkserver.store.sqlite import FILE_NAME
from chunkserver.world import World

TERRAIN = builtin("terrain")


def world(name="a", seed=42, source=TERRAIN, **values):
    return World(id=name, recipe=WorldRecipe(seed, source), recipe_name="terrain", generator="0123", **values)


def edited(folder, *statements):
    """What another program does to the file."""
    connection = apsw.Connection(str(folder / FILE_NAME))
    for statement in statements:
        connection.execute(statement)
    connection.close()


def refused(folder, *words):
    """The catalogue does not open, says why, and gives the folder back."""
    before = (folder / FILE_NAME).read_bytes()
    for _ in range(2):
        with pytest.raises(StoreError) as caught:
            Store(folder)
        assert str(folder / FILE_NAME) in caught.value.message
        for word in words:
            assert word in caught.value.message
    assert (folder / FILE_NAME).read_bytes() == before, "what is not understood is not written to"
