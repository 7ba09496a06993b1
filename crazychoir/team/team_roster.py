"""The roster in force at one drone, and the rosters that it issues as the coordinator."""

from collections.abc import Callable, Iterable

from crazychoir.bus.port import Port
from crazychoir.bus.presence import SILENCE_TIMEOUT
from crazychoir.bus.reliable import Reliable
from crazychoir.bus.topics import MESSAGE_TOPICS
from crazychoir.runtime.clock import NS_PER_SECOND
from crazychoir.team.graph import Graph
from crazychoir.team.messages import GoMessage, HoldAnswer, HoldRequest, Roster

RosterListener = Callable[[Roster], None]
"""Callable that gets each new roster."""


class TeamRoster:
    """Holds the roster in force at this drone, and sends rosters to other members.

    port: port of the drone on the bus
    graph: communication graph of the whole swarm
    mission_hash: hash of the swarm file and the mission
    version: version of crazychoir
    seed: seed of the mission

    Attributes:
    roster: the present roster; None before GO
    former_members: {drone id: incarnation} of the roster before it
    checksum: checksum of the present roster; 0 before GO
    settled_ns: ns: time until which the other members may still adopt the present roster
    apart: text with the parts of the graph that cannot reach each other, if the graph of the whole
        swarm has fewer parts; else empty
    listeners: callables that get each new roster, in this order
    reliable: reliable messages of the port
    """

    def __init__(
        self,
        port: Port,
        graph: Graph,
        *,
        mission_hash: str,
        version: str,
        seed: int,
    ) -> None:
        self.port = port
        self.graph = graph
        self.mission_hash = mission_hash
        self.version = version
        self.seed = seed
        self.roster: Roster | None = None
        self.former_members: dict[int, int] = {}
        self.checksum = 0
        self.settled_ns = 0
        self.apart = ""
        self.listeners: list[RosterListener] = []
        self.reliable = Reliable(port)

    def has_member(self, j: int) -> bool:
        """Return whether drone j is in the roster in force."""
        return self.roster is not None and j in self.roster.members

    @property
    def absent(self) -> tuple[int, ...]:
        """Drones of the mission that are not in the team."""
        here = self.roster.members if self.roster is not None else {}
        return tuple(j for j in self.graph.ids if j not in here)

    @property
    def epoch(self) -> int:
        """Number of the present roster; 0 before GO."""
        return self.roster.epoch if self.roster is not None else 0

    def restrict_graph(self, members: Iterable[int]) -> Graph:
        """Return the graph of the whole swarm, restricted to these drones."""
        inside = dict.fromkeys(members)
        if len(inside) == len(self.graph.ids):
            return self.graph
        arcs = [arc for arc in self.graph.arcs if arc[0] in inside and arc[1] in inside]
        return Graph.from_edges(inside, arcs, directed=True)

    def issue(self, members: dict[int, int], epoch: int, first_round: int) -> None:
        """Send a roster to its members, and adopt it.

        members: {drone id: incarnation}
        epoch: number of the roster
        first_round: round from which the roster counts
        """
        graph = self.restrict_graph(sorted(members))
        directed = not graph.is_undirected
        edges = [list(arc) for arc in (graph.arcs if directed else graph.edges())]
        roster = Roster(
            epoch,
            members,
            edges,
            directed,
            self.seed,
            first_round,
            self.mission_hash,
            self.version,
        )
        self.send([j for j in members if j != self.port.address], roster)
        self.adopt(roster)

    def send(self, receivers: Iterable[int], roster: Roster) -> None:
        """Send a roster to these drones, until each has acknowledged it."""
        bus = self.port.bus
        payload = GoMessage(roster, bus.impairment.age(bus.clock.now())).wire()
        for j in receivers:
            self.reliable.send(MESSAGE_TOPICS.roster, j, payload)

    def remind(self, j: int, roster: Roster) -> None:
        """Send a roster to drone j again, unless a message to it is still on its way."""
        if not self.reliable.is_sending(MESSAGE_TOPICS.roster, j):
            self.send([j], roster)

    def send_message(self, j: int, message: HoldRequest | HoldAnswer) -> None:
        """Send a message about the next roster to drone j, until it is acknowledged."""
        self.reliable.send(MESSAGE_TOPICS.roster, j, message.wire())

    def take(self, message: GoMessage) -> None:
        """Adopt a roster that another drone has sent, if it is newer and meant for this drone."""
        roster = message.roster
        is_ours = (
            roster.mission_hash == self.mission_hash
            and roster.members.get(self.port.address) == self.port.incarnation
        )
        if is_ours and roster.epoch > self.epoch:
            self.adopt(roster, message.age)

    def adopt(self, roster: Roster, age: float = 0.0) -> None:
        """Put a roster in force at this drone.

        age: seconds since GO
        """
        clock = self.port.bus.clock
        self.port.bus.impairment.begin(clock.now(), age)
        self.former_members = self.roster.members if self.roster is not None else {}
        self.roster = roster
        self.checksum = roster.checksum
        self.apart = self._describe_parts(roster)
        self.settled_ns = clock.now_ns() + int(SILENCE_TIMEOUT * NS_PER_SECOND)
        for listener in self.listeners:
            listener(roster)

    def _describe_parts(self, roster: Roster) -> str:
        """Return the text for `apart`."""
        parts = roster.graph.parts()
        if len(parts) <= len(self.graph.parts()):
            return ""
        names = " | ".join(" ".join(map(str, part)) for part in parts)
        return f"graph in {len(parts)} parts: {names}"
