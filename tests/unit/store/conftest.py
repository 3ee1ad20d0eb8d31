from contextlib import closing

import pytest

from chunkserver.store import Store
from tests.unit.store.edits import A, B


@pytest.fixture
def folder(tmp_path):
    return tmp_path / "new" / "folder"


@pytest.fixture(params=["file", "memory"])
def store(request, folder):
    with closing(Store(folder if request.param == "file" else None)) as kept:
        kept.catalogue.create(A)
        kept.catalogue.create(B)
        yield kept
