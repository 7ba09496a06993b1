"""Wait for the other processes of a computation that was started in several processes."""

from crazychoir.bus.network.zenoh_link import ZenohLink
from crazychoir.team.graph import Graph

CONNECTION_LOOK_INTERVAL = 0.01
"""Seconds between two checks of the connections."""


async def wait_until_joined(link: ZenohLink, links: Graph) -> None:
    """Wait until HELLO has gone both ways with every process that holds a neighbour of ours."""
    here = link.bus.ports
    elsewhere = dict.fromkeys(
        j for i in here for j in links.neighbors(i) if j not in here
    )
    while not all(_is_greeted(link, j) for j in elsewhere):
        await link.bus.clock.sleep(CONNECTION_LOOK_INTERVAL)


def _is_greeted(link: ZenohLink, j: int) -> bool:
    peer = link.directory.get(j)
    return peer is not None and link.table.mutual(peer)
