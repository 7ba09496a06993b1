"""The exchange of one drone with its neighbours, below the verbs: its channels, and the parts that
send, take and await their messages.
"""

from crazychoir.bus.port import Port
from crazychoir.team.barrier import Barrier
from crazychoir.team.channel import Channel
from crazychoir.team.channel_table import FAILURE_CHANNEL, ChannelTable, Membership
from crazychoir.team.epochs import AnyGraph
from crazychoir.team.messages import Roster
from crazychoir.team.round_arrivals import RoundArrivals
from crazychoir.team.round_sender import ROUND_TOPIC, RoundSender
from crazychoir.team.round_waits import RoundWaits


class Exchange:
    """The channels of one drone, across the epochs of its team.

    port: port of the drone on the bus
    graph: communication graph, or a periodic sequence of graphs
    membership: says which drones are lost; None if no drone is

    Attributes:
    table: channels and epochs
    sender: sends rounds
    arrivals: takes what arrives
    waits: waits for rounds and readers
    """

    def __init__(
        self, port: Port, graph: AnyGraph, membership: Membership | None = None
    ) -> None:
        self.table = ChannelTable(port.address, graph, membership)
        self.sender = RoundSender(port, self.table)
        self.arrivals = RoundArrivals(port, self.table, self.sender)
        self.waits = RoundWaits(port, self.table, self.sender)
        port.handlers[ROUND_TOPIC.number] = self.arrivals.take
        self.open(FAILURE_CHANNEL, joinable=True)  # a failed agent stops in every epoch

    def open(self, channel: str, joinable: bool = False) -> Channel:
        """Return a channel, which is an algorithm instance with its own rounds.

        Create it if needed.

        A `joinable` channel continues across epochs; a new member begins with the first round of
        its epoch.
        Raises ConfigError if the channel is already in use and not joinable, or if there are too
        many channels.
        """
        is_known = channel in self.table.channels
        ch = self.table.open(channel, joinable)
        if not is_known:
            self.arrivals.replay()
        return ch

    def follow(self, barrier: Barrier) -> None:
        """Take part in all epochs of this barrier's rosters."""
        self.table.membership = barrier.presence
        barrier.attach(self)

    def hold(self) -> int:
        """Send no further round of a joinable channel until the next epoch.

        Returns the first held round.
        """
        return self.table.hold()

    def adopt(self, roster: Roster) -> None:
        """Put a roster in force: joinable channels change to its graph at its first round, others
        raise RosterChanged.
        """
        self.table.adopt(roster)
        self.arrivals.replay()
