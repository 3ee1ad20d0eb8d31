"""A server that ends and comes back while clients work."""

from contextlib import ExitStack

import httpx2

from chunkserver_client import Retry
from tests.client.chaos import chaos
from tests.client.conftest import KINDS, Asker
from tests.serving import serving

KEYS = [(0, x, -1, z) for x in range(20) for z in range(20)]
PATIENT = Retry(attempts_max=1000, seconds_max=60.0, backoff_seconds=0.05, backoff_seconds_max=0.2)
TIMEOUT = httpx2.Timeout(5.0)


def test_batches_survive_a_restart(tmp_path):
    options = ("--workers", "1", "--data", str(tmp_path / "data"))
    with chaos("http://127.0.0.1:9") as proxy, ExitStack() as stack:
        askers = [Asker(kind, proxy.url, retry=PATIENT, coding="identity", timeout=TIMEOUT) for kind in KINDS]
        for asker in askers:
            stack.callback(asker.close)
            assert not asker.is_ready()
        with serving(tmp_path / "first", *options, ready=False) as first:
            proxy.target = first.url
            for asker in askers:
                asker.wait_until_ready(60)
            world = askers[0].create_world("kept", 42, "terrain")
            streams = [asker.chunks(world, KEYS) for asker in askers]
            found = [[next(chunks).key for _ in range(3)] for chunks in streams]
            proxy.hang_up()
        with serving(tmp_path / "second", *options, ready=False) as second:
            proxy.target = second.url
            for before, chunks in zip(found, streams, strict=True):
                assert sorted(before + [mesh.key for mesh in chunks]) == KEYS, "each of them, once"
            assert askers[0].world("kept") == world
        batches = [body for body in proxy.bodies if '"chunks"' in body]
        assert len(batches) >= 4
        assert all(len(later) < len(batches[0]) for later in batches[2:])
