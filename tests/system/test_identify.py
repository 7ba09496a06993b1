"""crazychoir identify: the LEDs of one virtual drone among two, through cflib."""

import json

import pytest
from system.agents import CRAZYCHOIR, Program
from system.hall import Hall, reached
from typer.testing import CliRunner

from crazychoir.cli.main import app
from crazychoir.config.swarm_config import default_swarm
from crazychoir.radio.link.ownership import own_dongle

pytestmark = [pytest.mark.system, pytest.mark.real_time, pytest.mark.timeout(120)]


@pytest.mark.slow
async def test_identify_lights_only_its_drone_and_refuses_while_its_dongle_is_in_use(
    tmp_path,
) -> None:
    config = reached(default_swarm(2).replace(control={"sender": "xyz"}))
    async with Hall(config, tmp_path) as hall:
        command = (
            *CRAZYCHOIR,
            "identify",
            "1",
            "--swarm",
            str(hall.path),
            "--seconds",
            "1",
            "--json",
        )
        lights = await Program.start(*command)
        hall.programs.append(lights)
        lit = await hall.until(lambda state: state[1]["led"] == 255, 30.0)
        assert lit[0]["led"] == 0
        said = await lights.end(20.0)
        found = [
            lights.text.index(words)
            for words in ("is being connected", "are lit", "as they")
        ]
        assert found == sorted(found)
        assert (said["code"], said["drone"], said["parameters"]) == (
            0,
            1,
            {"led.bitmask": 255},
        )
        state = hall.state()
        assert state[1]["led"] == 0
        assert state[1]["zeros"] == 0
        with own_dongle(config, 0):
            refused = CliRunner().invoke(app, command[-7:])
        assert refused.exit_code == 2
        assert (
            "has it, and may fly drones: land them first"
            in json.loads(refused.stdout)["error"]
        )


def test_a_drone_without_a_radio_is_refused(tmp_path) -> None:
    (tmp_path / "swarm.json").write_text(default_swarm(2).dumps())
    said = CliRunner().invoke(
        app, ["identify", "1", "--swarm", str(tmp_path / "swarm.json"), "--json"]
    )
    assert said.exit_code == 2
    assert json.loads(said.stdout)["error"].startswith(
        "DRONE: found 1; allowed: drones that a radio reaches"
    )
