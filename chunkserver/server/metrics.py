"""What the server has counted, for Prometheus: one table says what there is and how it is read.

Nothing is counted here. Every part has its own plain numbers, which are read when somebody asks; what this server does
not have, like a cache on disk that nobody wanted, has no lines.
"""

import platform
from collections.abc import Callable, Iterator, Mapping
from itertools import accumulate
from typing import Final, NamedTuple

from fastapi import APIRouter, Request, Response
from prometheus_client import ProcessCollector
from prometheus_client.exposition import CONTENT_TYPE_PLAIN_0_0_4 as TEXT
from prometheus_client.exposition import generate_latest as generate_text
from prometheus_client.metrics_core import Metric
from prometheus_client.openmetrics.exposition import CONTENT_TYPE_LATEST as OPENMETRICS
from prometheus_client.openmetrics.exposition import generate_latest as generate_openmetrics
from prometheus_client.registry import Collector
from prometheus_client.utils import floatToGoString

from chunkserver import __version__
from chunkserver.kernel import SOURCES_DIGEST
from chunkserver.server.accept import preferred
from chunkserver.server.disk import DiskCache
from chunkserver.server.edit_counts import EditCounts, Standing
from chunkserver.server.histogram import Histogram
from chunkserver.server.openapi import RESOURCE, header, problem_responses
from chunkserver.server.pool import Pool
from chunkserver.server.problems import problem_of
from chunkserver.server.service import Service, ServiceOfApp

Readings = Mapping[tuple[str, ...], float | Histogram]
"""Values by their labels. Without any, there is nothing to say."""


class Row(NamedTuple):
    """One metric. `kind` is "counter", "gauge" or "histogram"; `labels` name what its values are told apart by."""

    name: str
    kind: str
    says: str
    read: Callable[[Service], Readings]
    labels: tuple[str, ...] = ()


def _one(read: Callable[[Service], float]) -> Callable[[Service], Readings]:
    return lambda service: {(): read(service)}


def _pool(read: Callable[[Pool], Readings]) -> Callable[[Service], Readings]:
    return lambda service: read(service.pool) if isinstance(service.pool, Pool) else {}


def _tally(name: str) -> Callable[[Service], Readings]:
    return _pool(lambda pool: {(): getattr(pool.tally, name)})


def _disk(read: Callable[[DiskCache], float]) -> Callable[[Service], Readings]:
    return lambda service: {(): read(service.cache.disk)} if service.cache.disk else {}


def _edits(read: Callable[[EditCounts], float | Histogram]) -> Callable[[Service], Readings]:
    return lambda service: {(): read(service.worlds.edits.counts)}


def _standing(read: Callable[[Standing], float]) -> Callable[[Service], Readings]:
    return lambda service: {(): read(service.worlds.edits.standing())}


def _refused_edits(service: Service) -> Readings:
    found: dict[tuple[str, ...], float] = {}
    for kind, count in service.worlds.edits.counts.refused.items():
        named = (problem_of(kind).name,)
        found[named] = found.get(named, 0) + count
    return found


def _front(service: Service) -> Readings:
    found = service.answers
    return {
        ("found",): found.hits,
        ("not_modified",): found.not_modified,
        ("built",): found.built - found.refused,
        ("refused",): found.refused,
    }


def _requests(service: Service) -> Readings:
    return {(route, method, str(status)): n for (route, method, status), n in service.requests.answered.items()}


TABLE: Final = (
    Row(
        "chunkserver_build_info",
        "gauge",
        "Always 1: what runs here. Equal sources make equal terrain.",
        lambda _: {(__version__, SOURCES_DIGEST, platform.python_version()): 1},
        ("version", "sources", "python"),
    ),
    Row("chunkserver_ready", "gauge", "1 when chunks can be built, 0 until then.", _one(lambda of: of.pool.ready)),
    Row(
        "chunkserver_requests_total",
        "counter",
        "Requests that the application answered, by the template of the route; those answered in front are apart.",
        _requests,
        ("route", "method", "status"),
    ),
    Row(
        "chunkserver_request_seconds",
        "histogram",
        "Until the last byte of the application's answer was handed on.",
        lambda service: {(route,): found for route, found in service.requests.seconds.items()},
        ("route",),
    ),
    Row(
        "chunkserver_requests_in_flight",
        "gauge",
        "Requests that the application is answering.",
        _one(lambda of: of.requests.in_flight),
    ),
    Row(
        "chunkserver_requests_unlogged_total",
        "counter",
        "Lines that were left out of the log because too many requests failed.",
        _one(lambda of: of.requests.unlogged),
    ),
    Row(
        "chunkserver_front_answers_total",
        "counter",
        "Requests answered in front of the application: found there, not_modified (304), built (asked of the cache and "
        "the workers), or refused.",
        _front,
        ("kind",),
    ),
    Row("chunkserver_connections", "gauge", "Connections that are open.", _one(lambda of: of.connections.open)),
    Row(
        "chunkserver_connections_ended_total",
        "counter",
        "Connections that the server ended before their clients left, by why.",
        lambda service: {(why,): n for why, n in service.connections.ended.items()},
        ("why",),
    ),
    Row("chunkserver_cache_hits_total", "counter", "Chunks found in memory.", _one(lambda of: of.cache.hits)),
    Row(
        "chunkserver_cache_joined_total",
        "counter",
        "Requests that waited for a chunk which another request had asked for already.",
        _one(lambda of: of.cache.joined),
    ),
    Row("chunkserver_cache_misses_total", "counter", "Builds that were started.", _one(lambda of: of.cache.misses)),
    Row(
        "chunkserver_cache_evicted_total",
        "counter",
        "Chunks that made room for others in memory.",
        _one(lambda of: of.cache.evicted),
    ),
    Row(
        "chunkserver_cache_found_bytes_total",
        "counter",
        "Bytes of the chunks that were found in memory.",
        _one(lambda of: of.cache.found_bytes),
    ),
    Row("chunkserver_cache_chunks", "gauge", "Chunks in memory.", _one(lambda of: of.cache.entries)),
    Row("chunkserver_cache_bytes", "gauge", "What they weigh, bookkeeping included.", _one(lambda of: of.cache.bytes)),
    Row("chunkserver_cache_max_bytes", "gauge", "What they may weigh.", _one(lambda of: of.cache.bytes_max)),
    Row("chunkserver_disk_ready", "gauge", "1 when the cache on disk is open and whole.", _disk(lambda of: of.ready)),
    Row("chunkserver_disk_hits_total", "counter", "Chunks found on disk.", _disk(lambda of: of.hits)),
    Row("chunkserver_disk_misses_total", "counter", "Chunks not found on disk.", _disk(lambda of: of.misses)),
    Row(
        "chunkserver_disk_corrupt_total",
        "counter",
        "Chunks on disk that were not what had been written. They were built anew, never served.",
        _disk(lambda of: of.corrupt),
    ),
    Row(
        "chunkserver_disk_dropped_total",
        "counter",
        "Chunks that were not written: too many at once, no room, or the disk failed.",
        _disk(lambda of: of.dropped),
    ),
    Row(
        "chunkserver_disk_evicted_total",
        "counter",
        "Chunks that made room for others on disk.",
        _disk(lambda of: of.evicted),
    ),
    Row("chunkserver_disk_chunks", "gauge", "Chunks on disk.", _disk(lambda of: of.entries)),
    Row("chunkserver_disk_bytes", "gauge", "Size of the pages that they take.", _disk(lambda of: of.bytes)),
    Row("chunkserver_disk_max_bytes", "gauge", "Bound on the file.", _disk(lambda of: of.bytes_max)),
    Row("chunkserver_jobs_done_total", "counter", "Chunks that workers built.", _tally("done")),
    Row("chunkserver_jobs_failed_total", "counter", "Errors that workers answered.", _tally("failed")),
    Row("chunkserver_jobs_refused_total", "counter", "Jobs turned away: too many waited.", _tally("refused")),
    Row("chunkserver_jobs_expired_total", "counter", "Jobs whose deadline passed.", _tally("expired")),
    Row(
        "chunkserver_jobs_retried_total", "counter", "Jobs given to another worker: theirs was lost.", _tally("retried")
    ),
    Row("chunkserver_jobs_waiting", "gauge", "Jobs without a worker.", _pool(lambda pool: {(): pool.waiting})),
    Row("chunkserver_workers_busy", "gauge", "Workers that have a job.", _pool(lambda pool: {(): pool.busy})),
    Row("chunkserver_workers_lost_total", "counter", "Workers that ended by themselves or hung.", _tally("lost")),
    Row("chunkserver_workers_hung_total", "counter", "Of these, workers that took too long.", _tally("hung")),
    Row(
        "chunkserver_workers_recycled_total",
        "counter",
        "Workers that were replaced because their memory had grown.",
        _tally("recycled"),
    ),
    Row(
        "chunkserver_stage_seconds",
        "histogram",
        "Of a job: until a worker gets it (queue), in that worker (field, mesh, encode), and until its answer (build).",
        _pool(lambda pool: {(stage,): found for stage, found in pool.tally.seconds.items()}),
        ("stage",),
    ),
    Row("chunkserver_worlds", "gauge", "Worlds in the catalogue.", _one(lambda of: len(of.worlds))),
    Row(
        "chunkserver_worlds_open",
        "gauge",
        "Worlds whose edits have been read from the log, since somebody asked for them.",
        _standing(lambda now: now.open),
    ),
    Row("chunkserver_edits_total", "counter", "Edits that were written.", _edits(lambda of: of.written)),
    Row("chunkserver_strokes_total", "counter", "Strokes of these edits.", _edits(lambda of: of.strokes)),
    Row(
        "chunkserver_edits_duplicate_total",
        "counter",
        "Edits that had been written before, and were answered as then.",
        _edits(lambda of: of.duplicates),
    ),
    Row(
        "chunkserver_edits_refused_total",
        "counter",
        "Edits that were not written, by problem.",
        _refused_edits,
        ("problem",),
    ),
    Row(
        "chunkserver_edit_seconds",
        "histogram",
        "Of an edit that was written: from when it was read until it was durable.",
        _edits(lambda of: of.write_seconds),
    ),
    Row(
        "chunkserver_edits_log_bytes_total",
        "counter",
        "What edits brought into the log: their strokes, and what they made stale.",
        _edits(lambda of: of.log_bytes),
    ),
    Row(
        "chunkserver_edits_stale_chunks_total",
        "counter",
        "Chunks, on all levels, that edits made stale.",
        _edits(lambda of: of.stale),
    ),
    Row(
        "chunkserver_edits_unfolded",
        "gauge",
        "Edits that are durable and not in the bricks yet: chunks that they have reached wait for that.",
        _standing(lambda now: now.unfolded),
    ),
    Row("chunkserver_edits_folded_total", "counter", "Edits that got into the bricks.", _edits(lambda of: of.folded)),
    Row(
        "chunkserver_fold_seconds",
        "histogram",
        "Of edits that were folded together: until their bricks could be read.",
        _edits(lambda of: of.fold_seconds),
    ),
    Row(
        "chunkserver_streams",
        "gauge",
        "Connections to streams of edits.",
        lambda service: {(): service.streams.connections},
    ),
    Row(
        "chunkserver_streams_closed_total",
        "counter",
        "Connections to streams that ended, by the code they were closed with; 1006: without one.",
        lambda service: {(str(code),): count for code, count in service.streams.closed.items()},
        ("code",),
    ),
    Row(
        "chunkserver_stream_pauses_total",
        "counter",
        "Pauses in reading from a connection to a stream that had had its share of the event loop's time.",
        _one(lambda of: of.connections.shares.pauses),
    ),
    Row("chunkserver_bricks", "gauge", "Bricks of the open worlds.", _standing(lambda now: now.bricks)),
    Row("chunkserver_arena_slots", "gauge", "Bricks that are ready to be read.", _standing(lambda now: now.slots)),
    Row(
        "chunkserver_arena_slots_max", "gauge", "How many can be, of 16 KiB each.", _standing(lambda now: now.slots_max)
    ),
    Row(
        "chunkserver_edit_memory_bytes",
        "gauge",
        "What edits take beside the arena; `edit_bytes` is its limit.",
        _standing(lambda now: now.weight),
    ),
    Row("chunkserver_recipes", "gauge", "Posted recipes that are kept.", _one(lambda of: len(of.posted))),
    Row("chunkserver_recipes_bytes", "gauge", "What they weigh.", _one(lambda of: of.posted.bytes)),
)
"""Besides these there are those of the server's own process (`process_*`): its memory, its CPU, its files."""

FORMATS: Final = {
    content_type.partition(";")[0]: (content_type, write)
    for content_type, write in ((TEXT, generate_text), (OPENMETRICS, generate_openmetrics))
}
"""By media type: how it is called in full, and who writes it."""

router: Final = APIRouter(tags=["operations"])


@router.api_route(
    "/metrics",
    methods=RESOURCE,
    summary="What has been counted, for Prometheus",
    response_class=Response,
    responses={
        200: {
            "description": "The metrics, as text or as OpenMetrics.",
            "content": {media_type: {"schema": {"type": "string"}} for media_type in FORMATS},
            "headers": {"Cache-Control": header("Always `no-store`.")},
        },
        **problem_responses(),
    },
)
async def metrics(request: Request, service: ServiceOfApp) -> Response:
    """Everything that the server has counted since its start, and how things stand now."""
    content_type, write = FORMATS[preferred(request.headers.getlist("accept"), FORMATS)]
    headers = {"Cache-Control": "no-store", "Vary": "Accept", "Content-Type": content_type}
    return Response(write(_Reading(service)), headers=headers)


class _Reading(Collector):
    """All metrics of a service, as they are now."""

    def __init__(self, service: Service) -> None:
        self._service = service

    def collect(self) -> Iterator[Metric]:
        """Yield every metric that there is."""
        for row in TABLE:
            readings = row.read(self._service)
            if readings:
                yield _family(row, readings)
        yield from ProcessCollector(registry=None).collect()


def _family(row: Row, readings: Readings) -> Metric:
    family = Metric(row.name.removesuffix("_total"), row.says, row.kind)
    for values, reading in readings.items():
        labels = dict(zip(row.labels, values, strict=True))
        if isinstance(reading, Histogram):
            _add_histogram(family, labels, reading)
        else:
            family.add_sample(row.name, labels, float(reading))
    return family


def _add_histogram(family: Metric, labels: dict[str, str], found: Histogram) -> None:
    *_, count = counts = list(accumulate(found.counts))
    ends = [*map(floatToGoString, found.bounds), "+Inf"]
    for end, below in zip(ends, counts, strict=True):
        family.add_sample(f"{family.name}_bucket", {**labels, "le": end}, below)
    family.add_sample(f"{family.name}_sum", labels, found.total)
    family.add_sample(f"{family.name}_count", labels, count)
