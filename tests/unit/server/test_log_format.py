import json
import logging
import re
import sys

import pytest

from chunkserver.server import log_format
from chunkserver.server.log_format import FIELDS, FORMATS, TEXT_CHARS_MAX, JsonFormat, TextFormat, install, request_id

LINE = re.compile(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\.\d{3}Z INFO a\.logger: ")
BREAKING = "a\nb\r\nc\x00d\x1b[2Je\x7ff\x85g\u2028h\u2029i\x0bj\x0ck\x9bl\udce4"
"""Whatever ends a line for some reader, moves a terminal's cursor, or cannot be encoded."""


def record(message="said", *arguments, fields=None, exc_info=None, created=0.0):
    made = logging.LogRecord("a.logger", logging.INFO, __file__, 1, message, arguments, exc_info)
    made.created = created
    if fields is not None:
        setattr(made, FIELDS, fields)
    return made


def test_a_line_of_text():
    line = TextFormat().format(record("%d worlds", 3, fields={"status": 422, "ms": 0.5}, created=1769860800.1239))
    assert line == "2026-01-31T12:00:00.123Z INFO a.logger: 3 worlds status=422 ms=0.5"


def test_a_line_of_json():
    line = JsonFormat().format(record("%d worlds", 3, fields={"status": 422, "name": "ä"}, created=1769860800.9999))
    assert json.loads(line) == {
        "time": "2026-01-31T12:00:00.999Z",
        "level": "INFO",
        "logger": "a.logger",
        "message": "3 worlds",
        "status": 422,
        "name": "ä",
    }
    assert line.isascii()


@pytest.mark.parametrize("form", [TextFormat(), JsonFormat()])
def test_nothing_breaks_a_line(form):
    line = form.format(record(BREAKING, fields={"field": BREAKING}))
    assert len(line.splitlines()) == 1
    assert not re.search("[\x00-\x1f\x7f-\x9f]", line)
    line.encode()
    for letter in "abcdefghijkl":
        assert letter in line


def test_a_value_cannot_pass_for_a_field():
    line = TextFormat().format(record(fields={"name": 'x status=200 "'}))
    assert line.endswith(r'said name="x status=200 \""')
    assert TextFormat().format(record(fields={"name": ""})).endswith(' name=""')


@pytest.mark.parametrize("form", [TextFormat(), JsonFormat()])
def test_a_traceback_is_part_of_the_line(form):
    try:
        raise ValueError("first\nsecond")
    except ValueError:
        line = form.format(record(exc_info=sys.exc_info()))
    assert len(line.splitlines()) == 1
    assert "ValueError: first" in line
    assert "second" in line
    assert "test_log_format.py" in line


@pytest.mark.parametrize("form", [TextFormat(), JsonFormat()])
def test_a_long_traceback_keeps_its_end(form):
    try:
        raise ValueError("x" * 10 * TEXT_CHARS_MAX + "the end")
    except ValueError:
        line = form.format(record(exc_info=sys.exc_info()))
    assert "the end" in line
    assert len(line) < TEXT_CHARS_MAX + 200


@pytest.mark.parametrize("form", [TextFormat(), JsonFormat()])
def test_a_line_has_an_end(form):
    line = form.format(record("m" * 10 * TEXT_CHARS_MAX, fields={"field": "f" * 10 * TEXT_CHARS_MAX}))
    assert len(line) < 2 * TEXT_CHARS_MAX + 200


def test_what_is_logged_during_a_request_has_its_id():
    token = request_id.set("abc-1")
    try:
        assert TextFormat().format(record(fields={"status": 1})).endswith("said status=1 request=abc-1")
        assert json.loads(JsonFormat().format(record()))["request"] == "abc-1"
    finally:
        request_id.reset(token)
    assert "request" not in TextFormat().format(record())


@pytest.fixture
def root(monkeypatch):
    """The root logger, as another one: what is installed here ends with the test."""
    logger = logging.RootLogger(logging.WARNING)
    monkeypatch.setattr(logging, "root", logger)
    return logger


@pytest.mark.parametrize("name", FORMATS)
def test_installed_once_however_often(root, name, capsys):
    for _ in range(2):
        install(name, "info")
    root.info("told")
    root.debug("not told")
    (line,) = capsys.readouterr().err.splitlines()
    assert "told" in line
    assert (name == "json") == line.startswith("{")


def test_the_pattern_of_times_is_that_of_the_lines():
    assert LINE.match(TextFormat().format(record(created=1e9)))
    assert log_format._utc(0.0) == "1970-01-01T00:00:00.000Z"
