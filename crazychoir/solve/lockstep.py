"""A simulated team on links that lose nothing: one loop plays the rounds of all agents.

If each message takes the same time and none is lost, all agents are always in the same round. Then
a round needs no tasks, no bus and no resends: in the order of their ids the agents take the
messages of the round, make their step, and leave their next message. Values pass the codec as they
do on a network, so what is heard and the counts of messages and bytes are the same. A failure
spreads as the protocol spreads it: one edge a round.
"""

from collections.abc import Mapping, Sequence
from typing import Any, Final

from crazychoir.bus.codec import encode
from crazychoir.bus.impairment.rules import (
    EdgeEffects,
    ImpairmentRule,
    effects_on_edge,
)
from crazychoir.bus.message import NOT_OPENED, Message
from crazychoir.bus.port import Counters
from crazychoir.errors import (
    ChannelEnded,
    CodecError,
    CrazyChoirError,
    refuse_exit,
)
from crazychoir.runtime.clock import NS_PER_SECOND, Clock, run_virtual
from crazychoir.solve.followed_agent import FollowedAgent
from crazychoir.team.algorithm_run import (
    AlgorithmEnded,
    describe_encoding,
    require_alive,
)
from crazychoir.team.communicator import CLOSING_RULES
from crazychoir.team.graph import Graph
from crazychoir.team.round_sender import ROUND_TOPIC, encode_each
from crazychoir.types import Failure, PerNeighbor

MESSAGE_DELAY: Final = 0.001
"""s that each message takes, so that time advances with the rounds."""
_DELAY_NS: Final = round(MESSAGE_DELAY * NS_PER_SECOND)
_CLOSING_MESSAGES: Final = 2 + CLOSING_RULES.end_messages
"""Messages to each neighbour at the end: a question, an answer, and the end of the channel."""


def goes_in_lockstep(
    agents: Mapping[int, Any],
    graph: Graph,
    rules: Sequence[ImpairmentRule],
) -> bool:
    """Return True if all agents are always in the same round, and a LockstepTeam can play them.

    rules: effects of the network on all edges
    """
    i = graph.ids[0]
    return (
        effects_on_edge(rules, i, i) == EdgeEffects(delay=MESSAGE_DELAY)
        and not any(getattr(agent, "asynchronous", False) for agent in agents.values())
        and all(
            graph.in_neighbors(j) and graph.in_neighbors(j) == graph.out_neighbors(j)
            for j in graph.ids
        )
    )


class LockstepTeam:
    """Synchronous agents on an undirected graph; each has a neighbour.

    agents: {id: agent}, by increasing id
    graph: communication graph
    channel: name of the channel of the messages, for the texts of errors

    Attributes:
    errors: {id: error} of the agents that have failed or have ended with another
    has_begun: True when all agents have their first values
    """

    def __init__(
        self, agents: Mapping[int, FollowedAgent], graph: Graph, channel: str
    ) -> None:
        self._agents = agents
        self._channel = channel
        self._neighbors = {i: graph.in_neighbors(i) for i in agents}
        self._counts = {i: Counters() for i in agents}
        self._round = 0
        self._ended_at: dict[int, int] = {}
        self._inboxes: dict[int, dict[int, Message]] = {}
        """{receiver: {sender: message}} of the next round."""
        self._saying = {i: refuse_exit(f"message() of agent {i}") for i in agents}
        self._stepping = {i: refuse_exit(f"step() of agent {i}") for i in agents}
        self.errors: dict[int, CrazyChoirError] = {}
        self.has_begun = False

    @property
    def counters(self) -> list[Counters]:
        """Counts of the messages of each agent."""
        return list(self._counts.values())

    def run(self) -> float:
        """Run all agents until each is done or has failed; return the time of the simulation, s."""
        return run_virtual(self._main)

    async def _main(self, clock: Clock) -> float:
        for i, agent in self._agents.items():
            agent.begin(clock.now, self._counts[i])
        self.has_begun = True
        active = list(self._agents)
        self._inboxes = {i: {} for i in active}
        active = [i for i in active if self._speaks(i)]
        while active:
            inboxes = self._inboxes
            self._inboxes = {i: {} for i in self._agents}
            self._round += 1
            await clock.sleep_until(self._round * _DELAY_NS)  # Ctrl-C ends it here
            active = [i for i in active if self._steps(i, inboxes[i])]
        await clock.sleep_until((self._round + 1) * _DELAY_NS)  # the end of the channel
        return clock.now()

    def _speaks(self, i: int) -> bool:
        """Let agent i send its next message; return False if it is done or has failed."""
        agent = self._agents[i]
        if agent.done:
            self._close(i)
            return False
        try:
            self._send(i, agent)
        except AlgorithmEnded as ended:
            self._fail(i, ended)
            return False
        return True

    def _steps(self, i: int, inbox: dict[int, Message]) -> bool:
        """Let agent i end the round and send its next message; return False if it is at its end."""
        agent = self._agents[i]
        try:
            if len(inbox) < len(self._neighbors[i]):
                raise self._describe_missing(i, inbox)
            try:
                heard = {
                    j: message.open() if message.value is NOT_OPENED else message.value
                    for j, message in inbox.items()
                }
            except CodecError as error:
                told = describe_encoding(i, self._round, error)
                raise AlgorithmEnded.at(i, told) from error
            require_alive(heard)
            try:
                with self._stepping[i]:
                    agent.step(heard)
            except Exception as error:
                raise AlgorithmEnded.at(i, error, heard) from error
            if not agent.done:
                self._send(i, agent)
                return True
        except AlgorithmEnded as ended:
            self._fail(i, ended)
            return False
        self._close(i)
        return False

    def _send(self, i: int, agent: FollowedAgent) -> None:
        """Encode the message of agent i, and put it into the inboxes of its neighbours."""
        k = self._round
        try:
            with self._saying[i]:
                data = agent.message()
        except Exception as error:
            raise AlgorithmEnded.at(i, error) from error
        neighbors = self._neighbors[i]
        try:
            if type(data) is PerNeighbor:
                where = f"drone {i}: channel {self._channel!r}"
                self._post_each(i, encode_each(data, neighbors, where))
                return
            payload = encode(data)
        except CodecError as error:
            raise AlgorithmEnded.at(i, describe_encoding(i, k, error)) from error
        message = Message(ROUND_TOPIC, i, payload, k, self._channel)
        inboxes = self._inboxes
        for j in neighbors:
            inboxes[j][i] = message
        counts = self._counts[i]
        counts.sent += len(neighbors)
        counts.bytes += len(neighbors) * len(payload)

    def _post_each(self, i: int, payloads: Mapping[int, bytes]) -> None:
        """Put a message of its own into the inbox of each neighbour."""
        for j, payload in payloads.items():
            message = Message(ROUND_TOPIC, i, payload, self._round, self._channel)
            self._inboxes[j][i] = message
            self._counts[i].sent += 1
            self._counts[i].bytes += len(payload)

    def _close(self, i: int) -> None:
        """Note that agent i has ended the channel, and count the messages of the end."""
        self._ended_at[i] = self._round
        self._counts[i].sent += _CLOSING_MESSAGES * len(self._neighbors[i])

    def _fail(self, i: int, ended: AlgorithmEnded) -> None:
        """Note the error of agent i, and tell its neighbours in place of its next message."""
        self.errors[i] = ended.error
        word = Failure(ended.failed.agent, ended.failed.reason)
        message = Message(ROUND_TOPIC, i, b"", self._round, self._channel, value=word)
        for j in self._neighbors[i]:
            self._inboxes[j][i] = message

    def _describe_missing(self, i: int, inbox: Mapping[int, Message]) -> AlgorithmEnded:
        """Return the end of agent i: neighbours have ended the channel before this round."""
        k = self._round - 1
        ended = {
            j: self._ended_at[j]
            for j in self._neighbors[i]
            if j not in inbox and j in self._ended_at
        }
        return AlgorithmEnded.by(ChannelEnded(i, self._channel, k, ended))
