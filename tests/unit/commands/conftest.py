"""No variable of the machine that the tests run on is a setting here, and no log is set up twice."""

import pytest

from chunkserver.server import Settings, log_format
from chunkserver.server.sources import CONFIG, variable


@pytest.fixture(autouse=True)
def _no_variables(monkeypatch):
    for name in (CONFIG, *map(variable, Settings.model_fields)):
        monkeypatch.delenv(name, raising=False)


@pytest.fixture(autouse=True)
def installed(monkeypatch):
    """How the command line has the log written."""
    found = []
    monkeypatch.setattr(log_format, "install", lambda *chosen: found.append(chosen))
    return found
