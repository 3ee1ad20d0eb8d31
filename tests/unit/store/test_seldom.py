import logging

from chunkserver.store.seldom import SECONDS_MIN, Seldom


def test_one_line_a_second_says_how_many_were_left_out(caplog):
    now = 100.0
    say = Seldom(logging.getLogger("seldom"), logging.ERROR, lambda: now)
    for _ in range(5):
        say("%s is full", "the disk")
    assert caplog.messages == ["the disk is full"]
    now += SECONDS_MIN
    say("%s is full", "the disk")
    say("%s is full", "the disk")
    now += SECONDS_MIN
    say("it is well")
    now += SECONDS_MIN
    say("it is well")
    assert caplog.messages[1:] == [
        "the disk is full (and 4 times before)",
        "it is well (and 1 times before)",
        "it is well",
    ]
    assert {record.levelno for record in caplog.records} == {logging.ERROR}
