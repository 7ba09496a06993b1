"""Timed goals: the planned flights, and how a miss is explained."""

import pytest

from crazychoir.errors import ConfigError
from crazychoir.guidance.defaults.goals import GoalHooks, GoalOptions
from crazychoir.guidance.mission import load_mission


def test_flights_that_meet_are_named_before_the_flight():
    mission = load_mission("goto")
    assert mission.check(mission.swarm(None), False) == []
    notes = mission.check(
        mission.swarm(None).replace(collision={"method": "off"}), False
    )
    assert len(notes) == 1
    assert "are planned 0.00 m from each other" in notes[0]


def test_a_flight_is_at_each_goal_in_time():
    mission = load_mission("goto")
    config = mission.swarm(None)
    for i, rows in mission.hooks.goals(config).items():
        path = mission.hooks.flight(i, config)
        for t, *place in rows:
            assert path.sample(t).p == pytest.approx(place, abs=1e-6)


def test_a_goal_that_was_missed_is_named_with_its_time():
    mission = load_mission("goto")
    config = mission.swarm(None)
    results = {i: {"mark_errors_m": [0.01, 0.02, 0.01]} for i in config.ids}
    assert mission.report(config, results)["success"]
    results[1] = {"mark_errors_m": [0.01, 0.08, 0.06]}
    results[2] = {"mark_errors_m": [0.01]}
    assert mission.report(config, results)["reasons"] == {
        1: "0.080 m from its goal at 25 s, allowed 0.05 m",
        2: "its flight ended before its goal at 25 s",
    }


def test_other_numbers_of_drones_need_goals():
    config = load_mission("targets").swarm(3)
    hooks = GoalHooks(GoalOptions, [((5.0, 0.0, 0.0, 1.0),)])
    with pytest.raises(ConfigError, match=r"3; allowed: 1, or mission_options.goals"):
        hooks.check(config)
