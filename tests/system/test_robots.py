"""Missions of robots that do not fly."""

import pytest

from crazychoir.guidance.mission import load_mission
from crazychoir.launch.flight import fly_fast

pytestmark = pytest.mark.system


def driven(name, loss=0.0, **changes):
    mission = load_mission(name)
    return fly_fast(
        mission.swarm(None).replace(seed=1, network={"loss": loss}, **changes), mission
    )


def test_unicycles_drive_into_a_square_though_messages_are_lost():
    result = driven("unicycles", loss=0.2)
    assert result["success"], result["reasons"]
    assert result["worst_error_m"] < 0.02
    assert result["min_separation_m"] > 0.5
    assert all(abs(one["place"][2]) < 0.01 for one in result["results"].values())
    assert all(0.5 < way < 3.0 for way in result["flown_m"].values())


def test_points_with_and_without_inertia_are_drawn_into_the_triangle():
    result = driven("integrators")
    assert result["success"], result["reasons"]
    assert result["formation_error_m"] < 0.01
    assert result["settling_s"] < 10.0
    assert [round(one["place"][0], 2) for one in result["results"].values()][
        3:
    ] == pytest.approx([0.32, -0.32, 0.0], abs=0.011)


@pytest.mark.slow
def test_robots_that_would_leave_the_fence_stop_at_it_and_are_not_where_they_should_be():
    """The square is wider than the fence."""
    mission = load_mission("unicycles")
    robots = [
        {"id": i, "home": [0.6 * i - 0.9, 0.0, 0.0], "uri": "sim://unicycle"}
        for i in range(4)
    ]
    result = driven(
        "unicycles",
        drones=robots,
        fence={"min": [-1.9, -0.3, 0.0], "max": [1.9, 0.3, 3.0]},
    )
    assert not result["success"]
    assert any("from its corner" in reason for reason in result["reasons"].values())
    assert max(abs(one["place"][1]) for one in result["results"].values()) < 0.45
    assert mission.swarm(None).drone(0).uri == "sim://unicycle"
