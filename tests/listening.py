"""How a test's own server ends: no connection that was just accepted is lost."""

import asyncio
from typing import Final

TURNS: Final = 20
"""Of the loop: an accepted connection has its task after a few, and a transport that is ended is closed after one."""


async def turns() -> None:
    """Have the loop do what it has to, however slow the machine is."""
    for _ in range(TURNS):
        await asyncio.sleep(0)


async def close(server: asyncio.Server) -> None:
    """Accept no more, and close the server when each connection that it has accepted has its transport.

    asyncio makes the transport a turn after it has accepted; of a server that is closed by then, it drops the
    connection without closing its socket, and the collector complains of that in whichever test comes then.
    """
    for socket in server.sockets:
        asyncio.get_running_loop().remove_reader(socket)
    await turns()
    server.close()
