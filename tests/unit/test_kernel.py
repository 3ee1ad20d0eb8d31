"""Compiled code: what its digest covers, where it lies, and that a changed callee really is compiled again."""

import os
import shutil
import subprocess
import sys
from functools import partial
from pathlib import Path
from typing import Any

import numba
import numpy as np
import platformdirs
import pytest
from numpy.typing import NDArray

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
    assert folder == package.parent / "cache" / f"kernels-{digest}", "nothing is left out of so small a package"
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


def test_a_change_of_any_file_shows_but_in_the_service(tmp_path):
    """No byte of a chunk depends on the service; whatever else is new in the package is in the digest at once."""
    copy = tmp_path / "chunkserver"
    shutil.copytree(kernel.PACKAGE, copy, ignore=shutil.ignore_patterns("__pycache__"))
    before, unseen = kernel.sources_digest(copy), set()
    for path in copy.rglob("*.py"):
        source = path.read_bytes()
        path.write_bytes(source + b"\n")
        if kernel.sources_digest(copy) == before:
            unseen.add(path.relative_to(copy).as_posix())
        path.write_bytes(source)
    rooms = ("server", "store", "stream", "commands", "wire/reading")
    service = {path.relative_to(copy).as_posix() for room in rooms for path in (copy / room).rglob("*.py")}
    assert unseen == {"__init__.py", "__main__.py", "errors.py", "memory.py", "worker.py", "world.py", *service}


def test_the_cache_folder_is_the_one_chosen_or_the_users(monkeypatch, tmp_path):
    monkeypatch.setenv("CHUNKSERVER_CACHE_DIR", str(tmp_path))
    assert kernel.cache_root() == tmp_path
    monkeypatch.setenv("CHUNKSERVER_CACHE_DIR", "")
    assert kernel.cache_root() == platformdirs.user_cache_path("chunkserver")
    monkeypatch.delenv("CHUNKSERVER_CACHE_DIR")
    assert kernel.cache_root() == platformdirs.user_cache_path("chunkserver")


def aligned(n: int) -> int:
    kernel.aligned_stack()
    return n


def test_a_kernel_that_asks_for_it_has_its_stack_aligned():
    """The compiler keeps the one local variable, and all that it puts beside it, where a line of the cache begins."""
    compiled: Any = numba.njit(aligned)
    assert compiled(3) == 3
    assert all("alloca i8, align 64" in code for code in compiled.inspect_llvm().values())


ARRAYS: list[NDArray[Any]] = [np.arange(500, dtype=np.uint16), np.ones((3, 4), np.uint8)]


@pytest.fixture
def cache(tmp_path, monkeypatch):
    """A cache folder that is not there yet."""
    monkeypatch.setattr(kernel, "CACHE_DIR", tmp_path / "cache")
    return tmp_path / "cache"


def kept_or_made():
    """Return whether `ARRAYS` had to be made."""
    made = []

    def make():
        made.append(True)
        return ARRAYS

    found = kernel.kept("table", make)
    assert len(found) == len(ARRAYS)
    for array, expected in zip(found, ARRAYS, strict=True):
        assert array.dtype == expected.dtype
        assert np.array_equal(array, expected)
    return bool(made)


def test_arrays_are_made_once(cache):
    assert [kept_or_made() for _ in range(3)] == [True, False, False]
    assert [path.name for path in cache.iterdir()] == ["table.npz"]


def test_a_file_that_was_cut_off_or_overwritten_is_made_again(cache):
    assert kept_or_made()
    whole = (cache / "table.npz").read_bytes()
    for broken in (b"", whole[:1], whole[:100], whole[: len(whole) // 2], whole[:-1], bytes(200), whole[:300] * 2):
        (cache / "table.npz").write_bytes(broken)
        assert kept_or_made(), len(broken)
        assert not kept_or_made()
        assert (cache / "table.npz").read_bytes() == whole


def test_what_cannot_be_kept_is_made_all_the_same(cache, caplog):
    cache.write_bytes(b"a file where the folder should be")
    assert [kept_or_made() for _ in range(2)] == [True, True]
    assert [record.msg for record in caplog.records] == ["%s cannot be kept: %s"] * 2


def test_a_disk_that_is_full_leaves_nothing_behind(cache, monkeypatch, caplog):
    def full(path, *_):
        path.write_bytes(b"half")
        raise OSError("no space left")

    monkeypatch.setattr(np, "savez", full)
    assert [kept_or_made() for _ in range(2)] == [True, True]
    assert not list(cache.iterdir())
    assert len(caplog.records) == 2


KEEPER = """
import sys
import numpy as np
from chunkserver.kernel import kept

def make():
    print("making", flush=True)
    sys.stdin.readline()
    return [np.arange(200_000)]

print(kept("table", make)[0].sum())
"""


def test_two_that_keep_the_same_at_once(tmp_path):
    """Both have begun before either goes on: each makes it, and what the last one wrote is whole."""
    environment = {**os.environ, "CHUNKSERVER_CACHE_DIR": str(tmp_path)}
    command = [sys.executable, "-c", KEEPER]
    start = partial(
        subprocess.Popen, command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=environment
    )
    with start() as one, start() as other:
        both = (one, other)
        try:
            assert [process.stdout.readline() for process in both if process.stdout] == ["making\n"] * 2
            answers = [process.communicate("\n", timeout=SECONDS_MAX)[0] for process in both]
        finally:
            for process in both:
                process.kill()
    assert answers == ["19999900000\n"] * 2
    found = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=SECONDS_MAX, check=True)
    assert found.stdout == "19999900000\n", "kept: not made a third time"
    assert [path.name for path in tmp_path.glob("kernels-*/*")] == ["table.npz"]
