"""How long a wait for a round takes, and when the round is sent again."""

import asyncio
import contextlib

import numpy as np
import pytest

from crazychoir.bus.impairment.model import Impairment
from crazychoir.bus.impairment.rules import ImpairmentRule
from crazychoir.bus.port import Bus
from crazychoir.errors import ChannelEnded, PeerLost, RoundTimeout
from crazychoir.runtime.clock import Clock, run_virtual
from crazychoir.team import graph as graphs
from crazychoir.team.communicator import Communicator
from crazychoir.team.expected_wait import RESEND_TIMES, ExpectedWait
from crazychoir.team.graph import Graph
from crazychoir.team.message_kind import (
    EPOCH_SHIFT,
    KIND_MASK,
    LATENESS_STEPS,
    MOST_RELAYS,
    MessageKind,
    flag_lateness,
    read_lateness,
)
from crazychoir.team.round_waits import CHECK_GRID, LONGEST_UNCHECKED


def test_a_new_channel_resends_after_the_shortest_time():
    assert ExpectedWait().find_first_resend() == RESEND_TIMES.shortest


def test_long_rounds_are_learned():
    expected = ExpectedWait()
    for _ in range(30):
        expected.learn(0.3)
    assert 0.3 < expected.find_first_resend() < 0.4


def test_one_long_wait_is_not_learned():
    expected = ExpectedWait()
    expected.learn(60.0)
    assert expected.find_first_resend() < 5 * RESEND_TIMES.shortest


def test_resends_never_wait_longer_than_the_longest_time():
    expected = ExpectedWait(lost_share=0.0)
    for _ in range(200):
        expected.learn(50.0)
    assert expected.find_first_resend() == RESEND_TIMES.longest_first
    assert expected.find_next_resend(1) == RESEND_TIMES.longest


def test_the_time_between_resends_doubles():
    expected = ExpectedWait()
    times = [expected.find_next_resend(attempt) for attempt in range(40)]
    assert times[0] == RESEND_TIMES.shortest
    assert times[RESEND_TIMES.attempts_a_time] == 2 * RESEND_TIMES.shortest
    assert times[-1] == RESEND_TIMES.longest


def test_losses_shorten_the_time_before_a_resend():
    expected = ExpectedWait(lost_share=0.0)
    for _ in range(30):
        expected.learn(0.3)
    calm = expected.find_first_resend()
    expected.note_repeat(True)
    disturbed = expected.find_first_resend()
    for _ in range(3):
        expected.note_repeat(True)
    assert RESEND_TIMES.shortest == expected.find_first_resend() < disturbed < calm
    for _ in range(500):
        expected.note_repeat(False)
    assert expected.lost_share == 0.0
    assert expected.find_first_resend() == calm
    expected.note_repeat(True)
    expected.undo_repeat()
    assert expected.find_first_resend() == calm


@pytest.mark.parametrize("step", range(1, len(LATENESS_STEPS)))
@pytest.mark.parametrize("relays", [1, 7, MOST_RELAYS])
def test_the_lateness_of_a_message_is_in_its_flags(step, relays):
    seconds = LATENESS_STEPS[step]
    for late in (seconds, 1.2 * seconds):
        flags = flag_lateness(late, relays)
        assert read_lateness(3 << EPOCH_SHIFT | flags | KIND_MASK) == (seconds, relays)
        assert flags < 1 << EPOCH_SHIFT


def test_the_largest_lateness_stands_for_all_above():
    assert read_lateness(flag_lateness(1e9, 1)) == (LATENESS_STEPS[-1], 1)


@pytest.mark.parametrize(("seconds", "relays"), [(0.0, 15), (0.003, 15), (1.0, 0)])
def test_a_message_that_is_not_late_has_plain_flags(seconds, relays):
    assert flag_lateness(seconds, relays) == 0


class LosesOne:
    """A port's `send` that loses the first copies of one round."""

    def __init__(self, c: Communicator, k: int) -> None:
        self.send = c.port.send
        self.k = k
        c.port.send = self  # type: ignore[method-assign, assignment]

    def __call__(self, message, to, *more):
        kind = message.flags & KIND_MASK
        is_first = kind in (MessageKind.DATA, MessageKind.AHEAD)
        if message.number != self.k or not is_first:
            self.send(message, to, *more)


def exchange_rounds(
    graph: Graph,
    rule: dict[str, float],
    rounds: int,
    computation: float,
    lost_round: int = -1,
    deadline: float = 60.0,
    seed: int = 1,
) -> tuple[list[Communicator], list[int]]:
    """Return the communicators of a team after so many rounds, and the repeats of all until each round.

    computation: s, mean; computations vary
    lost_round: of drone 0; the first copies of its messages of this round are lost
    """
    repeats: list[int] = []

    async def agent(clock: Clock, c: Communicator, team: list[Communicator]) -> None:
        draws = np.random.default_rng(c.id)
        for _ in range(rounds):
            if computation > 0.0:
                await clock.sleep(computation * draws.gamma(10.0, 0.1))
            while True:
                with contextlib.suppress(RoundTimeout):
                    await c.neighbors_exchange(c.id, deadline=deadline)
                    break
                assert clock.now() < 1000.0, "the round never ends"
            if c.id == 0:
                repeats.append(sum(c.port.counters.resent for c in team))
        await c.close()

    async def main(clock: Clock) -> tuple[list[Communicator], list[int]]:
        bus = Bus(clock, Impairment(seed, [ImpairmentRule(rule)]))
        bus.impairment.begin(clock.now())
        team = [Communicator(bus.port(i), graph) for i in graph.ids]
        LosesOne(team[0], lost_round)
        await asyncio.gather(*(agent(clock, c, team) for c in team))
        return team, repeats

    return run_virtual(main)


@pytest.mark.parametrize(
    ("delay", "computation"), [(0.002, 0.03), (0.002, 0.12), (0.02, 0.0)]
)
def test_a_network_without_losses_needs_hardly_a_repeat(delay, computation):
    rounds = 500
    _, repeats = exchange_rounds(graphs.ring(6), {"delay": delay}, rounds, computation)
    assert repeats[-1] < 0.03 * rounds * 2 * 6


def test_waits_for_lost_messages_of_others_are_not_learned():
    """With few losses, nearly each wait contains the wait of another drone for a lost message."""
    team, _ = exchange_rounds(
        graphs.ring(20), {"loss": 0.02, "delay": 0.001}, 300, computation=0.0
    )
    means = [c.open("main").wait.expected.mean for c in team]
    assert max(means) < 0.004


@pytest.mark.parametrize("n", [5, 6])
@pytest.mark.parametrize("delay", [0.015, 0.05, 0.1])
def test_the_lateness_after_one_lost_message_dies_out(delay, n):
    """All drones are equally late soon: none is late any more, and all waits are as before."""
    team, repeats = exchange_rounds(
        graphs.ring(n), {"delay": delay}, 300, computation=0.0, lost_round=60
    )
    assert repeats[-1] == repeats[150]
    means = [c.open("main").wait.expected.mean for c in team]
    assert means == pytest.approx([delay] * n, rel=0.2)


@pytest.mark.parametrize(("delay", "jitter"), [(0.002, 0.03), (0.05, 0.05)])
def test_messages_that_were_overtaken_count_as_lost_for_a_moment_only(delay, jitter):
    team, repeats = exchange_rounds(
        graphs.complete(5), {"delay": delay, "jitter": jitter}, 400, computation=0.03
    )
    assert repeats[-1] - repeats[200] < 0.03 * 200 * 4 * 5
    assert max(c.open("main").wait.expected.lost_share for c in team) < 0.05


def test_losses_are_learned_by_the_rounds_themselves():
    team, _ = exchange_rounds(
        graphs.ring(4), {"loss": 0.2, "delay": 0.002}, 200, computation=0.12
    )
    shares = [c.open("main").wait.expected.lost_share for c in team]
    assert min(shares) > 0.1
    assert all(c.open("main").wait.expected.find_first_resend() < 0.02 for c in team)


@pytest.mark.parametrize("deadline", [0.25, 0.4])
def test_a_round_that_is_tried_again_does_not_lose_the_same_messages_again(deadline):
    """The simulated network draws once for each number of a repeat, so all tries count on."""
    burst = {"p_good_bad": 0.02, "p_bad_good": 0.1, "loss_bad": 1.0, "delay": 0.1}
    for seed in (5, 8, 9, 10, 13):
        _, repeats = exchange_rounds(
            graphs.path(2), burst, 300, 0.0, deadline=deadline, seed=seed
        )
        assert len(repeats) == 300


def list_attempts(rounds: int, deadline: float) -> list[tuple[int, int, float]]:
    """Return (round, attempt, s) of each repeat of drone 0, when its neighbour sends after 1 s only."""
    repeats: list[tuple[int, int, float]] = []

    async def main(clock: Clock) -> None:
        bus = Bus(clock)
        team = [Communicator(bus.port(i), graphs.path(2)) for i in (0, 1)]
        send = team[0].port.send

        def noted(message, to, attempt=0):
            if message.flags & KIND_MASK in (MessageKind.REPEAT, MessageKind.DOUBLE):
                repeats.append((message.number, attempt, clock.now()))
            send(message, to, attempt)

        team[0].port.send = noted  # type: ignore[method-assign, assignment]

        async def wait_for_late() -> None:
            for _ in range(rounds):
                while True:
                    with contextlib.suppress(RoundTimeout):
                        await team[0].neighbors_exchange(0, deadline=deadline)
                        break

        async def send_late() -> None:
            for _ in range(rounds):
                await clock.sleep(1.0)
                await team[1].neighbors_exchange(1)

        await asyncio.gather(wait_for_late(), send_late())

    run_virtual(main)
    return repeats


def test_the_repeats_of_a_round_are_numbered_from_its_start_over_all_tries():
    repeats = list_attempts(2, deadline=0.4)
    for k in (0, 1):
        attempts = [attempt for number, attempt, _ in repeats if number == k]
        assert attempts == [2 * n for n in range(1, len(attempts) + 1)]
        assert len(attempts) > 10


def test_a_round_that_is_tried_again_is_sent_again_as_soon_as_at_first():
    times = [t for number, _, t in list_attempts(1, deadline=0.4) if number == 0]
    first = [t for t in times if t < 0.4]
    second = [t - 0.4 for t in times if 0.4 <= t < 0.8]
    assert second == pytest.approx(first)


def test_a_sender_that_tries_again_does_not_lose_the_same_messages_again():
    """Drone 1 reads the first rounds only, and drone 0 tells it of the oldest again and again."""

    async def main(clock: Clock) -> int:
        rule = {"p_good_bad": 0.02, "p_bad_good": 0.1, "loss_bad": 1.0}
        bus = Bus(clock, Impairment(3, [ImpairmentRule(rule)]))
        bus.impairment.begin(clock.now())
        graph = Graph([0, 1], [(0, 1)])
        sender, reader = (Communicator(bus.port(i), graph) for i in (0, 1))

        async def read() -> None:
            for _ in range(64):
                await reader.neighbors_exchange(1)

        async def send() -> int:
            for k in range(100):
                while True:
                    with contextlib.suppress(RoundTimeout):
                        await sender.neighbors_exchange(0, deadline=0.25)
                        break
                    if clock.now() > 60.0:
                        return k
            return 100

        _, sent = await asyncio.gather(read(), send())
        return sent

    assert run_virtual(main) == 100


def test_a_lost_message_is_asked_for_before_a_short_deadline():
    """Rounds take longer than the deadline, so each wait is a new try."""
    _, repeats = exchange_rounds(
        graphs.ring(4),
        {"delay": 0.1, "jitter": 0.1},
        100,
        computation=0.0,
        lost_round=60,
        deadline=0.25,
    )
    assert len(repeats) == 100


def test_a_lost_neighbour_is_found_although_rounds_are_long():
    """The first resend is due after half a second; the neighbour is lost before."""

    class LostAt:
        def __init__(self, clock: Clock, when: float) -> None:
            self.clock = clock
            self.when = when

        def is_lost(self, j: int) -> bool:
            return self.clock.now() >= self.when

    async def main(clock: Clock) -> float:
        c = Communicator(Bus(clock).port(0), graphs.path(2))
        for _ in range(100):
            c.open("main").wait.expected.learn(0.5)
        c.exchange.table.membership = LostAt(clock, 0.1)
        with pytest.raises(PeerLost):
            await c.neighbors_exchange(None)
        return clock.now()

    found = run_virtual(main)
    assert 0.1 <= found <= 0.1 + 1e-9 * (LONGEST_UNCHECKED + CHECK_GRID)


def test_a_channel_that_ended_is_found_although_rounds_are_long():
    async def main(clock: Clock) -> float:
        bus = Bus(clock)
        here, there = (Communicator(bus.port(i), graphs.path(2)) for i in range(2))
        await asyncio.gather(here.neighbors_exchange(0), there.neighbors_exchange(1))
        for _ in range(100):
            here.open("main").wait.expected.learn(0.5)
        closing = asyncio.ensure_future(there.close(linger=1.0))
        began = clock.now()
        with pytest.raises(ChannelEnded):
            await here.neighbors_exchange(2)
        took = clock.now() - began
        await closing
        return took

    assert run_virtual(main) <= 0.06


def test_each_waiting_channel_is_sent_again_in_time():
    async def main(clock: Clock) -> list[float]:
        c = Communicator(Bus(clock).port(0), graphs.path(2))
        for _ in range(100):
            c.open("slow").wait.expected.learn(0.5)
        sent: list[float] = []

        def send(message, to, *more):
            kind = message.flags & KIND_MASK
            if kind == MessageKind.REPEAT and message.channel == "fast":
                sent.append(clock.now())

        c.port.send = send  # type: ignore[method-assign, assignment]
        waits = [
            asyncio.ensure_future(
                c.neighbors_exchange(None, channel=name, deadline=0.3)
            )
            for name in ("fast", "slow")
        ]
        await asyncio.gather(*waits, return_exceptions=True)
        return sent

    sent = run_virtual(main)
    assert sent[0] <= 0.015
    assert len(sent) > 5


def test_a_drone_that_need_not_wait_is_not_late():
    async def main(clock: Clock) -> float:
        bus = Bus(clock)
        here, there = (Communicator(bus.port(i), graphs.path(2)) for i in range(2))
        await there.send(1)
        here.open("main").wait.own_lateness = 0.5
        await here.neighbors_exchange(0)
        return here.open("main").wait.own_lateness

    assert run_virtual(main) == 0.0


@pytest.mark.parametrize(
    ("lost_share", "earliest", "latest"), [(0.0, 0.03, 0.035), (0.001, 0.01, 0.02)]
)
def test_a_wait_is_checked_later_where_no_message_was_lost_for_long(
    lost_share, earliest, latest
):
    async def main(clock: Clock) -> list[float]:
        c = Communicator(Bus(clock).port(0), graphs.path(2))
        c.open("main").wait.expected.lost_share = lost_share
        sent: list[float] = []

        def send(message, to, *more):
            if message.flags & KIND_MASK == MessageKind.REPEAT:
                sent.append(clock.now())

        c.port.send = send  # type: ignore[method-assign, assignment]
        with pytest.raises(RoundTimeout):
            await c.neighbors_exchange(None, deadline=0.1)
        return sent

    assert earliest <= run_virtual(main)[0] <= latest


def test_rounds_without_losses_wake_the_process_seldom():
    async def main(clock: Clock) -> int:
        bus = Bus(clock)
        team = [Communicator(bus.port(i), graphs.path(2)) for i in range(2)]
        for c in team:
            c.open("main").wait.expected.lost_share = 0.0
        checks: list[float] = []
        call_about = clock.call_about

        def count(when_ns, callback, drone=-1):
            checks.append(when_ns)
            return call_about(when_ns, callback, drone)

        clock.call_about = count  # type: ignore[method-assign]

        async def exchange(c: Communicator) -> None:
            while clock.now() < 1.0:
                await clock.sleep(0.001)
                await c.neighbors_exchange(None)

        await asyncio.gather(*map(exchange, team))
        return len(checks)

    assert run_virtual(main) <= 2 * 36
