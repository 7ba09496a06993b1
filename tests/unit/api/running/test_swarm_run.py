"""The bodies and the files of a run that a program starts."""

import signal
import subprocess

import pytest
from msgspec.structs import replace

from crazychoir.agents import operator as mission
from crazychoir.api.connecting import launch
from crazychoir.api.running.swarm_run import SwarmRun, with_virtual_bodies
from crazychoir.errors import ConfigError
from crazychoir.guidance.mission import check_before_flight, load_mission


def test_virtual_bodies_have_ports_of_their_own_and_share_dongles():
    config = with_virtual_bodies(mission.swarm(6))
    assert len({drone.uri for drone in config.drones} | {config.mocap.port}) == 7
    assert all(drone.uri.startswith("udp://127.0.0.1:") for drone in config.drones)
    assert config.topology.dongles == {0: (0, 1, 2), 1: (3, 4, 5)}
    assert config.mocap.source == "virtual"
    assert config.control.sender == "xyz"
    assert config.mission == "operator"
    assert check_before_flight(load_mission("operator"), config) == []


def test_virtual_bodies_are_seen_by_the_cameras_of_this_machine():
    cameras = {"source": "vicon", "hostname": "192.168.1.2", "rate": 50.0}
    mocap = with_virtual_bodies(mission.swarm(2).replace(mocap=cameras)).mocap
    assert (mocap.source, mocap.hostname) == ("virtual", "127.0.0.1")
    assert mocap.rate == 50.0


def test_virtual_bodies_keep_the_platforms_of_real_drones():
    (paper, real) = mission.swarm(2).drones
    real = replace(real, platform="cf21bl")
    flown = with_virtual_bodies(mission.swarm(2).replace(drones=[paper, real]))
    assert [drone.platform for drone in flown.drones] == ["cf21", "cf21bl"]


class StuckProcess:
    """A process that ends only when it is killed."""

    def __init__(self):
        self.got = []

    def send_signal(self, number):
        self.got.append(number)

    def kill(self):
        self.got.append(signal.SIGKILL)

    def communicate(self, timeout=None):
        if signal.SIGKILL not in self.got:
            raise subprocess.TimeoutExpired("virtual", timeout)


def test_virtual_bodies_that_do_not_end_are_killed():
    run = object.__new__(SwarmRun)
    run._bodies = stuck = StuckProcess()
    run._end_bodies()
    assert stuck.got == [signal.SIGINT, signal.SIGKILL]
    assert run._bodies is None


def test_unknown_bodies_are_refused_before_anything_starts():
    with pytest.raises(ConfigError, match='allowed: "sim" or "virtual"'):
        launch("operator", drones=2, bodies="real")


def test_a_recording_that_is_there_is_refused_before_anything_starts(
    tmp_path, monkeypatch
):
    monkeypatch.setattr("crazychoir.api.connecting.SwarmRun", None)
    path = tmp_path / "a.mcap"
    path.touch()
    with pytest.raises(ConfigError, match=r"a\.mcap: there is one already"):
        launch("operator", drones=2, record=path)
