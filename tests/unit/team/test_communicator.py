"""The verbs over good and bad networks, in virtual time: the answer may not depend on the network."""

import asyncio
from collections import Counter
from collections.abc import Awaitable, Callable
from typing import Any

import numpy as np
import pytest

from crazychoir.bus.codec import encode
from crazychoir.bus.impairment.model import Impairment
from crazychoir.bus.impairment.rules import ImpairmentRule, NetworkPartition
from crazychoir.bus.message import Message
from crazychoir.bus.port import Bus
from crazychoir.bus.topics import MESSAGE_TOPICS
from crazychoir.errors import (
    AgentFailed,
    ChannelEnded,
    CodecError,
    ConfigError,
    PeerLost,
    RosterChanged,
    RoundTimeout,
)
from crazychoir.runtime.clock import Clock, run_virtual, run_wall
from crazychoir.team import graph as graphs
from crazychoir.team.algorithm_run import run_algorithm
from crazychoir.team.channel import ROUND_WINDOW, Channel
from crazychoir.team.channel_table import CHANNEL_LIMITS, FAILURE_CHANNEL
from crazychoir.team.communicator import Communicator
from crazychoir.team.epochs import Epochs
from crazychoir.team.graph import Graph, GraphSequence, metropolis
from crazychoir.team.message_kind import (
    EPOCH_SHIFT,
    KIND_MASK,
    MessageKind,
    join_contents,
)
from crazychoir.team.round_arrivals import EARLY_LIMITS, FIRST_REFUSED_ROUND
from crazychoir.team.round_sender import MOST_DOUBLE_BYTES
from crazychoir.team.round_waits import LONGEST_UNCHECKED
from crazychoir.types import Failure, PerNeighbor

BAD = {
    "delay": 0.003,
    "jitter": 0.02,
    "duplicate": 0.3,
    "reorder": 0.3,
    "reorder_delay": 0.04,
}
Agent = Callable[[Communicator], Awaitable[Any]]


def swarm(
    graph: Graph | GraphSequence,
    agent: Agent,
    rules: list[ImpairmentRule] | None = None,
    *,
    seed: int = 1,
    partitions: list[NetworkPartition] | None = None,
    gone: tuple[int, ...] = (),
    deadline: float = 60.0,
) -> dict[int, Any]:
    """What `agent` returns for each drone, all in one process in virtual time; a second later, so that all is quiet."""

    async def main(clock: Clock) -> dict[int, Any]:
        bus = Bus(clock, Impairment(seed, rules or [], partitions or []))
        bus.impairment.begin(clock.now())
        team = [Communicator(bus.port(i), graph, deadline=deadline) for i in graph.ids]
        found = await asyncio.gather(*(agent(c) for c in team if c.id not in gone))
        return dict(zip([i for i in graph.ids if i not in gone], found, strict=True))

    return run_virtual(main)


def begin_epoch(
    c: Communicator,
    gone: tuple[int, ...],
    epoch: int,
    joined: tuple[int, ...] = (),
) -> None:
    c.exchange.table.begin_epoch(epoch, gone, joined)
    c.exchange.arrivals.replay()


def loss(p: float, **more: float) -> list[ImpairmentRule]:
    return [ImpairmentRule({"loss": p, **more})]


def averaging(
    graph: Graph | GraphSequence, rounds: int, channel: str = "main"
) -> Agent:
    """Average consensus; returns the bytes of all iterates."""

    async def agent(c: Communicator) -> bytes:
        x = np.array([c.id, 1.0 / (1 + c.id), np.sin(c.id)])
        iterates = b""
        for k in range(rounds):
            heard = await c.neighbors_exchange(x, channel=channel)
            w = metropolis(graph.at(k))[c.id]
            x = w[c.id] * x + sum(w[j] * value for j, value in heard.items())
            iterates += x.tobytes()
        await c.close(channel)
        return iterates

    return agent


@pytest.fixture
def calls(monkeypatch) -> Counter[str]:
    """Calls of parts of the package, by name of the function."""
    counted: Counter[str] = Counter()

    def count(owner: type, name: str) -> None:
        original = getattr(owner, name)

        def counting(*arguments: Any) -> Any:
            counted[name] += 1
            return original(*arguments)

        monkeypatch.setattr(owner, name, counting)

    count(Channel, "trim")
    count(Epochs, "at")
    return counted


@pytest.mark.parametrize("answers", [False, True])
def test_messages_of_a_long_channel_are_forgotten_together(calls, answers):
    rounds = 40 * ROUND_WINDOW.forgotten_at_once

    async def ask(c: Communicator) -> None:
        for k in range(rounds):
            await c.send(k)
            if answers:
                assert await c.receive() == {1: k}
            ch = c.open("main")
            kept = ch.sending - ch.oldest
            assert kept == len(ch.sent)
            least = min(ch.sending, ROUND_WINDOW.kept_rounds)
            assert least <= kept <= least + ROUND_WINDOW.forgotten_at_once

    async def answer(c: Communicator) -> None:
        for k in range(rounds if answers else 0):
            assert await c.receive() == {0: k}
            await c.send(k)

    async def agent(c: Communicator) -> None:
        await (ask(c) if c.id == 0 else answer(c))

    swarm(graphs.path(2), agent)
    assert calls["trim"] <= (1 + answers) * rounds / ROUND_WINDOW.forgotten_at_once


def test_all_verbs_find_the_neighbours_of_a_lasting_graph_once(calls):
    async def agent(c: Communicator) -> None:
        for k in range(10):
            await c.send(k)
            await c.receive()
            await c.asynchronous_receive()
            await c.neighbors_exchange(k)

    swarm(graphs.ring(3), agent)
    assert calls["at"] == 3


def test_a_drone_that_has_sent_ahead_receives_from_the_neighbours_of_each_round():
    graph = GraphSequence(
        tuple(
            Graph.from_edges(3, edges, directed=True)
            for edges in ([[0, 1], [1, 2], [2, 0]], [[1, 0], [2, 1], [0, 2]])
        )
    )

    async def agent(c: Communicator) -> list[list[int]]:
        for k in range(4):
            await c.send(k)
        return [list(await c.receive()) for _ in range(4)]

    assert swarm(graph, agent) == {
        i: [list(graph.at(k).in_neighbors(i)) for k in range(4)] for i in range(3)
    }


def in_a_loop(graph: Graph, rounds: int) -> dict[int, bytes]:
    """The same iterates by a for loop."""
    x = {i: np.array([i, 1.0 / (1 + i), np.sin(i)]) for i in graph.ids}
    w, iterates = metropolis(graph), dict.fromkeys(graph.ids, b"")
    for _ in range(rounds):
        x = {
            i: w[i][i] * x[i] + sum(w[i][j] * x[j] for j in graph.in_neighbors(i))
            for i in graph.ids
        }
        iterates = {i: iterates[i] + x[i].tobytes() for i in graph.ids}
    return iterates


# The same answer on every network -------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "graph",
    [graphs.ring(5), graphs.star(6), graphs.complete(4), graphs.path(2)],
    ids=lambda graph: str(len(graph.arcs)),
)
@pytest.mark.parametrize(
    "network",
    [None, loss(0.2), loss(0.5), loss(0.5, **BAD), loss(0.2, **BAD)],
    ids="abcde",
)
def test_average_consensus_has_the_same_bits_on_every_network(graph, network):
    assert swarm(graph, averaging(graph, 40), network) == in_a_loop(graph, 40)


@pytest.mark.parametrize("seed", range(6))
def test_bursts_of_loss_do_not_change_a_bit(seed):
    graph = graphs.k_regular(8, 4)
    network = [
        ImpairmentRule({"p_good_bad": 0.1, "p_bad_good": 0.2, "loss_bad": 0.95, **BAD})
    ]
    assert swarm(graph, averaging(graph, 15), network, seed=seed) == in_a_loop(
        graph, 15
    )


def test_a_graph_that_changes_with_the_round():
    sequence = GraphSequence.draw(graphs.complete(5), 0.3, 7, seed=3)
    assert any(
        not graph.neighbors(i) for graph in sequence.graphs for i in graph.ids
    ), "an agent is alone in a round"
    good = swarm(sequence, averaging(sequence, 300))
    assert swarm(sequence, averaging(sequence, 300), loss(0.4, **BAD)) == good
    ends = [np.frombuffer(iterates, dtype=float)[-3:] for iterates in good.values()]
    mean = np.mean([[i, 1.0 / (1 + i), np.sin(i)] for i in range(5)], axis=0)
    np.testing.assert_allclose(ends, [mean] * 5, atol=1e-9)


def test_each_round_of_a_changing_graph_has_its_own_neighbours():
    sequence = GraphSequence(
        (graphs.path(3), Graph.from_edges(3, [[0, 2]]), graphs.empty(3))
    )

    async def agent(c: Communicator) -> list[dict[int, int]]:
        return [await c.neighbors_exchange(10 * k + c.id) for k in range(4)]

    heard = swarm(sequence, agent, loss(0.3))
    assert heard[0] == [{1: 1}, {2: 12}, {}, {1: 31}]
    assert heard[1] == [{0: 0, 2: 2}, {}, {}, {0: 30, 2: 32}]


@pytest.mark.parametrize("p", [0.0, 0.5])
def test_a_directed_ring(p):
    async def agent(c: Communicator) -> list[int]:
        x, seen = c.id, []
        for _ in range(3 * ROUND_WINDOW.kept_rounds):
            (x,) = (await c.neighbors_exchange(x)).values()
            seen.append(x)
        await c.close()
        return seen

    heard = swarm(graphs.ring(4, directed=True), agent, loss(p, **BAD))
    assert heard[2] == [(1 - k) % 4 for k in range(3 * ROUND_WINDOW.kept_rounds)]


def test_each_payload_reaches_its_own_neighbour_only():
    async def agent(c: Communicator) -> list[dict[int, str]]:
        neighbors = c.graph.at(0).neighbors(c.id)
        return [
            await c.neighbors_exchange(
                PerNeighbor({j: f"{c.id}>{j} {k}" for j in neighbors})
            )
            for k in range(5)
        ]

    for i, rounds in swarm(graphs.ring(4), agent, loss(0.5)).items():
        assert rounds == [
            {j: f"{j}>{i} {k}" for j in sorted([(i - 1) % 4, (i + 1) % 4])}
            for k in range(5)
        ]


def test_neighbours_named_in_the_call():
    async def agent(c: Communicator) -> dict[int, int]:
        if c.id == 0:
            return await c.neighbors_exchange(7, in_neighbors=(), out_neighbors=(2,))
        return await c.neighbors_exchange(
            8, in_neighbors=(0,) if c.id == 2 else (), out_neighbors=()
        )

    assert swarm(graphs.complete(3), agent, loss(0.5)) == {0: {}, 1: {}, 2: {0: 7}}


def test_send_and_receive_are_rounds_too():
    async def agent(c: Communicator) -> list[dict[int, int]]:
        heard = []
        for k in range(100):
            await c.send(100 * c.id + k)
            heard.append(await c.receive())
        await c.close()
        return heard

    assert swarm(graphs.path(2), agent, loss(0.5, **BAD))[0] == [
        {1: 100 + k} for k in range(100)
    ]


def test_a_sender_ahead_of_its_peer_does_not_acknowledge_unread_rounds():
    async def agent(c: Communicator) -> Any:
        for k in range(3):
            await c.send(k)
        return c.open("main").peers.progress.get(1 - c.id, 0)

    assert swarm(graphs.path(2), agent) == {0: 0, 1: 0}


def test_an_exchange_after_a_send_completes_its_round():
    async def agent(c: Communicator) -> Any:
        await c.send(c.id)
        return [await c.neighbors_exchange(10 + c.id) for _ in range(2)]

    assert swarm(graphs.path(2), agent) == {0: [{1: 1}, {1: 11}], 1: [{0: 0}, {0: 10}]}


async def wait_after_the_end(c: Communicator) -> None:
    """End a channel, and wait on it all the same."""
    await c.close("main", linger=0.0)
    with pytest.raises(RoundTimeout):
        await c.receive((1,), deadline=1.0)


def test_a_channel_on_which_a_caller_waits_is_neither_replaced_nor_removed():
    async def agent(c: Communicator) -> None:
        c.open("main")
        async with asyncio.TaskGroup() as group:
            group.create_task(wait_after_the_end(c))
            await c.port.bus.clock.sleep(0.5)
            with pytest.raises(ConfigError, match="joinable"):
                c.open("main", joinable=True)
            for n in range(CHANNEL_LIMITS.most_open - 1):
                c.open(f"channel {n}")
            with pytest.raises(ConfigError, match="channels at once"):
                c.open("one more")

    swarm(graphs.path(2), agent, gone=(1,))


@pytest.mark.parametrize("lost", [7, 10, 60])
def test_a_sender_keeps_messages_that_were_not_yet_requested(lost):
    """The reader's credit is lost, and so is one message; it asks for it when the sender is ten rounds on."""
    graph = Graph.from_edges(2, [[0, 1]], directed=True)

    async def agent(c: Communicator) -> list[int]:
        send = c.port.send
        if c.id == 0:
            c.port.send = lambda message, to, *attempt: (  # type: ignore[method-assign]
                send(message, to, *attempt)
                if message.number != lost or attempt
                else None
            )
            for k in range(ROUND_WINDOW.kept_rounds + 6):
                await c.send(k)
            return []
        c.port.send = lambda message, to, *attempt: (
            send(message, to, *attempt)
            if message.flags & KIND_MASK != MessageKind.CREDIT
            else None
        )  # type: ignore[method-assign]
        await c.port.bus.clock.sleep(0.1)
        return [
            value
            for _ in range(ROUND_WINDOW.kept_rounds)
            for value in (await c.receive()).values()
        ]

    async def early(c: Communicator) -> list[int]:
        c.open("main")
        return await agent(c)

    assert swarm(graph, early)[1] == list(range(ROUND_WINDOW.kept_rounds))


def test_channels_do_not_meet():
    async def agent(c: Communicator) -> tuple[Any, ...]:
        return tuple(
            await asyncio.gather(
                *(averaging(graphs.ring(4), 5 + n, f"channel {n}")(c) for n in range(4))
            )
        )

    found = swarm(graphs.ring(4), agent, loss(0.5))
    assert [found[2][n] for n in range(4)] == [
        in_a_loop(graphs.ring(4), 5 + n)[2] for n in range(4)
    ]


def test_a_late_starter_costs_only_time():
    async def agent(c: Communicator) -> bytes:
        await c.port.bus.clock.sleep(1.7 * c.id)
        return await averaging(graphs.ring(3), 10)(c)

    assert swarm(graphs.ring(3), agent, loss(0.3)) == in_a_loop(graphs.ring(3), 10)


def test_a_partition_in_the_middle_costs_time_only():
    graph = graphs.ring(6)
    clocks: list[float] = []

    async def agent(c: Communicator) -> bytes:
        clock, x = c.port.bus.clock, await averaging(graph, 200)(c)
        clocks.append(clock.now())
        return x

    network = [ImpairmentRule({"delay": 0.01})]
    assert swarm(
        graph, agent, network, partitions=[NetworkPartition(1.0, 2.5, (0, 1, 2))]
    ) == in_a_loop(graph, 200)
    assert 3.5 < max(clocks) < 4.5


def test_a_run_repeats_to_the_last_message():
    async def agent(c: Communicator) -> tuple[float, int, int, int]:
        await averaging(graphs.k_regular(6, 4), 30)(c)
        counters = c.port.counters
        return (
            c.port.bus.clock.now(),
            counters.sent,
            counters.received,
            counters.resent,
        )

    runs = [
        swarm(graphs.k_regular(6, 4), agent, loss(0.4, **BAD), seed=s)
        for s in (5, 5, 6)
    ]
    assert runs[0] == runs[1] != runs[2]


def test_resends_are_few():
    """At loss p a message is needed 1 / (1 - p) times; answers and what overtakes them may double it."""
    graph, rounds = graphs.ring(6), 100
    sent: dict[int, int] = {}

    async def agent(c: Communicator) -> float:
        await averaging(graph, rounds)(c)
        sent[c.id] = c.port.counters.sent
        return c.port.bus.clock.now()

    ends = {}
    for p, most in ((0.0, 1.05), (0.2, 2.2), (0.5, 4.5)):
        ends[p] = max(swarm(graph, agent, loss(p)).values())
        assert sum(sent.values()) / (6 * 2 * rounds) < most
    assert ends[0.2] < 1.5
    assert ends[0.5] < 4.0


# Latest values, without waiting -----------------------------------------------------------------------------------


def test_the_latest_of_each_never_waits_and_grows_old():
    async def agent(c: Communicator) -> list[dict[int, int]]:
        clock = c.port.bus.clock
        if c.id == 1:
            await clock.sleep(0.1)
            for value in range(3 * ROUND_WINDOW.kept_rounds):
                await c.send(value)
            return []
        found = [await c.asynchronous_receive()]
        await clock.sleep(0.3)
        assert clock.now() == pytest.approx(0.3)
        found += [await c.asynchronous_receive(), await c.asynchronous_receive((2,))]
        return [
            *found,
            await c.asynchronous_receive(max_age=0.25),
            await c.asynchronous_receive(max_age=0.15),
        ]

    heard = swarm(graphs.star((1, 0, 2)), agent, gone=(2,))[0]
    assert heard == [
        {},
        {1: 3 * ROUND_WINDOW.kept_rounds - 1},
        {},
        {1: 3 * ROUND_WINDOW.kept_rounds - 1},
        {},
    ]


def test_an_overtaken_message_is_not_the_latest_and_delay_is_age():
    age = float("inf")

    async def agent(c: Communicator) -> Any:
        clock = c.port.bus.clock
        if c.id == 1:
            for value in range(20):
                await c.send(value)
                await clock.sleep(0.01)
            return None
        seen = []
        for _ in range(400):
            await clock.sleep(0.001)
            seen += (await c.asynchronous_receive(max_age=age)).values()
        return seen

    seen = swarm(
        graphs.path(2), agent, [ImpairmentRule({"delay": 0.1, "jitter": 0.1})]
    )[0]
    assert seen == sorted(seen)
    assert seen[-1] == 19
    age = 0.15
    assert swarm(graphs.path(2), agent, [ImpairmentRule({"delay": 0.16})])[0] == []


# Slow agents and lost agents --------------------------------------------------------------------------------------


@pytest.mark.parametrize("p", [0.0, 0.5])
def test_a_fast_source_waits_for_its_readers(p):
    graph = Graph.from_edges(2, [[0, 1]], directed=True)
    lead: list[int] = []
    here: dict[int, Communicator] = {}

    async def agent(c: Communicator) -> list[int]:
        here[c.id] = c
        if c.id == 0:
            for k in range(5 * ROUND_WINDOW.kept_rounds):
                await c.neighbors_exchange(k)
                lead.append(k - here[1].open("main").receiving)
            await c.close()
            return []
        got = []
        for _ in range(5 * ROUND_WINDOW.kept_rounds):
            await c.port.bus.clock.sleep(0.005)
            got += (await c.neighbors_exchange(None)).values()
        await c.close()
        return got

    assert swarm(graph, agent, loss(p))[1] == list(range(5 * ROUND_WINDOW.kept_rounds))
    assert ROUND_WINDOW.kept_rounds // 2 < max(lead) <= ROUND_WINDOW.kept_rounds + 1
    assert here[1].ahead == 0
    assert p or not here[0].port.counters.resent, (
        "credit comes before the source has to ask"
    )


def test_a_sender_waits_for_its_receiver():
    async def agent(c: Communicator) -> list[int]:
        if c.id == 0:
            await c.port.bus.clock.sleep(0.1)
            for k in range(4 * ROUND_WINDOW.kept_rounds):
                await c.send(k)
            await c.close()
            return []
        got = [
            value
            for _ in range(4 * ROUND_WINDOW.kept_rounds)
            for value in (await c.receive()).values()
        ]
        await c.close()
        return got

    got = swarm(
        Graph.from_edges(2, [[0, 1]], directed=True), agent, loss(0.3, delay=0.005)
    )[1]
    assert got == list(range(4 * ROUND_WINDOW.kept_rounds))


def test_what_a_reader_lacks_is_asked_for():
    """All first messages of the source are lost: only WANT can bring them."""
    graph = Graph.from_edges(2, [[0, 1]], directed=True)

    async def agent(c: Communicator) -> Any:
        if c.id == 0:
            send, c.port.send = (
                c.port.send,
                lambda message, to, attempt=0: (
                    send(message, to, attempt) if attempt else None
                ),
            )  # type: ignore[method-assign]
        return [await c.neighbors_exchange(k) for k in range(10)]

    assert swarm(graph, agent)[1] == [{0: k} for k in range(10)]


def test_a_ring_of_missing_messages_heals():
    """Each lacks the message of the one before it, and has that of the one after."""

    async def agent(c: Communicator) -> dict[int, int]:
        send, after = c.port.send, (c.id + 1) % 3

        def lossy(message: Message, to: tuple[int, ...], *attempt: int) -> None:
            kind = message.flags & KIND_MASK
            first = kind == MessageKind.DATA and not attempt
            to = tuple(j for j in to if not (first and j == after))
            send(message, to, *attempt)

        c.port.send = lossy  # type: ignore[method-assign, assignment]
        return await c.neighbors_exchange(c.id)

    assert swarm(graphs.ring(3), agent, deadline=1.0) == {
        0: {1: 1, 2: 2},
        1: {0: 0, 2: 2},
        2: {0: 0, 1: 1},
    }


def test_a_duplicate_of_a_finished_round_is_not_answered():
    """Otherwise two finished agents would answer each other for ever."""

    async def agent(c: Communicator) -> int:
        await c.neighbors_exchange(1)
        before = c.port.counters.sent
        for kind in (MessageKind.DATA, MessageKind.AHEAD):
            c.port.bus.deliver(
                Message(MESSAGE_TOPICS.rounds, 1 - c.id, encode(1), 0, "main", kind),
                (c.port.address,),
                0.0,
            )
        await c.port.bus.clock.sleep(1.0)
        return c.port.counters.sent - before

    assert swarm(graphs.path(2), agent) == {0: 0, 1: 0}


@pytest.mark.parametrize("seconds", [0.001, 0.0123, 0.5])
def test_a_deadline_names_the_missing_and_is_kept(seconds):
    async def agent(c: Communicator) -> Any:
        clock = c.port.bus.clock
        other = asyncio.ensure_future(c.receive(channel="other"))
        await clock.sleep(0.0)
        with pytest.raises(
            RoundTimeout,
            match=r"channel 'plan', round 0: nothing from neighbour\(s\) 1, 3",
        ) as caught:
            await c.neighbors_exchange(c.id, channel="plan", deadline=seconds)
        assert clock.now() == pytest.approx(seconds, abs=1e-6)
        other.cancel()
        return caught.value.missing

    assert swarm(graphs.ring(4), agent, gone=(1, 3)) == {0: (1, 3), 2: (1, 3)}


def test_after_a_timeout_the_same_round_goes_on():
    async def agent(c: Communicator) -> list[dict[int, int]]:
        if c.id == 1:
            await c.port.bus.clock.sleep(0.5)
        else:
            with pytest.raises(RoundTimeout):
                await c.neighbors_exchange(0, deadline=0.2)
        return [await c.neighbors_exchange(k) for k in range(3)]

    assert swarm(graphs.path(2), agent) == {
        0: [{1: 0}, {1: 1}, {1: 2}],
        1: [{0: 0}, {0: 1}, {0: 2}],
    }


def test_partial_and_hold():
    async def agent(c: Communicator) -> Any:
        if c.id == 2:
            return [await c.neighbors_exchange(20 + k) for k in range(2)]
        heard = []
        for k in range(3 * ROUND_WINDOW.kept_rounds):
            policy = "hold" if c.id == 0 else "partial"
            heard.append(
                await c.neighbors_exchange(
                    10 * c.id + k % 2, deadline=0.05, policy=policy
                )
            )
        return heard

    found = swarm(graphs.complete(3), agent)
    assert found[0][:3] == [{1: 10, 2: 20}, {1: 11, 2: 21}, {1: 10, 2: 21}]
    assert found[0][-1] == {1: 11, 2: 21}
    assert found[1][:3] == [{0: 0, 2: 20}, {0: 1, 2: 21}, {0: 0}]
    assert found[1][-1] == {0: 1}


class Lost:
    """A membership that loses a drone at some time."""

    def __init__(self, clock: Clock, gone: int, when: float) -> None:
        self.clock, self.gone, self.when = clock, gone, when

    def is_lost(self, j: int) -> bool:
        return j == self.gone and self.clock.now() >= self.when


@pytest.mark.parametrize("policy", ["raise", "partial"])
def test_a_lost_neighbour(policy):
    async def agent(c: Communicator) -> Any:
        c.exchange.table.membership = Lost(c.port.bus.clock, 1, 0.3)
        if policy == "partial":
            return await c.neighbors_exchange(c.id, policy="partial")
        with pytest.raises(
            PeerLost, match=rf"drone {c.id}: lost drone\(s\) 1"
        ) as caught:
            await c.neighbors_exchange(c.id)
        assert c.port.bus.clock.now() < 0.3 + 2e-9 * LONGEST_UNCHECKED
        return caught.value.lost

    found = swarm(graphs.ring(4), agent, gone=(1, 3))
    assert found == ({0: {}, 2: {}} if policy == "partial" else {0: (1,), 2: (1,)})


def test_a_lost_drone_counts_as_silent_since_it_was_heard_last():
    async def agent(c: Communicator) -> str:
        await c.neighbors_exchange(c.id)
        if c.id == 1:
            return ""
        c.exchange.table.membership = Lost(c.port.bus.clock, 1, 3.0)
        await c.port.bus.clock.sleep(3.5)
        with pytest.raises(PeerLost) as caught:
            await c.neighbors_exchange(c.id)
        assert caught.value.seconds == pytest.approx(3.5, abs=0.1)
        return str(caught.value)

    found = swarm(graphs.complete(2), agent)
    assert found[0].startswith("drone 0: lost drone(s) 1: silent for 3.5")


def test_a_source_hears_that_its_reader_is_lost():
    async def agent(c: Communicator) -> int:
        c.exchange.table.membership = Lost(c.port.bus.clock, 1, 0.3)
        for _ in range(ROUND_WINDOW.kept_rounds):
            await c.neighbors_exchange(0)
        with pytest.raises(PeerLost):
            await c.neighbors_exchange(0)
        return c.rounds

    assert swarm(Graph.from_edges(2, [[0, 1]], directed=True), agent, gone=(1,)) == {
        0: ROUND_WINDOW.kept_rounds
    }


# The end ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("p", [0.0, 0.5])
def test_the_last_round_reaches_everybody_and_closing_is_quick(p):
    async def agent(c: Communicator) -> float:
        clock = c.port.bus.clock
        await averaging(graphs.ring(8), 10)(c)
        ended = clock.now()
        del c.port.bus.ports[c.id]  # the process ends
        return ended

    for seed in range(10):
        ends = swarm(graphs.ring(8), agent, loss(p), seed=seed)
        assert max(ends.values()) < (0.05 if p == 0.0 else 4.5)


@pytest.mark.parametrize("p", [0.0, 0.5])
def test_closing_serves_the_neighbours_of_earlier_rounds_too(p):
    """1 ends a round with 2, and 0 may still lack its message of the round before."""
    sequence = GraphSequence(
        (graphs.Graph.from_edges(3, [[0, 1]]), graphs.Graph.from_edges(3, [[1, 2]]))
    )

    async def agent(c: Communicator) -> list[dict[int, int]]:
        heard = [await c.neighbors_exchange(c.id) for _ in range(2)]
        await c.close()
        del c.port.bus.ports[c.id]
        return heard

    for seed in range(10):
        found = swarm(sequence, agent, loss(p), seed=seed)
        assert found == {0: [{1: 1}, {}], 1: [{0: 0}, {2: 2}], 2: [{}, {1: 1}]}


def test_closing_waits_for_the_late_and_not_for_the_lost():
    async def agent(c: Communicator) -> float:
        clock = c.port.bus.clock
        c.exchange.table.membership = Lost(clock, 2, 1.2)
        await c.neighbors_exchange(c.id, (1 - c.id,), (1 - c.id,))
        await clock.sleep(1.0 * c.id)
        await c.close()
        return clock.now()

    ends = swarm(graphs.complete(3), agent, gone=(2,))
    assert ends[0] == pytest.approx(1.2, abs=0.03)
    assert ends[1] == pytest.approx(1.2, abs=0.03)


def test_closing_lingers_for_drones_that_still_ask():
    """All that 0 sends is lost for two seconds, but 1 can be heard asking."""

    async def agent(c: Communicator) -> float:
        clock, bus = c.port.bus.clock, c.port.bus
        clock.call_at(2 * 10**9, bus.impairment.replace, ())
        await c.neighbors_exchange(c.id)
        await c.close(linger=0.5)
        bus.ports.pop(c.id, None)
        return clock.now()

    ends = swarm(
        graphs.path(2),
        agent,
        [ImpairmentRule({"loss": 1.0}, edge=(0, 1), directed=True)],
    )
    assert max(ends.values()) < 2.3


def test_an_open_channel_does_not_report_that_it_is_closed():
    async def agent(c: Communicator) -> int:
        c.open("main")
        c.port.bus.deliver(
            Message(
                MESSAGE_TOPICS.rounds, 1 - c.id, b"", 0, "main", MessageKind.FIN_TOO
            ),
            (c.port.address,),
            0.0,
        )
        return c.port.counters.sent

    assert swarm(graphs.path(2), agent) == {0: 0, 1: 0}


def test_closing_ends_after_its_linger():
    async def agent(c: Communicator) -> float:
        await c.close(linger=0.7)
        return c.port.bus.clock.now()

    assert swarm(graphs.path(2), agent, gone=(1,))[0] == pytest.approx(0.7, abs=0.03)


def ending(rounds: dict[int, int], linger: float = 2.0, **options: Any) -> Agent:
    """Each drone ends after its own number of rounds; returns when, and the error that it got instead."""

    async def agent(c: Communicator) -> tuple[float, ChannelEnded | None]:
        try:
            for k in range(rounds[c.id]):
                await c.neighbors_exchange(k, channel="optimize", **options)
        except ChannelEnded as error:
            return c.port.bus.clock.now(), error
        await c.close("optimize", linger=linger)
        return c.port.bus.clock.now(), None

    return agent


@pytest.mark.parametrize(("p", "soon"), [(0.0, 0.1), (0.5, 1.0)])
def test_waiting_for_a_drone_that_has_ended_fails_at_once(p, soon):
    for seed in range(10):
        found = swarm(graphs.path(3), ending({0: 9, 1: 6, 2: 6}), loss(p), seed=seed)
        at, error = found[0]
        assert isinstance(error, ChannelEnded)
        assert (error.drone, error.channel, error.k, error.ended) == (
            0,
            "optimize",
            6,
            {1: 6},
        )
        assert (
            "drone 1 has ended it after 6 round(s), 0 to 5; all must end in the same round"
            in str(error)
        )
        assert at < soon
        assert (found[1][1], found[2][1]) == (None, None)


def test_a_drone_that_has_ended_and_gone_on_still_reports_it_when_asked():
    """All that 1 says of its end is lost, and it no longer lingers when 0 can hear it again."""

    async def agent(c: Communicator) -> tuple[float, ChannelEnded | None]:
        clock, bus = c.port.bus.clock, c.port.bus
        if c.id == 1:
            await c.neighbors_exchange(0, channel="optimize")
            bus.impairment.replace(
                [ImpairmentRule({"loss": 1.0}, edge=(1, 0), directed=True)]
            )
            clock.call_at(10**9, bus.impairment.replace, ())
        return await ending({0: 3, 1: 0}, linger=0.3)(c)

    at, error = swarm(graphs.path(2), agent)[0]
    assert isinstance(error, ChannelEnded)
    assert 1.0 < at < 1.3


@pytest.mark.parametrize("p", [0.0, 0.5])
def test_a_drone_that_has_ended_still_serves_its_late_neighbours(p):
    """No error while what was said before the end may still come: 0 needs all rounds, and gets them late."""

    async def agent(c: Communicator) -> list[int]:
        heard = []
        for k in range(8):
            await c.port.bus.clock.sleep(0.3 * (c.id == 0))
            heard += (await c.neighbors_exchange(k)).values()
        await c.close(linger=0.2)
        return heard

    for seed in range(10):
        assert swarm(
            graphs.ring(4), agent, loss(p, delay=0.02, reorder=0.2), seed=seed
        )[0] == sorted([*range(8)] * 2)


@pytest.mark.parametrize("p", [0.0, 0.5])
def test_a_channel_that_all_have_ended_together_goes_on(p):
    async def agent(c: Communicator) -> list[int]:
        heard = []
        for _ in range(3):
            for k in range(4):
                await c.port.bus.clock.sleep(0.02 * c.id)
                heard += (await c.neighbors_exchange(k)).values()
            await c.close(linger=0.5)
        return heard

    for seed in range(10):
        assert swarm(graphs.path(2), agent, loss(p), seed=seed) == dict.fromkeys(
            range(2), [*range(4)] * 3
        )


def test_a_partial_exchange_with_an_ended_drone_returns_what_came():
    agent = ending({0: 7, 1: 6}, policy="partial", deadline=0.5)
    at, error = swarm(graphs.path(2), agent)[0]
    assert error is None
    assert at >= 0.5


def test_a_closed_channel_goes_on_where_it_was():
    async def agent(c: Communicator) -> tuple[bytes, bytes, int]:
        first = await averaging(graphs.ring(4), 10)(c)
        return first, await averaging(graphs.ring(4), 10)(c), c.open("main").sending

    for i, found in swarm(graphs.ring(4), agent, loss(0.5)).items():
        assert found == (*[in_a_loop(graphs.ring(4), 10)[i]] * 2, 20)


# What comes from elsewhere ----------------------------------------------------------------------------------------


def test_a_flood_of_unknown_messages_takes_no_memory_and_disturbs_no_exchange():
    async def agent(c: Communicator) -> Any:

        def deliver(*parts: Any) -> None:
            message = Message(MESSAGE_TOPICS.rounds, *parts)
            c.port.bus.deliver(message, (c.id,), 0.0)

        for n in range(3000):
            deliver(
                1 - c.id,
                b"x" * 2000,
                0,
                f"name {n}",
                MessageKind.DATA,
            )
            deliver(
                1 - c.id,
                b"x" * (EARLY_LIMITS.most_bytes + 1),
                0,
                "large",
                MessageKind.DATA,
            )
            deliver(
                1 - c.id,
                b"x",
                ROUND_WINDOW.kept_rounds + n,
                "main",
                n % 8,
            )
            deliver(
                1 - c.id,
                b"x",
                FIRST_REFUSED_ROUND << (n % 100),
                "main",
                n % 8,
            )
            deliver(
                77 + n,
                b"x",
                0,
                "main",
                MessageKind.DATA,
            )
            deliver(
                1 - c.id,
                b"x",
                0,
                "main",
                n + 1 << EPOCH_SHIFT,
            )
        kept = [len(message.payload) for message, _ in c.exchange.arrivals._early]
        assert len(kept) == EARLY_LIMITS.most_kept
        assert max(kept) <= EARLY_LIMITS.most_bytes
        ch = c.open("main")
        assert list(c.exchange.table.channels) == [FAILURE_CHANNEL, "main"]
        assert (
            len(ch.inbox)
            + len(ch.peers.latest)
            + len(ch.peers.progress)
            + len(ch.peers.finished)
            < 10
        )
        return [await c.neighbors_exchange(10 * k + c.id) for k in range(30)]

    assert swarm(graphs.path(2), agent)[0] == [{1: 10 * k + 1} for k in range(30)]


def test_rounds_far_ahead_are_dropped_and_counted():
    async def agent(c: Communicator) -> tuple[int, int]:
        ch = c.open("main")
        for number in (
            0,
            ROUND_WINDOW.kept_rounds - 1,
            ROUND_WINDOW.kept_rounds,
            10**9,
        ):
            c.port.bus.deliver(
                Message(
                    MESSAGE_TOPICS.rounds,
                    1 - c.id,
                    encode(1),
                    number,
                    "main",
                    MessageKind.DATA,
                ),
                (c.port.address,),
                0.0,
            )
        return len(ch.inbox), c.ahead

    assert swarm(graphs.path(2), agent)[0] == (2, 2)


def test_too_many_channels_are_refused_and_closed_ones_make_room():
    async def agent(c: Communicator) -> None:
        for n in range(CHANNEL_LIMITS.most_open + 20):
            await c.neighbors_exchange(n, channel=f"{n}")
            await c.close(f"{n}")
        for n in range(CHANNEL_LIMITS.most_open):
            await c.neighbors_exchange(n, channel=f"again {n}")
        with pytest.raises(
            ConfigError,
            match=f"drone 0: channel 'more': found {CHANNEL_LIMITS.most_open}; allowed",
        ):
            await c.neighbors_exchange(0, channel="more")

    swarm(graphs.empty(1), agent)


def test_an_undecodable_message_is_an_error_of_its_reader():
    async def agent(c: Communicator) -> int:
        if c.id == 1:
            c.port.send(
                Message(
                    MESSAGE_TOPICS.rounds,
                    c.port.address,
                    b"\xff",
                    0,
                    "main",
                    MessageKind.DATA,
                ),
                (0,),
            )
            return 0
        with pytest.raises(CodecError):
            await c.neighbors_exchange(1)
        return c.port.counters.malformed

    assert swarm(graphs.path(2), agent)[0] == 1


@pytest.mark.parametrize("kind", range(MessageKind.GONE + 1, KIND_MASK + 1))
def test_messages_of_unknown_kinds_are_dropped(kind):
    async def agent(c: Communicator) -> int:
        if c.id == 1:
            c.port.send(
                Message(
                    MESSAGE_TOPICS.rounds, c.port.address, encode("x"), 5, "main", kind
                ),
                (0,),
            )
        found = await c.neighbors_exchange(c.id)
        assert found == {1 - c.id: 1 - c.id}
        assert not c.open("main").peers.finished
        return c.port.counters.malformed

    assert swarm(graphs.path(2), agent) == {0: 1, 1: 0}


@pytest.mark.parametrize(
    "content", [b"", b"\x05", (9).to_bytes(4, "little") + b"12345678"]
)
def test_a_message_of_two_rounds_that_is_too_short_is_dropped(content):
    async def agent(c: Communicator) -> int:
        if c.id == 1:
            kind = MessageKind.DOUBLE
            c.port.send(
                Message(
                    MESSAGE_TOPICS.rounds, c.port.address, content, 5, "main", kind
                ),
                (0,),
            )
        assert await c.neighbors_exchange(c.id) == {1 - c.id: 1 - c.id}
        assert list(c.open("main").inbox) == []
        return c.port.counters.malformed

    assert swarm(graphs.path(2), agent) == {0: 1, 1: 0}


def test_a_message_of_round_0_and_the_round_before_is_dropped():
    async def agent(c: Communicator) -> int:
        if c.id == 1:
            both = join_contents(encode("new"), encode("old"))
            kind = MessageKind.DOUBLE
            c.port.send(
                Message(MESSAGE_TOPICS.rounds, c.port.address, both, 0, "main", kind),
                (0,),
            )
        assert await c.neighbors_exchange(c.id) == {1 - c.id: 1 - c.id}
        return c.port.counters.malformed

    assert swarm(graphs.path(2), agent) == {0: 1, 1: 0}


def test_a_message_of_two_rounds_brings_both():
    async def agent(c: Communicator) -> list[Any]:
        if c.id == 1:
            both = join_contents(encode("new"), encode("old"))
            kind = MessageKind.DOUBLE
            c.port.send(
                Message(MESSAGE_TOPICS.rounds, c.port.address, both, 1, "main", kind),
                (0,),
            )
            return []
        return [await c.receive() for _ in range(2)]

    assert swarm(graphs.path(2), agent)[0] == [{1: "old"}, {1: "new"}]


@pytest.mark.parametrize("size", [MOST_DOUBLE_BYTES // 2 - 8, 2000])
def test_two_rounds_are_sent_again_in_one_message_if_they_are_small(size):
    kinds = Counter[int]()

    async def agent(c: Communicator) -> None:
        send = c.port.send

        def counted(message, to, *more):
            kind = message.flags & KIND_MASK
            kinds[kind] += len(to)
            # The other drone misses the first copies of the second round.
            if message.number != 1 or kind != MessageKind.DATA:
                send(message, to, *more)

        c.port.send = counted  # type: ignore[method-assign, assignment]
        for k in range(2):
            found = await c.neighbors_exchange(bytes([c.id, k]) + bytes(size))
            assert {j: value[:2] for j, value in found.items()} == {
                1 - c.id: bytes([1 - c.id, k])
            }

    swarm(graphs.path(2), agent)
    if size < 1000:
        assert kinds[MessageKind.DOUBLE] > 0
        assert kinds[MessageKind.REPEAT] == 0
    else:
        assert kinds[MessageKind.DOUBLE] == 0
        assert kinds[MessageKind.REPEAT] > 0


def test_one_channel_cannot_be_awaited_twice():
    async def agent(c: Communicator) -> None:
        first = asyncio.ensure_future(c.receive())
        await c.port.bus.clock.sleep(0.0)
        with pytest.raises(ConfigError, match="two tasks that wait on it"):
            await c.receive()
        first.cancel()

    swarm(graphs.path(2), agent, gone=(1,))


# Epochs -----------------------------------------------------------------------------------------------------------


def test_a_new_epoch_ends_what_is_not_joinable_and_the_next_begins_at_zero():
    async def agent(c: Communicator) -> Any:
        clock = c.port.bus.clock
        if c.id == 2:
            await c.neighbors_exchange(0, channel="a")
            return None
        clock.call_at(10**9, begin_epoch, c, (2,), 1)
        heard = [await c.neighbors_exchange(0, channel="a")]
        with pytest.raises(
            RosterChanged, match=rf"drone {c.id}: epoch 1: joined \[\], left \[2\]"
        ):
            await c.neighbors_exchange(1, channel="a")
        return [
            *heard,
            *[await c.neighbors_exchange(10 + k, channel="a") for k in range(3)],
        ]

    found = swarm(graphs.complete(3), agent, loss(0.3))
    assert found[0] == [{1: 0, 2: 0}, {1: 10}, {1: 11}, {1: 12}]


def test_a_drone_that_is_not_waiting_learns_of_the_epoch_at_its_next_call():
    async def agent(c: Communicator) -> Any:
        await c.neighbors_exchange(1)
        if c.id == 2:
            return None
        begin_epoch(c, (2,), 1)
        with pytest.raises(RosterChanged):
            await (c.neighbors_exchange(2) if c.id else c.send(2))
        return await c.neighbors_exchange(3)

    found = swarm(graphs.complete(3), agent)
    assert (found[0], found[1]) == ({1: 3}, {0: 3})


def test_messages_of_an_earlier_epoch_are_ignored_and_those_of_the_next_are_kept():
    async def agent(c: Communicator) -> dict[int, str]:
        clock = c.port.bus.clock
        if c.id == 1:
            c.port.send(
                Message(
                    MESSAGE_TOPICS.rounds,
                    c.port.address,
                    encode("old"),
                    0,
                    "main",
                    MessageKind.DATA,
                ),
                (0,),
            )
            begin_epoch(c, (), 1)
            return await c.neighbors_exchange("new")
        await clock.sleep(0.2)
        c.open("main")
        begin_epoch(c, (), 1)
        assert encode("old") not in c.open("main").inbox.get(0, {}).values()
        c.port.bus.deliver(
            Message(
                MESSAGE_TOPICS.rounds, 1, encode("old"), 0, "main", MessageKind.DATA
            ),
            (c.port.address,),
            0.0,
        )
        assert not c.exchange.arrivals._early
        await clock.sleep(0.5)
        return await c.neighbors_exchange("mine")

    network = [ImpairmentRule({"delay": 0.3})]
    assert swarm(graphs.path(2), agent, network) == {0: {1: "new"}, 1: {0: "mine"}}
    assert swarm(graphs.path(2), agent) == {0: {1: "new"}, 1: {0: "mine"}}


@pytest.mark.parametrize("back", [False, True])
def test_a_failed_agent_stays_failed_in_the_next_epoch_unless_it_has_restarted(
    back,
):
    async def agent(c: Communicator) -> str:
        if c.id == 1:
            await c.fail(Failure(1, "no idea"))
            return ""
        await c.port.bus.clock.sleep(2.0)
        begin_epoch(c, (2,), 1, joined=(1,) if back else ())
        with pytest.raises((AgentFailed, RoundTimeout)) as raised:
            await c.neighbors_exchange(0, deadline=5.0)
        return type(raised.value).__name__

    assert swarm(graphs.complete(3), agent)[0] == (
        "RoundTimeout" if back else "AgentFailed"
    )


class Counting:
    """A round algorithm that counts; joinable."""

    joinable = True

    def __init__(self, rounds: int) -> None:
        self.k, self.rounds = 0, rounds
        self.heard: list[dict[int, Any]] = []

    @property
    def done(self) -> bool:
        return self.k == self.rounds

    def message(self) -> int:
        return self.k

    def step(self, heard: dict[int, Any]) -> None:
        self.k += 1
        self.heard.append(heard)


def test_run_algorithm_drives_a_pure_algorithm():
    async def agent(c: Communicator) -> list[dict[int, int]]:
        algorithm = Counting(20)
        await run_algorithm(c, algorithm, channel="count")
        await c.close("count")
        assert c.open("count").joinable
        return algorithm.heard

    assert swarm(graphs.path(2), agent, loss(0.5))[1] == [{0: k} for k in range(20)]


def test_a_joinable_channel_goes_on_without_members_that_leave():
    async def agent(c: Communicator) -> Any:
        algorithm = Counting(4 if c.id == 2 else 10)
        if c.id != 2:
            c.port.bus.clock.call_at(10**9, begin_epoch, c, (2,), 1)
        await run_algorithm(c, algorithm)
        return algorithm.heard

    found = swarm(graphs.complete(3), agent, loss(0.3))
    assert found[0] == [{1: k, 2: k} for k in range(4)] + [{1: k} for k in range(4, 10)]


def test_a_channel_in_use_cannot_become_joinable():
    async def agent(c: Communicator) -> None:
        await c.neighbors_exchange(1)
        with pytest.raises(ConfigError, match="before its first round"):
            c.open("main", joinable=True)

    swarm(graphs.path(2), agent)


def test_a_quick_exchange_ends_on_time_beside_a_slow_one():
    async def main(clock: Clock) -> tuple[dict[int, Any], float]:
        bus = Bus(clock)
        member = Communicator(bus.port(0), graphs.path(2))
        bus.port(1)
        slow = asyncio.create_task(
            member.neighbors_exchange(1, channel="slow", deadline=0.6, policy="partial")
        )
        began = clock.now()
        heard = await member.neighbors_exchange(
            1, channel="quick", deadline=0.05, policy="partial"
        )
        took = clock.now() - began
        await slow
        return heard, took

    heard, took = run_wall(main)
    assert heard == {}
    assert took < 0.4


@pytest.mark.parametrize("policy", ["partial", "hold"])
def test_a_deadline_of_nothing_waits_for_nothing(policy: Any) -> None:
    async def main(clock: Clock) -> tuple[dict[int, Any], float]:
        bus = Bus(clock)
        member = Communicator(bus.port(0), graphs.path(2))
        bus.port(1)
        return await member.neighbors_exchange(
            1, deadline=0.0, policy=policy
        ), clock.now()

    assert run_virtual(main) == ({}, 0.0)
