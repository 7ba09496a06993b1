"""The cooperative schemes fly to their goals, headless, over lossy links, and refuse what they cannot fly."""

import numpy as np
import pytest

from crazychoir.errors import ConfigError
from crazychoir.guidance.mission import load
from crazychoir.launch.flight import fly_fast
from crazychoir.launch.recording import recording_file
from crazychoir.swarm.config import SwarmConfig

pytestmark = pytest.mark.system
QUICK = {"takeoff_height": 0.5, "landing_speed": 1.0}


def flown(name, loss=0.0, file=None, config=None, **changes):
    """A mission's own swarm, or this one, with changes, in virtual time; checked first, as `run` does."""
    mission = load(name)
    config = (config or mission.swarm(None)).replace(**{"network": {"loss": loss}, **changes})
    mission.check(config, False)
    return config, fly_fast(config, mission, file=file)


@pytest.mark.parametrize(
    ("x", "loss", "places"),
    [(0.0, 0.3, {0: [-0.5, 0.5], 1: [-0.5, -0.5], 2: [0.5, 0.0]}),
     (0.2, 0.0, {0: [-0.3, 0.5], 1: [-0.3, -0.5], 2: [0.7, 0.0]})],
)  # fmt: skip
def test_defenders_end_between_their_intruders_and_the_target(x, loss, places):
    intruders = [[x - 1.0, 1.0], [x - 1.0, -1.0], [x + 1.0, 0.0]]
    options = {"target": [x, 0.0], "intruders": intruders, "duration": 6.0}
    _, result = flown("aggregative", loss, flight=QUICK, mission_options=options)
    assert result["success"], result["reasons"]
    for i, place in places.items():
        assert np.linalg.norm(np.subtract(result["places"][i], place)) < 0.01
    assert result["final_error_m"] < 0.01


def test_defenders_follow_intruders_that_fly_and_the_same_ones_replayed_from_a_recording(repository, tmp_path):
    config = SwarmConfig.load(repository / "deploy" / "aggregative_moving.toml")
    options, path = {"leg": 7.0, "legs": 1}, tmp_path / "a.mcap"
    with recording_file(path, config, virtual=True) as file:
        config, first = flown("aggregative", file=file, config=config, flight=QUICK, mission_options=options)
    drones = [
        {"id": i, "home": config.drone(i).home, "role": config.drone(i).role, **replayed}
        for i, replayed in enumerate([{}] * 3 + [{"uri": f"replay://{path}"}] * 3)
    ]
    _, again = flown("aggregative", config=config, drones=drones)
    for result in (first, again):
        assert result["success"], result["reasons"]
        assert result["final_error_m"] < 0.01
        assert 0.3 < result["lag_s"] < 1.0
        assert result["min_separation_m"] > 0.3
    assert again["results"][3] == {"success": True}, "it has flown nothing by itself"
    assert again["flown_m"][3] == pytest.approx(first["flown_m"][3], abs=0.05)


def test_a_row_moves_on_together_though_one_is_slow_and_messages_are_lost():
    config, result = flown("mpc", 0.3, flight=QUICK, mission_options={"shift": [1.0, 0.5], "duration": 9.0})
    assert result["success"], result["reasons"]
    assert result["formation_error_m"] < 0.02
    assert 0.25 < result["most_ahead_m"] <= result["reach_m"] == 0.35, "the constraint counts, and holds"
    assert all(count >= 10 for count in result["solved"].values())
    assert set(result["infeasible"].values()) == {0}


def test_four_cross_a_square_in_time():
    goals = {
        str(k): [[2.5, x, y, z], [9.5, -x, -y, z], [14.5, y, -x, z]]
        for k, (x, y, z) in enumerate([(1, 1, 0.55), (-1, 1, 0.85), (-1, -1, 1.15), (1, -1, 1.45)])
    }
    _, result = flown("goto", flight=QUICK, graph="path", mission_options={"goals": goals})
    assert result["success"], result["reasons"]
    assert max(max(errors) for errors in result["goal_errors_m"].values()) < 0.02
    assert [len(errors) for errors in result["goal_errors_m"].values()] == [3] * 4
    assert result["min_separation_m"] > 0.25


def test_two_exchange_their_places_head_on():
    config, result = flown("head_on", flight=QUICK)
    assert result["success"], result["reasons"]
    for i, end in ((0, [1.0, -0.1]), (1, [-1.0, 0.1])):
        assert np.linalg.norm(np.subtract(result["results"][i]["way"][-1][1:3], end)) < 0.02
    assert result["min_separation_m"] > 0.25


def test_targets_are_reached_one_after_the_other_by_one_command(here):
    said = here("crazychoir", "run", "targets", "--fast", "--json")
    assert said.code == 0, said.err
    times = said.json["reached_s"]["0"]
    assert len(times) == said.json["targets"] == 5
    assert times == sorted(times)


def test_a_word_that_is_not_flown_as_it_was_drawn_is_no_success():
    mission = load("drawn_path")
    config = mission.swarm(1)
    path = mission.drawn(config, 0).path
    rows = [[t, *path.sample(t).p.tolist()] for t in np.arange(0.0, path.duration, 0.1)]
    good = mission.report(config, {0: {"way": rows}})
    assert good["success"]
    assert good["written_mm"][0] < 15.0
    for wrong in (rows[: len(rows) // 2], [[t, x, y + 0.05, z] for t, x, y, z in rows], []):
        report = mission.report(config, {0: {"way": wrong}})
        assert report["success"] is False
        assert "from its drawing, allowed 30 mm" in report["reasons"][0]


def six(edges, role="intruder"):
    """Three defenders and three others in a row."""
    drones = [{"id": i, "home": [0.5 * i, 0.0, 0.0], "role": role if i > 2 else ""} for i in range(6)]
    return {"name": "six", "drones": drones, "edges": edges}


def goals_of(**goals):
    return {"graph": "path", "mission_options": {"goals": goals}}


PATH = [[0, 1], [1, 2], [0, 3], [1, 4]]


@pytest.mark.parametrize(
    ("name", "changes", "says"),
    [
        ("aggregative", {"graph": "empty"}, "graph.*not connected by themselves"),
        ("aggregative", {"mission_options": {"intruders": [[1, 1]]}}, "1 places in mission_options.intruders.*3: one"),
        ("aggregative", {"mission_options": {"intruders": [[9, 9], [1, 1], [1, 0]]}}, "drone 0 would end at.*fence"),
        ("aggregative", {"mission_options": {"step_size": -1}}, "step_size: found -1.*positive"),
        ("aggregative", {"mission_options": {"weights": [0, 1, 0]}}, "weights"),
        ("aggregative", {"mission_options": {"target": "here"}}, "target.*see agents/aggregative.py"),
        ("aggregative", six([*PATH, [4, 5]]), "no edge 2-5.*Add the edge .2, 5."),
        ("aggregative", six([[0, 3], [1, 3], [2, 3], [3, 4], [3, 5]]), "not connected by themselves"),
        ("aggregative", six([*PATH, [2, 5]], role="scout"), "3 places in mission_options.intruders.*6: one"),
        ("mpc", {"graph": "empty"}, "graph.*undirected and connected"),
        ("mpc", {"mission_options": {"shift": [9, 0]}}, "drone 0: goal.*inside .fence"),
        ("mpc", {"mission_options": {"reach": 0.05}}, "reach: found 0.05.*more than 0.05"),
        ("mpc", {"mission_options": {"speed": 3.0}}, "drone 0: speed: found 3.0.*flight.speed_limit"),
        ("mpc", {"mission_options": {"horizon": 2}}, "horizon: found 2.*3 steps"),
        (
            "mpc",
            {"graph": "path", "drones": [{"id": 0, "home": [0, 0, 0]}, {"id": 1, "home": [1, 0, 0],
             "options": {"goal": [1.0, 0.0]}}], "mission_options": {"shift": [1.0, 0.0]}},
            "drone 0: goal.*1.00 m more or less to go than drone 1.*infeasible at the start",
        ),
        ("goto", {"mission_options": {"goals": {"0": [[5, 0, 0, 1]]}}}, "goals of drones .0.*0 to 3"),
        ("goto", {"mission_options": {"levels": 2.0}}, r"drone 0: goals.*\[-2.0, -2.0, 0.0\]"),
        ("goto", {"mission_options": {"levels": "none"}}, "levels.*see agents/goto.py"),
        ("head_on", {"mission_options": {"goals": {"0": [[1, 1, 0, 1]], "1": [[9, -1, 0, 1]]}}}, "drone 0: goals.0."),
        ("targets", {"mission_options": {"targets": [[0, 0, 9]]}}, r"targets\[0\].*fence"),
        ("targets", {"mission_options": {"targets": []}}, "targets: found none"),
        ("targets", {"mission_options": {"targets": [1]}}, "mission_options"),
    ],
)  # fmt: skip
def test_what_cannot_be_flown_is_refused(name, changes, says):
    mission = load(name)
    base = SwarmConfig.of({"name": "a", **changes}) if "drones" in changes else mission.swarm(None).replace(**changes)
    with pytest.raises(ConfigError, match=says):
        mission.check(base, False)


def test_flights_that_meet_are_named_before_the_flight():
    mission = load("goto")
    assert mission.check(mission.swarm(None), False) == []
    notes = mission.check(mission.swarm(None).replace(mission_options={"levels": 0.0}), False)
    assert len(notes) == 1
    assert "are planned 0.00 m from each other" in notes[0]
