"""One process has a dongle. A second one is refused before it starts anything, and told the owner and what to do."""

import contextlib
import json
import os
import signal
import subprocess
import sys

import pytest
from other_user import as_user, homeless
from typer.testing import CliRunner

from crazychoir.cli.main import app
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.errors import Refused
from crazychoir.radio.link import ownership
from crazychoir.radio.link.ownership import own_dongle, require_free

LAND_FIRST = (
    "has it, and may fly drones: land them first (Ctrl-C there, or `crazychoir land`)"
)


@pytest.fixture(autouse=True)
def own_place(tmp_path, monkeypatch):
    """Locks of these tests alone."""
    monkeypatch.setattr(
        "crazychoir.radio.link.ownership.LOCK_PREFIX", f"crazychoir-{hash(tmp_path):x}-"
    )


def swarm(scheme: str = "udp") -> SwarmConfig:
    """Four drones at two dongles."""
    uri = {
        "udp": "udp://127.0.0.1:{port}",
        "radio": "radio://{dongle}/80/2M/E7E7E7E70{i}",
    }[scheme]
    drones = [
        {
            "id": i,
            "home": [i, 0, 0],
            "uri": uri.format(port=19850 + i, dongle=i // 2, i=i),
        }
        | ({"dongle": i // 2} if scheme == "udp" else {})
        for i in range(4)
    ]
    return SwarmConfig.of(
        {"name": "lab", "drones": drones, "mission": "pickup_delivery"}
    )


@pytest.mark.parametrize("scheme", ["udp", "radio"])
def test_a_second_owner_is_told_which_process_has_the_dongle_and_to_land_first(
    scheme,
) -> None:
    config = swarm(scheme)
    expected = f"dongle 1: refused: process {os.getpid()} (swarm lab) {LAND_FIRST}"
    with own_dongle(config, 1):
        require_free(config, [0])
        for again in (
            lambda: own_dongle(config, 1).__enter__(),
            lambda: require_free(config, [0, 1]),
        ):
            with pytest.raises(Refused) as refused:
                again()
            assert str(refused.value) == expected
        with own_dongle(config, 0):
            pass
    require_free(config, [0, 1])
    with own_dongle(config, 1):
        pass


def test_a_run_is_refused_before_any_process_is_started(tmp_path, monkeypatch) -> None:
    def started(*arguments, **options):
        raise AssertionError("something was started")

    config, file = swarm(), tmp_path / "lab.json"
    file.write_text(config.dumps())
    monkeypatch.setattr("crazychoir.launch.flight.fly_real", started)
    with own_dongle(config, 1):
        said = CliRunner().invoke(app, ["run", str(file), "--json"])
    assert (said.exit_code, json.loads(said.stdout)["error"]) == (
        2,
        f"dongle 1: refused: process {os.getpid()} (swarm lab) {LAND_FIRST}",
    )


OWNS = """if True:
    import sys
    from crazychoir.radio.link import ownership
    from crazychoir.errors import Refused
    from crazychoir.config.swarm_config import SwarmConfig
    ownership.LOCK_PREFIX = sys.argv[1]
    try:
        with ownership.own_dongle(SwarmConfig.loads(sys.argv[2], "swarm.json"), 1):
            print("owns", flush=True)
            sys.stdin.read()
    except Refused as refused:
        print(refused, flush=True)
"""
ENVIRONMENTS = (
    {"XDG_RUNTIME_DIR": "{folder}", "HOME": "{folder}"},
    {"HOME": "/"},
    {"TMPDIR": "{folder}"},
    {"CRAZYCHOIR_RUNTIME_DIR": "{folder}"},
)
"""Of a login shell, of cron, of services."""


@contextlib.contextmanager
def owner(config, folder, uid=0, **environment):
    """A process of a user that wants dongle 1; what it says first, and it."""
    words = [
        *(as_user(uid) if uid else ()),
        sys.executable,
        "-c",
        OWNS,
        ownership.LOCK_PREFIX,
        config.dumps(),
    ]
    environment = homeless(PYTHONPATH=os.pathsep.join(sys.path)) | {
        name: value.format(folder=folder) for name, value in environment.items()
    }
    pipe = subprocess.PIPE
    with subprocess.Popen(
        words, env=environment, stdin=pipe, stdout=pipe, text=True
    ) as process:
        yield process.stdout.readline().strip(), process
        process.kill()


def test_the_lock_is_the_same_in_every_environment_and_for_every_user(tmp_path) -> None:
    config = swarm("radio")
    with owner(config, tmp_path, **ENVIRONMENTS[0]) as (said, process):
        assert said == "owns"
        mine = f"dongle 1: refused: process {process.pid} (swarm lab) {LAND_FIRST}"
        for environment in ENVIRONMENTS:
            with owner(config, tmp_path, **environment) as (refused, _):
                assert refused == mine
        with owner(config, tmp_path, 12345) as (refused, _):
            assert refused.startswith(
                f"dongle 1: refused: process {process.pid} (swarm lab) of user root (0) has it"
            )
            assert "that user, or root, must land them first" in refused
    with owner(config, tmp_path, 12345) as (said, process):
        assert said == "owns", "it was given up with its process"
        with pytest.raises(
            Refused, match=rf"process {process.pid} \(swarm lab\) of user 12345 has it"
        ):
            require_free(config, [1])


def test_a_stopped_process_keeps_its_dongle_and_a_killed_one_does_not(
    tmp_path,
) -> None:
    config = swarm()
    with owner(config, tmp_path) as (said, process):
        assert said == "owns"
        process.send_signal(signal.SIGSTOP)
        with pytest.raises(
            Refused,
            match=f"process {process.pid}.* has it, and may fly drones: land them first",
        ):
            require_free(config, [1])
        process.kill()
        process.wait()
        require_free(config, [1])


def test_a_name_of_any_length_is_locked() -> None:
    host = ".".join(["a" * 60] * 4)
    assert len(ownership._lock_address(f"udp://{host}:19850")) <= 108
    assert ownership._lock_address(f"udp://{host}:19850") != ownership._lock_address(
        f"udp://{host}:19851"
    )


def test_what_cannot_be_locked_is_refused_and_never_flown_without(monkeypatch) -> None:
    monkeypatch.setattr(ownership, "_lock_address", lambda name: b"/nowhere/at/all")
    monkeypatch.setattr(ownership, "_describe_owner", lambda name: None)
    with pytest.raises(Refused, match="cannot be locked"), own_dongle(swarm(), 1):
        pass
