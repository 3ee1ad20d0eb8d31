"""What an operator may choose: one frozen value, and everything there is to say about each part of it.

A field's name is also that of the flag, of the variable and of the key in a file; `sources.py` reads those. Units stand
in the names. What a field says of itself here is what the command line's help says.
"""

import re
from pathlib import Path
from typing import Annotated, Any, ClassVar, Final, Literal, Self

from pydantic import BeforeValidator, ByteSize, Field, PlainSerializer, PlainValidator, model_validator
from pydantic_settings import BaseSettings, NoDecode, PydanticBaseSettingsSource, SettingsConfigDict

from chunkserver.server.connections import LIMITS_DEFAULT as CONNECTIONS
from chunkserver.server.connections import ConnectionLimits
from chunkserver.server.disk import DISK_BYTES_MIN
from chunkserver.server.keys import KEYS_MAX, ApiKey, Keyring, parse_key
from chunkserver.server.pool import LIMITS_DEFAULT as POOL
from chunkserver.server.pool import Limits
from chunkserver.worker import cores

PREFIX: Final = "CHUNKSERVER_"
"""Of every variable."""
HOST_CHARACTERS_MAX: Final = 255
PORT_MAX: Final = 65535
WORKERS_MAX: Final = 256
CACHE_BYTES_DEFAULT: Final = 256 << 20
"""Room for about 4,000 chunks of 60 KB."""
CACHE_BYTES_MAX: Final = 1 << 40
DISK_CACHE_BYTES_DEFAULT: Final = 4 << 30
DISK_CACHE_BYTES_MAX: Final = 1 << 44
JOBS_WAITING_MAX: Final = 100_000
SECONDS_MIN: Final = 0.1
SECONDS_MAX: Final = 3600.0
WORKER_BYTES_MIN: Final = 16 << 20
"""Less would replace a worker after a few large chunks."""
WORKER_BYTES_MAX: Final = 1 << 40
ARENA_BYTES_MIN: Final = 64 << 20
"""Room for 4,096 bricks: the largest stroke that is as wide as it is long takes less than half, and is there twice."""
ARENA_BYTES_MAX: Final = 1 << 40
ARENA_STEP_BITS: Final = 20
"""It is cut to whole MiB, which are whole bricks."""
LOG_EDITS_MIN: Final = 1000
LOG_EDITS_MAX: Final = 1 << 40
EDIT_BYTES_MIN: Final = 16 << 20
EDIT_BYTES_MAX: Final = 1 << 40
CONNECTIONS_MAX: Final = 100_000
ORIGINS_MAX: Final = 1000
ORIGIN_PATTERN: Final = r"\*|[a-z][a-z0-9+.-]*://[!-.0-~]+"
"""A scheme, a host and maybe a port, as browsers send them; or any."""
MASK: Final = "***"
"""In place of a digest."""

_SEPARATOR: Final = re.compile(r"[\s,]+")


def _workers_default() -> int:
    return min(cores(), WORKERS_MAX)


def _listed(value: object) -> object:
    """A list is written in one line, too: a flag or a variable has no other way."""
    return tuple(filter(None, _SEPARATOR.split(value))) if isinstance(value, str) else value


def _origin(value: object) -> str:
    if not isinstance(value, str) or not re.fullmatch(ORIGIN_PATTERN, value):
        raise ValueError(f"{value!r:.100} is no origin: they look like https://example.org or http://localhost:3000")
    return value


def _key(value: object) -> ApiKey:
    if isinstance(value, ApiKey):
        return value
    if not isinstance(value, str):
        raise ValueError("an API key is written NAME:SCOPE:DIGEST")
    return parse_key(value)


_Seconds = Annotated[float, Field(ge=SECONDS_MIN, le=SECONDS_MAX)]
_Folder = Annotated[Path | None, BeforeValidator(lambda value: None if value == "" else value)]
_Origins = Annotated[
    tuple[Annotated[str, PlainValidator(_origin)], ...],
    NoDecode,
    BeforeValidator(_listed),
    Field(max_length=ORIGINS_MAX),
]
_Key = Annotated[ApiKey, PlainValidator(_key), PlainSerializer(str)]
_Keys = Annotated[tuple[_Key, ...], NoDecode, BeforeValidator(_listed), Field(max_length=KEYS_MAX)]


class Settings(BaseSettings):
    """How one server runs. Made as it stands: flags, variables and files are read by `choose` alone."""

    model_config: ClassVar[SettingsConfigDict] = SettingsConfigDict(
        env_prefix=PREFIX, env_ignore_empty=True, extra="forbid", frozen=True, allow_inf_nan=False
    )

    host: str = Field(
        "127.0.0.1", min_length=1, max_length=HOST_CHARACTERS_MAX, description="The address to listen on."
    )
    port: int = Field(8000, ge=0, le=PORT_MAX, description="The port; 0 takes a free one.")
    workers: int = Field(
        default_factory=_workers_default,
        ge=1,
        le=WORKERS_MAX,
        description="Processes that build chunks; one for each core, if not given.",
    )
    data: _Folder = Field(
        None,
        description="The folder where worlds are kept, for one server alone. Without it they are in memory, and end "
        "with the server.",
    )
    cache_bytes: ByteSize = Field(
        ByteSize(CACHE_BYTES_DEFAULT), ge=0, le=CACHE_BYTES_MAX, description="Memory for finished chunks."
    )
    disk_cache: _Folder = Field(
        None, description="The folder where finished chunks are kept on disk too. It can be deleted at any time."
    )
    disk_cache_bytes: ByteSize = Field(
        ByteSize(DISK_CACHE_BYTES_DEFAULT),
        ge=DISK_BYTES_MIN,
        le=DISK_CACHE_BYTES_MAX,
        description="Bound on the size of the cache on disk.",
    )
    jobs_waiting: int = Field(
        POOL.jobs_waiting, ge=1, le=JOBS_WAITING_MAX, description="Requests that wait for a worker; more are refused."
    )
    answer_seconds: _Seconds = Field(
        POOL.answer_seconds, description="From a request to its answer, waiting included; then it is refused."
    )
    build_seconds: _Seconds = Field(
        POOL.build_seconds,
        description="For one chunk; a worker that takes longer is taken for hung, and replaced. At most half of "
        "`answer_seconds`: what it built is tried once more.",
    )
    worker_bytes: ByteSize = Field(
        ByteSize(POOL.worker_bytes),
        ge=WORKER_BYTES_MIN,
        le=WORKER_BYTES_MAX,
        description="What a worker's own memory may grow by before it is replaced.",
    )
    arena_bytes: ByteSize = Field(
        ByteSize(POOL.arena_bytes),
        ge=ARENA_BYTES_MIN,
        le=ARENA_BYTES_MAX,
        description="Memory for what edits have changed while it is read; what is not used takes none. An edit that "
        "cannot be worked out in it is refused.",
    )
    edit_bytes: ByteSize = Field(
        ByteSize(1 << 30),
        ge=EDIT_BYTES_MIN,
        le=EDIT_BYTES_MAX,
        description="Memory for what edits have changed while nobody reads it, of all open worlds; an edit that has no "
        "room is refused. Beside it `arena_bytes` again at most.",
    )
    log_edits: int = Field(
        500_000,
        ge=LOG_EDITS_MIN,
        le=LOG_EDITS_MAX,
        description="Edits of a world that are kept one by one, at least. When there are twice as many, what the older "
        "half has made takes their place.",
    )
    connections_max: int = Field(
        CONNECTIONS.connections_max, ge=1, le=CONNECTIONS_MAX, description="Connections that are open at once."
    )
    header_seconds: _Seconds = Field(
        CONNECTIONS.header_seconds, description="For the head of a request to arrive; then the connection is closed."
    )
    keep_alive_seconds: _Seconds = Field(
        CONNECTIONS.keep_alive_seconds, description="Between an answer and the next request of a connection."
    )
    send_seconds: _Seconds = Field(
        CONNECTIONS.send_seconds, description="For a client to read what it is sent; then the connection is closed."
    )
    api_keys: _Keys = Field(
        (),
        repr=False,
        description="Keys of clients, each NAME:SCOPE:DIGEST as `chunkserver key new` prints it. Without any, nobody "
        "needs one.",
    )
    anonymous_read: bool = Field(False, description="Reading needs no key, also where there are API keys.")
    insecure: bool = Field(
        False, description="Listen on other than loopback addresses without API keys: whoever can connect may write."
    )
    cors_origins: _Origins = Field(
        ("*",), description="Sites whose pages may use this server; * lets the pages of any site read."
    )
    log_format: Literal["text", "json"] = Field("text", description="How a line of the log is written: text or json.")
    log_level: Literal["debug", "info", "warning", "error"] = Field(
        "info", description="The least that is logged: debug, info, warning or error."
    )
    log_requests: Literal["none", "problems", "all"] = Field(
        "problems",
        description="Requests that are logged: none; problems, those that failed, at a bounded rate; or all.",
    )

    @model_validator(mode="after")
    def _agrees(self) -> Self:
        if 2 * self.build_seconds > self.answer_seconds:
            named = f"twice build_seconds, {self.build_seconds:g}, is more than answer_seconds, {self.answer_seconds:g}"
            raise ValueError(f"{named}: a worker may hang, and what it built is tried once more")
        Keyring(self.api_keys)
        return self

    @classmethod
    def settings_customise_sources(
        cls,
        settings_cls: type[BaseSettings],
        init_settings: PydanticBaseSettingsSource,
        *others: PydanticBaseSettingsSource,
        **named: PydanticBaseSettingsSource,
    ) -> tuple[PydanticBaseSettingsSource, ...]:
        """Take what the caller gives, and nothing else."""
        del cls, settings_cls, others, named
        return (init_settings,)

    def shown(self) -> dict[str, Any]:
        """Return the value of each setting, as JSON has it; without the digests of keys."""
        names = [f"{key.name}:{key.scope}:{MASK}" for key in self.api_keys]
        return {**self.model_dump(mode="json"), "api_keys": names}

    @property
    def pool_limits(self) -> Limits:
        """What bounds the waiting, and the workers."""
        arena_bytes = self.arena_bytes >> ARENA_STEP_BITS << ARENA_STEP_BITS
        return Limits(self.jobs_waiting, self.answer_seconds, self.build_seconds, self.worker_bytes, arena_bytes)

    @property
    def connection_limits(self) -> ConnectionLimits:
        """What bounds connections. The limits that are not settings have their defaults."""
        return ConnectionLimits(
            connections_max=self.connections_max,
            header_seconds=self.header_seconds,
            keep_alive_seconds=self.keep_alive_seconds,
            send_seconds=self.send_seconds,
        )
