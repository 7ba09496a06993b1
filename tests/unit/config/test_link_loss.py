"""How far a drone flies on without its radio, and how far inside the fence it stays for that."""

import numpy as np
import pytest

from crazychoir.config.link_loss import (
    LINK_LOSS_RULES,
    STRAY_DISTANCES,
    TILT_TIMES,
    allowed_speed,
    describe_crowding,
    distance_without_link,
    fence_inset,
)
from crazychoir.config.swarm_config import SwarmConfig


@pytest.mark.parametrize("sender", ["fpqr", "frpy", "vel"])
@pytest.mark.parametrize(
    ("speed", "acceleration"), [(0.3, 1.0), (1.0, 2.0), (5.0, 2.0)]
)
def test_it_is_the_worst_place_of_all(sender, speed, acceleration) -> None:
    d = np.linspace(0.0, 50.0, 200_001)
    v = np.minimum(speed, np.sqrt(d * acceleration / LINK_LOSS_RULES.braking_factor))
    worst = STRAY_DISTANCES[sender] + np.max(
        (LINK_LOSS_RULES.cut_time + TILT_TIMES[sender]) * v - d
    )
    assert distance_without_link(speed, acceleration, sender) == pytest.approx(
        worst, abs=1e-3
    )


def swarm(speed: float, home: float = 0.0, **changes: object) -> SwarmConfig:
    drones = [{"id": 0, "home": [home, 0.0, 0.0], "uri": "udp://127.0.0.1:19850"}]
    flight = {"speed_limit": speed, "acceleration_limit": 2.0}
    return SwarmConfig.of({"name": "a", "drones": drones, "flight": flight, **changes})


def test_it_stays_inside_by_what_keep_out_leaves() -> None:
    found = fence_inset(swarm(0.5), "frpy")
    assert (
        found.needed
        == found.given
        == pytest.approx(distance_without_link(0.5, 2.0, "frpy") - 0.5)
    )
    wide = {"keep_out": {"min": [-6, -6, -1], "max": [6, 6, 4]}}
    assert fence_inset(swarm(0.5, **wide), "frpy").needed == 0.0


def test_it_leaves_room_for_homes_and_for_a_mission() -> None:
    assert fence_inset(swarm(1.0, home=3.5), "fpqr").given == pytest.approx(0.2)
    fast = fence_inset(swarm(3.0), "fpqr")
    assert (fast.given, fast.needed > 1.0) == (1.0, True)


@pytest.mark.parametrize("sender", ["fpqr", "frpy", "vel"])
def test_it_says_with_which_speed_limit_there_is_room(sender) -> None:
    found = fence_inset(swarm(1.5), sender)
    assert found.given < found.needed
    slower = fence_inset(swarm(found.slow_enough), sender)
    assert (
        f"lower speed_limit to {int(100 * found.slow_enough) / 100:.2f} m/s"
        in found.problem
    )
    assert slower.problem == ""
    assert slower.needed == slower.given == pytest.approx(found.given)
    assert allowed_speed(0.9 * STRAY_DISTANCES[sender], 2.0, sender) == 0.0


def test_drones_that_share_a_dongle_and_start_too_near_are_named() -> None:
    homes, numbers = ((0.0, 0.0), (0.6, 0.0), (0.0, 0.5), (0.0, 1.2)), (0, 0, 1, 0)
    drones = [
        {
            "id": i,
            "home": [*home, 0.0],
            "uri": f"udp://127.0.0.1:{19850 + i}",
            "dongle": k,
        }
        for i, (home, k) in enumerate(zip(homes, numbers, strict=True))
    ]
    config = SwarmConfig.of({"name": "a", "drones": drones})
    fast = dict.fromkeys(config.ids, "fpqr")
    assert describe_crowding(config, 0, fast).startswith(
        "starts 0.60 m from drone 1, which the same dongle reaches"
    )
    assert "1.14 m are needed" in describe_crowding(config, 0, fast)
    assert [describe_crowding(config, i, fast) for i in (1, 2, 3)] == [""] * 3
    assert describe_crowding(config, 0, dict.fromkeys(config.ids, "frpy")) == ""
    assert describe_crowding(config, 0, {0: "fpqr", 3: "fpqr"}) == "", (
        "drone 1 is sent places"
    )
    assert "0.79 m are needed" in describe_crowding(config, 0, fast | {1: "frpy"})
    assert describe_crowding(config, 0, fast).endswith(
        "or on two dongles, or send frpy or vel or xyz"
    )


def test_a_sender_that_strays_little_is_offered_only_senders_that_stray_less() -> None:
    drones = [
        {"id": i, "home": [0.2 * i, 0.0, 0.0], "uri": f"udp://127.0.0.1:{19850 + i}"}
        for i in range(2)
    ]
    config = SwarmConfig.of(
        {"name": "a", "drones": drones, "collision": {"method": "off"}}
    )
    for sender, offered in (
        ("frpy", "vel or xyz"),
        ("fullstate", "vel or xyz"),
        ("vel", "xyz"),
    ):
        assert describe_crowding(config, 0, dict.fromkeys(config.ids, sender)).endswith(
            f"two dongles, or send {offered}"
        )
