"""`crazychoir solve`: instances with a proven optimum, without flying."""

import json
import subprocess
import sys

import pytest

from crazychoir.routing.instance.instance import Instance
from crazychoir.solve.solve_options import SolveOptions
from crazychoir.solve.solving import solve_here

pytestmark = pytest.mark.system
KEYS = {
    "cost",
    "feasible",
    "lower_bound",
    "bound_exact",
    "method",
    "disclosed",
    "rounds",
    "messages",
    "bytes",
    "wall_s",
    "critical_path_s",
    "plan_digest",
    "routes",
    "bound_relaxation",
}
SHARED = ["N3_M3_s1", "N5_M5_s1", "N5_M8_s1_R25", "lab6_M10_s1", "N10_M15_s1_R25"]
OWN = ["flat", "limited", "room"]


def near(result, optimum):
    """Within 1 % of the optimum, with a bound that is one, in an object that is complete."""
    assert set(result) >= KEYS
    assert result["feasible"]
    assert optimum - 1e-6 <= result["cost"] <= 1.01 * optimum
    assert result["lower_bound"] <= optimum + 1e-6
    assert result["cost"] == pytest.approx(
        sum(route["length"] for route in result["routes"])
    )
    served = [
        stop["task"]
        for route in result["routes"]
        for stop in route["stops"]
        if stop["kind"] == "pickup"
    ]
    assert len(served) == len(set(served))


@pytest.mark.parametrize("name", SHARED)
def test_the_optimum_also_when_messages_are_lost(reference_data, name):
    path = reference_data("pdvrp") / f"pdvrp_opt_{name}.json"
    optimum = json.loads(path.read_text())["optimum"]
    result, lossy = (
        solve_here(Instance.load(path), SolveOptions(loss=loss)) for loss in (0.0, 0.3)
    )
    near(result, optimum)
    near(lossy, optimum)
    assert lossy["plan_digest"] == result["plan_digest"]
    assert lossy["lost"] > 0


@pytest.mark.parametrize("name", OWN)
def test_own_instances(here, repository, name):
    path = repository / "tests" / "data" / f"pickup_delivery_{name}.json"
    said = here("crazychoir", "solve", path, "--loss", 0.3, "--seed", 7, "--json")
    assert said.code == 0, said.err
    near(said.json, json.loads(path.read_text())["optimum"])


WARM = """
import gc, json, sys
from numba.core.dispatcher import Dispatcher
from crazychoir.routing.instance.instance import Instance
from crazychoir.routing.distributed.plain_loop import compile_routing_kernels
from crazychoir.solve.solve_options import SolveOptions
from crazychoir.solve.solving import solve_here

def compiled():
    return {repr(d): len(d.overloads) for d in gc.get_objects() if isinstance(d, Dispatcher)}

changes = [{}, {"recharge": 2}, {"release": 1.0}, {"penalty": [9.0] * 4}, {"objective": "makespan"}]
for method, several in (("columns", changes), ("resource-columns", changes[:-1]), ("cbba", changes)):
    for change in several:
        instance = Instance.parse(json.load(open(sys.argv[1])) | change)
        compile_routing_kernels(instance.local(0), method)
        before = compiled()
        result = solve_here(instance, SolveOptions(method=method))
        assert compiled() == before, (method, change, set(compiled().items()) - set(before.items()))
        assert result["wall_s"] > 0.0 < result["startup_s"]
"""


@pytest.mark.timeout(300)  # on a fresh machine it compiles
def test_the_clock_of_a_solution_counts_no_compiling(repository):
    """Nor any loading of compiled laws: before it starts all have been called, with the types that they will get."""
    path = repository / "tests" / "data" / "pickup_delivery_flat.json"
    done = subprocess.run(
        [sys.executable, "-c", WARM, path],
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr


@pytest.fixture
def instance(repository):
    """A small instance, to be spoilt."""
    return json.loads(
        (repository / "tests" / "data" / "pickup_delivery_flat.json").read_text()
    )


def test_a_task_that_no_robot_can_carry_is_named(here, tmp_path, instance):
    path = tmp_path / "heavy.json"
    instance["load"][2] = 1e3
    path.write_text(json.dumps(instance))
    said = here("crazychoir", "solve", path, "--json")
    said.refuses("InstanceError", "task 2")
    assert said.json["success"] is False


@pytest.mark.parametrize("text", ["", "[]", "{", '{"home": []}', "\x00\xff"])
def test_a_file_that_is_no_instance_is_refused(here, tmp_path, text):
    path = tmp_path / "odd.json"
    path.write_text(text)
    here("crazychoir", "solve", path).refuses("odd.json")


def test_a_method_and_a_graph_that_do_not_exist_are_refused(here, repository):
    path = repository / "tests" / "data" / "pickup_delivery_flat.json"
    here("crazychoir", "solve", path, "--method", "magic").refuses(
        "magic", "resource-columns"
    )
    here("crazychoir", "solve", path, "--graph", "knot").refuses("knot")
    here("crazychoir", "solve", path, "--loss", "1").refuses("--loss", "less than 1")


@pytest.mark.parametrize(
    ("name", "said"),
    [("a.txt", ".png, .pdf, .svg"), ("/proc/none/a.png", "can be made")],
)
def test_a_picture_that_cannot_be_drawn_is_refused_before_anything_is_solved(
    here, repository, tmp_path, name, said
):
    path = repository / "tests" / "data" / "pickup_delivery_flat.json"
    here("crazychoir", "solve", path, "--picture", tmp_path / name).refuses(
        "--picture", said
    )
