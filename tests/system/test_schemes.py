"""The cooperative schemes fly to their goals, headless, over lossy links, and refuse what they cannot fly."""

import numpy as np
import pytest

from crazychoir.agent.agent import Agent
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.errors import ConfigError
from crazychoir.guidance.mission import load_mission
from crazychoir.guidance.mpc import MPCGuidance
from crazychoir.launch.flight import fly_fast
from crazychoir.launch.recording import open_recording_file
from crazychoir.optimization.algorithms.aggregative_tracking import AggregativeTracking
from crazychoir.runtime.clock import NS_PER_SECOND, run_virtual

pytestmark = pytest.mark.system
QUICK = {"takeoff_height": 0.5, "landing_speed": 1.0}
CLEAR = 0.24
"""m: two semi-axes, between two at one height."""
ABOVE = {str(i): [[9.0, 0.5 * i, 0.0, 4.0]] for i in range(4)}


def flown(name, loss=0.0, file=None, config=None, **changes):
    """A mission's own swarm, or this one, with changes, in virtual time; checked first, as `run` does."""
    mission = load_mission(name)
    config = (config or mission.swarm(None)).replace(
        **{"network": {"loss": loss}, **changes}
    )
    mission.check(config, False)
    return config, fly_fast(config, mission, file=file)


@pytest.mark.parametrize(
    ("x", "loss", "places"),
    [
        (0.0, 0.3, {0: [-0.5, 0.5], 1: [-0.5, -0.5], 2: [0.5, 0.0]}),
        (0.2, 0.0, {0: [-0.3, 0.5], 1: [-0.3, -0.5], 2: [0.7, 0.0]}),
    ],
)
def test_defenders_end_between_their_intruders_and_the_target(x, loss, places):
    intruders = [[x - 1.0, 1.0], [x - 1.0, -1.0], [x + 1.0, 0.0]]
    options = {"target": [x, 0.0], "intruders": intruders, "duration": 6.0}
    _, result = flown("aggregative", loss, flight=QUICK, mission_options=options)
    assert result["success"], result["reasons"]
    for i, place in places.items():
        assert np.linalg.norm(np.subtract(result["places"][i], place)) < 0.01
    assert result["final_error_m"] < 0.01


def test_a_round_that_fails_beside_the_law_ends_the_law_at_once(monkeypatch):
    step = AggregativeTracking.step

    def fails(self, heard):
        if self.k == 20:
            raise ValueError("no idea")
        step(self, heard)

    monkeypatch.setattr(AggregativeTracking, "step", fails)
    _, result = flown("aggregative", flight=QUICK, mission_options={"duration": 30.0})
    assert all("ValueError: no idea" in reason for reason in result["reasons"].values())
    assert set(result["reasons"]) == {0, 1, 2}
    assert result["simulated_s"] < 20.0


def test_defenders_follow_intruders_that_fly_and_the_same_ones_replayed_from_a_recording(
    repository, tmp_path
):
    config = SwarmConfig.load(repository / "deploy" / "aggregative_moving.toml")
    options, path = {"leg": 7.0, "legs": 1}, tmp_path / "a.mcap"
    with open_recording_file(
        path, config, load_mission("aggregative"), virtual=True
    ) as file:
        config, first = flown(
            "aggregative",
            file=file,
            config=config,
            flight=QUICK,
            mission_options=options,
        )
    drones = [
        {
            "id": i,
            "home": config.drone(i).home,
            "role": config.drone(i).role,
            **replayed,
        }
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


def test_a_row_moves_on_together_though_one_is_slow_and_messages_are_lost(monkeypatch):
    flat, step = [], MPCGuidance.step

    def kept(self, me, heard):
        wanted = step(self, me, heard)
        if self.id == 0:
            flat.append(wanted.flat)
        return wanted

    monkeypatch.setattr(MPCGuidance, "step", kept)
    _, result = flown(
        "mpc", 0.3, flight=QUICK, mission_options={"shift": [1.0, 0.5], "duration": 9.0}
    )
    assert result["success"], result["reasons"]
    assert result["formation_error_m"] < 0.02
    assert 0.25 < result["most_ahead_m"] <= result["reach_m"] == 0.35, (
        "the constraint counts, and holds"
    )
    assert all(count >= 10 for count in result["solved"].values())
    assert set(result["infeasible"].values()) == {0}
    p, v, a, j = (np.array(flat)[:, 3 * n : 3 * n + 3] for n in range(4))
    for slope, x, most in (
        (v, p, 1e-4),
        (a, v, 1e-3),
        (j, a, 0.05),
    ):  # only the jerk of the reference jumps
        assert (
            np.abs(np.diff(x, axis=0) - 0.005 * (slope[1:] + slope[:-1])).max() < most
        )


def test_a_row_waits_for_a_drone_that_its_operator_holds():
    mission = load_mission("mpc")
    options = {"shift": [1.5, 0.0], "duration": 14.0}
    config = mission.swarm(None).replace(
        flight=QUICK, mission_options=options, mocap={"tilt_spread": 0.0}
    )

    async def main(clock):
        agent = Agent(clock, config, mission, config.ids)
        for seconds, on in ((4.0, True), (8.0, False)):
            clock.call_at(
                round(seconds * NS_PER_SECOND), agent.drones[1].pilot.hold, on
            )
        return await agent.run()

    results = run_virtual(main)
    way = {i: np.array(result["way"]) for i, result in results.items()}
    held = (way[1][:, 0] > 4.0) & (way[1][:, 0] < 5.0)
    assert np.ptp(way[1][held, 1]) < 0.01, "it stood"
    ahead, _ = mission.hooks.most_ahead(config, results)
    assert 0.3 < ahead < 0.9, (
        "they waited: a step until it is seen, one until it is decided, and brakes; of 1.5 m"
    )
    assert all(result["infeasible"] == 0 for result in results.values())
    for i, result in results.items():
        assert np.linalg.norm(result["place"][:2] - mission.goal(config)[i][:2]) < 0.03


@pytest.mark.parametrize("until", [{"until": 8.0}, {}])
def test_defenders_go_on_after_a_partition_and_land_when_a_mate_is_lost(until):
    network = {"partitions": [{"at": 6.0, "groups": [[0], [1, 2]], **until}]}
    options = {"duration": 9.0}
    _, result = flown(
        "aggregative",
        flight=QUICK,
        network=network,
        lost_after=3.0,
        mission_options=options,
    )
    assert result["success"] is bool(until)
    assert result["results"][0]["success"] is bool(until)
    assert (result["reasons"] == {}) is bool(until)
    assert all(
        result["results"][i]["success"] or "left [" in result["reasons"][i]
        for i in range(3)
    ), result["reasons"]


def test_four_cross_a_square_in_time():
    goals = {
        str(k): [[2.5, x, y, 1.0], [9.5, -x, -y, 1.0], [14.5, y, -x, 1.0]]
        for k, (x, y) in enumerate([(1, 1), (-1, 1), (-1, -1), (1, -1)])
    }
    _, result = flown(
        "goto", flight=QUICK, graph="path", mission_options={"goals": goals}
    )
    assert result["success"], result["reasons"]
    assert max(max(errors) for errors in result["goal_errors_m"].values()) < 0.02
    assert [len(errors) for errors in result["goal_errors_m"].values()] == [3] * 4
    assert result["min_separation_m"] > CLEAR


@pytest.mark.parametrize(
    "method", ["barrier", pytest.param("cells", marks=pytest.mark.slow)]
)
def test_two_exchange_their_places_head_on(method):
    _, result = flown("head_on", 0.1, flight=QUICK, collision={"method": method})
    assert result["success"], result["reasons"]
    for i, end in ((0, [1.0, -0.1]), (1, [-1.0, 0.1])):
        assert (
            np.linalg.norm(np.subtract(result["results"][i]["way"][-1][1:3], end))
            < 0.02
        )
    assert result["min_separation_m"] > CLEAR


def test_two_head_on_meet_without_the_filter():
    goals = {
        "0": [[2.5, -0.5, 0.1, 1], [6.5, 0.5, -0.1, 1]],
        "1": [[2.5, 0.5, -0.1, 1], [6.5, -0.5, 0.1, 1]],
    }
    _, result = flown(
        "head_on",
        flight=QUICK,
        collision={"method": "off"},
        mission_options={"goals": goals},
    )
    assert result["min_separation_m"] < 0.15


def test_targets_are_reached_one_after_the_other_by_one_command(here):
    said = here("crazychoir", "run", "targets", "--fast", "--json")
    assert said.code == 0, said.err
    times = said.json["reached_s"]["0"]
    assert len(times) == said.json["targets"] == 5
    assert times == sorted(times)


PICTURE = """<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 600 600"><defs><path id="n" d="M0 0H9000"/></defs>
<g transform="translate(300 300)" fill="none" stroke="#000"><path id="arc" d="M-200 0a200 200 0 01400 0"/>
<rect x="-50" y="50" width="100" height="80" rx="20"/><path id="off" display="none" d="M0 0H9000"/></g></svg>"""


def test_an_svg_picture_is_flown_as_it_is_seen(tmp_path):
    file = tmp_path / "picture.svg"
    file.write_text(PICTURE)
    mission = load_mission("drawn_path")
    config = mission.swarm(1).replace(mission_options={"drawing": str(file)})
    said = mission.check(config)
    assert said[1:] == [f'{file}: <path id="off"> in line 3: left out: display: none']
    result = fly_fast(config, mission)
    assert result["success"], result["reasons"]
    x, y = np.array(result["results"][0]["way"])[:, 1:3].T
    assert np.ptp(x) == pytest.approx(0.4, abs=0.03)
    assert np.ptp(y) == pytest.approx(0.33, abs=0.03)
    assert x[np.argmax(y)] == pytest.approx(0.0, abs=0.03), (
        "the arc is above the rectangle"
    )
    with pytest.raises(ConfigError, match='"drawn"'):
        mission.check(
            config.replace(mission_options={"drawing": str(file), "timing": "drawn"})
        )


def test_long_sides_between_round_corners_are_flown_straight(tmp_path):
    file = tmp_path / "plate.svg"
    file.write_text(
        '<svg xmlns="http://www.w3.org/2000/svg"><rect width="1000" height="800" rx="30"/></svg>'
    )
    mission = load_mission("drawn_path")
    config = mission.swarm(1).replace(mission_options={"drawing": str(file)})
    result = fly_fast(config, mission)
    assert result["success"], result["reasons"]
    assert result["deviation_mm"] < 15.0
    x, y = np.array(result["results"][0]["way"])[:, 1:3].T
    assert np.ptp(x) == pytest.approx(1.0, abs=0.03)
    assert np.ptp(y) == pytest.approx(0.8, abs=0.03)


def six(edges, role="intruder"):
    """Three defenders and three others in a row."""
    drones = [
        {"id": i, "home": [0.5 * i, 0.0, 0.0], "role": role if i > 2 else ""}
        for i in range(6)
    ]
    return {"name": "six", "drones": drones, "edges": edges}


def goals_of(**goals):
    return {"graph": "path", "mission_options": {"goals": goals}}


PATH = [[0, 1], [1, 2], [0, 3], [1, 4]]


@pytest.mark.parametrize(
    ("name", "changes", "says"),
    [
        ("aggregative", {"graph": "empty"}, "graph.*not connected by themselves"),
        (
            "aggregative",
            {"mission_options": {"intruders": [[1, 1]]}},
            "1 places in mission_options.intruders.*3: one",
        ),
        (
            "aggregative",
            {"mission_options": {"intruders": [[9, 9], [1, 1], [1, 0]]}},
            "drone 0 would end at.*fence",
        ),
        (
            "aggregative",
            {"mission_options": {"step_size": -1}},
            "step_size: found -1.*a share",
        ),
        ("aggregative", {"mission_options": {"weights": [0, 1, 0]}}, "weights"),
        ("aggregative", {"mission_options": {"target": "here"}}, "target.*a place"),
        ("aggregative", six([*PATH, [4, 5]]), "no edge 2-5.*Add the edge .2, 5."),
        (
            "aggregative",
            six([[0, 3], [1, 3], [2, 3], [3, 4], [3, 5]]),
            "not connected by themselves",
        ),
        (
            "aggregative",
            six([*PATH, [2, 5]], role="scout"),
            "3 places in mission_options.intruders.*6: one",
        ),
        ("mpc", {"graph": "empty"}, "graph.*undirected and connected"),
        ("mpc", {"mission_options": {"shift": [9, 0]}}, "drone 0: goal.*inside .fence"),
        (
            "mpc",
            {"mission_options": {"reach": 0.05}},
            "reach: found 0.05.*more than 0.05",
        ),
        (
            "mpc",
            {"mission_options": {"speed": 3.0}},
            "drone 0: speed: found 3.0.*flight.speed_limit",
        ),
        ("mpc", {"mission_options": {"horizon": 2}}, "horizon: found 2.*3 steps"),
        (
            "mpc",
            {
                "graph": "path",
                "drones": [
                    {"id": 0, "home": [0, 0, 0]},
                    {"id": 1, "home": [1, 0, 0], "options": {"goal": [1.0, 0.0]}},
                ],
                "mission_options": {"shift": [1.0, 0.0]},
            },
            "drone 0: goal.*1.00 m more or less to go than drone 1.*infeasible at the start",
        ),
        (
            "goto",
            {"mission_options": {"goals": {"0": [[5, 0, 0, 1]]}}},
            "places of drones .0.*0 to 3",
        ),
        (
            "goto",
            {"mission_options": {"goals": ABOVE}},
            r"drone 0: goals.*\[-2.0, -2.0, 0.0\]",
        ),
        ("goto", {"mission_options": {"goals": "none"}}, "goals.*one row"),
        (
            "head_on",
            {"mission_options": {"goals": {"0": [[1, 1, 0, 1]], "1": [[9, -1, 0, 1]]}}},
            "drone 0: goals.0.",
        ),
        (
            "targets",
            {"mission_options": {"targets": [[0, 0, 9]]}},
            r"targets\[0\].*fence",
        ),
        ("targets", {"mission_options": {"targets": []}}, "targets.*one place"),
        ("targets", {"mission_options": {"targets": [1]}}, "targets.*one place"),
    ],
)
def test_what_cannot_be_flown_is_refused(name, changes, says):
    mission = load_mission(name)
    base = (
        SwarmConfig.of({"name": "a", **changes})
        if "drones" in changes
        else mission.swarm(None).replace(**changes)
    )
    with pytest.raises(ConfigError, match=says):
        mission.check(base, False)
