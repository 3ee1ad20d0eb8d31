import pytest

from chunkserver.server.settings import WORKERS_MAX, Settings, cores


def test_a_worker_for_each_core():
    assert Settings().workers == min(cores(), WORKERS_MAX) >= 1


def test_frozen():
    with pytest.raises(AttributeError):
        Settings().port = 1  # type: ignore[misc]
