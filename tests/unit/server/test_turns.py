"""Turns: whose request came first is next, whoever leaves the line hands on what they were given."""

import asyncio
from collections.abc import Awaitable, Callable

import pytest

from kleinkram.server.turns import NoTurn, Turns, note_arrival


async def _settle() -> None:
    for _ in range(5):
        await asyncio.sleep(0)


def _run(story: Callable[[Turns], Awaitable[None]]) -> None:
    asyncio.run(asyncio.wait_for(story(Turns(1)), timeout=20))


def test_whose_request_came_first_is_next_however_late_it_asks() -> None:
    served: list[str] = []

    async def request(name: str, line: Turns, may_ask: asyncio.Event) -> None:
        note_arrival()
        await may_ask.wait()
        async with line.taken(within_s=20):
            served.append(name)
            await asyncio.sleep(0)

    async def story(line: Turns) -> None:
        asks = {name: asyncio.Event() for name in ("first", "second", "third")}
        tasks = []
        for name, may_ask in asks.items():
            tasks.append(asyncio.create_task(request(name, line, may_ask)))
            await _settle()
        async with line.taken(within_s=20):
            for name in ("third", "first", "second"):
                asks[name].set()
                await _settle()
        await asyncio.gather(*tasks)

    _run(story)
    assert served == ["first", "second", "third"]


def test_who_waits_too_long_is_told_and_others_go_on() -> None:
    async def story(line: Turns) -> None:
        async with line.taken(within_s=20):
            with pytest.raises(NoTurn):
                async with line.taken(within_s=0.01):
                    pytest.fail("there was no turn to be had")
        async with line.taken(within_s=0.01):
            pass

    _run(story)


@pytest.mark.parametrize("is_given", [False, True])
def test_who_leaves_the_line_keeps_no_turn(is_given: bool) -> None:
    async def hold(line: Turns) -> None:
        async with line.taken(within_s=20):
            await asyncio.sleep(0)

    async def story(line: Turns) -> None:
        async with line.taken(within_s=20):
            leaving = asyncio.create_task(hold(line))
            await _settle()
            if not is_given:
                leaving.cancel()
                await _settle()
        # The turn was passed on in leaving the block; the task has not run since.
        leaving.cancel()
        with pytest.raises(asyncio.CancelledError):
            await leaving
        async with line.taken(within_s=1):
            pass

    _run(story)


def test_what_is_no_request_waits_from_when_it_asks() -> None:
    served: list[int] = []

    async def job(number: int, line: Turns) -> None:
        async with line.taken(within_s=20):
            served.append(number)

    async def story(line: Turns) -> None:
        async with line.taken(within_s=20):
            tasks = [asyncio.create_task(job(number, line)) for number in range(5)]
            await _settle()
        await asyncio.gather(*tasks)

    _run(story)
    assert served == [0, 1, 2, 3, 4]
