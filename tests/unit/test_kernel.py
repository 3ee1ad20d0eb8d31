"""Compiled code: what its digest covers, where it lies, and that a changed callee really is compiled again."""

import os
import subprocess
import sys
from pathlib import Path

import platformdirs
import pytest

from chunkserver import kernel

CALLER = """
from {package}.kernel import CACHE_DIR, SOURCES_DIGEST, kernel
from {package}.callee import answer

@kernel
def caller():
    return answer() + 1

if __name__ == "__main__":
    print(caller(), SOURCES_DIGEST, CACHE_DIR, sum(caller.stats.cache_hits.values()))
"""
CALLEE = """
from {package}.kernel import kernel

@kernel
def answer():
    return {value}
"""
SECONDS_MAX = 120


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """A package of two modules, compiled by a copy of `kernel.py`."""
    folder = tmp_path / "small"
    folder.mkdir()
    (folder / "__init__.py").touch()
    (folder / "kernel.py").write_bytes(Path(kernel.__file__).read_bytes())
    (folder / "caller.py").write_text(CALLER.format(package="small"))
    (folder / "callee.py").write_text(CALLEE.format(package="small", value=41))
    return folder


def run(package: Path) -> tuple[int, str, Path, int]:
    """Return what the package's kernel answers, its digest, its folder of compiled code, and how often it was found."""
    answer = subprocess.run(
        [sys.executable, "-m", "small.caller"],
        env={**os.environ, "CHUNKSERVER_CACHE_DIR": str(package.parent / "cache")},
        cwd=package.parent,
        capture_output=True,
        text=True,
        timeout=SECONDS_MAX,
        check=True,
    )
    value, digest, folder, hits = answer.stdout.split()
    return int(value), digest, Path(folder), int(hits)


def test_a_changed_callee_is_compiled_again_and_an_unchanged_one_is_not(package):
    first = run(package)
    assert (first[0], first[3]) == (42, 0)
    again = run(package)
    assert again[:3] == first[:3]
    assert again[3] == 1
    (package / "callee.py").write_text(CALLEE.format(package="small", value=51))
    changed = run(package)
    assert (changed[0], changed[3]) == (52, 0)
    assert changed[1] != first[1]
    assert changed[2] != first[2]


def test_compiled_code_lies_in_a_folder_named_after_the_digest(package):
    _, digest, folder, _ = run(package)
    assert folder == package.parent / "cache" / f"kernels-{digest}"
    assert any(folder.rglob("*.nbi"))


def test_the_digest_covers_names_contents_and_new_files(package):
    digests = [kernel.sources_digest(package)]
    (package / "callee.py").rename(package / "renamed.py")
    digests.append(kernel.sources_digest(package))
    with (package / "renamed.py").open("a") as source:
        source.write("\n")
    digests.append(kernel.sources_digest(package))
    (package / "below").mkdir()
    (package / "below" / "new.py").touch()
    digests.append(kernel.sources_digest(package))
    assert len(set(digests)) == len(digests)


@pytest.mark.parametrize("name", kernel.NOT_IN_DIGEST)
def test_the_digest_leaves_out_what_no_byte_depends_on(package, name):
    before = kernel.sources_digest(package)
    path = package / name if name.endswith(".py") else package / name / "app.py"
    path.parent.mkdir(exist_ok=True)
    path.write_text("changed = True\n")
    assert kernel.sources_digest(package) == before


def test_the_digest_covers_every_room_that_shapes_a_chunk():
    """Each file of the package is in the digest, unless its first name is in the list of what is not."""
    names = {path.relative_to(kernel.PACKAGE).parts[0] for path in kernel.PACKAGE.rglob("*.py")}
    assert {"field", "recipe", "mesher", "wire", "grid.py", "mesh.py", "pipeline.py", "kernel.py"} <= names
    assert not {"field", "recipe", "mesher", "wire", "grid.py", "mesh.py", "pipeline.py"} & set(kernel.NOT_IN_DIGEST)


def test_the_cache_folder_is_the_one_chosen_or_the_users(monkeypatch, tmp_path):
    monkeypatch.setenv("CHUNKSERVER_CACHE_DIR", str(tmp_path))
    assert kernel.cache_root() == tmp_path
    monkeypatch.setenv("CHUNKSERVER_CACHE_DIR", "")
    assert kernel.cache_root() == platformdirs.user_cache_path("chunkserver")
    monkeypatch.delenv("CHUNKSERVER_CACHE_DIR")
    assert kernel.cache_root() == platformdirs.user_cache_path("chunkserver")
