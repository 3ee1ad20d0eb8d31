"""What the server may make of frames, by RFC 6455 and docs/wire/edit_v1.md: which close codes are right.

What is wrong with a frame is seen when it arrives, and what is wrong with a message, or with how many frames it comes
in, a little later: then a wrong frame behind it, or a close, may be what the server answers to.
"""

import json
import re
from math import prod
from typing import Any, Final

from tests.frames import BINARY, CLOSE, CONT, FIN, PING, PONG, SHORT_MAX, TEXT, Frame, code_of

FRAME_BYTES_MAX: Final = 65_536
PIECES_MAX: Final = 64
REGIONS_MAX: Final = 64
SEQ_MAX: Final = 2**53 - 1
PLACE_MAX: Final = 2**40
LOD_MAX: Final = 20
OPCODES: Final = (TEXT, BINARY, CONT, CLOSE, PING, PONG)
PROTOCOL, NOT_TEXT, TOO_LARGE, MALFORMED, OUT_OF_ORDER = REFUSALS = 1002, 1007, 1009, 4400, 4412
CODES: Final = {*range(1000, 1004), *range(1007, 1015), *range(3000, 5000)}
"""That a close frame may carry."""


class Model:
    """One connection, as far as frames have come.

    codes: with which it may have been closed. is_over: it is closed, with one of these.
    is_cut: a frame has begun that does not end.
    pongs: what answers to pings, in order, as long as it is not closed. seqs: of edits that are to be answered then.
    """

    def __init__(self, *, welcome: bool) -> None:
        """welcome: whether there was a `hello`, and its answer."""
        self.codes: set[int] = set()
        self.is_over = self.is_cut = False
        self.pongs: list[bytes] = []
        self.seqs: set[int] = set()
        self._may_be = {"open"} if welcome else {"opening"}
        self._is_wrong = False
        self._pieces: list[Frame] = []
        self._regions: set[str] = set()

    def take(self, frame: Frame) -> None:
        """Go on with the next frame."""
        if self.is_over or self.is_cut:
            return
        opcode = frame.first & 0x0F
        wrong = self._faults(frame, opcode)
        if not frame.is_whole:
            self.is_cut = True
            self.codes |= {0, *wrong}
        elif wrong:
            self._end(*wrong)
        elif opcode == CLOSE:
            self._close(frame.payload)
        elif opcode == PING:
            self.pongs.append(frame.payload)
        elif opcode in (TEXT, BINARY, CONT):
            self._pieces.append(frame)
            size = sum(len(piece.payload) for piece in self._pieces)
            if len(self._pieces) > PIECES_MAX or size > FRAME_BYTES_MAX:
                self._refuse(TOO_LARGE)
            if frame.first & FIN:
                pieces, self._pieces = self._pieces, []
                self._message(pieces[0].first & 0x0F, b"".join(piece.payload for piece in pieces))
        if frame.is_wide and not self.is_over:
            self.codes.add(PROTOCOL)  # it must not be, but need not be seen

    def _faults(self, frame: Frame, opcode: int) -> set[int]:
        """Return the codes for what is wrong with a frame by itself, and where it stands."""
        found, is_control = set(), opcode >= CLOSE
        if frame.first & 0x70 or opcode not in OPCODES or not frame.masked:
            found.add(PROTOCOL)
        if is_control and (frame.length > SHORT_MAX or not frame.first & FIN):
            found.add(PROTOCOL)
        if not is_control and (opcode == CONT) != bool(self._pieces):
            found.add(PROTOCOL)
        before = 0 if is_control or opcode != CONT else sum(len(piece.payload) for piece in self._pieces)
        if before + frame.length > FRAME_BYTES_MAX + SHORT_MAX:
            found.add(TOO_LARGE)
        if frame.length >> 63:
            found.add(PROTOCOL)
        return found

    def _close(self, payload: bytes) -> None:
        code = code_of(payload)
        if self._pieces:
            self.codes.add(PROTOCOL)  # what the library says, in the middle of a message; RFC 6455 would take it
        wrong = set()
        if len(payload) == 1 or (payload and code not in CODES):
            wrong.add(PROTOCOL)
        if not is_text(payload[2:]):
            wrong |= {PROTOCOL, NOT_TEXT}
        self._end(*wrong or {code})

    def _end(self, *codes: int) -> None:
        self.codes |= set(codes)
        self.is_over = True

    def _message(self, opcode: int, payload: bytes) -> None:
        if opcode == TEXT and not is_text(payload):
            self._refuse(NOT_TEXT)
        elif not self._is_wrong:
            message = meaning(opcode, payload)
            if message is None:
                self._refuse(MALFORMED)
            else:
                self._obey(message)

    def _refuse(self, code: int) -> None:
        self.codes.add(code)
        self._is_wrong = True

    @property
    def is_amid(self) -> bool:
        """Whether a message has begun that does not end."""
        return bool(self._pieces)

    @property
    def is_ended(self) -> bool:
        """Whether the server ends the connection, whatever comes."""
        return self.is_over or self._is_wrong

    def _obey(self, message: dict[str, Any]) -> None:
        if message["type"] == "hello":
            if self._may_be == {"opening"}:
                self._may_be = {"introducing", "open"}
                self._regions = regions_of(message)
            else:
                self._refuse(OUT_OF_ORDER)
            return
        if "introducing" in self._may_be:
            self.codes.add(OUT_OF_ORDER)
        if "open" not in self._may_be:
            self._refuse(OUT_OF_ORDER)
        elif message["type"] == "edit":
            if message["seq"] <= max(self.seqs, default=-1):
                self._refuse(OUT_OF_ORDER)
            else:
                self.seqs.add(message["seq"])
        elif message["type"] == "subscribe":
            self._regions |= regions_of(message)
            if len(self._regions) > REGIONS_MAX:
                self._refuse(MALFORMED)
        else:
            self._regions -= regions_of(message)


def is_text(payload: bytes) -> bool:
    """Return whether it is UTF-8."""
    try:
        payload.decode()
    except UnicodeDecodeError:
        return False
    return True


def meaning(opcode: int, payload: bytes) -> dict[str, Any] | None:
    """Return the message of a frame; None if it is none."""
    text, values = payload, None
    if opcode == BINARY:
        end = 4 + int.from_bytes(payload[:4], "little")
        start = end + -end % 4
        if start > len(payload) or payload[end:start].strip(b"\0"):
            return None
        text, values = payload[4:end], payload[start:]
    try:
        found = json.loads(text.decode(), parse_constant=_refuse)
    except (ValueError, RecursionError):
        return None
    kind = found.get("type") if isinstance(found, dict) else None
    if not isinstance(kind, str) or kind not in MEANT or not MEANT[kind](found):
        return None
    return found if values is None or fits(found, values) else None


def fits(found: dict[str, Any], values: bytes) -> bool:
    """Return whether values are those of an edit's deltas that have none."""
    if found["type"] != "edit":
        return False
    deltas = [each for each in found["strokes"] if isinstance(each, dict) and each.get("op") == "delta"]
    sizes: list[Any] = [each.get("size") for each in deltas if "values" not in each]
    for size in sizes:
        if not is_list(size) or len(size) != 3 or not all(is_integer(each, 1, FRAME_BYTES_MAX) for each in size):
            return False
    count: int = sum(prod(size) for size in sizes)
    return len(values) == 4 * count


def _refuse(name: str) -> None:
    raise ValueError(name)


def is_list(value: object) -> bool:
    return isinstance(value, list)


def is_integer(value: object, low: int, high: int) -> bool:
    return type(value) is int and low <= value <= high


def is_name(value: object) -> bool:
    return isinstance(value, str) and bool(re.fullmatch("[!-~]{1,128}", value))


def is_revision(value: object) -> bool:
    return isinstance(value, str) and bool(re.fullmatch("0|[1-9][0-9]{0,18}", value)) and int(value) < 1 << 63


def is_place(value: Any) -> bool:
    return is_list(value) and len(value) == 3 and all(is_integer(each, -PLACE_MAX, PLACE_MAX) for each in value)


def is_region(value: Any) -> bool:
    if not isinstance(value, dict) or not is_place(value.get("min")) or not is_place(value.get("max")):
        return False
    is_box = all(low <= high for low, high in zip(value["min"], value["max"], strict=True))
    return is_box and is_integer(value.get("lod", LOD_MAX), 0, LOD_MAX)


def are_regions(found: dict[str, Any]) -> bool:
    regions = found.get("regions")
    return isinstance(regions, list) and len(regions) <= REGIONS_MAX and all(map(is_region, regions))


def regions_of(found: dict[str, Any]) -> set[str]:
    return {json.dumps([each["min"], each["max"], each.get("lod", LOD_MAX)]) for each in found["regions"]}


def is_hello(found: dict[str, Any]) -> bool:
    epoch, resume = found.get("epoch"), found.get("resume")
    places = (epoch is None or is_name(epoch)) and (resume is None or is_revision(resume))
    return is_name(found.get("client")) and places and are_regions(found)


def is_edit(found: dict[str, Any]) -> bool:
    return is_integer(found.get("seq"), 0, SEQ_MAX) and is_list(found.get("strokes"))


MEANT: Final = {"hello": is_hello, "edit": is_edit, "subscribe": are_regions, "unsubscribe": are_regions}
