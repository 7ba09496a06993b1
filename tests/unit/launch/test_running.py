"""A run is found while it flies, by its file or alone; two never stand for one another."""

import json
import os
import socket
import subprocess
import sys
from dataclasses import asdict

import pytest

from crazychoir.cli import meant
from crazychoir.cli.chosen import named_file
from crazychoir.cli.meant import DISCOVERY, STARTS, nobody, patience, running_swarm
from crazychoir.errors import Refused
from crazychoir.launch.running import Run, of_file, recorded, runs
from crazychoir.swarm.config import SwarmConfig, default_swarm, demo_swarm

LAB = default_swarm(2).replace(name="lab")


@pytest.fixture(autouse=True)
def own_place(tmp_path, monkeypatch):
    """Records of these tests alone, and a working folder with a swarm file lab.toml."""
    monkeypatch.setenv("CRAZYCHOIR_RUNTIME_DIR", str(tmp_path / "crazychoir"))
    monkeypatch.chdir(tmp_path)
    (tmp_path / "lab.toml").write_text(LAB.dumps())
    return tmp_path


def run_of(folder, name, source=None):
    """A run as `crazychoir run` leaves it: under a name of its own, by a file of its own."""
    file = folder / f"{name}.json"
    file.write_text(default_swarm(2).replace(name=name).dumps())
    return Run(name, source or "pickup_delivery", source and named_file(source, None), str(file))


def test_my_file_finds_the_swarm_that_was_started_by_it(own_place):
    run = run_of(own_place, "lab-1", "lab.toml")
    assert running_swarm("lab.toml") == LAB, "nothing runs: its agents may have been started one by one"
    with recorded(run):
        assert running_swarm("lab.toml").name == "lab-1"
        assert running_swarm(str(own_place / "lab.toml")).name == "lab-1"
        assert running_swarm(run.file).name == "lab-1"
    assert running_swarm("lab.toml") == LAB


def test_without_a_file_the_only_run_is_meant(own_place, monkeypatch):
    with pytest.raises(Refused, match="no swarm of yours runs here"):
        running_swarm(None)
    monkeypatch.setattr(meant, "_listens", lambda port: port == demo_swarm().base_port)
    found = running_swarm(None)
    assert found.name == "pickup", "the swarm of the demo's mission, if anybody is there"
    assert found.endpoints() == demo_swarm().endpoints(), "it is looked for where it is"
    with recorded(run_of(own_place, "demo-1")):
        assert running_swarm(None).name == "demo-1"
        (own_place / "swarm.toml").write_text(LAB.dumps())
        assert running_swarm(None) == LAB, "./swarm.toml goes first"


def test_of_several_none_is_guessed(own_place):
    one, other = run_of(own_place, "lab-1", "lab.toml"), run_of(own_place, "lab-2", "lab.toml")
    with recorded(one):
        with recorded(other), recorded(run_of(own_place, "demo-1")):
            assert [run.swarm for run in runs()] == ["demo-1", "lab-1", "lab-2"]
            for option in ("lab.toml", None):
                with pytest.raises(Refused, match="several") as refused:
                    running_swarm(option)
                assert one.file in refused.value.reason
                assert other.file in refused.value.reason
            assert ("demo-1" in refused.value.reason), "it could be meant too"
        assert running_swarm("lab.toml").name == "lab-1", "the end of one leaves the other alone"


def test_nobody_is_waited_for_who_cannot_be_there_and_a_run_that_starts_is(own_place):
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        port = taken.getsockname()[1]
        here = default_swarm(2).replace(name="lab-1", base_port=port - 1)
        assert patience(here) == 0.0, "nobody listens yet"
        taken.listen()
        assert patience(here) == DISCOVERY, "drone 1 does"
    drones = [{"id": i, "home": [i, 0, 0], "host": "far"} for i in range(2)]
    raw = {"name": "lab", "drones": drones, "hosts": {"far": "10.9.9.9"}, "security": {"insecure": True}}
    far = SwarmConfig.of(raw)
    assert patience(far) == DISCOVERY, "on another host, that is not asked"
    with recorded(run_of(own_place, "lab-1")):
        assert patience(here) == STARTS
        assert "Name one: --swarm" in nobody(LAB, "lab.toml").reason


def test_a_run_that_is_starting_is_not_absent_and_names_no_other(own_place):
    with recorded(run_of(own_place, "lab-1", "lab.toml")), recorded(run_of(own_place, "demo-1")):
        said = nobody(running_swarm("lab.toml"), "lab.toml").reason
        assert "has not started them yet (a first run compiles its laws" in said
        assert said.endswith("try again.")
        assert "--swarm" not in said
        assert "is it running" not in said


def test_two_processes_of_one_swarm_are_one(own_place):
    run = run_of(own_place, "lab", "lab.toml")
    with recorded(run), recorded(Run("lab", "lab.toml", run.source, run.file)):
        assert of_file("lab.toml") == [run]


def test_who_was_killed_left_nothing(own_place):
    run = run_of(own_place, "lab-1", "lab.toml")
    program = f"""if True:
        import os, signal
        from crazychoir.launch.running import Run, recorded, runs
        with recorded(Run(**{asdict(run)!r})):
            assert runs()
            os.kill(os.getpid(), signal.SIGKILL)"""
    assert subprocess.run([sys.executable, "-c", program], check=False).returncode == -9
    left = list((own_place / "crazychoir").iterdir())
    assert json.loads(left[0].read_text()) == asdict(run), "its record is there"
    assert runs() == []
    assert not left[0].exists(), "and goes"


def test_a_run_flies_though_no_record_can_be_left(own_place, monkeypatch):
    monkeypatch.setenv("CRAZYCHOIR_RUNTIME_DIR", str(own_place / "missing" / "crazychoir"))
    with recorded(run_of(own_place, "lab-1")):
        assert runs() == []


def test_records_are_private(own_place):
    with recorded(run_of(own_place, "lab-1")):
        assert os.stat(own_place / "crazychoir").st_mode & 0o777 == 0o700
