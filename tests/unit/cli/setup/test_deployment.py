"""What deploy/ holds for several hosts: swarm files, systemd units that start, Zenoh files; and how it gets there."""

import configparser
import re
import shlex
import signal
import subprocess
import sys

import pytest
from typer.testing import CliRunner

from crazychoir.bus.network import authority, endpoints
from crazychoir.cli.main import app
from crazychoir.cli.setup import push as pushing
from crazychoir.config.access import access_of
from crazychoir.config.addresses import PROCESS_NUMBERS, Addresses
from crazychoir.config.digest import compute_digest
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.errors import ConfigError, ProcessFailed
from crazychoir.launch.processes import compute_patience

PROGRAMS = {
    "crazychoir": "main",
    "crazychoir-agent": "fly.agent",
    "crazychoir-world": "fly.world",
    "crazychoir-mocap": "fly.mocap",
    "crazychoir-radio": "fly.radio_owner",
}
UNITS = ("agent@", "world", "mocap", "radio@", "router")


def unit(repository, name):
    """A unit's keys."""
    parser = configparser.ConfigParser(interpolation=None, strict=False)
    parser.optionxform = str
    parser.read_string(
        (repository / "deploy/systemd" / f"crazychoir-{name}.service").read_text()
    )
    return parser


def list_processes(config, host):
    """Return the numbers of the processes of a host, owners first, because agents wait for them."""
    addresses = Addresses(config)
    return [p for p in addresses.endpoints() if addresses.host_of(p) == host]


def list_started_units(line):
    """Return the units that a command line starts."""
    return re.findall(
        r"crazychoir-([\w@]+)", line.partition("systemctl --user start")[2]
    )


def test_thirty_drones_on_three_workstations(repository):
    config = SwarmConfig.load(repository / "deploy/three_workstations.toml")
    grid = SwarmConfig.load(repository / "deploy/grid30.toml")
    assert (config.topology.owned, config.world.host, config.security.operators) == (
        config.ids,
        "physics",
        ("physics",),
    )
    assert [drone.host for drone in config.drones] == ["left"] * 15 + ["right"] * 15
    assert (config.edges, config.mission_options, config.mission) == (
        grid.edges,
        grid.mission_options,
        grid.mission,
    )
    assert [(d.home, d.leader) for d in config.drones] == [
        (d.home, d.leader) for d in grid.drones
    ]


def test_a_drone_moves_by_one_word(repository, tmp_path):
    text = (repository / "deploy/three_workstations.toml").read_text()
    moved = text.replace('id = 3\nhost = "left"', 'id = 3\nhost = "physics"')
    assert moved != text
    config = SwarmConfig.loads(moved)
    assert Addresses(config).endpoint(3) == "tls/192.168.1.10:7463"
    assert list_processes(config, "physics") == [PROCESS_NUMBERS.world, 3]


def test_six_drones_on_three_dongles_of_three_hosts(repository):
    config = SwarmConfig.load(repository / "deploy/three_dongles.toml")
    assert config.topology.dongles == {0: (0, 1), 1: (2, 3), 2: (4, 5)}
    assert [config.topology.dongle_host(k) for k in config.topology.dongles] == [
        "physics",
        "left",
        "right",
    ]
    assert all(drone.uri.startswith("radio://0/") for drone in config.drones), (
        "each is the first of its host"
    )
    assert list_processes(config, "left") == [PROCESS_NUMBERS.first_dongle - 1, 2, 3]


def test_the_guide_starts_the_processes_of_each_host(repository):
    config = SwarmConfig.load(repository / "deploy/three_dongles.toml")
    lines = [
        line
        for line in (repository / "deploy/GUIDE.md").read_text().splitlines()
        if "systemctl --user start" in line and "crazychoir-radio@" in line
    ]
    units = {PROCESS_NUMBERS.motion_capture: "mocap"}
    units |= {PROCESS_NUMBERS.first_dongle - k: f"radio@{k}" for k in range(3)}
    units |= {i: f"agent@{i}" for i in config.ids}

    for host, line in zip(("physics", "left", "right"), lines, strict=True):
        processes = list_processes(config, host)
        assert sorted(list_started_units(line)) == sorted(map(units.get, processes))


def test_six_virtual_drones_behind_dongles_of_two_hosts(repository):
    config = SwarmConfig.load(repository / "deploy/virtual_dongles.toml")
    assert [config.topology.dongle_host(k) for k in config.topology.dongles] == [
        "left",
        "right",
    ]
    assert config.mocap.host == "physics"
    assert {drone.uri.split(":")[1] for drone in config.drones} == {
        "//" + config.hosts["physics"]
    }


def test_one_dongle_has_one_number_on_its_host(repository):
    text = (repository / "deploy/three_dongles.toml").read_text()
    with pytest.raises(ConfigError, match="other drones of dongle 2 say 0"):
        SwarmConfig.loads(
            text.replace("radio://0/80/2M/E7E7E7E705", "radio://1/80/2M/E7E7E7E705")
        )


@pytest.mark.parametrize("name", UNITS)
def test_what_a_unit_starts_is_there(repository, name):
    started = shlex.split(unit(repository, name)["Service"]["ExecStart"])
    program = started[0].rpartition("/")[2]
    module = f"crazychoir.cli.{PROGRAMS[program]}"
    words = [word for word in started[1:2] if not word.startswith("-")]
    done = subprocess.run(
        [sys.executable, "-m", module, *words, "--help"],
        capture_output=True,
        text=True,
        env={"COLUMNS": "200", "NO_COLOR": "1", "PATH": ""},
    )
    assert done.returncode == 0, done.stderr
    for option in (word for word in started if word.startswith("--")):
        assert option in done.stdout, f"{option} of {started}"


@pytest.mark.parametrize("name", UNITS)
def test_a_unit_gives_drones_the_time_to_land(repository, name):
    parts = unit(repository, name)
    service = parts["Service"]
    assert set(parts.sections()) == {"Unit", "Service", "Install"}
    assert (service["KillSignal"], service["KillMode"]) == ("SIGINT", "mixed")
    if name != "router":
        config = SwarmConfig.load(repository / "deploy/three_workstations.toml")
        assert float(service["TimeoutStopSec"]) > compute_patience(config)
    assert service["Restart"] == ("no" if name == "agent@" else "on-failure")


@pytest.mark.parametrize("name", ["peer", "router"])
def test_zenoh_takes_its_files(repository, name):
    import zenoh

    config = zenoh.Config.from_file(str(repository / f"deploy/zenoh/{name}.json5"))
    assert config.get_json("mode") == f'"{name}"'
    assert config.get_json("scouting/multicast/enabled") == "false"


def test_a_swarm_with_a_router_talks_through_it_alone():
    config = SwarmConfig.of(
        {
            "name": "r",
            "hosts": {"a": "10.0.0.1", "r": "10.0.0.9"},
            "router": "r",
            "security": {"insecure": True},
            "drones": [{"id": 0, "home": [0, 0, 0], "host": "a"}],
        }
    )
    assert Addresses(config).routers == ["tcp/10.0.0.9:7441"]
    assert (
        Addresses(config).endpoints()[PROCESS_NUMBERS.router]
        == Addresses(config).routers[0]
    )
    assert Addresses(config).host_of(PROCESS_NUMBERS.router) == "r"
    assert endpoints.router_settings(Addresses(config).routers, 1.0)["mode"] == "router"
    assert compute_digest(config.replace(router=None)) == compute_digest(config), (
        "hosts need not agree on it"
    )
    with pytest.raises(ConfigError, match=r"router = .*there is no such host"):
        config.replace(router="x")


def test_a_router_that_is_not_named_is_refused():
    done = CliRunner().invoke(app, ["router"])
    assert done.exit_code == 2


@pytest.fixture
def lab(tmp_path):
    """A swarm of two hosts in a folder, with a mission of its own and keys."""
    (tmp_path / "missions").mkdir()
    (tmp_path / "missions/own.py").write_text("def guidance(i, config): ...\n")
    authority.make_authority(tmp_path / "keys")
    authority.add_host(tmp_path / "keys", "a")
    file = tmp_path / "lab.toml"
    file.write_text(
        'name = "lab"\nmission = "missions/own.py"\n[hosts]\na = "10.0.0.1"\nb = "10.0.0.2"\n'
        '[security]\noperators = ["a"]\n[[drones]]\nid = 0\nhost = "a"\nhome = [0, 0, 0]\n'
    )
    return file


def test_a_dry_push_prints_each_step_and_does_nothing(lab, repository, monkeypatch):
    monkeypatch.setattr(
        subprocess, "run", lambda *a, **k: pytest.fail("it did something")
    )
    folder = str(repository / "deploy/systemd")
    command = [
        "push",
        "--swarm",
        str(lab),
        "--host",
        "a",
        "--user",
        "me",
        "--units",
        folder,
        "--dry-run",
    ]
    done = CliRunner().invoke(app, command)
    assert done.exit_code == 0, done.output
    lines = done.output.splitlines()
    assert (
        "mkdir -p -m 700 choir choir/missions choir/keys .config/systemd/user"
        in lines[0]
    )
    assert any(line.endswith("me@10.0.0.1:choir/swarm.toml") for line in lines)
    assert any(
        line.endswith("missions/own.py me@10.0.0.1:choir/missions/own.py")
        for line in lines
    )
    assert any(line.endswith("keys/a me@10.0.0.1:choir/keys/") for line in lines)
    assert not any("keys/authority" in line for line in lines), (
        "that stays on one machine"
    )
    assert sum(".service" in line for line in lines) == len(UNITS)
    assert re.search(r"pip install --quiet crazychoir==\d", lines[-2])
    assert "bin/crazychoir compile" in lines[-1]


def test_a_push_puts_all_in_its_place(lab, repository, tmp_path, monkeypatch):
    """By programs that do on this machine what ssh and scp would do there; nothing is installed."""
    there, bin_folder = tmp_path / "there", tmp_path / "bin"
    for folder in (there, bin_folder):
        folder.mkdir()
    (bin_folder / "ssh").write_text(
        f"#!/bin/sh\ncd {there}; for last; do :; done\n"
        'case "$last" in *venv*|*systemctl*) echo "$last" >>said;; *) sh -c "$last";; esac\n'
    )
    (bin_folder / "scp").write_text(
        f'#!/bin/sh\nfor last; do before=$here; here=$last; done\ncp -rp "$before" "{there}/${{last#*:}}"\n'
    )
    for program in bin_folder.iterdir():
        program.chmod(0o755)
    monkeypatch.setenv("PATH", f"{bin_folder}:/usr/bin:/bin")
    folder = str(repository / "deploy/systemd")
    for _ in range(2):  # again is no different
        done = CliRunner().invoke(
            app, ["push", "--swarm", str(lab), "--host", "a", "--units", folder]
        )
        assert done.exit_code == 0, done.output
    moved = SwarmConfig.load(there / "choir/swarm.toml")
    assert access_of(moved, "a").folder == there / "choir/keys/a"
    assert moved.mission == str(there / "choir/missions/own.py")
    assert (there / "choir/missions/own.py").is_file()
    assert sorted(path.name for path in (there / "choir/keys").iterdir()) == ["a"]
    assert (there / "choir/keys/a/key.pem").stat().st_mode & 0o777 == 0o600
    assert len(list((there / ".config/systemd/user").iterdir())) == len(UNITS)
    *_, installed, compiled = (there / "said").read_text().splitlines()
    assert installed.startswith("choir/venv/bin/pip install --quiet crazychoir==")
    assert compiled == "choir/venv/bin/crazychoir compile"


def test_a_push_of_what_units_do_not_read_is_refused(lab):
    lab.with_suffix(".json").write_text("{}")
    done = CliRunner().invoke(
        app, ["push", "--swarm", str(lab.with_suffix(".json")), "--dry-run"]
    )
    assert done.exit_code == 2
    assert "allowed: a TOML file" in done.output


def test_a_push_without_keys_or_beside_its_folder_is_refused(lab):
    done = CliRunner().invoke(
        app, ["push", "--swarm", str(lab), "--host", "b", "--dry-run"]
    )
    assert done.exit_code == 2
    with pytest.raises(ConfigError, match="below the folder of the swarm file"):
        pushing.path_in_swarm_folder(lab, lab.parent.parent / "elsewhere.py")
    with pytest.raises(ConfigError, match="--host"):
        pushing.hosts_to_push(SwarmConfig.load(lab), lab, ["c"])


def test_what_is_missing_for_one_host_is_said_before_anything_is_done(
    lab, tmp_path, monkeypatch
):
    monkeypatch.setattr(
        subprocess, "run", lambda *a, **k: pytest.fail("it did something")
    )
    for words in (
        [],
        ["--host", "a", "--package", "no.whl"],
        ["--host", "a", "--units", str(tmp_path / "missions")],
    ):
        done = CliRunner().invoke(app, ["push", "--swarm", str(lab), *words])
        assert done.exit_code == 2, done.output
        assert "folders" not in done.output


def test_a_folder_is_installed_under_its_name(lab, tmp_path, monkeypatch):
    (tmp_path / "source").mkdir()
    monkeypatch.chdir(tmp_path / "source")
    done = CliRunner().invoke(
        app, ["push", "--swarm", str(lab), "--host", "a", "--package", ".", "--dry-run"]
    )
    assert f"{tmp_path}/source 10.0.0.1:choir/" in done.output
    assert "install --quiet choir/source" in done.output


def test_scp_takes_an_ipv6_address_in_brackets(lab):
    lab.write_text(lab.read_text().replace("10.0.0.1", "fd00::11"))
    done = CliRunner().invoke(
        app, ["push", "--swarm", str(lab), "--host", "a", "--user", "me", "--dry-run"]
    )
    assert "me@[fd00::11]:choir/swarm.toml" in done.output
    assert re.search(r"ssh [^\n]* me@fd00::11 ", done.output)


def test_a_step_that_fails_says_why_and_what_to_try():
    failing = (sys.executable, "-c", "import sys; sys.exit('no route to host')")
    with pytest.raises(ProcessFailed, match="exit code 1: no route to host"):
        pushing.run_push_step("a", pushing.PushStep("folders", failing))
    with pytest.raises(ProcessFailed, match=r"not done within 0\.2 s"):
        pushing.run_push_step(
            "a",
            pushing.PushStep(
                "x", (sys.executable, "-c", "import time; time.sleep(9)"), 0.2
            ),
        )
    with pytest.raises(ProcessFailed, match="not on this machine"):
        pushing.run_push_step("a", pushing.PushStep("x", ("no-such-program",)))


def test_the_guide_names_what_there_is(repository):
    text = (repository / "deploy/GUIDE.md").read_text()
    commands = [
        word
        for group in app.registered_commands
        for word in [group.name or group.callback.__name__]
    ]
    groups = [group.name for group in app.registered_groups]
    for name in re.findall(r"(?:bin/|`|\n)crazychoir ([a-z][a-z-]+)", text):
        assert name in commands + groups, name
    for line in re.findall(r"systemctl --user (?:start|stop) (.*)", text):
        for one in re.findall(r"crazychoir-([a-z]+@?)", line):
            assert one in UNITS, one
    for path in re.findall(r"\]\(([\w.]+)\)", text):
        assert (repository / "deploy" / path).is_file(), path
    for name in re.findall(r"deploy/([\w.]+)", text):
        assert (repository / "deploy" / name).exists(), name


@pytest.mark.parametrize("name", [".gitignore", ".dockerignore"])
def test_keys_beside_a_swarm_file_go_into_no_commit_and_no_image(repository, name):
    assert "keys" in [
        line.strip("*/") for line in (repository / name).read_text().splitlines()
    ]


def test_moving_a_drone_to_another_host_changes_the_digest_of_the_file(
    repository,
):
    text = (repository / "deploy/three_workstations.toml").read_text()
    moved = text.replace('id = 3\nhost = "left"', 'id = 3\nhost = "right"')
    assert compute_digest(SwarmConfig.loads(moved)) != compute_digest(
        SwarmConfig.loads(text)
    )


def test_a_router_that_does_not_start_leaves_signals_as_they_were():
    before = signal.pthread_sigmask(signal.SIG_BLOCK, [])
    ended = CliRunner().invoke(app, ["router", "--swarm", "nowhere.toml"])
    assert ended.exit_code == 2
    assert signal.pthread_sigmask(signal.SIG_BLOCK, []) == before
