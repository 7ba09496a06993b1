"""Algorithms of the catalogue in flight: the simulated object flies; a failure at one drone lands all."""

import numpy as np
import pytest

from crazychoir.solve.simulate import simulate
from crazychoir.team.graph import ring

pytestmark = pytest.mark.system
MISSION = '''
"""Each drone has a target; all together stay near a place that nobody else has been told of."""

import numpy as np

from crazychoir import CFGuidance
from crazychoir.optimization.algorithms.aggregative_tracking import AggregativeProblem, AggregativeTracking
from crazychoir.optimization.algorithms.asynchronous_consensus import AsynchronousConsensus
from crazychoir.optimization.rounds.mixing import rows
from crazychoir.config.swarm_config import default_swarm
from crazychoir.team.graph import row_stochastic
from crazychoir.team.algorithm_run import WakingTimes

TARGETS = np.array([drone.home[:2] for drone in default_swarm(4).drones])  # all move alike, and keep apart


def agent(i, graph):
    gradients = lambda x, s: x - TARGETS[i], lambda x, s: 4.0 * (s - [0.4, 0.2])
    problem = AggregativeProblem(lambda x: x, lambda x: np.eye(2), *gradients)
    return AggregativeTracking(i, [0.0, 0.0], rows(graph)[i], problem, 0.03, rounds=600)


class Surveillance(CFGuidance):
    async def mission(self):
        await self.take_off()
        place = agent(self.id, self.graph)
        if self.member.config.mission_options.get("fail"):
            place.gradient_own.function = lambda x, s: x / (0.0 if self.id == 2 and place.k == 40 else 1.0)
        await self.optimize(place, channel="place")
        height = AsynchronousConsensus(self.id, [0.8 + 0.1 * self.id], rows(self.graph, row_stochastic)[self.id][0], 60)
        await self.optimize(height, channel="height", pace=WakingTimes((0.01, 0.05)))
        await self.go_to([*place.x, float(height.x[0])])
        reached = self.state.p.tolist()
        await self.land()
        return {"reached": reached, "x": place.x.tolist(), "height": float(height.x[0])}


def guidance(i, config):
    return Surveillance()
'''


@pytest.fixture
def mission_file(tmp_path):
    path = tmp_path / "surveillance.py"
    path.write_text(MISSION)
    return path


def test_what_was_simulated_flies(here, mission_file):
    result = here(
        "crazychoir",
        "run",
        mission_file,
        "--fast",
        "--loss",
        0.3,
        "--seed",
        2,
        "--json",
    ).json
    assert result["success"], result["reasons"]
    results = [result["results"][str(i)] for i in range(4)]
    space = {}
    exec(compile(MISSION, "mission", "exec"), space)  # noqa: S102 - our own text, above
    graph = ring(4)
    history = simulate({i: space["agent"](i, graph) for i in graph.ids}, graph)
    assert [own["x"] for own in results] == [
        x.tolist() for x in history.last().values()
    ]
    targets, place = space["TARGETS"], np.array([0.4, 0.2])
    sigma = (targets.mean(axis=0) + 4.0 * place) / 5.0
    assert np.array([own["x"] for own in results]) == pytest.approx(
        targets - 4.0 * (sigma - place), abs=1e-6
    )
    assert np.ptp([own["height"] for own in results]) < 0.01
    for own in results:
        assert own["reached"] == pytest.approx([*own["x"], own["height"]], abs=0.2)


@pytest.mark.filterwarnings(
    "ignore:divide by zero"
)  # numpy's word about what is done on purpose
def test_an_algorithm_that_fails_at_one_drone_lands_all_with_its_reason(
    here, mission_file, tmp_path
):
    drones = "".join(
        f"[[drones]]\nid = {i}\nhome = [{0.6 * i}, 0.0, 0.0]\n" for i in range(4)
    )
    head = (
        f'name = "fails"\nmission = "{mission_file}"\n[mission_options]\nfail = true\n'
    )
    (tmp_path / "fails.toml").write_text(head + drones)
    said = here(
        "crazychoir", "run", tmp_path / "fails.toml", "--fast", "--loss", 0.3, "--json"
    )
    result = said.json
    assert said.code == 1
    reasons = {int(i): reason for i, reason in result["reasons"].items()}
    assert sorted(reasons) == [0, 1, 2, 3]
    assert all(
        "agent 2: gradient_own, round 40[0]: found " in reason
        for reason in reasons.values()
    ), reasons
    assert (
        sum(
            "agent 2 has failed, and with it the team" in reason
            for reason in reasons.values()
        )
        == 3
    )
    assert result["simulated_s"] < 30.0


ALONE = """
from crazychoir import CFGuidance


class Alone(CFGuidance):
    async def mission(self):
        await self.take_off()
        for k in range(200):
            if self.id == 0 and k == 50:
                raise ValueError("my own trouble")
            await self.neighbors_exchange([k])
        await self.land()


def guidance(i, config):
    return Alone()
"""


def test_a_mission_that_fails_alone_in_its_own_exchange_lands_all_with_its_reason(
    here, tmp_path
):
    (tmp_path / "alone.py").write_text(ALONE)
    said = here(
        "crazychoir",
        "run",
        tmp_path / "alone.py",
        "--drones",
        5,
        "--fast",
        "--loss",
        0.3,
        "--json",
    )
    assert said.code == 1
    assert sorted(said.json["reasons"]) == ["0", "1", "2", "3", "4"]
    assert all(
        "ValueError: my own trouble" in reason
        for reason in said.json["reasons"].values()
    )
    assert (
        sum("agent 0 has failed" in reason for reason in said.json["reasons"].values())
        == 4
    )
    assert said.json["simulated_s"] < 25.0
