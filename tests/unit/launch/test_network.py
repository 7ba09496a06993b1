"""Two runs never meet; observers come and go."""

import asyncio
import os
import random
import resource
import socket
import subprocess
import sys
import tempfile

import pytest
from other_user import as_user, in_own_namespace
from ports import free_ports, is_free
from typer.testing import CliRunner

from crazychoir.bus.port import PORT_ADDRESSES, Bus
from crazychoir.cli.main import app
from crazychoir.config.addresses import Addresses
from crazychoir.config.swarm_config import SwarmConfig, default_swarm
from crazychoir.errors import ConfigError
from crazychoir.launch import network
from crazychoir.launch.network import (
    hold_isolated_swarm,
    isolate_swarm,
    make_observer_link,
    reserve_ports,
    run_attached,
    write_swarm_file,
)
from crazychoir.runtime.actor import Actor
from crazychoir.runtime.clock import run_virtual


def test_two_runs_have_names_and_ports_of_their_own():
    config = default_swarm(4)
    one, other = isolate_swarm(config, None), isolate_swarm(config, 2)
    assert len({config.name, one.name, other.name}) == 3
    assert one.base_port != config.base_port
    assert (one.ids, Addresses(one).groups()) == (
        config.ids,
        Addresses(config).groups(),
    )
    assert Addresses(other).groups() == ((0, 1), (2, 3))
    assert Addresses(isolate_swarm(config, 9)).groups() == Addresses(config).groups(), (
        "no process without a drone"
    )


def test_ports_in_use_are_left_alone(monkeypatch):
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        port = taken.getsockname()[1]
        assert not is_free(port)
    assert is_free(port)
    tried = []

    def hold(address, port, kept):
        tried.append(port)
        return len(tried) > 3

    monkeypatch.setattr(network, "_reserve_port", hold)
    base = free_ports([0, 2])
    assert tried[-2:] == [base, base + 2]
    monkeypatch.setattr(network, "_reserve_port", lambda address, port, kept: False)
    with pytest.raises(ValueError, match=r"base_port.*2 processes"):
        free_ports([0, 2])


def test_no_connection_is_given_a_port_that_was_drawn(monkeypatch):
    with (
        socket.create_server(("127.0.0.1", 0)) as server,
        socket.create_connection(server.getsockname()) as connection,
    ):
        given = connection.getsockname()[1]
    assert all(free_ports([0, 200]) + 200 < given for _ in range(50))
    monkeypatch.setattr(network, "_read_first_connection_port", lambda: 4_000)
    assert free_ports([0, 5]) + 5 < 4_000, "also where the system gives low ones"


def test_the_swarm_file_is_there_while_it_flies():
    config = default_swarm(3)
    with write_swarm_file(config) as path:
        assert SwarmConfig.load(path) == config
        assert config.name in str(path)
        assert path.parent.stat().st_mode & 0o077 == 0, "no other user may read it"
    assert not path.parent.exists()


def test_observers_side_by_side_have_names_and_addresses_of_their_own():
    async def main(clock):
        return [make_observer_link(clock, default_swarm(2)).bus for _ in range(2)]

    one, other = run_virtual(main)
    assert one.process != other.process
    assert list(one.ports) != list(other.ports)
    assert min(*one.ports, *other.ports) > PORT_ADDRESSES.first_observer


def test_actors_work_while_the_link_is_open_and_stop_before_it():
    said = []

    class Part(Actor):
        def __init__(self, name):
            self.name = name

        async def run(self):
            said.append(f"{self.name} runs")
            await asyncio.Event().wait()

        async def on_stop(self):
            said.append(f"{self.name} stops")

    class Link(Part):
        def open(self):
            said.append("opens")

    async def main(clock):
        link = Link("link")
        link.bus = Bus(clock)
        async with run_attached(link, Part("score")):
            await clock.sleep(1.0)

    run_virtual(main)
    assert said == ["opens", "link runs", "score runs", "score stops", "link stops"]


# Ports that are held --------------------------------------------------------------------------------------------------

LOCAL = "127.0.0.1"
LOW_RANGE = """if True:
    import sys
    from crazychoir.launch.network import hold_isolated_swarm
    from crazychoir.config.swarm_config import default_swarm
    for given in (None, 7999):
        config = default_swarm(int(sys.argv[1]))
        config = config if given is None else config.replace(base_port=given)
        with hold_isolated_swarm(config, None, keeps_port=True) as changed:
            print(changed.base_port)
"""


def listens_at(port):
    """Listen as Zenoh does."""
    with socket.socket() as server:
        server.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        server.bind((LOCAL, port))
        server.listen()
        socket.create_connection((LOCAL, port), 1.0).close()


def test_ports_are_held_for_the_processes_that_listen_there_and_for_no_other():
    with reserve_ports(dict.fromkeys([-1, 0, 3], LOCAL)) as base:
        for port in (base - 1, base, base + 3):
            assert not is_free(port), "another run does not choose it"
            with pytest.raises(ConnectionRefusedError):
                socket.create_connection((LOCAL, port), 1.0)
            for _ in range(2):
                listens_at(port)
        assert is_free(base + 2)
    assert all(is_free(base + offset) for offset in (-1, 0, 3))


def test_no_connection_is_given_a_port_that_is_held_where_the_system_gives_all():
    """With ten ports for connections, nine of them held, all connections get the tenth."""
    program = f"""if True:
        import contextlib, socket
        from crazychoir.launch import network
        network._draw_base_ports = lambda offsets: [40_000]
        server = socket.create_server(({LOCAL!r}, 50_000))
        with network.reserve_ports(dict.fromkeys(range(9), {LOCAL!r})), contextlib.suppress(OSError):
            while True:
                print(socket.create_connection(({LOCAL!r}, 50_000)).getsockname()[1])
    """
    assert in_low_range(program, "40000 40009").split() == ["40009"]


def in_low_range(program, span, *words, user=()):
    """What a program says in a network of its own, where the system gives these ports to connections."""
    prepare = 'ip link set lo up && echo "$0" >/proc/sys/net/ipv4/ip_local_port_range && exec "$@"'
    command = [
        *in_own_namespace("--net"),
        "sh",
        "-c",
        prepare,
        span,
        *user,
        sys.executable,
        "-c",
        program,
        *words,
    ]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    answer = subprocess.run(
        command, env=environment, capture_output=True, text=True, check=False, cwd="/"
    )
    assert answer.returncode == 0, answer.stderr
    return answer.stdout


@pytest.mark.parametrize("span", ["1024 65535", "2048 65535"])
def test_a_user_gets_ports_where_the_system_gives_nearly_all_to_connections(span):
    said = [
        int(word)
        for word in in_low_range(LOW_RANGE, span, "40", user=as_user()).split()
    ]
    assert 1024 <= said[0] <= 65535 - 40
    assert said[1] == 7999, "the swarm file's own"


@pytest.mark.parametrize("first", [1024, 1500, 32768, 60999])
@pytest.mark.parametrize("drones", [1, 1200, 2500])
def test_many_processes_get_ports_wherever_those_of_connections_begin(
    monkeypatch, first, drones
):
    monkeypatch.setattr(network, "_read_first_connection_port", lambda: first)
    monkeypatch.setattr(network, "_reserve_port", lambda address, port, kept: True)
    monkeypatch.setattr(network, "_allow_files", lambda processes: None)
    with reserve_ports(dict.fromkeys(range(-3, drones), LOCAL)) as base:
        assert base - 3 >= 1024
        assert base + drones - 1 <= 65535


def test_1200_processes_hold_their_ports():
    before = resource.getrlimit(resource.RLIMIT_NOFILE)
    try:
        resource.setrlimit(resource.RLIMIT_NOFILE, (1024, before[1]))
        with reserve_ports(dict.fromkeys(range(1200), LOCAL)) as base:
            assert not is_free(base + 1199)
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, before)


def test_too_few_open_files_are_told_before_anything_starts(monkeypatch):
    monkeypatch.setattr(resource, "getrlimit", lambda _: (1024, 2048))
    with pytest.raises(
        ConfigError,
        match=r"limit of open files: found 2048; allowed: 5056 for 1200 processes.*--proc",
    ):
        reserve_ports(dict.fromkeys(range(1200), LOCAL)).__enter__()


def test_wide_ids_have_ports_too(monkeypatch):
    monkeypatch.setattr(network, "_read_first_connection_port", lambda: 2048)
    for highest in random.Random(1).sample(range(2000, 10_000), 5):  # noqa: S311 - the same each time
        drones = [{"id": 0, "home": [0, 0, 0]}, {"id": highest, "home": [1, 0, 0]}]
        config = SwarmConfig.of(
            {"name": "wide", "drones": drones, "processes": [[0, highest]]}
        )
        for processes in (None, 1, 2):
            assert isolate_swarm(config, processes).base_port + highest <= 65535


def test_a_block_is_found_where_few_are_free(monkeypatch):
    draw = random.Random(7)  # noqa: S311 - the same each time
    free = draw.randrange(33_000, 60_000)
    monkeypatch.setattr(
        network, "_reserve_port", lambda address, port, kept: free <= port < free + 5
    )
    with reserve_ports(dict.fromkeys(range(5), LOCAL)) as base:
        assert base == free
    with pytest.raises(ConfigError, match="no free block for 6 processes"):
        reserve_ports(dict.fromkeys(range(6), LOCAL)).__enter__()


def test_the_base_port_is_used_or_the_drone_that_needs_a_taken_port_is_named():
    with reserve_ports(dict.fromkeys(range(4), LOCAL)) as base:
        pass
    config = default_swarm(4).replace(base_port=base)
    with hold_isolated_swarm(config, None, keeps_port=True) as changed:
        assert changed.base_port == base
        with hold_isolated_swarm(config, None) as other:
            assert other.base_port != base, "a replay flies beside it"
        with pytest.raises(
            ConfigError,
            match=rf"base_port = {base}: port {base}, that of drone 0, is taken;.*sport",
        ):
            hold_isolated_swarm(config, None, keeps_port=True).__enter__()
    with (
        socket.create_server((LOCAL, base + 2)),
        pytest.raises(ConfigError, match=rf"{base + 2}, that of drone 2"),
    ):
        hold_isolated_swarm(config, None, keeps_port=True).__enter__()


def test_run_flies_at_the_base_port_of_its_file(tmp_path, monkeypatch):
    flown = []

    def fly_real(launcher, config, *arguments, **options):
        flown.append(
            (
                config.base_port,
                is_free(config.base_port),
                SwarmConfig.load(launcher.path).base_port,
            )
        )
        raise ConfigError("flown", "so far", "no further")

    with reserve_ports({0: LOCAL, 1: LOCAL}) as base:
        pass
    file = tmp_path / "lab.json"
    file.write_text(default_swarm(2).replace(base_port=base, mission="figure").dumps())
    monkeypatch.setattr("crazychoir.api.flying.fly_real", fly_real)
    monkeypatch.setenv("CRAZYCHOIR_RUNTIME_DIR", str(tmp_path / "crazychoir"))
    said = CliRunner().invoke(app, ["run", str(file), "--json"])
    assert said.exit_code == 2
    assert flown == [(base, False, base)]


def test_a_temporary_folder_that_cannot_be_or_is_full_is_told_with_what_to_do(
    monkeypatch,
):
    def none(**_):
        raise FileNotFoundError(2, "No usable temporary directory found in ['/tmp']")

    expected = r"temporary folder: found .*{}.*; allowed: .* has room\. Free some room, or set TMPDIR"
    with monkeypatch.context() as patch:
        patch.setattr(
            "crazychoir.files.private_folder.write_fault",
            lambda folder: "No space left on device",
        )
        with pytest.raises(
            ConfigError, match=expected.format("No space left on device")
        ):
            write_swarm_file(default_swarm(2)).__enter__()
    monkeypatch.setattr(tempfile, "TemporaryDirectory", none)
    with pytest.raises(
        ConfigError, match=expected.format("No usable temporary directory")
    ):
        write_swarm_file(default_swarm(2)).__enter__()


def test_a_port_that_only_closed_connections_have_is_free():
    """After a run that used the port, its connections stay in TIME_WAIT for a minute."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
        with socket.create_connection(("127.0.0.1", port)) as client:
            accepted, _ = server.accept()
            accepted.close()  # the side that closes first keeps the connection
            client.recv(1)
        with (
            pytest.raises(ConfigError, match=f"port {port}, that of drone 0, is taken"),
            reserve_ports({0: "127.0.0.1"}, port),
        ):
            pass
    assert is_free(port)


def test_a_port_of_closed_connections_is_held_by_one_run_alone():
    with socket.create_server((LOCAL, 0)) as server:
        port = server.getsockname()[1]
        with socket.create_connection((LOCAL, port)) as client:
            accepted, _ = server.accept()
            accepted.close()
            client.recv(1)
    with reserve_ports({0: LOCAL}, port):
        assert not is_free(port)
    assert is_free(port)
