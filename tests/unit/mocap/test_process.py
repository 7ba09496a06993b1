"""The process of motion capture and its readers, in virtual time; sources are stand-ins."""

import asyncio
from types import SimpleNamespace

import numpy as np
import pytest

from crazychoir.bus.port import PORT_ADDRESSES
from crazychoir.bus.topics import DRONE_TOPICS
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.errors import ConfigError
from crazychoir.mocap.frames import PoseFrame, make_frame, parse_frame
from crazychoir.mocap.mounting import Mounting
from crazychoir.mocap.process import SHUTDOWN_PATIENCE, MocapProcess, make_source
from crazychoir.runtime.actor import Actor
from crazychoir.runtime.clock import run_virtual
from crazychoir.runtime.mailbox import Call
from crazychoir.types import Body


class Cameras:
    """100 Hz: drone 0 flies along x at 1 m/s, drone 1 stands; fails once at frame `fails`."""

    live, state, where = True, "connected", "test cameras"

    def __init__(self, clock, seconds, fails=None, bodies=None):
        self.clock, self.again, self._frames, self._fails = (
            clock,
            0,
            round(100 * seconds),
            fails,
        )
        self._bodies, self._k = bodies or self.flown, 0

    def flown(self, k):
        x = {"cf0": k / 100, "b": 2.0}
        return {
            name: np.array([at, 0.0, 1.0 + 1e-6 * k, 0.0, 0.0, 0.0, 1.0])
            for name, at in x.items()
        }

    async def run(self, take):
        async for _ in self.clock.ticks(100.0):
            if self._k == self._fails:
                self._fails = None
                raise RuntimeError("lens cap")
            if self._k >= self._frames:
                return
            take(PoseFrame(self._k, self._k / 100, self._bodies(self._k)), 0.001)
            self._k += 1


class Link(Actor):
    """A stand-in for the network; `directory` names the agents that are there."""

    name = "zenoh"

    def __init__(self):
        self.directory = {}

    async def run(self):
        await asyncio.Event().wait()


def swarm(mocap=None, **keys):
    drones = [
        {"id": i, "home": [float(i), 0.0, 0.0], "uri": f"udp://127.0.0.1:{19850 + i}"}
        for i in range(2)
    ]
    drones[1] |= {"body": "b", **keys}
    return SwarmConfig.of(
        {"name": "lab", "drones": drones, "mocap": mocap or {"source": "mock"}}
    )


def served(seconds=2.0, config=None, act=None, cameras=Cameras, **source):
    """What a reader gets of each drone while the process runs: {(topic, i): [(time, value, age)]}, and the process."""

    async def main(clock):
        mocap = MocapProcess(
            clock, config or swarm(), cameras(clock, seconds, **source), "m", "here", 1
        )
        mocap.bus.port(PORT_ADDRESSES.first_observer)
        got = {}
        for topic in (DRONE_TOPICS.pose, DRONE_TOPICS.truth):
            for i in mocap.tracks:
                kept = got[topic, i] = []
                box = Call(
                    clock,
                    lambda value, age, kept=kept: kept.append(
                        (clock.now(), value, age)
                    ),
                )
                mocap.bus.subscribe(
                    topic,
                    PORT_ADDRESSES.camera_offset + i,
                    PORT_ADDRESSES.first_observer,
                    box,
                )
        link = Link()
        serving = asyncio.create_task(mocap.serve(link))
        await (act(clock, mocap, link) if act else clock.sleep(seconds + 0.5))
        mocap.end("it is over")
        await serving
        return got, mocap, clock.now()

    return run_virtual(main)


def test_each_drone_that_is_seen_gets_its_poses_and_its_truth():
    got, mocap, _ = served()
    assert [pose.p[0] for _, pose, _ in got[DRONE_TOPICS.pose, 0]] == [
        k / 100 for k in range(200)
    ]
    assert {pose.p[0] for _, pose, _ in got[DRONE_TOPICS.pose, 1]} == {2.0}
    assert {pose.age for _, pose, _ in got[DRONE_TOPICS.pose, 0]} == {0.001}, (
        "as old as the source says"
    )
    assert len(got[DRONE_TOPICS.truth, 0]) == pytest.approx(40, abs=1)
    _, state, _ = got[DRONE_TOPICS.truth, 0][-1]
    np.testing.assert_allclose(state.v, [1.0, 0.0, 1e-4], atol=1e-3)
    assert mocap.report()["seen"] == {0: 200, 1: 200}


def test_poses_are_those_of_the_drone_and_not_of_its_body():
    config = swarm(body_offset=[0.0, 0.0, 0.03], body_rotation=[0.0, 0.0, 1.5])
    got, _, _ = served(config=config)
    flat = np.array([2.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0])
    expected = Mounting((0.0, 0.0, 0.03), (0.0, 0.0, 1.5)).drone(flat)
    np.testing.assert_allclose(
        got[DRONE_TOPICS.pose, 1][0][1].flat, expected, atol=1e-12
    )
    assert expected[2] == pytest.approx(0.97)
    assert expected[5] != 0.0


def test_a_body_that_shows_the_same_digits_again_gets_old():
    still = np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0])
    got, _, _ = served(1.0, bodies=lambda k: {"cf0": still})
    ages = [age for _, _, age in got[DRONE_TOPICS.pose, 0]]
    np.testing.assert_allclose(ages, 0.001 + np.arange(100) / 100, atol=1e-6)
    assert got[DRONE_TOPICS.pose, 1] == []


def test_truth_of_virtual_drones_has_no_noise_and_their_poses_have():
    got, _, _ = served(config=swarm({"noise": 0.01, "tilt": [0.1, 0.0]}))
    x = np.array(
        [
            pose.p[0] - k / 100
            for k, (_, pose, _) in enumerate(got[DRONE_TOPICS.pose, 0])
        ]
    )
    assert np.std(x) == pytest.approx(0.01, rel=0.3)
    told = [
        (state.p[0] - now, state.q[0])
        for now, state, _ in got[DRONE_TOPICS.truth, 0]
        if now > 0.5
    ]
    assert np.std([x for x, _ in told]) < 1e-6
    assert {tilt for _, tilt in told} == {0.0}


def test_truth_of_a_virtual_drone_is_that_of_the_drone_and_not_of_its_body():
    mounting = {"body_offset": [0.0, 0.0, 0.03], "body_rotation": [0.0, 0.0, 1.5]}
    got, _, _ = served(config=swarm({"source": "virtual"}, **mounting))
    flat = np.array([2.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0])
    expected = Mounting((0.0, 0.0, 0.03), (0.0, 0.0, 1.5)).drone(flat)
    state = got[DRONE_TOPICS.truth, 1][0][1]
    np.testing.assert_allclose(state.p, expected[:3], atol=1e-4)
    np.testing.assert_allclose(state.q, expected[3:], atol=1e-9)


def test_a_source_that_fails_runs_again(caplog):
    got, mocap, _ = served(fails=50)
    assert len(got[DRONE_TOPICS.pose, 0]) == 200
    assert not mocap.failure
    assert "lens cap" in caplog.text


def ends(clock, mocap, link, after=0.0, leaves=None):
    async def act():
        await clock.sleep(0.5)
        link.directory[1] = object()
        mocap.end("SIGTERM")
        if leaves is not None:
            await clock.sleep(leaves)
            link.directory.clear()

    return act()


def test_it_ends_at_once_where_no_agent_of_its_drones_is():
    async def act(clock, mocap, link):
        link.directory[PORT_ADDRESSES.camera_offset + 7] = link.directory[7] = object()
        await clock.sleep(0.5)
        mocap.end("SIGTERM")

    _, mocap, now = served(30.0, act=act)
    assert now == pytest.approx(0.5, abs=0.01)
    assert not mocap.failure


def test_it_goes_on_until_the_agents_of_its_drones_have_ended(caplog):
    got, _, now = served(30.0, act=lambda *them: ends(*them, leaves=7.0))
    assert 7.5 <= now < 7.8
    assert got[DRONE_TOPICS.pose, 1][-1][0] > 7.4
    assert (
        "SIGTERM: it goes on until drone(s) 1 are down and without agents"
        in caplog.text
    )


def test_it_goes_on_while_a_drone_flies_that_its_agent_has_left():
    """Its firmware lands it, and needs its poses."""

    async def act(clock, mocap, link):
        owner = mocap.bus.port(PORT_ADDRESSES.body_offset + 1)
        for k in range(1, 21):
            owner.publish(DRONE_TOPICS.body, Body("", flying=k < 15))
            if k == 3:
                mocap.end("SIGTERM")
            await clock.sleep(0.25)

    got, _, now = served(30.0, act=act)
    assert got[DRONE_TOPICS.pose, 1][-1][0] == pytest.approx(0.25 * 14, abs=0.3)
    assert now == 5.0


def test_the_end_does_not_wait_for_a_drone_without_news():
    async def act(clock, mocap, link):
        mocap.bus.port(PORT_ADDRESSES.body_offset + 1).publish(
            DRONE_TOPICS.body, Body("", flying=True)
        )
        await clock.sleep(0.1)
        mocap.end("SIGTERM")
        await clock.sleep(5.0)

    got, _, _ = served(30.0, act=act)
    assert got[DRONE_TOPICS.pose, 1][-1][0] == pytest.approx(
        DRONE_TOPICS.body.max_age, abs=0.3
    )


def test_but_not_for_ever():
    _, _, now = served(90.0, act=ends)
    assert now == pytest.approx(0.5 + SHUTDOWN_PATIENCE, abs=0.3)


def test_a_swarm_without_drones_that_are_seen_is_refused():
    config = SwarmConfig.of(
        {"name": "lab", "drones": [{"id": 0, "home": [0.0, 0.0, 0.0]}]}
    )
    with pytest.raises(ConfigError, match="no drone that is seen"):
        MocapProcess(
            SimpleNamespace(now=lambda: 0.0, now_ns=lambda: 0),
            config,
            Cameras(None, 1),
            "m",
            "here",
            1,
        )


@pytest.mark.parametrize("origin", [0.0, -40.0, 1.76e9])
def test_a_recording_from_any_origin_of_time_is_seen_frame_by_frame(tmp_path, origin):
    head = "t,name,x,y,z,qx,qy,qz,qw"
    rows = [f"{origin + k / 100!r},cf0,{k / 100},0,1,0,0,0,1" for k in range(100)]
    (tmp_path / "flight.csv").write_text("\n".join([head, *rows]))
    config = swarm({"source": "replay", "file": str(tmp_path / "flight.csv")})

    async def main(clock):
        mocap = MocapProcess(clock, config, make_source(clock, config), "m", "here", 1)
        serving = asyncio.create_task(mocap.serve(Link()))
        await clock.sleep(2.0)
        mocap.end("it is over")
        await serving
        return mocap.report()

    report = run_virtual(main)
    assert (report["frames"], report["lost"], report["late"], report["timeless"]) == (
        100,
        0,
        0,
        0,
    )
    assert report["seen"] == {0: 100, 1: 0}
    assert report["success"]


def test_a_run_that_saw_no_frame_is_no_success():
    _, mocap, _ = served(0.0)
    report = mocap.report()
    assert report["frames"] == 0
    assert not report["success"]
    assert "test cameras (connected): no frame was seen" in report["reason"]


def test_a_source_without_frame_times_in_seconds_is_no_success():
    class Milliseconds(Cameras):
        async def run(self, take):
            await super().run(
                lambda frame, age: take(
                    PoseFrame(frame.number, 1.76e12 + frame.time, frame.bodies), age
                )
            )

    _, mocap, _ = served(cameras=Milliseconds)
    assert not mocap.report()["success"]
    assert (
        "200 were dropped, because their time is not a number of s"
        in mocap.report()["reason"]
    )


def test_a_source_that_saw_no_body_of_a_drone_is_no_success():
    _, mocap, _ = served(
        bodies=lambda k: {
            "wand": np.array([0.0, 0.0, 1.0 + 1e-6 * k, 0.0, 0.0, 0.0, 1.0])
        }
    )
    report = mocap.report()
    assert report["frames"] == 200
    assert not report["success"]
    assert "the frames have 'wand', the swarm file 'cf0', 'b'" in report["reason"]


def test_a_body_that_is_twice_in_a_frame_is_not_seen_and_said(caplog):
    class Doubling(Cameras):
        async def run(self, take):
            def doubled(frame, age):
                rows = [*frame.bodies.items(), ("b", frame.bodies["cf0"])]
                take(
                    parse_frame(make_frame(frame.number, frame.time, rows).packed()),
                    age,
                )

            await super().run(doubled)

    got, mocap, _ = served(cameras=Doubling)
    assert len(got[DRONE_TOPICS.pose, 0]) == 200
    assert not got[DRONE_TOPICS.pose, 1], "it is unknown which of the two is meant"
    assert "body 'b' is there twice in a frame" in caplog.text
    assert mocap.report()["success"], "the other drone was seen"
