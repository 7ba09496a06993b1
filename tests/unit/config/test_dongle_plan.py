"""What a dongle carries: the time of its exchanges, of its changes from drone to drone, and of broadcasts."""

import math
from typing import Any

import pytest

from crazychoir.config.dongle_plan import (
    RADIO_TRAFFIC,
    DonglePlan,
    DongleTime,
    capacity_of,
)
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.errors import ConfigError
from crazychoir.radio.budget import compute_setpoint_rates, plan_dongles


def crowd(n: int, sender: str, dongles: int = 1, **radio: Any) -> SwarmConfig:
    drone = {"pose": radio.pop("pose", "mocap")}
    rows = [
        {
            "id": i,
            "home": [0.5 * (i % 6), 0.5 * (i // 6), 0.0],
            "uri": f"udp://127.0.0.1:{19850 + i}",
            "dongle": i % dongles,
        }
        | drone
        for i in range(n)
    ]
    fence = {"min": [-4.0, -4.0, 0.0], "max": [9.0, 9.0, 3.0]}
    tables = {"control": {"sender": sender}, "radio": radio, "fence": fence}
    return SwarmConfig.of({"name": "x", "drones": rows} | tables)


def plan(n: int, sender: str, **radio: Any) -> DonglePlan:
    return plan_dongles(crowd(n, sender, **radio))[0]


def test_the_time_of_a_dongle_follows_from_its_capacity() -> None:
    shared = DongleTime.of(250.0, 4)
    assert shared.exchange + shared.change == pytest.approx(1.0 / 250.0)
    assert shared.exchange == pytest.approx(1.0 / RADIO_TRAFFIC.single_drone_capacity)
    assert DongleTime.of(1250.0, 12) == DongleTime(1.0 / 1250.0, 0.0)
    assert DongleTime.of(1000.0, 1) == DongleTime(1.0 / 1000.0, 0.0)


@pytest.mark.parametrize(
    ("sender", "radio", "most"),
    [
        ("xyz", {}, 13),
        ("frpy", {}, 6),
        ("fpqr", {}, 3),
        ("xyz", {"inline": True}, 27),
        ("fpqr", {"inline": True}, 17),
        ("xyz", {"pose": "onboard", "log_rate": 25.0}, 6),
    ],
)
def test_the_page_says_how_many_drones_are_carried(
    sender: str, radio: dict[str, Any], most: int
) -> None:
    assert plan(most, sender, **radio).load <= RADIO_TRAFFIC.planned_share
    with pytest.raises(ConfigError, match="Use more dongles"):
        plan(most + 1, sender, **radio)


def test_the_goals_are_carried() -> None:
    assert plan(12, "xyz", inline=True).load < 0.5
    assert plan(12, "xyz").load < 0.8
    assert plan(6, "frpy", inline=True, command_rate=50.0).load < 0.4


def test_the_load_is_the_sum_of_its_parts() -> None:
    """Twelve drones: 10 lines, 40 / 12 echoes and 2 requests up, 20 logs and as many answers down."""
    down = 20.0 + 10.0 + 40.0 / 12.0 + 2.0
    found = plan(12, "xyz", inline=True)
    assert found.broadcasts
    assert found.load == pytest.approx((12.0 * down + 10.0 * 6.0) / 1250.0)
    assert found.up == pytest.approx(12.0 * (down - 20.0) + 10.0 * 6.0)
    told = plan(12, "xyz")
    assert not told.broadcasts, "a change of the address takes longer than a pose"
    assert told.load == pytest.approx(12.0 * down * 0.001 + 12.0 * 10.0 * 0.003)
    assert told.up == pytest.approx(12.0 * (down - 20.0 + 10.0))


def test_poses_are_broadcast_where_that_takes_less_time() -> None:
    assert not plan(8, "vel").broadcasts
    assert plan(8, "vel", pose_rate=30.0).broadcasts
    assert not plan(8, "vel", inline=True, broadcast=False).broadcasts
    assert not plan(1, "xyz", broadcast=True).broadcasts, "one drone alone"
    own = plan(4, "xyz", pose="onboard", log_rate=25.0, broadcast=True)
    assert not own.broadcasts, "no drone is sent a pose"


def test_a_dongle_of_several_channels_changes_more() -> None:
    raw = crowd(4, "xyz", broadcast=True)
    one, two = (
        SwarmConfig.of(
            {
                "name": "x",
                "control": {"sender": "xyz"},
                "radio": {"broadcast": True},
                "drones": [
                    {
                        "id": i,
                        "home": raw.drone(i).home,
                        "uri": f"radio://0/{80 + 5 * (i % channels)}/2M/E7E7E7E70{i}",
                    }
                    for i in range(4)
                ],
            }
        )
        for channels in (1, 2)
    )
    more = plan_dongles(two)[0].load - plan_dongles(one)[0].load
    assert more == pytest.approx(4 * 10.0 * 0.003 + 10.0 * 3 * 0.003)


def test_four_drones_at_100_hz_are_too_much_for_one_dongle() -> None:
    with pytest.raises(ConfigError) as caught:
        plan(4, "fpqr", command_rate=100.0)
    assert str(caught.value) == (
        "dongle 0 = drones 0, 1, 2, 3 (fpqr) need 169 % of its time: 4 x 100 set-points a second; exchanges 49 %, "
        "changes of the drone 120 %; it exchanges 250 packets a second, 47 set-points a second and drone. Use more "
        "dongles, a Crazyradio 2.0 with inline = true ([radio]), set command_rate = 50 to 57 ([radio]), or measure its "
        "capacity."
    )


@pytest.mark.parametrize(
    ("n", "rate", "says"),
    [
        (6, 13.0, "send frpy or vel or fullstate (37 Hz at most), or measure"),
        (
            3,
            90.0,
            "Use more dongles, a Crazyradio 2.0 with inline = true ([radio]), set",
        ),
        (3, 13.0, "radio.command_rate: found 13.0; allowed: 50 to 77 Hz, for what is"),
    ],
)
def test_what_is_said_to_be_carried_is(n: int, rate: float, says: str) -> None:
    with pytest.raises(ConfigError) as caught:
        plan(n, "fpqr", command_rate=rate)
    assert says in str(caught.value)
    for told in (50.0, 77.0) if n == 3 else ():
        assert plan(n, "fpqr", command_rate=told).setpoint_rate == told


def test_a_refusal_of_an_inline_dongle_does_not_advise_one() -> None:
    with pytest.raises(ConfigError) as caught:
        plan(30, "xyz", inline=True, pose_rate=20.0, log_rate=25.0)
    assert "Crazyradio 2.0" not in str(caught.value)
    assert "a lower log_rate ([radio]), a lower pose_rate ([radio]), or" in str(
        caught.value
    )


def test_set_point_rates_are_as_many_as_the_dongles_carry() -> None:
    assert compute_setpoint_rates(crowd(3, "fpqr")) == {0: 65.0}
    assert compute_setpoint_rates(crowd(4, "frpy")) == {0: 47.0}
    assert compute_setpoint_rates(crowd(6, "frpy", dongles=3)) == {
        0: 100.0,
        1: 100.0,
        2: 100.0,
    }
    assert compute_setpoint_rates(crowd(1, "fpqr", pose_rate=100.0)) == {0: 100.0}
    assert compute_setpoint_rates(crowd(5, "xyz")) == {0: 0.0}


def test_the_capacity_is_of_the_row_else_of_the_table_else_of_the_kind() -> None:
    def capacity(**radio: Any) -> float:
        return capacity_of(crowd(3, "xyz", **radio), 0)

    assert capacity() == RADIO_TRAFFIC.shared_capacity
    assert capacity(inline=True) == RADIO_TRAFFIC.inline_capacity
    assert capacity(capacity=350.0, inline=True) == 350.0
    assert capacity(dongles=1, capacity=350.0) == 350.0
    rows = [{"dongle": 0, "inline": True}]
    assert capacity_of(crowd(3, "xyz").replace(radio={"dongles": rows}), 0) == 1250.0
    rows = [{"dongle": 0, "capacity": 300.0}]
    assert capacity_of(crowd(3, "xyz").replace(radio={"dongles": rows}), 0) == 300.0


def test_echoes_are_rarer_where_many_drones_share_a_dongle() -> None:
    assert plan(3, "xyz").echo_rate == 10.0
    assert plan(12, "xyz").echo_rate == pytest.approx(40.0 / 12.0)


def test_packets_are_paced_by_the_planned_mix() -> None:
    found = plan(12, "xyz")
    assert found.packet_rate == pytest.approx(found.up / found.load)
    assert math.isfinite(found.packet_rate)
