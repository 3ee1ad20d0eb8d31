"""Whom to send to. A load goes to this machine unless the user says otherwise, in so many words."""

import ipaddress
import socket
import ssl
from typing import Final, NamedTuple
from urllib.parse import urlsplit

from chunkserver_loadtest.errors import BadTarget

PORTS: Final = {"http": 80, "https": 443}


class Target(NamedTuple):
    """A server.

    address, port: where to connect; a resolved address, so that nothing is looked up while a load runs.
    authority: what goes into `Host`. name: for the certificate. tls: None for plain HTTP.
    """

    address: str
    port: int
    authority: str
    name: str
    tls: ssl.SSLContext | None = None


def resolve(url: str, allow_remote: bool = False) -> Target:
    """Return the server of `url`, of which only scheme, host and port count.

    Raises BadTarget if it is no http or https URL, has no address, or is not on loopback without `allow_remote`.
    """
    try:
        parts = urlsplit(url)
        host, port = parts.hostname, parts.port
    except ValueError as error:
        raise BadTarget(f"{url!r} is no URL: {error}") from None
    if parts.scheme not in PORTS or not host:
        raise BadTarget(f"{url!r} is no URL of a server: http://127.0.0.1:8000 is one")
    port = PORTS[parts.scheme] if port is None else port
    address = _address(host, port)
    if not allow_remote and not ipaddress.ip_address(address.partition("%")[0]).is_loopback:
        raise BadTarget(f"{host} ({address}) is not this machine: --allow-remote, if it is yours to put under load")
    tls = ssl.create_default_context() if parts.scheme == "https" else None
    return Target(address, port, parts.netloc.rpartition("@")[2], host, tls)


def _address(host: str, port: int) -> str:
    """Return the first address, of IPv4 if there is one: `localhost` often means ::1 first, where no server listens."""
    try:
        found = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)
    except OSError as error:
        raise BadTarget(f"{host!r} has no address: {error.strerror}") from None
    return str(min(found, key=lambda one: one[0] != socket.AF_INET)[4][0])
