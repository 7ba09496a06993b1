"""Virtual time: the same run is the same run, whatever the machine does and the network loses."""

import json
import os
import signal
import subprocess
import time

import pytest
from system.commands import PROGRAMS

from crazychoir.routing.instance.instance import Instance
from crazychoir.solve.solving import solve_here

pytestmark = pytest.mark.system
RUNNING, AWAY = 0.3, 0.1
"""s of the wall clock: how long a process has a processor, and how long it is then kept from it."""


def run_by_fits_and_starts(path, *words):
    """A command in a process of its own, which has no processor again and again, as on a busy machine.

    Its object, by way of this file, and how often it was stopped.
    """
    environment, stops = {**os.environ, "PYTHONHASHSEED": "random"}, 0
    command = [*PROGRAMS["crazychoir"], *words]
    with (
        path.open("w") as out,
        subprocess.Popen(command, stdout=out, env=environment) as process,
    ):
        while process.poll() is None:
            time.sleep(RUNNING)
            process.send_signal(signal.SIGSTOP)
            time.sleep(AWAY)
            process.send_signal(signal.SIGCONT)
            stops += 1
    return json.loads(path.read_text()), stops


@pytest.fixture(scope="module")
def fly(here):
    """Flies the pickups and deliveries in this process; what the run says."""
    return lambda *words: (
        here("crazychoir", "run", "pickup_delivery", "--fast", "--json", *words).json
    )


@pytest.fixture(scope="module")
def usual(fly):
    """Seed 1, the hash seed of this process, nothing lost."""
    return fly("--seed", 1)


def test_the_digest_depends_neither_on_the_process_and_its_hash_seed_nor_on_the_load_of_the_machine(
    usual, tmp_path
):
    words = "run", "pickup_delivery", "--fast", "--seed", "1", "--json"
    again, stops = run_by_fits_and_starts(tmp_path / "said.json", *words)
    assert stops > 3
    assert again["digest"] == usual["digest"]


def test_another_seed_is_another_run(usual, fly):
    assert fly("--seed", 2)["digest"] != usual["digest"]


def test_the_plan_does_not_depend_on_what_is_lost(usual, fly):
    loss = 0.5
    lossy = fly("--seed", 1, "--loss", loss)
    assert lossy["success"]
    assert lossy["plan_digest"] == usual["plan_digest"]
    assert lossy["messages"]["lost"] == pytest.approx(
        loss * lossy["messages"]["sent"], rel=0.1
    )
    assert lossy["messages"]["resent"] > usual["messages"]["resent"]
    assert lossy["digest"] != usual["digest"]


def test_the_plan_that_is_flown_is_that_of_solve(usual, repository):
    lab6 = Instance.load(repository / "agents" / "data" / "lab6.json")
    assert usual["plan_digest"] == solve_here(lab6)["plan_digest"]
