"""A run is found while it flies, by its file or alone; two never stand for one another."""

import json
import os
import subprocess
import sys
from dataclasses import asdict

import pytest

from crazychoir.cli.chosen import named_file, running_swarm
from crazychoir.errors import Refused
from crazychoir.launch.running import Run, of_file, recorded, runs
from crazychoir.swarm.config import default_swarm

LAB = default_swarm(2).replace(name="lab")


@pytest.fixture(autouse=True)
def own_place(tmp_path, monkeypatch):
    """Records of these tests alone, and a working folder with a swarm file lab.toml."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
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


def test_without_a_file_the_only_run_is_meant(own_place):
    assert running_swarm(None).name == "pickup", "the swarm of the demo's mission"
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
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(own_place / "missing"))
    with recorded(run_of(own_place, "lab-1")):
        assert runs() == []


def test_records_are_private(own_place):
    with recorded(run_of(own_place, "lab-1")):
        assert os.stat(own_place / "crazychoir").st_mode & 0o777 == 0o700
