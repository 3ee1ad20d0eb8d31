"""Many chunks in one answer; what a stream that breaks off leaves out is asked for again."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final

from chunkserver_client.answers import mesh_of
from chunkserver_client.cache import Entry, head_of
from chunkserver_client.coding import Coding, decoded
from chunkserver_client.errors import BadAnswer, ClientError, Unavailable, problem
from chunkserver_client.exchange import BODY_BYTES_MAX, Exchange, checked, media_type
from chunkserver_client.frames import MEDIA_TYPE, Frame, FrameReader
from chunkserver_client.json_tree import Json
from chunkserver_client.questions import (
    MEDIA_TYPES,
    AnyWorld,
    ChunkOptions,
    Fitted,
    batch_request,
    chunk_request,
    is_immutable,
)
from chunkserver_client.retry import Trial
from chunkserver_client.steps import LOST, Answer, Deliver, Pause, Read, Request, Steps

CHUNKS_MAX: Final = 1024
"""Chunks of one request."""


@dataclass(frozen=True, slots=True)
class _Wanted:
    """One chunk of a batch, and what the cache has of it."""

    chunk: Fitted
    request: Request
    entry: Entry | None


@dataclass(slots=True)
class Batch:
    """One batch under way. chunks: at most `CHUNKS_MAX`, each once.

    viewer: (x, y, z) in voxels: nearer chunks come first.
    coding: of each chunk.
    """

    exchange: Exchange
    world: AnyWorld
    chunks: Sequence[Fitted]
    options: ChunkOptions
    viewer: Sequence[float] | None
    coding: Coding
    _missing: dict[Fitted, _Wanted] = field(init=False, default_factory=dict)
    _failed: list[ClientError] = field(init=False, default_factory=list)

    def steps(self) -> Steps[None]:
        """Deliver the mesh of each chunk as soon as it is there.

        A chunk that fails for a reason of its own does not stop the others: the first such error is raised at the end.
        """
        yield from self._deliver_fresh()
        trial = Trial(self.exchange.retry)
        while self._missing:
            try:
                yield from self._stream(trial)
            except (Unavailable, BadAnswer, *LOST) as error:
                if self._missing:
                    yield Pause(self._pause_after(error, trial))
        if self._failed:
            raise self._failed[0]

    def _pause_after(self, error: Exception, trial: Trial) -> float:
        try:
            return trial.pause_after(error)
        except ClientError as last:
            last.add_note(f"{len(self._missing)} of {len(self.chunks)} chunks are missing")
            raise

    def _deliver_fresh(self) -> Steps[None]:
        cache = self.exchange.cache
        for chunk in self.chunks:
            request = chunk_request(self.world, chunk.key, self.options | {"coarser": chunk.coarser})
            entry = cache.find(request)
            if entry is not None and cache.is_fresh(entry):
                yield Deliver(mesh_of(entry.answer, self.world.place(chunk.key)))
            else:
                self._missing[chunk] = _Wanted(chunk, request, entry)

    def _stream(self, trial: Trial) -> Steps[None]:
        """Ask once for all that is missing. Returns when nothing is; raises what there is to wait for otherwise."""
        wanted = list(self._missing.values())
        known = [one.entry.tag.strip('"') for one in wanted if one.entry is not None]
        request = batch_request(
            self.world, self._missing, self.options, viewer=self.viewer, known=known, coding=self.coding
        )
        head = yield from self.exchange.open(request, trial)
        if head.status != 200 or media_type(head.headers) != MEDIA_TYPE:
            answer = checked((yield from self.exchange.rest(head, trial)), 200)
            raise BadAnswer(f"the media type is {media_type(answer.headers)!r}: expected {MEDIA_TYPE}")
        busy = yield from self._frames(wanted, trial)
        if self._missing:
            raise busy or BadAnswer("the batch is whole, but chunks are missing in it")

    def _frames(self, wanted: Sequence[_Wanted], trial: Trial) -> Steps[Unavailable | None]:
        """Take all frames. Return the last that may be asked for again. Raises `BadAnswer` if the stream is cut."""
        reader, busy = FrameReader(BODY_BYTES_MAX), None
        while not reader.is_done:
            piece: bytes = yield Read()
            for frame in reader.feed(piece):
                if frame.index < len(wanted) and (one := wanted[frame.index]).chunk in self._missing:
                    found = yield from self._take(frame, one)
                    busy = found or busy
                    if found is None:
                        trial.renew()
            if not piece or trial.seconds_left < 0:
                raise BadAnswer("the batch broke off" if not piece else "the batch came too slowly")
        yield Read()  # the end of the body: the connection can be used again
        return busy

    def _take(self, frame: Frame, wanted: _Wanted) -> Steps[Unavailable | None]:
        """Deliver what is in a frame. Return the error if the chunk may be asked for again."""
        if frame.status >= 400:
            error = problem(frame.status, Json.parse(frame.body).members())
            error.add_note(f"{wanted.chunk.key}")
            if isinstance(error, Unavailable):
                return error
            self._failed.append(error)
        else:
            answer = self._answer(frame, wanted)
            mesh = mesh_of(answer, self.world.place(wanted.chunk.key))
            self.exchange.cache.keep(wanted.request, answer)
            yield Deliver(mesh)
        del self._missing[wanted.chunk]
        return None

    def _answer(self, frame: Frame, wanted: _Wanted) -> Answer:
        """Return what a request for this chunk alone would have given."""
        if frame.status == 304:
            if wanted.entry is None or wanted.entry.tag != f'"{frame.tag}"':
                raise BadAnswer(f"a 304 for {frame.tag!r}, which was not named for {wanted.chunk.key}")
            return wanted.entry.answer
        immutable = is_immutable(self.world, self.options, frame.revision)
        headers = {
            **head_of(frame.tag, frame.content or "", frame.revision, immutable=immutable),
            "content-type": MEDIA_TYPES[self.options.get("format", "mesh")],
        }
        return Answer(frame.status, headers, decoded(frame.body, frame.coding, BODY_BYTES_MAX))
