"""A replay by steps: lines that are steps, lines that are no steps, and a cancelled read that does not wait."""

import asyncio
import io
import math
import os
import sys
import threading

import pytest

from crazychoir.cli.recordings.replay import _local_swarm, _read_steps
from crazychoir.config.access import access_of
from crazychoir.config.addresses import Addresses
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.runtime.clock import run_wall


@pytest.fixture
def typed(monkeypatch):
    """Sets what standard input says."""

    def put(content):
        monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(content)))

    return put


def steps(count):
    async def main(clock):
        step = _read_steps(0.5)
        return [await step() for _ in range(count)]

    return run_wall(main)


def test_a_line_is_a_step_and_its_end_the_rest(typed, capsys):
    typed(b"\n 2.5 \n \n")
    assert steps(4) == [0.5, 2.5, 0.5, math.inf]
    said = capsys.readouterr().err.splitlines()
    assert (
        said[0]
        == "at 0.00 s; Enter: on by 0.5 s; a number and Enter: by that many; Ctrl-C ends it"
    )
    assert [line.split(";")[0] for line in said] == [
        "at 0.00 s",
        "at 0.50 s",
        "at 3.00 s",
        "at 3.50 s",
    ]


def test_what_is_no_step_is_said_and_asked_for_again(typed, capsys):
    typed(b"2,5\n-1\nnan\n0\n\xff\n1\n")
    assert steps(2) == [1.0, math.inf]
    said = capsys.readouterr().err
    assert said.count("allowed: Enter, or a number of seconds above 0 and Enter") == 5
    assert "--step: found 2,5;" in said


def test_a_cancelled_read_does_not_wait_for_a_line(monkeypatch):
    """A line that comes after the end is ignored and causes no error."""
    end, other = os.pipe()
    keyboard = os.fdopen(end)
    monkeypatch.setattr(sys, "stdin", keyboard)

    async def main(clock):
        asking = asyncio.create_task(_read_steps(0.5)())
        await clock.sleep(0.05)
        asking.cancel()
        await asyncio.wait([asking], timeout=5.0)
        return asking.cancelled()

    assert run_wall(main)
    os.close(other)
    for thread in threading.enumerate():
        if thread.name == "standard input":
            thread.join(5.0)
    keyboard.close()


def test_a_closed_network_of_several_hosts_is_said_again_on_this_machine_alone():
    raw = {
        "name": "lab",
        "hosts": {"a": "10.0.0.1"},
        "security": {"insecure": False, "operators": ["a"]},
        "drones": [{"id": 0, "home": [0, 0, 0], "host": "a"}],
    }
    here = _local_swarm(SwarmConfig.of(raw))
    assert (Addresses(here).endpoint(0), access_of(here, "a")) == (
        "tcp/127.0.0.1:7460",
        None,
    )
