import tracemalloc
from functools import partial

from chunkserver.grid import ChunkKey
from chunkserver.pipeline import Chunk, ChunkRequest
from chunkserver.recipe import WorldRecipe, builtin
from chunkserver.server.answers import ENTRY_BYTES, KEY_BYTES_MAX, PLANS_MAX, Answers, asked
from chunkserver.server.cache import ChunkCache
from chunkserver.server.cors import Cors
from chunkserver.server.plan import Plan, Reply
from chunkserver.wire import Encoding


def wanted_of(path, query=b"", headers=()):
    wanted = asked({"path": path, "query_string": query, "headers": headers})
    assert wanted is not None
    return wanted


TEMPLATE = ChunkRequest(WorldRecipe(42, builtin("terrain")), ChunkKey(0, 0, 0, 0), encoding=Encoding("glb"))


def plan_of(holds=lambda: True, age=lambda: 0, **more):
    headers = {
        "Cache-Control": "public, max-age=31536000, immutable",
        "Chunk-Revision": str(1 << 62),
        "World-Revision": str(1 << 62),
    }
    return Plan.of(TEMPLATE, lambda _: headers, holds, age, **more)


def test_entries_weigh_no_more_than_they_are_charged():
    count = 500
    answers = Answers(ChunkCache(0), Cors(["*"]), bytes_max=count * (ENTRY_BYTES + 1000))
    tracemalloc.start()
    before, _ = tracemalloc.get_traced_memory()
    for number in range(3 * count):
        path, query = f"/v1/worlds/{'w' * 64}/chunks/0/{number}/0/0", f"g={number:0100}".encode()
        wanted = wanted_of(path, query, [(b"accept", b"%0100d" % number)])
        plan = plan_of(partial(bool, f"{number:0100}"))
        answers.keep(wanted, plan, plan.found(plan.current(ChunkKey(0, number, 0, 0)), Chunk("surface", b"x")))
    after, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert 0.25 * answers.bytes < after - before < answers.bytes <= answers.bytes_max
    assert len(answers) > count // 2


def test_plans_are_bounded():
    answers = Answers(ChunkCache(0), Cors([]))
    plan = plan_of()
    for number in range(PLANS_MAX + 10):
        answers.learn(wanted_of(f"/v1/seeds/{number}/chunks/0/0/0/0"), plan)
    assert len(answers._plans) == PLANS_MAX
    assert answers.plan(wanted_of("/v1/seeds/9/chunks/0/0/0/0")) is None
    assert answers.plan(wanted_of("/v1/seeds/10/chunks/1/2/3/-4")) == (plan, ChunkKey(1, 2, 3, -4))


def test_what_is_not_kept():
    answers = Answers(ChunkCache(0), Cors([]))
    plan = plan_of()
    reply = plan.not_modified(plan.current(ChunkKey(0, 0, 0, 0)))
    for wanted in (
        wanted_of("/a/chunks" * KEY_BYTES_MAX),
        wanted_of("/a", headers=[(b"accept", b"a" * KEY_BYTES_MAX)]),
    ):
        answers.keep(wanted, plan, reply)
        answers.learn(wanted, plan)
    answers.keep(wanted_of("/a"), plan_of(lambda: False), reply)
    answers.keep(wanted_of("/a"), plan, Reply(499, (), b""))
    assert (answers.bytes, len(answers._plans)) == (0, 0)
    answers.keep(wanted_of("/a"), plan, reply)
    assert answers.bytes


def test_a_field_that_comes_twice_is_for_the_application():
    assert asked({"path": "/a", "query_string": b"", "headers": [(b"accept", b"a"), (b"accept", b"b")]}) is None


def test_what_is_older_than_the_plan_is_by_now_is_not_given_again():
    age = 3
    answers = Answers(cache := ChunkCache(1 << 20), Cors([]))
    plan = plan_of(age=lambda: age)
    version = plan.current(ChunkKey(0, 0, 0, 0))
    cache._keep(version.tag, Chunk("surface", b"x"))
    scope = {"path": "/a", "query_string": b"", "headers": ()}

    def keep():
        answers.keep(wanted_of("/a"), plan, plan.found(version, Chunk("surface", b"x")))

    keep()
    assert answers.find(scope)
    age += 1
    assert answers.find(scope) is None
    keep()
    assert answers.find(scope)


def test_a_chunk_that_was_edited_while_it_was_built_is_not_given_again():
    edits = 0
    answers = Answers(cache := ChunkCache(1 << 20), Cors([]))
    plan = plan_of(age=lambda: edits, last_edit=lambda _: edits)
    asked = plan.current(ChunkKey(0, 0, 0, 0))
    edits += 1
    for revision in (0, 1):
        reply = plan.found(asked, chunk := Chunk("surface", b"x", revision))
        cache._keep(reply.version.tag, chunk)
        answers.keep(wanted_of("/a"), plan, reply)
        assert (answers.find({"path": "/a", "query_string": b"", "headers": ()}) is None) == (revision < edits)
