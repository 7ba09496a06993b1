"""Scripts that start a swarm in real time, fly it, and read its recording."""

import re
import runpy

import pandas as pd
import pytest
from pages import block

from crazychoir.api import OrderFailed, launch, read
from crazychoir.radio.virtual.control import ask_server

pytestmark = [pytest.mark.system, pytest.mark.real_time]
PAGE = "crazychoir/api/README.md"


def test_script_launches_a_swarm_flies_it_and_reads_its_track(tmp_path):
    record = tmp_path / "flight.mcap"
    with launch("operator", drones=2, processes=1, record=record) as swarm:
        swarm.take_off(height=0.3)
        swarm.go_to([0.0, 0.3, 0.0], relative=True)
        assert swarm[1].state().p == pytest.approx([0.6, 0.3, 0.3], abs=0.1)
        with pytest.raises(OrderFailed, match="drone 0: go-to refused: go-to = "):
            swarm[0].go_to([0.0, 0.0, 50.0])
        assert swarm[0].param["control.kp"] == swarm.param["control.kp"][1]
    assert swarm.result["success"], swarm.result
    end = read(record).track(1)["position"][-1]
    assert end == pytest.approx([0.6, 0.3, 0.0], abs=0.1)


def test_a_virtual_drone_that_falls_is_a_failure_of_the_run():
    with launch("operator", drones=1, bodies="virtual") as swarm:
        swarm.take_off(height=0.6, duration=1.5)
        port = swarm.config.mocap.port
        ask_server({"faults": {"all": {"off": 1}}}, port=port)
    assert not swarm.result["success"]
    assert "crashed: hit the floor" in swarm.result["reasons"]["0"]


def test_hello_world_of_the_page_from_crazyswarm2_takes_off_and_lands(
    tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    code = block("deploy/FROM_CRAZYSWARM2.md", "hello.py")
    assert len(code.splitlines()) <= 16, "as many as in Crazyswarm2"
    waits = "time.sleep(5.0)"
    assert waits in code
    (tmp_path / "hello.py").write_text(code.replace(waits, "height = cf.state().p[2]"))
    found = runpy.run_path("hello.py")
    assert found["height"] == pytest.approx(1.0, abs=0.1)
    assert found["swarm"].result["success"], found["swarm"].result


def read_script(repository):
    """Return the script of the page."""
    text = (repository / PAGE).read_text()
    (code,) = re.findall(r"<!-- script.py -->\n```python\n(.*?)```", text, re.DOTALL)
    return code.replace("agents/data", str(repository / "agents" / "data"))


def test_script_of_the_page_has_at_most_20_lines(repository):
    assert len(read_script(repository).splitlines()) <= 20


@pytest.mark.slow
@pytest.mark.timeout(300)
@pytest.mark.parametrize("bodies", ["sim", "virtual"])
def test_script_of_the_page_flies_simulated_and_virtual_drones(
    repository, tmp_path, monkeypatch, capsys, bodies
):
    monkeypatch.chdir(tmp_path)
    code = read_script(repository).replace('"sim"', f'"{bodies}"')
    (tmp_path / "script.py").write_text(code)
    found = runpy.run_path("script.py")
    assert found["swarm"].result["success"], capsys.readouterr().out
    assert isinstance(found["table"].max(), pd.DataFrame)
    assert found["table"].max()["x_m"][0] == pytest.approx(0.8, abs=0.1)


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_six_virtual_drones_fly_a_figure_eight_from_their_memories(repository):
    eight = repository / "agents" / "data" / "figure8.csv"
    with launch("operator", drones=6, processes=3, bodies="virtual") as swarm:
        swarm.take_off(height=0.6, duration=2.0)
        swarm.follow(eight, timescale=2.0, on_board=True)
        swarm.land(duration=2.5)
    assert swarm.result["success"], swarm.result
    assert swarm.result["min_separation_m"] > 0.25
