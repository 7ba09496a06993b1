"""What the system tests share."""

import logging
import subprocess
import sys

import pytest
from system.commands import Said
from typer.testing import CliRunner

from crazychoir.cli import agent, crazychoir


@pytest.fixture(scope="session")
def compiled() -> None:
    """All kernels are compiled and cached, so that agents that start together do not each compile them."""
    for mission in ("pickup_delivery", "bearing_formation"):
        command = [sys.executable, "-m", "crazychoir.cli.crazychoir", "run", mission, "--fast", "--json"]
        subprocess.run(command, check=True, capture_output=True, timeout=300)


@pytest.fixture
def here(monkeypatch):
    """Calls a command in this process, where nothing is imported anew; like `call`, which starts one."""
    monkeypatch.setattr(logging.root, "handlers", [*logging.root.handlers])  # a command sets up its own
    apps = {"crazychoir": crazychoir.app, "crazychoir-agent": agent.app}

    def call_here(program, *words):
        done = CliRunner().invoke(apps[program], [str(word) for word in words], catch_exceptions=False)
        return Said(done.exit_code, done.stdout, done.stderr)

    return call_here
