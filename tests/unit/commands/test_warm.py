import pytest

from chunkserver import worker
from chunkserver.commands import warm
from chunkserver.worker import Warmth
from tests.unit.commands.edited import plane
from tests.unit.commands.typed import refused, run


@pytest.mark.parametrize(("compiled", "said"), [(12, "compiled 12 functions (3.5 s)"), (0, "compiled already (3.5 s)")])
def test_warm_says_what_it_did(monkeypatch, compiled, said):
    monkeypatch.setattr(worker, "warm", lambda: Warmth("digest", compiled, 3.5))
    assert said in run("warm").stdout


def test_a_command_that_compiles_says_so_before(monkeypatch, capsys, tmp_path):
    said = []
    monkeypatch.setattr(worker, "warm", lambda: said.append(capsys.readouterr()))
    for folder in (tmp_path, tmp_path / "none"):
        monkeypatch.setattr(warm, "CACHE_DIR", folder)
        warm.make_ready()
    assert said == [("", ""), ("", "the kernels are compiled, once for this version: half a minute\n")]


@pytest.mark.parametrize("words", [("warm",), ("verify", "--data", "d")])
def test_no_place_for_compiled_code_is_one_line(monkeypatch, tmp_path, words):
    def warmed():
        raise PermissionError(13, "Permission denied")

    plane(tmp_path / "d")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(worker, "warm", warmed)
    assert "Permission denied. CHUNKSERVER_CACHE_DIR names a folder" in refused(1, *words)
