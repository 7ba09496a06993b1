"""What the system tests share."""

import subprocess
import sys

import pytest


@pytest.fixture(scope="session")
def compiled() -> None:
    """All kernels are compiled and cached, so that agents that start together do not each compile them."""
    for mission in ("pickup_delivery", "bearing_formation"):
        command = [sys.executable, "-m", "crazychoir.cli.crazychoir", "run", mission, "--fast", "--json"]
        subprocess.run(command, check=True, capture_output=True, timeout=300)
