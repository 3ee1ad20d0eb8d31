"""A client that leaves cancels what is done for it alone, and nothing else."""

import asyncio

import pytest

from chunkserver.server.presence import while_there


class Client:
    """The receiving side of a request: its end of body, then nothing until it leaves."""

    def __init__(self):
        self.left = asyncio.Event()
        self._messages = [{"type": "http.request", "body": b"", "more_body": False}]

    async def receive(self):
        if self._messages:
            return self._messages.pop()
        await self.left.wait()
        return {"type": "http.disconnect"}


def cancellations() -> int:
    task = asyncio.current_task()
    assert task is not None
    return task.cancelling()


def test_an_answer_and_an_error_come_through():
    async def scenario():
        assert await while_there(Client().receive, asyncio.sleep(0, "done")) == "done"

        async def fail():
            await asyncio.sleep(0)
            raise ValueError("no")

        with pytest.raises(ValueError, match="no"):
            await while_there(Client().receive, fail())
        assert cancellations() == 0

    asyncio.run(scenario())


def test_who_leaves_cancels_the_work_and_not_the_task():
    async def scenario():
        client, cancelled = Client(), asyncio.Event()

        async def work():
            try:
                await asyncio.Future()
            finally:
                cancelled.set()

        asyncio.get_running_loop().call_soon(client.left.set)
        assert await while_there(client.receive, work()) is None
        assert cancelled.is_set()
        assert cancellations() == 0
        await asyncio.sleep(0)

    asyncio.run(scenario())


def test_a_cancellation_from_outside_is_one():
    async def scenario():
        task = asyncio.create_task(while_there(Client().receive, asyncio.sleep(1000)))
        await asyncio.sleep(0)
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task

    asyncio.run(scenario())


@pytest.mark.parametrize("turns", range(8))
def test_who_leaves_at_the_moment_of_the_answer_does_no_harm(turns):
    async def scenario():
        client, answer = Client(), asyncio.get_running_loop().create_future()

        async def work():
            return await answer

        async def end():
            for _ in range(4):
                await asyncio.sleep(0)
            if not answer.done():
                answer.set_result("done")

        async def leave():
            for _ in range(turns):
                await asyncio.sleep(0)
            client.left.set()

        others = [asyncio.create_task(end()), asyncio.create_task(leave())]
        assert await while_there(client.receive, work()) in ("done", None)
        for _ in range(10):
            await asyncio.sleep(0)
        assert cancellations() == 0
        await asyncio.gather(*others)

    asyncio.run(scenario())
