import os
import random
import resource
import signal
from contextlib import contextmanager
from itertools import pairwise

import lmdb
import pytest

from chunkserver.errors import StoreError, StoreFull
from chunkserver.mesh import EMPTY
from chunkserver.pipeline import Chunk
from chunkserver.server.chunk_file import FILE_NAME, WRITE_PART, TornEntry, claim, give_back, open_claimed

MIB = 1 << 20


def key(number):
    return number.to_bytes(16, "little")


def surface(size=1000):
    return Chunk("surface", os.urandom(size), size << 40)


def names(folder):
    return sorted(path.name for path in folder.iterdir())


@contextmanager
def opened(folder, bytes_max=4 * MIB, whole=True):
    """Yield the file in a folder; leave it as a server that closes it, or as one that is killed."""
    lock = claim(folder)
    file = open_claimed(folder, bytes_max, lock)
    try:
        yield file
    finally:
        file.close()
        give_back(lock, whole=whole)


@contextmanager
def edited(folder):
    """Yield the bytes of the file, and write them back."""
    path = folder / FILE_NAME
    content = bytearray(path.read_bytes())
    yield content
    path.write_bytes(content)


def leaves(content):
    """Return where LMDB's leaf pages begin, those included that are not in use any more."""
    return [page for page in range(0, len(content), 4096) if content[page + 8 : page + 12] == b"\0\0\2\0"]


def test_what_was_written_is_read_also_after_a_restart(tmp_path):
    chunks = {key(size): surface(size) for size in (0, 1, 100, 2000, 4096, 60_000)}
    chunks |= {key(10**6 + number): Chunk(content, b"header") for number, content in enumerate(EMPTY)}
    with opened(tmp_path) as file:
        file.write([*chunks.items()])
        assert {name: file.read(name) for name in chunks} == chunks
        assert file.read(key(2)) is None
        assert file.entries == len(chunks)
        before = file.bytes
    with opened(tmp_path) as file:
        assert {name: file.read(name) for name in chunks} == chunks
        assert (file.entries, file.bytes, file.evicted) == (len(chunks), before, 0)


def test_deletes_and_overwrites(tmp_path):
    with opened(tmp_path) as file:
        first, second = surface(), surface()
        file.write([(key(1), first), (key(2), first), (key(1), second)])
        file.write([(key(2), None), (key(3), None)])
        assert (file.read(key(1)), file.read(key(2)), file.entries) == (second, None, 1)


def test_the_oldest_written_go_first_and_the_file_keeps_its_bound(tmp_path):
    bytes_max, count, sizes = 8 * MIB, 400, random.Random(1)
    with opened(tmp_path, bytes_max) as file:
        written = {}
        for number in range(count):
            written[key(number)] = surface(sizes.choice((100, 3000, 30_000, bytes_max // WRITE_PART - 1000)))
            file.write([(key(number), written[key(number)])])
            assert file.bytes <= bytes_max * 7 // 8
        kept = [file.read(name) for name in written]
        assert file.entries + file.evicted == count
        assert kept[-file.entries :] == [*written.values()][-file.entries :]
        assert kept[: -file.entries] == [None] * file.evicted
        assert sum(map(len, (chunk.body for chunk in kept if chunk))) > bytes_max // 2
    assert sum(len(chunk.body) for chunk in written.values()) > 3 * bytes_max
    assert (tmp_path / FILE_NAME).stat().st_size <= bytes_max


def test_each_damaged_byte_of_an_entry_is_noticed(tmp_path):
    body = b"a body which is nowhere else"
    with opened(tmp_path) as file:
        file.write([(key(1), Chunk("rock", body))])
    place = (tmp_path / FILE_NAME).read_bytes().index(body)
    for byte in range(place - 5, place + len(body)):  # checksum, content, body
        flip = 1 << byte % 8
        with edited(tmp_path) as content:
            content[byte] ^= flip
        with opened(tmp_path) as file, pytest.raises(TornEntry):
            file.read(key(1))
        with edited(tmp_path) as content:
            content[byte] ^= flip
    with opened(tmp_path) as file:
        assert file.read(key(1)) == Chunk("rock", body)


def test_an_entry_under_the_key_of_another_is_noticed(tmp_path):
    with opened(tmp_path) as file:
        file.write([(key(1), surface())])
    with edited(tmp_path) as content:
        place = content.index(key(1))
        while place >= 0:
            content[place : place + 16] = key(2)
            place = content.find(key(1))
    with opened(tmp_path) as file:
        assert file.read(key(1)) is None
        with pytest.raises(TornEntry):
            file.read(key(2))


def test_a_cut_entry_is_noticed(tmp_path):
    with opened(tmp_path) as file:
        file.write([(key(number), surface()) for number in range(6)])
    environment = lmdb.open(str(tmp_path / FILE_NAME), subdir=False, max_dbs=2)
    with environment.begin(environment.open_db(b"chunks"), write=True) as txn:
        whole = txn.get(key(0), b"")
        for number, length in enumerate((0, 1, 4, 5, 6, len(whole) - 1)):
            txn.put(key(number), whole[:length])
    environment.close()
    with opened(tmp_path) as file:
        for number in range(6):
            with pytest.raises(TornEntry):
                file.read(key(number))


def test_what_is_larger_than_the_file_is_refused(tmp_path):
    with opened(tmp_path, MIB) as file:
        for number in range(5):
            with pytest.raises(StoreFull, match=FILE_NAME):
                file.write([(key(number), surface(2 * MIB))])
            assert file.read(key(number)) is None
        for number in range(10, 50):
            file.write([(key(number), surface(MIB // WRITE_PART))])
        assert file.entries > 10
        assert not file.ruined


def test_a_full_disk_goes_by(tmp_path):
    """The operating system refuses to make the file longer."""
    with opened(tmp_path, 64 * MIB) as file:
        first, second = surface(100_000), surface(100_000)
        file.write([(key(1), first)])
        _, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
        was = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, ((tmp_path / FILE_NAME).stat().st_size + 8192, hard))
        try:
            for _ in range(3):
                with pytest.raises(StoreError, match=FILE_NAME):
                    file.write([(key(2), second)])
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, (hard, hard))
            signal.signal(signal.SIGXFSZ, was)
        assert (file.read(key(1)), file.read(key(2)), file.ruined) == (first, None, False)
        file.write([(key(2), second)])
        assert file.read(key(2)) == second
    with opened(tmp_path, 64 * MIB) as file:
        assert file.read(key(1)) == first


def test_one_server_alone(tmp_path):
    folder = tmp_path / "a" / "b"
    with opened(folder) as file:
        with pytest.raises(StoreError, match=f"^{folder} is in use") as caught:
            claim(folder)
        assert caught.value.values == {"folder": str(folder)}
        file.write([(key(1), surface())])
    with opened(folder) as file:
        assert file.entries == 1


def test_a_folder_that_cannot_be(tmp_path):
    taken = tmp_path / "taken"
    taken.write_text("a file")
    with pytest.raises(StoreError, match=f"^{taken} cannot be used"):
        claim(taken)


def test_a_file_that_cannot_be(tmp_path):
    (tmp_path / FILE_NAME).mkdir()
    lock = claim(tmp_path)
    with pytest.raises(StoreError, match=f"^{tmp_path} cannot be used"):
        open_claimed(tmp_path, MIB, lock)
    give_back(lock, whole=False)


def starts_empty(folder, caplog, reason, bytes_max=4 * MIB):
    caplog.clear()
    with opened(folder, bytes_max) as file:
        assert file.entries == 0
        file.write([(key(1), surface())])
        assert file.read(key(1)) is not None
    assert [record.getMessage() for record in caplog.records] == [f"{folder}: {reason}: the disk cache starts empty"]
    caplog.clear()
    with opened(folder, bytes_max) as file:
        assert file.entries == 1
    assert not caplog.records


@pytest.mark.parametrize("content", [b"x", b"not a database " * 1000, bytes(8192)])
@pytest.mark.parametrize("whole", [True, False])
def test_what_is_no_file_of_lmdb_is_replaced(tmp_path, caplog, content, whole):
    with opened(tmp_path, whole=whole):
        pass
    (tmp_path / FILE_NAME).write_bytes(content)
    lock = claim(tmp_path)
    file = open_claimed(tmp_path, 4 * MIB, lock)
    assert file.entries == 0
    file.close()
    give_back(lock, whole=True)
    assert len(caplog.records) == 1
    assert caplog.records[0].getMessage().endswith(": the disk cache starts empty")


def test_a_file_of_another_version_is_replaced(tmp_path, caplog):
    for name in ("chunks-0.mdb", "chunks-0.mdb-lock", "mine.txt"):
        (tmp_path / name).write_text("old")
    starts_empty(tmp_path, caplog, "chunks-0.mdb is of another version")
    assert names(tmp_path) == ["chunks-2.mdb", "chunks-2.mdb-lock", "chunks.lock", "mine.txt"]


def test_a_file_beyond_the_bound_is_replaced(tmp_path, caplog):
    with opened(tmp_path) as file:
        for number in range(30):
            file.write([(key(number), surface(60_000))])
        assert file.entries == 30
    starts_empty(tmp_path, caplog, f"{FILE_NAME} is larger than {MIB} bytes", MIB)


@pytest.mark.parametrize("damage", ["cut", "page number", "overlap"])
def test_pages_are_checked_after_a_server_that_was_killed(tmp_path, caplog, damage):
    with opened(tmp_path, whole=False) as file:
        for number in range(40):
            file.write([(key(number), surface(9000))])
    with opened(tmp_path, whole=False) as file:
        assert file.entries == 40
    assert not caplog.records
    with edited(tmp_path) as content:
        if damage == "cut":
            del content[len(content) // 2 :]
        else:
            for page in leaves(content):
                content[page + (0 if damage == "page number" else 12)] ^= 0x40
    lock = claim(tmp_path)
    file = open_claimed(tmp_path, 4 * MIB, lock)
    assert file.entries == 0
    file.close()
    give_back(lock, whole=True)
    assert len(caplog.records) == 1
    assert f": {FILE_NAME} is damaged: " in caplog.records[0].getMessage()


def test_a_ruined_file_is_gone_at_the_next_start(tmp_path, caplog):
    with opened(tmp_path) as file:
        file.write([(key(number), surface(500)) for number in range(40)])
    with edited(tmp_path) as content:
        for page in leaves(content):
            if key(39) in content[page : page + 4096] and key(20) not in content[page : page + 4096]:
                content[page + 10] = 0  # no kind of page
    with opened(tmp_path) as file:
        for _ in range(2):
            with pytest.raises(StoreError, match=FILE_NAME):
                file.read(key(39))
        assert file.ruined
    with opened(tmp_path) as file:
        assert (file.entries, file.ruined) == (0, False)
    assert not caplog.records


def test_numbers_of_writes_rise_over_restarts(tmp_path):
    for start in (0, 3):
        with opened(tmp_path) as file:
            for number in range(start, start + 3):
                file.write([(key(number), surface(10))])
    environment = lmdb.open(str(tmp_path / FILE_NAME), subdir=False, max_dbs=2)
    with environment.begin(environment.open_db(b"order")) as txn:
        order = list(txn.cursor())
    environment.close()
    assert [name for _, name in order] == [key(number) for number in range(6)]
    assert all(before < after for (before, _), (after, _) in pairwise(order))
