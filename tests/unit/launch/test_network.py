"""Two runs never meet; observers come and go."""

import asyncio
import socket

import pytest

from crazychoir.bus.local import OBSERVER, Bus
from crazychoir.launch import network
from crazychoir.launch.network import apart, attached, free_ports, observer, swarm_file
from crazychoir.runtime.actor import Actor
from crazychoir.runtime.clock import run_virtual
from crazychoir.swarm.config import SwarmConfig, default_swarm


def test_two_runs_have_names_and_ports_of_their_own():
    config = default_swarm(4)
    one, other = apart(config, None), apart(config, 2)
    assert len({config.name, one.name, other.name}) == 3
    assert one.base_port != config.base_port
    assert (one.ids, one.groups()) == (config.ids, config.groups())
    assert other.groups() == ((0, 1), (2, 3))
    assert apart(config, 9).groups() == config.groups(), "no process without a drone"


def test_ports_in_use_are_left_alone(monkeypatch):
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        port = taken.getsockname()[1]
        assert not network._free(port)
    assert network._free(port)
    tried = []

    def free(port):
        tried.append(port)
        return len(tried) > 3

    monkeypatch.setattr(network, "_free", free)
    base = free_ports([0, 2])
    assert tried[-2:] == [base, base + 2]
    monkeypatch.setattr(network, "_free", lambda port: False)
    with pytest.raises(ValueError, match=r"base_port.*2 processes"):
        free_ports([0, 2])


def test_no_connection_is_given_a_port_that_was_drawn(monkeypatch):
    with socket.create_server(("127.0.0.1", 0)) as server, socket.create_connection(server.getsockname()) as connection:
        given = connection.getsockname()[1]
    assert all(free_ports([0, 200]) + 200 < given for _ in range(50))
    monkeypatch.setattr(network, "_first_of_connections", lambda: 4_000)
    assert free_ports([0, 5]) + 5 < 4_000, "also where the system gives low ones"


def test_the_swarm_file_is_there_while_it_flies():
    config = default_swarm(3)
    with swarm_file(config) as path:
        assert SwarmConfig.load(path) == config
        assert config.name in str(path)
        assert path.parent.stat().st_mode & 0o077 == 0, "for nobody else"
    assert not path.parent.exists()


def test_observers_side_by_side_have_names_and_addresses_of_their_own():
    async def main(clock):
        return [observer(clock, default_swarm(2)).bus for _ in range(2)]

    one, other = run_virtual(main)
    assert one.process != other.process
    assert list(one.ports) != list(other.ports)
    assert min(*one.ports, *other.ports) > OBSERVER


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
        async with attached(link, Part("score")):
            await clock.sleep(1.0)

    run_virtual(main)
    assert said == ["opens", "link runs", "score runs", "score stops", "link stops"]
