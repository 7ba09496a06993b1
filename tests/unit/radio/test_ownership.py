"""One process has a dongle; whoever wants it too is told who, and what to do, before anything is started."""

import json
import os

import pytest
from typer.testing import CliRunner

from crazychoir.cli.crazychoir import app
from crazychoir.errors import Refused
from crazychoir.radio.ownership import owned, require_free
from crazychoir.swarm.config import SwarmConfig

LAND_FIRST = "has it, and may fly drones: land them first (Ctrl-C there, or `crazychoir land`)"


@pytest.fixture(autouse=True)
def own_place(tmp_path, monkeypatch):
    """Locks of these tests alone."""
    monkeypatch.setattr("crazychoir.radio.ownership.PREFIX", f"crazychoir-{tmp_path}-")


def swarm(scheme: str = "udp") -> SwarmConfig:
    """Four drones at two dongles."""
    uri = {"udp": "udp://127.0.0.1:{port}", "radio": "radio://{dongle}/80/2M/E7E7E7E70{i}"}[scheme]
    drones = [
        {"id": i, "home": [i, 0, 0], "uri": uri.format(port=19850 + i, dongle=i // 2, i=i)}
        | ({"dongle": i // 2} if scheme == "udp" else {})
        for i in range(4)
    ]
    return SwarmConfig.of({"name": "lab", "drones": drones, "mission": "pickup_delivery"})


@pytest.mark.parametrize("scheme", ["udp", "radio"])
def test_a_second_owner_is_told_who_has_it_and_to_land_first(scheme) -> None:
    config = swarm(scheme)
    expected = f"dongle 1: refused: process {os.getpid()} (swarm lab) {LAND_FIRST}"
    with owned(config, 1):
        require_free(config, [0])
        for again in (lambda: owned(config, 1).__enter__(), lambda: require_free(config, [0, 1])):
            with pytest.raises(Refused) as refused:
                again()
            assert str(refused.value) == expected
        with owned(config, 0):
            pass
    require_free(config, [0, 1])
    with owned(config, 1):
        pass


def test_a_run_is_refused_before_any_process_is_started(tmp_path, monkeypatch) -> None:
    def started(*arguments, **options):
        raise AssertionError("something was started")

    config, file = swarm(), tmp_path / "lab.json"
    file.write_text(config.dumps())
    monkeypatch.setattr("crazychoir.launch.flight.fly_real", started)
    with owned(config, 1):
        said = CliRunner().invoke(app, ["run", str(file), "--json"])
    assert (said.exit_code, json.loads(said.stdout)["error"]) == (
        2, f"dongle 1: refused: process {os.getpid()} (swarm lab) {LAND_FIRST}",
    )  # fmt: skip
