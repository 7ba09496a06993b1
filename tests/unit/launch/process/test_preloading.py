"""What the fork server reads once for all agents of a run."""

import sys

import pytest

from crazychoir.config.swarm_config import default_swarm
from crazychoir.errors import ConfigError
from crazychoir.launch.process.preloading import PreloadedSwarms
from crazychoir.numerics.compiling import KERNEL_QUEUE


@pytest.fixture
def write_swarm(tmp_path):
    def write(mission):
        path = tmp_path / "swarm.json"
        path.write_text(default_swarm(2).replace(mission=mission).dumps())
        return str(path)

    return write


def test_a_swarm_file_is_read_once(write_swarm):
    swarms = PreloadedSwarms()
    path = write_swarm("goto")
    assert swarms.find(path) is None
    assert swarms.preload(path) is True
    assert swarms.find(path).ids == (0, 1)
    assert swarms.preload(path) is False
    assert swarms.find(None) is None


def test_a_mission_of_the_package_and_its_laws_are_loaded(write_swarm, monkeypatch):
    monkeypatch.delitem(sys.modules, "crazychoir.agents.goto", raising=False)
    PreloadedSwarms().preload(write_swarm("goto"))
    assert "crazychoir.agents.goto" in sys.modules
    assert KERNEL_QUEUE.count_waiting() == 0


def test_a_mission_file_of_the_user_is_not_run(write_swarm, tmp_path):
    mission = tmp_path / "own.py"
    mission.write_text("raise RuntimeError('ran in the fork server')")
    swarms = PreloadedSwarms()
    assert swarms.preload(write_swarm(str(mission))) is True


def test_a_faulty_swarm_file_is_read_by_each_agent_itself(tmp_path):
    swarms = PreloadedSwarms()
    missing = str(tmp_path / "none.json")
    with pytest.raises(ConfigError):
        swarms.preload(missing)
    assert swarms.find(missing) is None
