from contextlib import closing, contextmanager

import apsw
import pytest

from chunkserver.errors import BadParameter, ChunkError, StoreFull, WorldGone
from chunkserver.store import Draft, EditLog, Outcome, Store, log
from tests.unit.store.worlds import world

A, B = world("a"), world("b")


@pytest.fixture(params=["file", "memory"])
def store(request, folder):
    with closing(Store(folder if request.param == "file" else None)) as kept:
        kept.catalogue.create(A)
        kept.catalogue.create(B)
        yield kept


def draft(body=b"x", epoch=A.epoch, **names):
    return Draft(epoch=epoch, digest=b"digest of " + body, strokes=body, stale=b"stale of " + body, **names)


def written(kept: EditLog, *drafts: Draft) -> list[Outcome]:
    outcomes = kept.append(drafts)
    assert not [one for one in outcomes if isinstance(one, ChunkError)]
    return [one for one in outcomes if isinstance(one, Outcome)]


def refusal(kept: EditLog, one: Draft) -> ChunkError:
    before = kept.revision(A.epoch)
    (outcome,) = kept.append([one])
    assert isinstance(outcome, ChunkError)
    assert kept.revision(A.epoch) == before
    return outcome


def bodies(kept: EditLog, epoch=A.epoch, after=0, limit=100):
    return [(edit.revision, edit.strokes) for edit in kept.read(epoch, after, limit)]


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
    monkeypatch.setattr(log, "KEYS_MAX", 3)
    written(store.log, draft(b"b", B.epoch, key="0"), *(draft(b"%d" % number, key=str(number)) for number in range(5)))
    again = written(store.log, *(draft(b"%d" % number, key=str(number)) for number in (4, 3, 2)))
    assert [one.duplicate for one in again] == [True] * 3
    assert [one.duplicate for one in written(store.log, draft(b"0", key="0"))] == [False]
    assert [one.duplicate for one in written(store.log, draft(b"2", key="2"))] == [False], "it was the oldest"
    assert written(store.log, draft(b"b", B.epoch, key="0"))[0].duplicate, "each world has its own"


def test_one_client_too_many(store, monkeypatch):
    monkeypatch.setattr(log, "CLIENTS_MAX", 2)
    written(store.log, *(draft(client=name, seq=1) for name in "ab"))
    store.log.compact(A.epoch, 1, [])
    refused = refusal(store.log, draft(client="c", seq=1))
    assert isinstance(refused, StoreFull)
    assert refused.values == {"clients_max": 2}
    again = written(store.log, draft(client="a", seq=1), draft(client="b", seq=2), draft(), draft(epoch=B.epoch))
    assert [one.duplicate for one in again] == [True, False, False, False]
    assert written(store.log, draft(epoch=B.epoch, client="c", seq=1)), "each world has its own"


def test_a_base_stands_for_the_edits_up_to_its_floor(store):
    written(store.log, *(draft(b"%d" % number) for number in range(1, 6)), draft(b"b", B.epoch))
    assert store.log.foundation(A.epoch) == (0, {})
    store.log.compact(A.epoch, 2, [(b"name", b"old"), (b"other", b"")])
    store.log.compact(A.epoch, 3, iter([(b"\0name", bytes(10_000))]))
    assert store.log.foundation(A.epoch) == (3, {b"\0name": bytes(10_000)})
    assert bodies(store.log, after=3) == [(4, b"4"), (5, b"5")]
    with pytest.raises(BadParameter, match="after is 2; edits up to 3") as caught:
        store.log.read(A.epoch, 2)
    assert caught.value.values == {"after": 2, "floor": 3}
    assert (bodies(store.log, B.epoch), store.log.foundation(B.epoch)) == ([(1, b"b")], (0, {}))


def test_revisions_go_on_behind_a_floor(store):
    written(store.log, draft(b"1"), draft(b"2"))
    store.log.compact(A.epoch, 2, [])
    assert (store.log.revision(A.epoch), store.log.floor(A.epoch), bodies(store.log, after=2)) == (2, 2, [])
    assert written(store.log, draft(b"3"))[0].revision == 3


def test_a_compaction_looks_at_each_edit_a_few_times(store):
    """However many clients there are. SQLite counts its own instructions."""
    counted = 0

    def another():
        nonlocal counted
        counted += 1
        return False

    edits = 500
    for number in range(edits):
        written(store.log, draft(client=f"c{number}", seq=number))
    store._database._writer.set_progress_handler(another, 100)
    store.log.compact(A.epoch, edits, [])
    store._database._writer.set_progress_handler(None)
    assert edits / 100 < counted < edits * 2
    assert (store.log.mark(A.epoch, "c0"), store.log.mark(A.epoch, f"c{edits - 1}")) == (0, edits - 1)


@pytest.mark.parametrize("floor", [1, 4])
def test_what_can_be_no_floor(store, floor):
    written(store.log, *(draft() for _ in range(3)))
    store.log.compact(A.epoch, 2, [(b"name", b"kept")])
    with pytest.raises(BadParameter, match=f"floor is {floor}; it lies in .2, 3."):
        store.log.compact(A.epoch, floor, [])
    assert store.log.foundation(A.epoch) == (2, {b"name": b"kept"})


def test_a_compaction_that_fails_changes_nothing(store):
    written(store.log, draft(b"1", key="k"))

    def parts():
        yield b"name", b"content"
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        store.log.compact(A.epoch, 1, parts())
    assert (store.log.foundation(A.epoch), bodies(store.log)) == ((0, {}), [(1, b"1")])
    written(store.log, draft(b"2"))


def test_seqs_and_keys_outlive_their_edits(store):
    drafts = [draft(b"1", client="c", seq=4), draft(b"2", client="c", seq=6), draft(b"3", client="d", seq=1, key="k")]
    first = written(store.log, *drafts)
    store.log.compact(A.epoch, 3, [])
    for names in ({"key": "k"}, {"key": "k", "client": "d", "seq": 1}, {"key": "k", "client": "c", "seq": 5}):
        assert written(store.log, draft(b"3", **names)) == [first[2]._replace(duplicate=True)], "its own answer"
    for seq in (4, 5, 6):
        (again,) = written(store.log, draft(b"whatever", client="c", seq=seq))
        assert again == (2, b"", True), "no later than the floor"
    assert (store.log.mark(A.epoch, "c"), store.log.mark(A.epoch, "d")) == (6, 1)
    written(store.log, draft(b"4", client="c", seq=9))
    assert "seq 8" in refusal(store.log, draft(b"5", client="c", seq=8)).message
    store.log.compact(A.epoch, 4, [])
    assert store.log.mark(A.epoch, "d") == 1, "a later floor does not forget who was silent since"
    assert written(store.log, draft(b"4", client="c", seq=9)) == [(4, b"", True)]


def test_all_of_it_is_there_after_a_restart(folder):
    drafts = [draft(b"1", client="c", seq=4), draft(b"2", key="k"), draft(b"3", client="c", seq=5, key="l")]
    with closing(Store(folder)) as first:
        first.catalogue.create(A)
        outcomes = written(first.log, *drafts)
        first.log.compact(A.epoch, 2, [(b"name", b"content")])
    with closing(Store(folder)) as second:
        found = second.catalogue.find("a")
        assert found is not None
        assert found.revision == 3
        assert second.log.foundation(A.epoch) == (2, {b"name": b"content"})
        assert bodies(second.log, after=2) == [(3, b"3")]
        again = written(second.log, *drafts)
        assert again == [(1, b"", True), *(one._replace(duplicate=True) for one in outcomes[1:])]


def test_a_log_goes_with_its_world(store):
    written(store.log, draft(b"1", client="c", seq=1, key="k"), draft(b"2"), draft(b"b", B.epoch, key="k"))
    store.log.compact(A.epoch, 1, [(b"name", b"content")])
    store.catalogue.delete("a")
    for asked in (store.log.read, store.log.revision, store.log.floor, store.log.foundation, store.log.mark):
        more = {store.log.read: (0,), store.log.mark: ("c",)}.get(asked, ())
        with pytest.raises(WorldGone):
            asked(A.epoch, *more)
    with store._database.read() as connection:
        left = {
            table: connection.execute(f"SELECT count(*) FROM {table}").get
            for table in ("logs", "edits", "clients", "keys", "foundations")
        }
    assert left == {"logs": 1, "edits": 1, "clients": 0, "keys": 1, "foundations": 0}
    again = world("a")
    store.catalogue.create(again)
    assert written(store.log, draft(b"1", again.epoch, client="c", seq=1, key="k")) == [(1, b"stale of 1", False)]


@pytest.mark.parametrize(
    ("names", "said"),
    [
        ({"client": "c"}, "both are needed"),
        ({"seq": 1}, "both are needed"),
        ({"client": "c", "seq": -1}, "seq is -1"),
        ({"client": "c", "seq": log.SEQ_MAX + 1}, "seq is"),
        ({"client": "", "seq": 1}, "client has 0 characters"),
        ({"key": "k" * (log.NAME_CHARS_MAX + 1)}, "key has 129 characters"),
        ({"key": ""}, "key has 0 characters"),
        ({"body": bytes(log.EDIT_BYTES_MAX)}, "the edit has"),
    ],
)
def test_what_is_no_draft(names, said):
    with pytest.raises(BadParameter, match=said):
        draft(**names)
