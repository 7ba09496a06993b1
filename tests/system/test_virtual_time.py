"""Virtual time: the same run is the same run, whatever the machine does and the network loses."""

import multiprocessing

import pytest
from system.commands import call, run

pytestmark = pytest.mark.system


def _busy() -> None:
    while True:
        pass


@pytest.fixture
def busy():
    """Both processors have other things to do."""
    others = [multiprocessing.get_context("spawn").Process(target=_busy, daemon=True) for _ in range(2)]
    for other in others:
        other.start()
    yield
    for other in others:
        other.kill()
        other.join()


@pytest.fixture(scope="module")
def usual():
    """Seed 1, hash seed 0, nothing lost."""
    return run("pickup_delivery", "--fast", "--seed", 1, PYTHONHASHSEED="0")


def test_the_digest_depends_neither_on_the_hash_seed_nor_on_the_load_of_the_machine(usual, busy):
    again = run("pickup_delivery", "--fast", "--seed", 1, PYTHONHASHSEED="random")
    assert again["digest"] == usual["digest"]


def test_another_seed_is_another_run(usual):
    assert run("pickup_delivery", "--fast", "--seed", 2)["digest"] != usual["digest"]


def test_the_plan_does_not_depend_on_what_is_lost(usual):
    loss = 0.5
    lossy = run("pickup_delivery", "--fast", "--seed", 1, "--loss", loss)
    assert lossy["success"]
    assert lossy["plan_digest"] == usual["plan_digest"]
    assert lossy["messages"]["lost"] == pytest.approx(loss * lossy["messages"]["sent"], rel=0.1)
    assert lossy["messages"]["resent"] > usual["messages"]["resent"]
    assert lossy["digest"] != usual["digest"]


@pytest.mark.real_time
def test_six_processes_make_the_plan_of_one(usual, repository):
    demo = repository / "agents" / "data" / "lab6.json"
    said = call("crazychoir", "solve", demo, "--processes", 6, "--loss", 0.2, "--json")
    assert said.code == 0, said.err
    assert said.json["plan_digest"] == usual["plan_digest"]
    assert said.json["lost"] == pytest.approx(0.2 * said.json["messages"], rel=0.1)
