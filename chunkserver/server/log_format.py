"""Lines of the log: one event is one line, as text or as JSON, whatever stands in it.

    2026-01-31T12:00:00.123Z INFO chunkserver.requests: GET /v1/seeds/x status=422 ms=0.8 request=7f3a-1
    {"time": "2026-01-31T12:00:00.123Z", "level": "INFO", "logger": "chunkserver.requests", "message": "GET ...", ...}

A record's `extra={FIELDS: {...}}` becomes fields of its line. What is logged while a request is answered has its id.
"""

import json
import logging
import re
import sys
import time
from collections.abc import Mapping
from contextvars import ContextVar
from typing import Any, Final

FIELDS: Final = "fields"
TEXT_CHARS_MAX: Final = 1 << 15
"""Of a message or a field. Their ends are cut; of a traceback the beginning."""

request_id: Final[ContextVar[str]] = ContextVar("request_id", default="")
"""Of the request that is being answered; empty if it has none."""

_UNPRINTABLE: Final = re.compile("[\x00-\x1f\x7f-\x9f\u2028\u2029\ud800-\udfff]")
"""What could break a line, move a terminal's cursor, or not be encoded."""
_PLAIN: Final = re.compile(r'[^\s"=]+')


def event(record: logging.LogRecord) -> dict[str, Any]:
    """Return what a record says, by name: time (UTC), level, logger, message, then its fields."""
    fields: Mapping[str, Any] = getattr(record, FIELDS, {})
    told: dict[str, Any] = {
        "time": _utc(record.created),
        "level": record.levelname,
        "logger": record.name,
        "message": record.getMessage()[:TEXT_CHARS_MAX],
        **{name: value[:TEXT_CHARS_MAX] if isinstance(value, str) else value for name, value in fields.items()},
    }
    if request_id.get():
        told["request"] = request_id.get()
    if record.exc_info:
        told["traceback"] = logging.Formatter().formatException(record.exc_info)[-TEXT_CHARS_MAX:]
    return told


class JsonFormat(logging.Formatter):
    """One JSON object a line, in ASCII."""

    def format(self, record: logging.LogRecord) -> str:
        """Return the line."""
        return json.dumps(event(record), default=str)


class TextFormat(logging.Formatter):
    """Time, level, logger and message, then fields as name=value; a value with spaces is quoted as JSON quotes it."""

    def format(self, record: logging.LogRecord) -> str:
        """Return the line."""
        told = event(record)
        head = f"{told.pop('time')} {told.pop('level')} {told.pop('logger')}: {told.pop('message')}"
        return _printable(" ".join([head, *(f"{name}={_value(value)}" for name, value in told.items())]))


FORMATS: Final[Mapping[str, type[logging.Formatter]]] = {"text": TextFormat, "json": JsonFormat}


def install(format_name: str, level: str) -> None:
    """Log to standard error from now on, in place of what was set up before. level: the least that is logged."""
    to_stderr = logging.StreamHandler(sys.stderr)
    to_stderr.setFormatter(FORMATS[format_name]())
    logging.basicConfig(level=level.upper(), handlers=[to_stderr], force=True)


def _utc(seconds: float) -> str:
    whole, milliseconds = divmod(int(seconds * 1000), 1000)
    return f"{time.strftime('%Y-%m-%dT%H:%M:%S', time.gmtime(whole))}.{milliseconds:03}Z"


def _value(value: object) -> str:
    text = str(value)
    return text if _PLAIN.fullmatch(text) else json.dumps(text, ensure_ascii=False)


def _printable(line: str) -> str:
    return _UNPRINTABLE.sub(lambda found: found[0].encode("unicode_escape").decode(), line)
