"""What the system tests share."""

import logging
import time

import pytest
from system.commands import Said, fly
from system.flights import scattered
from typer.testing import CliRunner

from crazychoir.cli import main as crazychoir
from crazychoir.cli.fly import agent


@pytest.fixture(scope="session")
def here():
    """Calls a command in this process, where nothing is imported anew; like `call`, which starts one."""
    apps = {"crazychoir": crazychoir.app, "crazychoir-agent": agent.app}

    def call_here(program, *words):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(
                logging.root, "handlers", [*logging.root.handlers]
            )  # a command sets up its own
            done = CliRunner().invoke(
                apps[program], [str(word) for word in words], catch_exceptions=False
            )
        return Said(done.exit_code, done.stdout, done.stderr)

    return call_here


@pytest.fixture(scope="session")
def compiled(here):
    """All kernels are compiled and cached, so that agents that start together do not wait for each other's."""
    for mission in ("pickup_delivery", "bearing_formation"):
        done = here("crazychoir", "run", mission, "--fast", "--json")
        assert done.code == 0, done.err


@pytest.fixture(scope="session")
def formation(tmp_path_factory, compiled):
    """A formation flown in real time by three processes and recorded: what the run says, its file, the time before."""
    folder, before = tmp_path_factory.mktemp("formation"), time.time()
    path = folder / "a.mcap"
    return (
        fly(
            scattered(1).replace(processes=[[0], [1], [2, 3]]), folder, "--record", path
        ),
        path,
        before,
    )
