"""Lives of a session, as the Python client leads them: the web client's session has to do and say the same.

Each is a list of steps: what is done to the session, and what comes of it. A server is played along, mostly as the
protocol has it, and now and then not.
"""

import json
from collections.abc import Callable
from typing import Any, Final

import numpy as np

from chunkserver_client import ChunkKey, ClientError, Retry
from chunkserver_client.stream import (
    Ack,
    ChunkRange,
    Edits,
    Ended,
    Event,
    Nack,
    Progress,
    Refresh,
    Region,
    Resync,
    Session,
    Stale,
    StartOver,
)
from chunkserver_client.stream.messages import Welcome

STEPS: Final = 80
CELLS: Final = 32
CODES: Final = (None, None, None, 1001, 1011, 4408, 4500, 4401, 4409, 1009)
WEIGHTS: Final = {
    "hear": 0.36,
    "edit": 0.12,
    "show": 0.08,
    "hide": 0.02,
    "take": 0.12,
    "done": 0.08,
    "failed": 0.02,
    "regions": 0.06,
    "send": 0.06,
    "wait": 0.03,
    "lost": 0.05,
}
"""How often what is done."""
STROKE: Final = {"op": "carve", "shape": "sphere", "center": [8, 200, 3], "radius": 6.5}


def histories(rng: np.random.Generator, count: int) -> list[dict[str, Any]]:
    """Return so many histories, as what JSON can say."""
    return [History(rng).record() for _ in range(count)]


class History:
    """One session, its clock, and a server that is made up along the way."""

    def __init__(self, rng: np.random.Generator) -> None:
        self._rng = rng
        self._now = 0.0
        self._regions = [self._region() for _ in range(int(rng.integers(1, 4)))]
        retry = Retry(backoff_seconds=0.5, backoff_seconds_max=8.0)
        self._session = Session("me", self._regions, CELLS, lambda: self._now, retry, lambda _, high: 0.5 * high)
        self._epoch, self._revision, self._asked = "one", int(rng.integers(0, 5)), 0
        self._inflight: list[int] = []
        self._refreshes: list[Refresh] = []
        self._steps: list[dict[str, Any]] = []

    def record(self) -> dict[str, Any]:
        """Let it live, and return what has happened."""
        start = [_written(region) for region in self._regions]
        for _ in range(STEPS):
            self._step()
        return {"regions": start, "cells": CELLS, "steps": self._steps}

    def _step(self) -> None:
        session = self._session
        if session.connect_at is not None and self._rng.random() < 0.5:
            self._do({"do": "connected"}, session.connected)
            self._send()
            if self._rng.random() < 0.9:
                self._hear(self._welcome())
        kind = str(self._rng.choice(list(WEIGHTS), p=list(WEIGHTS.values())))
        match kind:
            case "hear" if session.connect_at is None:
                self._hear(self._message())
            case "edit":
                strokes = [dict(STROKE)]
                if self._rng.random() < 0.3:
                    values = self._rng.integers(-(1 << 20), 1 << 20, 8).astype("<i4")
                    strokes.append({"op": "delta", "min": [0, 1, 2], "size": [2, 2, 2], "values": values.tobytes()})
                told = [stroke | ({"values": values.tolist()} if "values" in stroke else {}) for stroke in strokes]
                self._do({"do": "edit", "strokes": told}, lambda: session.edit(strokes))
            case "show" | "hide":
                key = self._key()
                act = session.chunks.add if kind == "show" else session.chunks.remove
                self._do({"do": kind, "key": key}, lambda: act(key))
            case "take":
                found: list[Refresh] = []
                self._do({"do": "take"}, lambda: found.extend(session.chunks.take()))
                found.sort(key=lambda each: sorted(each.keys))
                self._steps[-1]["refreshes"] = [[sorted(each.keys), str(each.revision)] for each in found]
                self._refreshes += found
            case "done" | "failed" if self._refreshes:
                at = int(self._rng.integers(len(self._refreshes)))
                refresh = self._refreshes.pop(at)
                revision = refresh.revision + int(self._rng.integers(0, 3))
                if kind == "done":
                    self._do(
                        {"do": kind, "at": at, "revision": str(revision)},
                        lambda: session.chunks.done(refresh, revision),
                    )
                else:
                    self._do({"do": kind, "at": at}, lambda: session.chunks.failed(refresh))
            case "regions":
                region = self._region()
                if self._rng.random() < 0.4 and session.regions:
                    region = session.regions[0]
                    self._do({"do": "unsubscribe", "region": _written(region)}, lambda: session.unsubscribe(region))
                else:
                    self._do({"do": "subscribe", "region": _written(region)}, lambda: session.subscribe(region))
            case "send":
                self._send()
            case "wait":
                seconds = float(self._rng.choice([0.25, 1.0, 4.0, 5.5]))
                self._now += seconds
                self._do({"do": "wait", "seconds": seconds}, lambda: None)
            case "lost" if session.connect_at is None:
                code = CODES[int(self._rng.integers(len(CODES)))]
                self._inflight = []
                self._do({"do": "lost", "code": code}, lambda: session.lost(code))
            case _:
                pass

    def _do(self, step: dict[str, Any], act: Callable[[], Any]) -> None:
        """Do something, and note what has come of it."""
        found: Any = None
        try:
            found = act()
        except (ValueError, OverflowError, ClientError):
            step["refused"] = True
        if isinstance(found, list):
            step["events"] = [_told(event) for event in found]
        elif isinstance(found, int):
            step["seq"] = found
        session = self._session
        step["state"] = {
            "epoch": session.epoch,
            "revision": str(session.revision),
            "isLive": session.is_live,
            "isBroken": session.is_broken,
            "connectAt": session.connect_at,
            "unansweredCount": session.unanswered,
            "areRegionsInForce": session.are_regions_in_force,
            "areCurrent": session.chunks.are_current,
            "regions": sorted(json.dumps(_written(region)) for region in session.regions),
        }
        self._steps.append(step)

    def _send(self) -> None:
        frames: list[str | bytes] = []
        self._do({"do": "send"}, lambda: frames.extend(self._session.outgoing()))
        self._steps[-1]["frames"] = [frame.hex() if isinstance(frame, bytes) else json.loads(frame) for frame in frames]
        for frame in frames:
            head = frame[4 : 4 + int.from_bytes(frame[:4], "little")] if isinstance(frame, bytes) else frame
            message = json.loads(head)
            self._asked += message["type"] in ("subscribe", "unsubscribe")
            self._inflight += [message["seq"]] if message["type"] == "edit" else []

    def _hear(self, text: str) -> None:
        self._do({"do": "hear", "text": text}, lambda: self._session.received(text))

    def _welcome(self) -> str:
        self._asked = 0
        if self._rng.random() < 0.1:
            self._epoch, self._revision = (
                str(self._rng.choice(["one", "two", "three"])),
                int(self._rng.integers(0, 100)),
            )
        last = None if self._rng.random() < 0.5 else int(self._rng.integers(0, 20))
        limits = {"frame_bytes": 65536, "inflight": int(self._rng.choice([1, 2, 64])), "regions": 64}
        members = {
            "epoch": self._epoch,
            "revision": str(self._revision),
            "floor": "0",
            "last_seq": last,
            "limits": limits,
        }
        return _text("welcome", members)

    def _message(self) -> str:
        rng, known = self._rng, self._session.revision
        stale = [_range(self._key()) for _ in range(int(rng.integers(0, 3)))]
        at = known + int(rng.integers(0, 4)) - (rng.random() < 0.04)
        kind = str(
            rng.choice(
                ["edits", "progress", "ack", "nack", "stale", "resync", "odd"],
                p=[0.3, 0.25, 0.2, 0.07, 0.08, 0.05, 0.05],
            )
        )
        self._revision = max(self._revision, at)
        seq = self._inflight.pop(0) if self._inflight and rng.random() < 0.9 else int(rng.integers(0, 30))
        problem = {
            "type": "urn:chunkserver:problem:bad-stroke",
            "title": "no",
            "status": 422,
            "detail": "no",
            "path": "radius",
        }
        strokes = None if rng.random() < 0.2 else [STROKE]
        after = known + (rng.random() < 0.04)
        members: dict[str, dict[str, Any]] = {
            "edits": {"after": str(after), "edits": [{"revision": str(at), "strokes": strokes}], "stale": stale},
            "progress": {"asked": max(self._asked - int(rng.integers(0, 2)), 0) + (rng.random() < 0.03)},
            "ack": {"seq": seq, "duplicate": bool(rng.random() < 0.2), "stale": None if rng.random() < 0.2 else stale},
            "nack": {"seq": seq, "problem": problem},
            "stale": {"chunks": stale},
            "resync": {"floor": "0", "epoch": self._epoch},
        }
        if kind == "odd":
            return str(
                rng.choice(
                    ["{", "[]", '{"type":"weather"}', self._welcome(), '{"type":"progress","revision":"05","asked":0}']
                )
            )
        return _text(kind, {"revision": str(at), **members[kind]})

    def _key(self) -> ChunkKey:
        lod = int(self._rng.integers(0, 2))
        x, y, z = (int(place) for place in self._rng.integers(-1, 3 >> lod, 3))
        return ChunkKey(lod, x, y, z)

    def _region(self) -> Region:
        x, y, z = (int(place) * CELLS for place in self._rng.integers(-1, 2, 3))
        return Region((x, y, z), (x + 31, y + 31, z + 31), int(self._rng.choice([0, 1, 20])))


def _text(kind: str, members: dict[str, Any]) -> str:
    return json.dumps({"type": kind, **members})


def _range(key: ChunkKey) -> dict[str, Any]:
    return {"lod": key.lod, "min": key[1:], "max": [key.x + 1, key.y, key.z]}


def _written(region: Region) -> dict[str, Any]:
    return {"low": region.low, "high": region.high, "lod": region.lod}


def _told(event: Event) -> dict[str, Any]:
    """Return an event in the web client's words."""
    match event:
        case Welcome(epoch, revision, floor, last_seq, inflight):
            found: dict[str, Any] = {
                "epoch": epoch,
                "revision": revision,
                "floor": floor,
                "lastSeq": last_seq,
                "inflight": inflight,
            }
        case Ack(seq, revision, duplicate, stale):
            found = {"seq": seq, "revision": revision, "duplicate": duplicate, "stale": _ranges(stale)}
        case Nack(seq, problem):
            found = {"seq": seq, "problem": problem.name, "path": problem.values["path"]}
        case Edits(after, revision, edits, stale):
            some = [{"revision": str(each.revision), "strokes": each.strokes} for each in edits]
            found = {"after": str(after), "revision": revision, "edits": some, "stale": _ranges(stale)}
        case Progress(revision, asked):
            found = {"revision": revision, "asked": asked}
        case Stale(stale, revision):
            found = {"stale": _ranges(stale), "revision": revision}
        case Resync(floor, revision, epoch):
            found = {"floor": floor, "revision": revision, "epoch": epoch}
        case StartOver(epoch, revision, lost):
            found = {"epoch": epoch, "revision": revision, "lost": lost}
        case Ended(code, lost):
            found = {"code": code, "lost": lost}
    texts: dict[str, Any] = {name: str(found[name]) for name in ("revision", "floor") if name in found}
    return {"kind": "start over" if isinstance(event, StartOver) else type(event).__name__.lower(), **found, **texts}


def _ranges(stale: tuple[ChunkRange, ...] | None) -> list[dict[str, Any]] | None:
    return None if stale is None else [{"lod": each.lod, "low": each.low, "high": each.high} for each in stale]
