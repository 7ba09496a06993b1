"""A dongle's time: one exchange carries a packet up, and one down on its acknowledgement."""

from types import SimpleNamespace

import pytest
from virtual_time import virtual

from crazychoir.config.radio_checks import RADIO_TRAFFIC
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.errors import ConfigError
from crazychoir.radio.budget import compute_setpoint_rates
from crazychoir.radio.checks import link_problems
from crazychoir.radio.virtual.air import AIR_MODEL, Air, VirtualDongle
from crazychoir.radio.virtual.faults import Faults
from crazychoir.runtime.clock import NS_PER_SECOND

MS = 1_000_000


@virtual
async def test_what_goes_down_rides_on_what_goes_up(clock):
    dongle, came = VirtualDongle(clock, (0, 1)), []
    for k in range(10):
        dongle.up(0, lambda k=k: came.append((clock.now(), "up", k)))
        dongle.down(0, lambda k=k: came.append((clock.now(), "down", k)))
    await clock.sleep(1.0)
    assert dongle.exchanges == 10
    assert [(way, k) for _, way, k in came] == [
        (way, k) for k in range(10) for way in ("down", "up")
    ]
    assert came[-1][0] == pytest.approx(10 / AIR_MODEL.shared_capacity)


@virtual
async def test_a_drone_that_only_sends_is_polled(clock):
    dongle, came = VirtualDongle(clock, (0, 1)), []
    for _ in range(5):
        dongle.down(1, lambda: came.append(clock.now()))
    await clock.sleep(1.0)
    assert dongle.exchanges == 5
    assert came == [
        pytest.approx((k + 1) / AIR_MODEL.shared_capacity) for k in range(5)
    ]


@virtual
async def test_an_answer_rides_on_the_next_exchange(clock):
    dongle, came = VirtualDongle(clock, (0,), 100.0), []
    dongle.up(0, lambda: dongle.down(0, lambda: came.append(clock.now())))
    await clock.sleep(1.0)
    assert came == [pytest.approx(0.02)]


@virtual
async def test_drones_take_turns_whatever_one_of_them_asks_for(clock):
    dongle, came = VirtualDongle(clock, (0, 1, 2)), []
    for k in range(20):
        dongle.up(0, lambda k=k: came.append(0))
    dongle.up(1, lambda: came.append(1))
    dongle.up(2, lambda: came.append(2))
    await clock.sleep(1.0)
    assert came[:4] in ([0, 1, 2, 0], [0, 0, 1, 2])
    assert len(came) == 22


def _speak(clock, dongle, seconds):
    """Let its drones be told and say what those do that are sent places; s for a round trip, as asked, 95 of 100."""
    trips = []

    def ask(i):
        began = clock.now()
        dongle.up(i, lambda: dongle.down(i, lambda: trips.append(clock.now() - began)))

    for i in dongle.drones:
        told = (10.0, lambda i: dongle.up(i, list))
        said = (RADIO_TRAFFIC.least_attitude_rate, lambda i: dongle.down(i, list))
        for row, (rate, flow) in enumerate(
            [
                (
                    RADIO_TRAFFIC.echo_rate
                    + RADIO_TRAFFIC.planner_rate
                    + RADIO_TRAFFIC.request_rate,
                    ask,
                ),
                told,
                said,
            ]
        ):
            for k in range(round(rate * seconds)):
                clock.call_at(
                    clock.now_ns()
                    + round((k + 0.37 * i + 0.29 * row) / rate * NS_PER_SECOND),
                    flow,
                    i,
                )
    return lambda: sorted(trips)[round(0.95 * len(trips)) - 1]


@virtual
async def test_what_the_budget_lets_pass_comes_in_time_and_what_it_refuses_does_not(
    clock,
):
    at_home = [
        f'[[drones]]\nid = {i}\nhome = [0, {i - 3}, 0]\nuri = "udp://127.0.0.1:{19850 + i}"\n'
        for i in range(7)
    ]
    latencies = {n: _speak(clock, VirtualDongle(clock, range(n)), 20.0) for n in (5, 7)}
    await clock.sleep(25.0)
    for n, latency in latencies.items():
        config = SwarmConfig.loads(
            'name = "x"\n[control]\nsender = "xyz"\n' + "".join(at_home[:n]), "x.toml"
        )
        if n == 5:
            assert compute_setpoint_rates(config) == {0: 0.0}
            assert link_problems(latency(), 1.0) == []
        else:
            with pytest.raises(ConfigError, match="say 294 packets a second"):
                compute_setpoint_rates(config)
            assert "round trip" in link_problems(latency(), 1.0)[0]


def test_a_late_computer_takes_no_time_of_the_radio():
    """Each time that it waits for an exchange it comes 30 ms late: what was due by then follows at once."""
    now, due, late = [0], [], 30 * MS
    clock = SimpleNamespace(
        now_ns=lambda: now[0], call_at=lambda ns, call, **_: due.append((ns, call))
    )
    dongle = VirtualDongle(clock, (0, 1), 1000.0)
    for _ in range(AIR_MODEL.down_queue):
        dongle.down(0, lambda: None)
    while due:
        at, call = due.pop()
        if now[0] < at:
            now[0] = at + late
        call()
    assert dongle.exchanges == AIR_MODEL.down_queue
    assert now[0] <= AIR_MODEL.down_queue * MS + late


@virtual
async def test_what_is_too_much_is_lost(clock):
    dongle, came = VirtualDongle(clock, (0, 1), 50.0), []
    taken = [
        dongle.up(0, lambda: came.append(1)) for _ in range(AIR_MODEL.up_queue + 5)
    ]
    assert taken.count(False) == 5
    assert dongle.refused == 5
    assert [
        dongle.down(0, lambda: None) for _ in range(AIR_MODEL.down_queue + 1)
    ].count(False) == 1
    await clock.sleep(10.0)
    assert len(came) == AIR_MODEL.up_queue


@virtual
async def test_four_drones_share_250_packets_a_second_both_ways(clock):
    dongle, counts = VirtualDongle(clock, range(4)), [0] * 4

    def came(i):
        counts[i] += 1

    for _ in range(200):  # 100 Hz of set-points each: more than there is
        for i in range(4):
            dongle.up(i, lambda i=i: came(i))
        await clock.sleep(0.01)
    assert sum(counts) == pytest.approx(2.0 * AIR_MODEL.shared_capacity, abs=4)
    assert max(counts) - min(counts) <= 2


def test_a_drone_alone_has_more():
    assert (
        VirtualDongle(None, (3,)).capacity
        == AIR_MODEL.single_capacity
        > VirtualDongle(None, (3, 4)).capacity
        == AIR_MODEL.shared_capacity
    )


@virtual
async def test_losses_delays_and_silence_of_a_link(clock):
    faults, came = Faults(), []
    air = Air(clock, 0, faults, None, seed=1)
    for _ in range(1000):
        air.rise(lambda: came.append(clock.now()))
    assert (len(came), air.up, air.lost) == (1000, 1000, 0)
    faults.loss = 0.3
    for _ in range(1000):
        air.sink(lambda: came.append(clock.now()))
    assert air.lost == pytest.approx(300, abs=60)
    assert air.down == 1000 - air.lost
    faults.loss, faults.delay = 0.0, 0.05
    came.clear()
    air.rise(lambda: came.append(clock.now()))
    assert came == []
    await clock.sleep(0.1)
    assert came == [pytest.approx(0.05)]
    faults.delay, faults.silent = 0.0, 1.0
    lost = air.lost
    air.rise(lambda: came.append(clock.now()))
    air.sink(lambda: came.append(clock.now()))
    assert (len(came), air.lost) == (1, lost + 2)


@virtual
async def test_a_lost_packet_takes_its_turn_all_the_same(clock):
    faults = Faults(loss=1.0)
    dongle = VirtualDongle(clock, (0, 1))
    air = Air(clock, 0, faults, dongle)
    for _ in range(5):
        air.rise(lambda: None)
    await clock.sleep(1.0)
    assert (dongle.exchanges, air.lost) == (5, 5)
