"""The drones that a drone's heartbeats reach, so that the messages of a start grow with the number
of drones and not with its square.
"""

from typing import Final

from crazychoir.team.graph import Graph

CLOSE_DRONES: Final = 32
"""Number of drones that a heartbeat reaches beside the neighbours.

The lowest ids are always reached, because the coordinator is the lowest live drone. A drone that
must find others reaches as many further drones with each heartbeat, in turn.
"""


def list_near(graph: Graph, i: int, *others: int) -> tuple[int, ...]:
    """Return the neighbours of drone i and these others, increasing, without i."""
    return tuple(sorted({*graph.neighbors(i), *others} - {i}))


def list_lowest(ids: tuple[int, ...]) -> tuple[int, ...]:
    """Return the lowest of these ids: each drone has CLOSE_DRONES others among them.

    ids: increasing
    """
    return ids[: CLOSE_DRONES + 1]


def list_watched(
    graph: Graph, members: tuple[int, ...], i: int, coordinator: int
) -> tuple[int, ...]:
    """Return the drones that drone i monitors after the start, unless it is the coordinator.

    members: ids of the team, increasing; the first one is the coordinator, as a rule
    coordinator: -1: it is silent; the lowest ids are monitored as well, because one of them leads
    """
    if coordinator == members[0]:
        return list_near(graph, i, coordinator)
    # A restarted coordinator may have no team.
    return list_near(graph, i, *list_lowest(graph.ids), *list_lowest(members))


class DroneSearch:
    """Goes through the drones of a swarm in turn, CLOSE_DRONES at a time.

    ids: the drones, increasing
    """

    def __init__(self, ids: tuple[int, ...]) -> None:
        self.ids = ids
        self._next = 0

    def count_turns(self) -> int:
        """Return how many turns it takes to go through all drones, beside the lowest."""
        return len(self.ids) // (CLOSE_DRONES + 2)

    def take_turn(self) -> tuple[int, ...]:
        """Return the drones that have their turn."""
        first = self._next
        self._next = (first + CLOSE_DRONES) % len(self.ids)
        return (self.ids + self.ids[:CLOSE_DRONES])[first : first + CLOSE_DRONES]
