"""A command line imports what it uses: its help comes at once."""

import json
import subprocess
import sys
from importlib.metadata import version

import pytest

from crazychoir.cli.compute import solve
from crazychoir.routing.distributed.pickup_delivery import PLANNING_METHODS
from crazychoir.solve.solve_options import SolveOptions

HEAVY = {
    "numpy",
    "numba",
    "scipy",
    "zenoh",
    "highspy",
    "matplotlib",
    "msgspec",
    "asyncio",
    "rich.live",
}


@pytest.mark.parametrize(
    "module",
    [
        f"crazychoir.cli.{name}"
        for name in ("main", "fly.agent", "fly.world", "fly.mocap")
    ],
)
def test_a_command_line_starts_without_what_is_heavy(module):
    program = f"import sys, json, {module}; print(json.dumps(list(sys.modules)))"
    loaded = json.loads(
        subprocess.run(
            [sys.executable, "-c", program], check=True, capture_output=True
        ).stdout
    )
    assert module in loaded
    assert HEAVY & set(loaded) == set()


@pytest.mark.parametrize("name", ["simulating", "solving"])
def test_what_computes_without_flight_loads_nothing_that_flies(name):
    module = f"crazychoir.api.{name}"
    program = f"import sys, json, {module}; print(json.dumps(list(sys.modules)))"
    loaded = json.loads(
        subprocess.run(
            [sys.executable, "-c", program], check=True, capture_output=True
        ).stdout
    )
    assert module in loaded
    assert not [m for m in loaded if m.startswith(("crazychoir.flight", "cvxpy"))]


def test_its_version_is_told():
    command = (sys.executable, "-m", "crazychoir.cli.main", "--version")
    said = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    assert said == f"crazychoir {version('crazychoir')}\n"


def test_solve_offers_the_methods_that_there_are():
    option = solve.solve.__annotations__["method"].__metadata__[0]
    assert option.help == f"Recovery of the plan: {', '.join(PLANNING_METHODS)}."
    assert solve.solve.__defaults__[0] == PLANNING_METHODS[0] == SolveOptions().method
