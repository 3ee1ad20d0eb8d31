import pytest

from chunkserver import worker
from chunkserver.worker import Warmth
from tests.unit.commands.typed import run


@pytest.mark.parametrize(("compiled", "said"), [(12, "compiled 12 functions (3.5 s)"), (0, "compiled already (3.5 s)")])
def test_warm_says_what_it_did(monkeypatch, compiled, said):
    monkeypatch.setattr(worker, "warm", lambda: Warmth("digest", compiled, 3.5))
    assert said in run("warm").stdout
