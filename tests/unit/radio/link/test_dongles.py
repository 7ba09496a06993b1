"""A dongle's time: one exchange carries a packet up, and one down on its acknowledgement; visits; broadcasts."""

from types import SimpleNamespace

import pytest
from virtual_time import virtual

from crazychoir.config.dongle_plan import RADIO_TRAFFIC
from crazychoir.radio.virtual.air import AIR_MODEL, Air, VirtualDongle
from crazychoir.radio.virtual.faults import Faults

MS = 1_000_000


@virtual
async def test_what_goes_down_rides_on_what_goes_up(clock):
    dongle, came = VirtualDongle(clock, (0, 1)), []
    for k in range(4):
        dongle.up(0, lambda k=k: came.append((clock.now(), "up", k)))
        dongle.down(0, lambda k=k: came.append((clock.now(), "down", k)))
    await clock.sleep(1.0)
    assert dongle.exchanges == 4
    assert [(way, k) for _, way, k in came] == [
        (way, k) for k in range(4) for way in ("down", "up")
    ]
    assert came[-1][0] == pytest.approx(dongle.time.change + 4 * dongle.time.exchange)


@virtual
async def test_a_drone_that_only_sends_is_polled(clock):
    dongle, came = VirtualDongle(clock, (0, 1)), []
    for _ in range(5):
        dongle.down(1, lambda: came.append(clock.now()))
    await clock.sleep(1.0)
    assert dongle.exchanges == 5
    assert came == [
        pytest.approx(dongle.time.change + (k + 1) * dongle.time.exchange)
        for k in range(5)
    ]


@virtual
async def test_an_answer_rides_on_the_next_exchange(clock):
    dongle, came = VirtualDongle(clock, (0,), 100.0), []
    dongle.up(0, lambda: dongle.down(0, lambda: came.append(clock.now())))
    await clock.sleep(1.0)
    assert came == [pytest.approx(0.02)]


@virtual
async def test_drones_take_turns_whatever_one_of_them_asks_for(clock):
    dongle, came = VirtualDongle(clock, (0, 1, 2), longest_visit=2), []
    for k in range(4):
        dongle.up(0, lambda k=k: came.append(0))
    dongle.up(1, lambda: came.append(1))
    dongle.up(2, lambda: came.append(2))
    await clock.sleep(1.0)
    assert came[:6] == [0, 0, 1, 2, 0, 0]
    assert len(came) == 6


@virtual
async def test_a_visit_of_several_packets_changes_the_address_once(clock):
    dongle, came = VirtualDongle(clock, (0, 1)), []
    for i in (0, 1, 0, 1):
        dongle.up(i, lambda i=i: came.append((i, clock.now())))
    await clock.sleep(1.0)
    c, x = dongle.time.change, dongle.time.exchange
    assert (c, x) == (pytest.approx(0.003), pytest.approx(0.001))
    assert [i for i, _ in came] == [0, 0, 1, 1]
    assert [t for _, t in came] == [
        pytest.approx(t) for t in (c + x, c + 2 * x, 2 * c + 3 * x, 2 * c + 4 * x)
    ]
    assert dongle.visits == 2
    assert dongle.busy_ns == pytest.approx(1e9 * (2 * c + 4 * x))


@virtual
async def test_a_broadcast_goes_before_visits_and_reaches_all_at_once(clock):
    dongle, came = VirtualDongle(clock, (0, 1, 2)), []
    for content in (b"poses of 0 and 1", b"pose of 2"):
        for i in range(3):
            dongle.spread(content, lambda i=i: came.append((i, clock.now())))
    await clock.sleep(0.001)
    for _ in range(9):
        dongle.up(1, lambda: came.append(("up", clock.now())))
    await clock.sleep(1.0)
    spread = [row for row in came if row[0] != "up"]
    assert [i for i, _ in spread] == [0, 1, 2, 0, 1, 2]
    assert len({t for _, t in spread}) == 1
    c, x = dongle.time.change, dongle.time.exchange
    begun = spread[0][1] - (3 * c + 2 * x)
    assert 0.002 <= begun <= 0.002 + c + x, "no later than after one exchange"
    assert (dongle.broadcasts, dongle.spreads) == (2, 1)
    assert dongle.visits == 2, "the broadcast has interrupted the visit"


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
async def test_a_burst_for_twelve_drones_does_not_delay_what_comes_after_it(clock):
    dongle, came = VirtualDongle(clock, range(12), RADIO_TRAFFIC.shared_capacity), []
    for i in dongle.drones:
        for _ in range(20):
            dongle.up(i, lambda: None)
    await clock.sleep(0.1)
    sent = clock.now()
    for i in dongle.drones:
        dongle.up(i, lambda: came.append(clock.now()))
    await clock.sleep(1.0)
    assert len(came) == 12
    assert max(came) - sent < 0.1


@virtual
async def test_four_drones_share_a_dongle(clock):
    dongle, counts = VirtualDongle(clock, range(4)), [0] * 4

    def came(i):
        counts[i] += 1

    for _ in range(400):  # 200 Hz of set-points each: more than there is
        for i in range(4):
            dongle.up(i, lambda i=i: came(i))
        await clock.sleep(0.005)
    # Visits of four packets, since more wait than there is time for.
    visit = 4 * dongle.time.exchange + dongle.time.change
    assert sum(counts) == pytest.approx(2.0 * 4 / visit, abs=8)
    assert max(counts) - min(counts) <= 4


def test_a_drone_alone_has_more():
    assert (
        VirtualDongle(None, (3,)).capacity
        == RADIO_TRAFFIC.single_drone_capacity
        > VirtualDongle(None, (3, 4)).capacity
        == RADIO_TRAFFIC.shared_capacity
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
    for _ in range(4):
        air.rise(lambda: None)
    await clock.sleep(1.0)
    assert (dongle.exchanges, air.lost) == (4, 4)
