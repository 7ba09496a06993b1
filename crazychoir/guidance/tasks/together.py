"""Rounds of a team in flight that may lose members at any time.

All robots run a program to its end, or all give it up.
"""

import asyncio
from typing import Any

from crazychoir.errors import AgentFailed, PeerLost
from crazychoir.guidance.tasks.team_news import Key, TeamNews
from crazychoir.optimization.rounds.program import Program
from crazychoir.team.graph import Graph

TOGETHER_ROUND_DEADLINE = 30.0
"""s for one round."""
TEAM_LOOK_INTERVAL = 0.05
"""s: interval at which a robot looks at a team with a silent neighbour."""


async def run_together(
    news: TeamNews, program: Program[Any], links: Graph, key: Key
) -> bool:
    """Run a program with the team of this key. Returns False if the team has changed meanwhile.

    news: the news of this robot.
    program: the program.
    links: the graph of the messages.
    key: epoch and lost members of the team.
    Raises RosterChanged at the beginning of an epoch.
    """
    channel = "-".join(["plan", *map(str, key[1])])
    while not program.done:
        heard = await _exchange(
            news, program.message(), links.neighbors(news.id), channel, key
        )
        if heard is None:
            return False
        await news.clock.compute(program.step, heard)
    return True


async def _exchange(
    news: TeamNews, message: Any, neighbors: tuple[int, ...], channel: str, key: Key
) -> dict[int, Any] | None:
    """Run one round with the neighbours. Returns None if the team has changed meanwhile.

    It waits for a neighbour that is lost or has failed, until the team continues without that
    neighbour.
    """
    ends = news.clock.now() + TOGETHER_ROUND_DEADLINE
    while True:
        exchange = asyncio.ensure_future(
            news.communicator.neighbors_exchange(
                message,
                neighbors,
                neighbors,
                channel=channel,
                deadline=TOGETHER_ROUND_DEADLINE,
            )
        )
        try:
            await wait_unless(exchange, news.changed)
            if exchange.done():
                return exchange.result()
            if news.key() != key:
                return None
            news.changed.clear()
        except (PeerLost, AgentFailed):
            if news.clock.now() > ends:
                raise
            await news.clock.sleep(TEAM_LOOK_INTERVAL, drone=news.id)
            if news.key() != key:
                return None
        finally:
            await cancel_task(exchange)


async def wait_unless(task: "asyncio.Future[Any]", event: asyncio.Event) -> None:
    """Wait for a task or for an event, until one of them is done."""
    waits = asyncio.ensure_future(event.wait())
    try:
        await asyncio.wait({task, waits}, return_when=asyncio.FIRST_COMPLETED)
    finally:
        await cancel_task(waits)


async def cancel_task(task: "asyncio.Future[Any]") -> None:
    """Cancel a task that is not needed any more, and wait for its end."""
    if not task.done():
        task.cancel()
        await asyncio.wait({task})
    if not task.cancelled():
        task.exception()
