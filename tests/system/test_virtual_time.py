"""Virtual time: the same run is the same run, whatever the machine does and the network loses."""

import subprocess
import sys

import pytest
from system.commands import run

from crazychoir.routing.instance import Instance
from crazychoir.solving import solve_here

pytestmark = pytest.mark.system


@pytest.fixture
def busy():
    """Both processors have other things to do."""
    others = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(2)]
    yield
    for other in others:
        other.kill()
        other.wait()


@pytest.fixture(scope="module")
def fly(here):
    """Flies the pickups and deliveries in this process; what the run says."""
    return lambda *words: here("crazychoir", "run", "pickup_delivery", "--fast", "--json", *words).json


@pytest.fixture(scope="module")
def usual(fly):
    """Seed 1, the hash seed of this process, nothing lost."""
    return fly("--seed", 1)


def test_the_digest_depends_neither_on_the_process_and_its_hash_seed_nor_on_the_load_of_the_machine(usual, busy):
    again = run("pickup_delivery", "--fast", "--seed", 1, PYTHONHASHSEED="random")
    assert again["digest"] == usual["digest"]


def test_another_seed_is_another_run(usual, fly):
    assert fly("--seed", 2)["digest"] != usual["digest"]


def test_the_plan_does_not_depend_on_what_is_lost(usual, fly):
    loss = 0.5
    lossy = fly("--seed", 1, "--loss", loss)
    assert lossy["success"]
    assert lossy["plan_digest"] == usual["plan_digest"]
    assert lossy["messages"]["lost"] == pytest.approx(loss * lossy["messages"]["sent"], rel=0.1)
    assert lossy["messages"]["resent"] > usual["messages"]["resent"]
    assert lossy["digest"] != usual["digest"]


def test_the_plan_that_is_flown_is_that_of_solve(usual, repository):
    lab6 = Instance.load(repository / "agents" / "data" / "lab6.json")
    assert usual["plan_digest"] == solve_here(lab6)["plan_digest"]
