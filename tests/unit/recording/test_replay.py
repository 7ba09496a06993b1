"""Drones that follow recordings: tables of samples, and flights. What cannot be followed is refused with a reason."""

import asyncio
from types import SimpleNamespace

import numpy as np
import pytest

from crazychoir.agent.agent import Agent
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.errors import ConfigError
from crazychoir.guidance.guidance import CFGuidance
from crazychoir.recording.mcap.file import RecordingEntry, RecordingFile, Series
from crazychoir.recording.mcap.messages import FORM_BY_VALUE_TYPE, make_packer
from crazychoir.recording.replay import replayed_states
from crazychoir.runtime.clock import run_virtual
from crazychoir.simulation.engines import make_worlds
from crazychoir.types import FPQR, State

DT = 0.01
ROWS = "t,x,y,z,yaw,vx,vy,vz\n0,1,0,0,0,0,0,0\n1,1,0,1,0.5,0,0,1\n2,1,1,1,1,0,0.4,0\n"


@pytest.fixture
def table(tmp_path):
    (tmp_path / "a.csv").write_text(ROWS)
    return tmp_path / "a.csv"


def recorded(path, topic=State, name="truth", drone=4):
    """A flight of two seconds along x, with its truth at 20 Hz, from 0.3 s after the begin of the recording on."""
    file = RecordingFile(path, {"version": "1"}, "{}", False)
    series, other = (
        Series(drone, name, FORM_BY_VALUE_TYPE[topic]),
        Series(2, "truth", FORM_BY_VALUE_TYPE[State]),
    )
    pack, also = make_packer(series.message, drone), make_packer(other.message, 2)
    entries = [RecordingEntry(other, 0, 0, also(State.at((9, 9, 9)), 0))]
    for k in range(41):
        t, ns = 0.05 * k, round(1e9 * (0.3 + 0.05 * k))
        state = State.at((np.sin(t), 0, 1), (np.cos(t), 0, 0))
        entries.append(RecordingEntry(series, ns, ns, pack(state, ns)))
    file.write(entries)
    file.close()
    return path


def swarm(uri, home):
    drones = [{"id": 0, "home": [0, 0, 0]}, {"id": 4, "home": home, "uri": uri}]
    return SwarmConfig.of({"name": "a", "graph": "path", "drones": drones})


def test_a_body_follows_its_table_and_stays_where_it_ends(table):
    config = swarm(f"replay://{table}", [1, 0, 0])
    _, world = make_worlds(config, config.ids)
    assert world.ids == (4,)
    seen = []
    for _ in range(250):
        world.step()
        seen.append(world.state(4).flat)
    np.testing.assert_allclose(seen[99][:6], [1, 0, 1, 0, 0, 1], atol=1e-9)
    assert 2 * np.arctan2(*seen[-1][8:10]) == pytest.approx(1.0), "its yaw"
    np.testing.assert_allclose(seen[-1][:6], [1, 1, 1, 0, 0, 0], atol=1e-9)
    assert np.linalg.norm(seen[150][3:6]) > 0.5
    np.testing.assert_allclose(np.linalg.norm(np.array(seen)[:, 6:10], axis=1), 1.0)


def test_a_replay_ignores_commands_and_counts_as_resting(table):
    config = swarm(f"replay://{table}", [1, 0, 0])
    one, other = make_worlds(config, (4,))[0], make_worlds(config, (4,))[0]
    link = one.link(4, "fpqr")
    for _ in range(100):
        link.send(FPQR(np.array([9.0, 9.0, 9.0, 9.0])))
        link.cut()
        one.step()
        other.step()
    np.testing.assert_array_equal(one.states, other.states)
    assert one.resting(4)
    assert one.harm(4) == ""
    assert one.crashed == []


def test_the_truth_of_a_recorded_flight_is_joined_by_its_velocities(tmp_path):
    path = recorded(tmp_path / "a.mcap")
    x = replayed_states(f"replay://{path}?drone=4", 0, DT)
    np.testing.assert_array_equal(x[:30, 0:3], np.tile([0, 0, 1], (30, 1)))
    t = np.arange(31, 220) * DT - 0.3
    np.testing.assert_allclose(x[31:220, 0], np.sin(t), atol=1e-6)
    np.testing.assert_allclose(x[31:220, 3], np.cos(t), atol=1e-4)


@pytest.mark.parametrize(
    ("uri", "says"),
    [
        ("replay://{}/none.csv", "none.csv.*readable CSV"),
        ("replay://{}/none.mcap", "none.mcap.*no file"),
        (
            "replay://{}/a.mcap?drone=7",
            "truth of drone 7.*nothing.*drone= one of .2, 4.",
        ),
        ("replay://{}/a.mcap?drone=x", "uri.*FILE.drone=NUMBER"),
        ("replay://{}/a.bag", "a.bag.*a table of samples, .csv"),
        ("replay://{}/a.csv", r"drone 4: home.*begins.*Set home = \[1.0, 0.0, 0.0\]"),
    ],
)
def test_what_cannot_be_followed_is_refused(tmp_path, table, uri, says):
    recorded(tmp_path / "a.mcap")
    config = swarm(uri.format(tmp_path), [2, 0, 0])
    with pytest.raises(ConfigError, match=says):
        make_worlds(config, config.ids)


# Times in other units than s -----------------------------------------------------------------------------------------


def rows(factor, origin):
    """Return a table of 30 samples, 10 ms apart; a second is `factor` units of its time."""
    times = [origin + round(0.01 * k * factor) for k in range(30)]
    return "t,x,y,z,yaw\n" + "".join(f"{t},1,0,0,0\n" for t in times)


@pytest.mark.parametrize(
    ("factor", "origin", "said"),
    [
        (1e9, 1_790_000_000_000_000_000, "line 31: .*They are ns"),
        (1e3, 1_790_000_000_000, "line 31: .*They are ms"),
        (1e3, 0, "line 31: .*They are ms"),
        (1e6, 0, "They are us"),
    ],
)
def test_times_in_another_unit_are_refused_with_line_and_unit(
    tmp_path, factor, origin, said
):
    path = tmp_path / "b.csv"
    path.write_text(rows(factor, origin))
    with pytest.raises(ConfigError, match=said):
        replayed_states(f"replay://{path}", 0, DT)


def test_clock_that_was_set_within_a_table_is_refused(tmp_path):
    path = tmp_path / "b.csv"
    path.write_text("t,x,y,z\n0,1,0,0\n1,1,0,0\n1790000000,1,0,0\n")
    with pytest.raises(ConfigError, match=r"line 4: .*after the row before"):
        replayed_states(f"replay://{path}", 0, DT)


def test_samples_written_by_hand_may_be_far_from_each_other(tmp_path):
    path = tmp_path / "b.csv"
    path.write_text("t,x,y,z\n0,1,0,0\n10,1,0,0\n20,1,0,1\n")
    assert len(replayed_states(f"replay://{path}", 0, 1.0)) == 21


# A mission of a drone that obeys nothing ------------------------------------------------------------------------------


class UpAndDown(CFGuidance):
    """Takes off, flies to some places, and lands."""

    def __init__(self, *places):
        self.places = places

    async def mission(self):
        await self.take_off()
        for place in self.places:
            await self.go_to(place)
        await self.land()


def test_mission_of_a_replayed_drone_ends_though_its_recording_ends_in_the_air(
    tmp_path, caplog
):
    config = swarm_with_replay(tmp_path)
    results = flown_with_replay(config)
    assert results[0]["success"]
    assert results[1]["success"]
    assert "obeys nothing: its landing ends 1.00 m above the ground" in caplog.text


def test_flight_of_a_replayed_drone_to_a_place_ends_with_the_reason(tmp_path):
    config = swarm_with_replay(tmp_path)
    results = flown_with_replay(config, [0.6, 1.0, 1.0])
    assert not results[1]["success"]
    assert "does not reach [0.6, 1.0, 1.0]" in results[1]["reason"]
    assert "follows a recording and obeys nothing" in results[1]["reason"]


def flown_with_replay(config, *places):
    """The results of a flight in virtual time, in which drone 1 is asked to fly to some places."""

    async def main(clock):
        mission = SimpleNamespace(
            guidance=lambda i, config: UpAndDown(*(places if i == 1 else ()))
        )
        agent = Agent(clock, config, mission, config.ids)
        async with asyncio.timeout(120.0):
            return await agent.run()

    return run_virtual(main)


def swarm_with_replay(tmp_path):
    """Two drones; the recording of drone 1 ends in the air."""
    path = tmp_path / "b.csv"
    path.write_text("t,x,y,z\n0,0.6,0,0\n3,0.6,0,1\n5,0.6,0,1\n")
    drones = [
        {"id": 0, "home": [0, 0, 0]},
        {"id": 1, "home": [0.6, 0, 0], "uri": f"replay://{path}"},
    ]
    return SwarmConfig.of({"name": "a", "graph": "path", "drones": drones})
