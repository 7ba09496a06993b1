"""A missing extra is said once, by the process that starts the others, before it starts any."""

import importlib.util

import pytest
from typer.testing import CliRunner

from crazychoir.cli.main import app
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.errors import ConfigError
from crazychoir.launch import flight
from crazychoir.launch.extras import require_extras
from crazychoir.launch.processes import Owner

WORLD = Owner("world", "crazychoir.cli.fly.world")
MOCAP = Owner("mocap", "crazychoir.cli.fly.mocap")


@pytest.fixture
def nothing_installed(monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda module: None)


def swarm(uri="mujoco://", **tables):
    drones = [
        {"id": i, "home": [1.0 * i, 0.0, 0.0], "uri": uri.format(19850 + i)}
        for i in range(4)
    ]
    return SwarmConfig.of(
        {
            "name": "four",
            "mission": "figure",
            "graph": "empty",
            "drones": drones,
            **tables,
        }
    )


@pytest.mark.parametrize(
    ("config", "owners", "fast", "words"),
    [
        (
            swarm(),
            [WORLD],
            False,
            "drone 0: uri = .mujoco://.: found no module mujoco; .*'crazychoir.mujoco.'",
        ),
        (swarm(), [], True, "no module mujoco"),
        (
            swarm("udp://127.0.0.1:{}", mocap={"source": "vicon"}),
            [MOCAP],
            False,
            "source = .vicon.*'crazychoir.mocap.'",
        ),
    ],
)
def test_what_a_run_needs_here_is_named_with_how_to_install_it(
    nothing_installed, config, owners, fast, words
):
    with pytest.raises(ConfigError, match=words):
        require_extras(config, owners, fast)


def test_what_other_machines_run_or_nothing_needs_is_not_asked_for(nothing_installed):
    require_extras(swarm(), [], fast=False)
    require_extras(swarm("sim://"), [WORLD], fast=True)
    require_extras(swarm("udp://127.0.0.1:{}"), [MOCAP], fast=False)


def test_a_run_says_it_once_and_starts_no_process(
    nothing_installed, monkeypatch, tmp_path
):
    started = []
    monkeypatch.setattr(flight, "run_children", lambda *words: started.append(words))
    file = tmp_path / "four.json"
    file.write_text(swarm().dumps())
    said = CliRunner().invoke(app, ["run", str(file)])
    assert (said.exit_code, started) == (2, [])
    assert said.stderr.count("pip install 'crazychoir[mujoco]'") == 1
