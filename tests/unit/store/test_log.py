from contextlib import contextmanager

import apsw
import pytest

from chunkserver.errors import BadParameter, StoreFull, WorldGone
from chunkserver.store import Outcome, appending, log
from chunkserver.store.draft import EDIT_BYTES_MAX, NAME_CHARS_MAX, SEQ_MAX
from tests.unit.store.edits import A, B, bodies, draft, refusal, swept, written


def test_revisions_are_one_two_three_in_each_world(store):
    outcomes = written(store.log, draft(b"1"), draft(b"2", B.epoch), draft(b"3"))
    assert outcomes == [(1, b"stale of 1", False), (1, b"stale of 2", False), (2, b"stale of 3", False)]
    written(store.log, draft(b"4"))
    assert bodies(store.log) == [(1, b"1"), (2, b"3"), (3, b"4")]
    assert bodies(store.log, B.epoch) == [(1, b"2")]
    assert (store.log.revision(A.epoch), store.log.revision(B.epoch), store.log.floor(A.epoch)) == (3, 1, 0)


def test_an_edit_is_read_as_it_was_written(store):
    written(store.log, draft(b"\0\xff", client="c", seq=7), draft(b"", key="k"))
    first, second = store.log.read(A.epoch, 0, 9)
    assert first == (1, b"\0\xff", b"stale of \0\xff", "c", 7)
    assert second == (2, b"", b"stale of ", None, None)


def test_reading_goes_on_behind_what_was_read(store):
    written(store.log, *(draft(b"%d" % number) for number in range(1, 6)))
    assert bodies(store.log, after=2, limit=2) == [(3, b"3"), (4, b"4")]
    assert bodies(store.log, after=5) == bodies(store.log, after=99) == []
    for limit in (0, log.READ_EDITS_MAX + 1):
        with pytest.raises(BadParameter, match=f"limit is {limit}"):
            store.log.read(A.epoch, 0, limit)


def test_a_read_is_bounded_in_bytes_too(store, monkeypatch):
    written(store.log, *(draft(bytes(100)) for _ in range(5)))
    size = len(draft(bytes(100)).stale) + 100
    for bytes_max, count in ((2 * size, 2), (3 * size - 1, 2), (size - 1, 1), (1, 1)):
        monkeypatch.setattr(log, "READ_BYTES_MAX", bytes_max)
        assert len(store.log.read(A.epoch, 1)) == count


def test_who_reads_next_sees_what_was_written_since(store, monkeypatch):
    """An answer that is not read to its end, because it is large, keeps no moment of the file for others."""
    written(store.log, *(draft(bytes(100)) for _ in range(5)))
    monkeypatch.setattr(log, "READ_BYTES_MAX", 1)
    database, seen = store._database, []
    read = database.read

    @contextmanager
    def watched():
        with read() as connection:
            yield connection
        seen.append(database._reader.txn_state())  # before `EditLog.read` has returned

    monkeypatch.setattr(database, "read", watched)
    assert len(store.log.read(A.epoch, 0)) == 1
    assert seen == [apsw.SQLITE_TXN_NONE]


def test_a_seq_that_comes_again_gets_its_first_answer(store):
    first, second = written(store.log, draft(b"1", client="c", seq=3), draft(b"2", client="c", seq=5))
    again = written(store.log, draft(b"1", client="c", seq=3), draft(b"2", client="c", seq=5))
    assert again == [first._replace(duplicate=True), second._replace(duplicate=True)]
    assert written(store.log, draft(b"1", client="other", seq=3)) == [(3, b"stale of 1", False)]
    assert written(store.log, draft(b"1", B.epoch, client="c", seq=3)) == [(1, b"stale of 1", False)]
    assert (store.log.mark(A.epoch, "c"), store.log.mark(A.epoch, "nobody")) == (5, None)


def test_twice_in_one_transaction_is_once(store):
    same = draft(b"1", client="c", seq=1, key="k")
    assert [one.duplicate for one in written(store.log, same, same)] == [False, True]
    assert bodies(store.log) == [(1, b"1")]


def test_a_seq_stands_for_one_body(store):
    written(store.log, draft(b"1", client="c", seq=3))
    assert "seq 3 of client 'c' was used for another body" in refusal(store.log, draft(b"2", client="c", seq=3)).message


def test_a_seq_that_was_left_out_is_no_duplicate(store):
    written(store.log, draft(b"1", client="c", seq=1), draft(b"3", client="c", seq=3))
    refused = refusal(store.log, draft(b"2", client="c", seq=2))
    assert isinstance(refused, BadParameter)
    assert refused.values == {"client": "c", "seq": 2, "mark": 3}


def test_a_key_that_comes_again_gets_its_first_answer(store):
    (first,) = written(store.log, draft(b"1", key="k"))
    written(store.log, draft(b"2"))
    assert written(store.log, draft(b"1", key="k")) == [first._replace(duplicate=True)]
    assert "key 'k' was used for another body" in refusal(store.log, draft(b"2", key="k")).message
    assert not written(store.log, draft(b"1", B.epoch, key="k"))[0].duplicate


def test_a_refusal_leaves_the_others_alone(store):
    written(store.log, draft(b"1", key="k"))
    outcomes = store.log.append([draft(b"2"), draft(b"3", "gone"), draft(b"4", key="k"), draft(b"5")])
    assert [type(one) for one in outcomes] == [Outcome, WorldGone, BadParameter, Outcome]
    assert bodies(store.log) == [(1, b"1"), (2, b"2"), (3, b"5")]


def test_the_newest_keys_are_kept(store, monkeypatch):
    monkeypatch.setattr(appending, "KEYS_MAX", 3)
    written(store.log, draft(b"b", B.epoch, key="0"), *(draft(b"%d" % number, key=str(number)) for number in range(5)))
    again = written(store.log, *(draft(b"%d" % number, key=str(number)) for number in (4, 3, 2)))
    assert [one.duplicate for one in again] == [True] * 3
    assert [one.duplicate for one in written(store.log, draft(b"0", key="0"))] == [False]
    assert [one.duplicate for one in written(store.log, draft(b"2", key="2"))] == [False], "it was the oldest"
    assert written(store.log, draft(b"b", B.epoch, key="0"))[0].duplicate, "each world has its own"


def test_one_client_too_many(store, monkeypatch):
    monkeypatch.setattr(appending, "CLIENTS_MAX", 2)
    written(store.log, *(draft(client=name, seq=1) for name in "ab"))
    store.log.lay(A.epoch, 2, [])
    store.log.lay(A.epoch, 2, [])
    swept(store.log)
    refused = refusal(store.log, draft(client="c", seq=1))
    assert isinstance(refused, StoreFull)
    assert refused.values == {"clients_max": 2}
    again = written(store.log, draft(client="a", seq=1), draft(client="b", seq=2), draft(), draft(epoch=B.epoch))
    assert [one.duplicate for one in again] == [True, False, False, False]
    assert written(store.log, draft(epoch=B.epoch, client="c", seq=1)), "each world has its own"


@pytest.mark.parametrize(
    ("names", "said"),
    [
        ({"client": "c"}, "both are needed"),
        ({"seq": 1}, "both are needed"),
        ({"client": "c", "seq": -1}, "seq is -1"),
        ({"client": "c", "seq": SEQ_MAX + 1}, "seq is"),
        ({"client": "", "seq": 1}, "client has 0 characters"),
        ({"key": "k" * (NAME_CHARS_MAX + 1)}, "key has 129 characters"),
        ({"key": ""}, "key has 0 characters"),
        ({"body": bytes(EDIT_BYTES_MAX)}, "the edit has"),
    ],
)
def test_what_is_no_draft(names, said):
    with pytest.raises(BadParameter, match=said):
        draft(**names)
