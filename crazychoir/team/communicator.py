"""The verbs of the ChoiRbot papers as coroutines over lossy links: send, receive,
asynchronous_receive, neighbors_exchange.
"""

from dataclasses import dataclass
from math import inf
from typing import Any, Literal

from crazychoir.bus.codec import encode
from crazychoir.bus.message import Message
from crazychoir.bus.port import Port
from crazychoir.errors import PeerLost, RoundTimeout
from crazychoir.runtime.clock import NS_PER_SECOND
from crazychoir.team.channel import Channel
from crazychoir.team.channel_table import FAILURE_CHANNEL, Membership
from crazychoir.team.epochs import AnyGraph
from crazychoir.team.exchange import Exchange
from crazychoir.team.expected_wait import RESEND_TIMES
from crazychoir.team.message_kind import AHEAD_KIND, DATA_KIND, MessageKind
from crazychoir.team.round_sender import ROUND_TOPIC
from crazychoir.types import Failure

CREDIT_EVERY = 16
"""Rounds between two credits."""


@dataclass(frozen=True, slots=True)
class ClosingRules:
    """How a channel ends: how long a drone stays for its neighbours, and how often it sends its
    last messages.
    """

    linger_time: float = 2.0
    """Seconds without a question from unfinished neighbours after which `close` returns."""
    last_messages: int = 32
    """Times that an important message is sent to neighbours that do not ask for it.

    At 50 % loss all copies are lost once in 4e9 cases.
    """
    end_messages: int = 3
    """Times that the end of a channel is sent to neighbours that need not answer."""


CLOSING_RULES = ClosingRules()


Policy = Literal["raise", "partial", "hold"]
"""Action of an exchange at its deadline."""


class Communicator:
    """One drone's part in the team's exchanges, on a graph that
    may be directed and may change with the round.

    port: port of the drone on the bus
    graph: communication graph, or a periodic sequence of graphs
    membership: says which drones are lost; None if no drone is
    deadline: default seconds to wait for a round

    Attributes:
    id: id of the drone
    exchange: channels of the drone, and the parts that send, take and await their messages
    """

    def __init__(
        self,
        port: Port,
        graph: AnyGraph,
        membership: Membership | None = None,
        deadline: float = 60.0,
    ) -> None:
        self.port = port
        self.deadline = deadline
        self.id = port.address
        self.exchange = Exchange(port, graph, membership)
        self._clock = port.bus.clock
        self._now_ns = self._clock.now_ns
        self._channels = self.exchange.table.channels
        self._epochs = self.exchange.table.epochs
        self._sender = self.exchange.sender
        self._waits = self.exchange.waits
        self._open_all = self.exchange.arrivals.open_all
        self._find_neighbors = self.exchange.table.find_neighbors

    @property
    def graph(self) -> AnyGraph:
        """Communication graph of the newest epoch."""
        return self._epochs.graph

    @graph.setter
    def graph(self, graph: AnyGraph) -> None:
        self.exchange.table.replace_graph(graph)

    @property
    def epoch(self) -> int:
        """Number of the team's present composition."""
        return self._epochs.epoch

    @property
    def rounds(self) -> int:
        """Rounds sent since the start."""
        return self.exchange.table.counters.sent

    @property
    def ahead(self) -> int:
        """Messages dropped because their round was too far ahead."""
        return self.exchange.table.counters.ahead

    def open(self, channel: str, joinable: bool = False) -> Channel:
        """Return a channel, which is an algorithm instance with its own rounds.

        Create it if needed, see `Exchange.open`.
        """
        return self.exchange.open(channel, joinable)

    # The verbs ------------------------------------------------------------------------

    async def neighbors_exchange(
        self,
        data: Any,
        in_neighbors: tuple[int, ...] | None = None,
        out_neighbors: tuple[int, ...] | None = None,
        *,
        channel: str = "main",
        deadline: float | None = None,
        policy: Policy = "raise",
    ) -> dict[int, Any]:
        """Send `data` to the out-neighbours and wait for the same round of every in-neighbour.

        data: one value for all, or a `PerNeighbor` with one for each neighbour
        in_neighbors: senders to wait for; None: those of the graph
        out_neighbors: receivers; None: those of the graph
        deadline: seconds to wait
        policy: at the deadline "raise" RoundTimeout, return the "partial" set, or "hold" the last
            value of the silent neighbours
        Returns {j: value} in increasing j.

        After a RoundTimeout the next exchange continues with the same round: its message is already
        sent.
        Raises RoundTimeout, PeerLost, RosterChanged and CodecError.
        Raises AgentFailed if a neighbour has said that it stops; the exchange then does not wait
        for the deadline.
        Raises ChannelEnded if a neighbour closed the channel before this round, unless we closed it
        there too: such a round would never come.
        """
        ch = self._channels.get(channel) or self.open(channel)
        k = ch.sending
        if k == ch.receiving:
            if k >= ch.limit or ch.changed is not None:
                await self._waits.admit(
                    ch,
                    self.deadline if deadline is None else deadline,
                    policy == "raise",
                )
                k = ch.sending
            if k not in ch.same_graph:
                self._find_neighbors(ch, k)
            self._sender.send_round(
                ch, data, ch.outs if out_neighbors is None else out_neighbors, DATA_KIND
            )
        elif ch.receiving not in ch.same_graph:
            self._find_neighbors(ch, ch.receiving)
        return await self._collect(
            ch, ch.ins if in_neighbors is None else in_neighbors, deadline, policy
        )

    async def send(
        self,
        data: Any,
        neighbors: tuple[int, ...] | None = None,
        *,
        channel: str = "main",
        deadline: float | None = None,
    ) -> None:
        """Send the next message of a channel, for `receive` (one
        each a round) or `asynchronous_receive`.

        Waits only for neighbours that use `receive` and are a whole history behind.
        Raises RoundTimeout, PeerLost or RosterChanged.
        """
        ch = self._channels.get(channel) or self.open(channel)
        if ch.sending >= ch.limit or ch.changed is not None:
            await self._waits.admit(
                ch, self.deadline if deadline is None else deadline, patient=False
            )
        k = ch.sending
        if neighbors is None:
            if k not in ch.same_graph:
                self._find_neighbors(ch, k)
            neighbors = ch.outs
        kind = DATA_KIND if ch.receiving >= k else AHEAD_KIND
        self._sender.send_round(ch, data, neighbors, kind)

    async def receive(
        self,
        neighbors: tuple[int, ...] | None = None,
        *,
        channel: str = "main",
        deadline: float | None = None,
        policy: Policy = "raise",
    ) -> dict[int, Any]:
        """Wait for the next message of every neighbour."""
        ch = self._channels.get(channel) or self.open(channel)
        if neighbors is None:
            if ch.receiving not in ch.same_graph:
                self._find_neighbors(ch, ch.receiving)
            neighbors = ch.ins
        return await self._collect(ch, neighbors, deadline, policy)

    async def asynchronous_receive(
        self,
        neighbors: tuple[int, ...] | None = None,
        *,
        channel: str = "main",
        max_age: float = inf,
    ) -> dict[int, Any]:
        """Return the latest message of each neighbour, without waiting.

        max_age: seconds; older messages are left out
        Returns {j: value}; a neighbour without a message is left out.
        """
        ch = self._channels.get(channel) or self.open(channel)
        if neighbors is None:
            if ch.sending not in ch.same_graph:
                self._find_neighbors(ch, ch.sending)
            neighbors = ch.ins
        oldest_ns = self._clock.now_ns() - max_age * NS_PER_SECOND
        latest = ch.peers.latest
        young = {
            j: message
            for j, (message, born_ns) in latest.items()
            if born_ns >= oldest_ns
        }
        return self._open_all(young, neighbors, ch.peers.takes_malformed)

    async def close(
        self, channel: str = "main", linger: float = CLOSING_RULES.linger_time
    ) -> None:
        """End a channel: send FIN to the neighbours and answer the late
        ones until all have finished or are silent.

        linger: seconds without a question from unfinished neighbours after which the channel is
            closed anyway

        A channel that is used again continues with its next round. For that all drones must have
        closed it in the same round.
        """
        ch = self.open(channel)
        n = ch.closed_at = max(ch.sending, ch.receiving)
        last = self._epochs.at(ch.joinable, max(n - 1, 0)).neighbors(self.id)
        neighbors = tuple(
            dict.fromkeys(
                [*last, *(j for _, readers in ch.sent.values() for j in readers)]
            )
        )
        ends = self._clock.now() + linger
        answers = ch.answers
        attempt = 0
        due_ns = self._clock.now_ns()
        while late := [
            j
            for j in neighbors
            if ch.peers.finished.get(j, -1) < n and not self.exchange.table.is_absent(j)
        ]:
            if ch.answers != answers:
                ends = self._clock.now() + linger
                answers = ch.answers
            if self._clock.now() >= ends or ch.changed is not None:
                return
            # Wait for the timer even if there is news: otherwise each of n neighbours asks n times.
            if self._clock.now_ns() >= due_ns:
                self._sender.send_control(
                    ch, MessageKind.FIN_TOO, tuple(late), n, attempt
                )
                attempt = attempt + 1
                due_ns = self._clock.now_ns() + round(
                    2 * RESEND_TIMES.shortest * NS_PER_SECOND
                )
            await self._waits.pause(ch, (due_ns - self._clock.now_ns()) / NS_PER_SECOND)
        for again in range(attempt, attempt + CLOSING_RULES.end_messages):
            self._sender.send_control(ch, MessageKind.FIN, neighbors, n, again)
        ch.sent.clear()
        ch.oldest = ch.sending

    async def fail(self, word: Failure) -> None:
        """Tell all neighbours that this agent stops on every channel.

        A neighbour that waits for this agent, now or later, gets AgentFailed with `word` instead of
        RoundTimeout at its deadline.
        """
        payload = encode(word)
        flags = self.exchange.table.epoch_flags | AHEAD_KIND
        for k in range(CLOSING_RULES.last_messages):
            readers = self._epochs.at(False, k).out_neighbors(self.id)
            message = Message(ROUND_TOPIC, self.id, payload, k, FAILURE_CHANNEL, flags)
            self.port.send(message, readers)
            await self._clock.sleep(RESEND_TIMES.shortest, drone=self.id)

    # Receiving ------------------------------------------------------------------------

    async def _collect(
        self,
        ch: Channel,
        wanted: tuple[int, ...],
        deadline: float | None,
        policy: Policy,
    ) -> dict[int, Any]:
        """Wait for the messages of the next round to receive, and decode them."""
        k = ch.receiving
        box = ch.inbox.get(k)
        if box is None:
            box = ch.inbox[k] = {}
        missing: dict[int, None] = {}
        for j in wanted:
            if j not in box:
                missing[j] = None
        if missing:
            ch.wait.strict = policy == "raise"
            waiter = self._waits.begin(
                ch, missing, self.deadline if deadline is None else deadline
            )
            try:
                await waiter
            except (RoundTimeout, PeerLost):
                if policy == "raise":
                    raise
            finally:
                ch.wait.end(self._now_ns())
        else:
            ch.wait.own_lateness = 0.0
            if not wanted:
                await self._clock.sleep(0.0, drone=self.id)
        del ch.inbox[k]
        ch.receiving = k + 1
        ch.wait.attempt = 0
        if not k % CREDIT_EVERY:
            self._sender.send_credit(ch, k, wanted)
        if policy == "hold":
            latest = ch.peers.latest
            box = {j: latest[j][0] for j in wanted if j in latest} | box
        return self._open_all(box, wanted, ch.peers.takes_malformed)
