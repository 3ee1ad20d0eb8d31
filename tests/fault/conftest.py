"""The event loops on which the tests of the workers run."""

import asyncio

import pytest
import uvloop

from tests.fault.pools import PATIENCE_SECONDS


@pytest.fixture(params=[uvloop.new_event_loop], ids=["uvloop"])
def run(request):
    """Run a coroutine on the server's event loop."""

    def run_on_loop(scenario):
        with asyncio.Runner(loop_factory=request.param) as runner:
            return runner.run(asyncio.wait_for(scenario, 4 * PATIENCE_SECONDS))

    return run_on_loop
