"""Iterates and rounds a second of the exact gradient methods, beside those of decent-bench, in turns.

    pip install decent-bench                                # in another environment: Python 3.13 or later
    python tests/bench/exact_gradient.py --python other/bin/python --agents 20 --size 10

Each row is one algorithm on the same random quadratic costs, graph, weights, starts and steps. `difference` is
the largest one between the iterates of both programs, over all agents and rounds. Both loops run in one
process and hand over each message; `simulated` is our runtime too, with its simulated network.
"""

import argparse
import json
import random
import statistics
import subprocess
import time
from dataclasses import dataclass

import cvxpy as cp
import numpy as np
from rich.console import Console
from rich.table import Table

from crazychoir.optimization.algorithms.directed_gradient_tracking import (
    DirectedGradientTracking,
)
from crazychoir.optimization.algorithms.exact_gradient.exact_diffusion import (
    ExactDiffusion,
)
from crazychoir.optimization.algorithms.exact_gradient.extra import EXTRA
from crazychoir.optimization.algorithms.exact_gradient.linearised_admm import (
    LinearisedADMM,
)
from crazychoir.optimization.algorithms.exact_gradient.nids import NIDS
from crazychoir.optimization.algorithms.exact_gradient.prox_skip import (
    ProxSkip,
    SharedCoin,
)
from crazychoir.optimization.algorithms.exact_gradient.relaxed_admm import RelaxedADMM
from crazychoir.optimization.generate import random_quadratics
from crazychoir.optimization.problems.composite import CompositeCost
from crazychoir.optimization.problems.problems import CostCoupled
from crazychoir.solve.simulate import simulate
from crazychoir.team.graph import erdos_renyi_connected, metropolis
from crazychoir.types import PerNeighbor

TURNS = 7
"""Turns; the median of each program counts."""
ROUNDS = 200
"""Iterations of decent-bench in a turn. Ours are fewer where an iteration sends nothing."""
COMMUNICATION_CHANCE = 0.3
COIN_SEED = 5
PEER = """
import json, random, sys, time
import networkx as nx
import numpy as np
from decent_array import interoperability as iop
from decent_bench.agents import Agent
from decent_bench.algorithms import p2p
from decent_bench.costs import QuadraticCost
from decent_bench.networks import P2PNetwork

iop.set_backend("numpy")
task = json.loads(sys.stdin.readline())

def add_copies(self, agent):
    total = None
    for value in agent.messages().values():
        total = iop.copy(value) if total is None else total + value
    return total

p2p.DLM._sum_messages = add_copies  # 0.3.0 adds to the messages themselves, and x grows without end

def make(name, period):
    costs = [QuadraticCost(iop.from_numpy(np.array(p)), iop.from_numpy(np.array(q)))
             for p, q in zip(task["p"], task["q"])]
    agents = [Agent(cost, state_snapshot_period=period) for cost in costs]
    graph = nx.Graph()
    graph.add_nodes_from(range(len(agents)))
    graph.add_edges_from(task["edges"])
    network = P2PNetwork(graph, agents)
    options = dict(task["options"][name])
    if name != "ADMM":
        options["x0"] = {a: iop.from_numpy(np.array(x)) for a, x in zip(agents, task["start"])}
    return getattr(p2p, name)(**options), network, agents

def values(agent, k):
    return iop.to_numpy(agent._x_history[k]).tolist()

for line in sys.stdin:
    name, wanted = json.loads(line)
    algorithm, network, agents = make(name, 1 if wanted else 10**9)
    random.seed(task["seed"])
    began = time.perf_counter()
    algorithm.run(network, task["rounds"])
    took = time.perf_counter() - began
    found = [[values(a, k) for a in agents] for k in range(1, task["rounds"] + 1)] if wanted else []
    print(json.dumps([took, found]), flush=True)
"""
"""The program that runs decent-bench's algorithms, one run for each line that it gets."""


@dataclass(frozen=True)
class Case:
    """One algorithm in both programs."""

    name: str
    """Class of decent-bench."""
    make: object
    """Returns our agent, given (i, rounds)."""
    options: dict
    """Options of decent-bench's class."""
    shift: int = 0
    """Iterations of decent-bench before our round 0."""


class Contest:
    """The problem, and the algorithms of both programs."""

    def __init__(self, agents, n):
        self.costs = random_quadratics(agents, n, seed=1)
        self.graph = erdos_renyi_connected(agents, 0.3, 1)
        self.start = np.random.default_rng(2).normal(size=(agents, n))
        self.step = 0.5 / self.costs.smoothness
        self.weights = metropolis(self.graph)

    def cases(self):
        """Return the algorithms that both programs have."""
        step = self.step
        penalty = self.costs.smoothness / 20.0
        degree = max(len(self.graph.neighbors(i)) for i in self.graph.ids)
        slow = 1.0 / (2.0 * penalty * degree + self.costs.smoothness)
        p = COMMUNICATION_CHANCE

        def linearised(i, rounds):
            neighbors = self.graph.neighbors(i)
            proximity = 1.0 / slow - 2.0 * penalty * len(neighbors)
            return LinearisedADMM(
                *self.first(i), neighbors, self.gradient(i), penalty, proximity, rounds
            )

        def relaxed(i, rounds):
            x = cp.Variable(self.start.shape[1])
            cost = 0.5 * cp.quad_form(x, self.costs.p[i]) + self.costs.q[i] @ x
            neighbors = self.graph.neighbors(i)
            return RelaxedADMM(CostCoupled(i, x, cost), neighbors, 1.0, 0.5, rounds)

        def simple(kind):
            return lambda i, rounds: kind(
                *self.first(i), self.weights[i], self.gradient(i), step, rounds
            )

        return [
            Case("EXTRA", simple(EXTRA), {"step_size": step}),
            Case(
                "NIDS",
                lambda i, rounds: NIDS(
                    *self.first(i),
                    self.weights[i],
                    CompositeCost(self.gradient(i)),
                    step,
                    rounds=rounds,
                ),
                {"step_size": step},
                shift=1,
            ),
            Case("ED", simple(ExactDiffusion), {"step_size": step}),
            Case(
                "ProxSkip",
                lambda i, rounds: ProxSkip(
                    *self.first(i),
                    self.weights[i],
                    self.gradient(i),
                    step,
                    SharedCoin(p, COIN_SEED),
                    rounds,
                ),
                {"step_size": step, "aux_step_size": p, "comm_probability": p},
            ),
            Case(
                "ATC_Tracking",
                lambda i, rounds: DirectedGradientTracking(
                    *self.first(i),
                    self.weights[i],
                    self.weights[i],
                    self.gradient(i),
                    step / 5.0,
                    rounds,
                ),
                {"step_size": step / 5.0},
            ),
            Case("DLM", linearised, {"step_size": slow, "penalty": penalty}, shift=1),
            Case("ADMM", relaxed, {"penalty": 1.0, "relaxation": 0.5}, shift=1),
        ]

    def first(self, i):
        """Return the first two arguments of an agent."""
        return i, self.start[i]

    def gradient(self, i):
        """Return the gradient of f_i."""
        p = self.costs.p[i]
        q = self.costs.q[i]
        return lambda x: p @ x + q

    def ends(self, case):
        """Return the iterations of decent-bench, from 1 on, after each of our rounds."""
        if case.name != "ProxSkip":
            return list(range(1 + case.shift, ROUNDS + 1))
        tosses = random.Random(COIN_SEED)  # noqa: S311 - when to send, not secrets
        return [
            k for k in range(1, ROUNDS + 1) if tosses.random() < COMMUNICATION_CHANCE
        ]

    def team(self, case, rounds):
        """Return our agents."""
        return {i: case.make(i, rounds) for i in self.graph.ids}

    def loop(self, case, rounds, keep):
        """Run our agents; return the seconds, and all x after each round if `keep`."""
        agents = self.team(case, rounds)
        neighbors = {i: self.graph.neighbors(i) for i in agents}
        found = []
        began = time.perf_counter()
        for _ in range(rounds):
            sent = {i: agent.message() for i, agent in agents.items()}
            for i, agent in agents.items():
                agent.step({j: received(i, sent[j]) for j in neighbors[i]})
            if keep:
                found.append([agent.x.copy() for agent in agents.values()])
        return time.perf_counter() - began, np.array(found)

    def simulated(self, case, rounds):
        """Return the seconds of our agents over a simulated network."""
        agents = self.team(case, rounds)
        began = time.perf_counter()
        simulate(agents, self.graph)
        return time.perf_counter() - began


def received(i, message):
    """Return what agent i gets of a message."""
    return message[i] if isinstance(message, PerNeighbor) else message


class Peer:
    """decent-bench in a process of its own."""

    def __init__(self, python, contest):
        self.process = subprocess.Popen(
            [python, "-c", PEER],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        edges = [list(edge) for edge in contest.graph.arcs if edge[0] < edge[1]]
        self._send(
            {
                "p": contest.costs.p.tolist(),
                "q": contest.costs.q.tolist(),
                "start": contest.start.tolist(),
                "edges": edges,
                "rounds": ROUNDS,
                "seed": COIN_SEED,
                "options": {case.name: case.options for case in contest.cases()},
            }
        )

    def _send(self, value):
        self.process.stdin.write(json.dumps(value) + "\n")
        self.process.stdin.flush()

    def run(self, case, keep):
        """Return the seconds of a run, and all x after each iteration if `keep`."""
        self._send([case.name, keep])
        took, found = json.loads(self.process.stdout.readline())
        return took, np.array(found)

    def close(self):
        self.process.stdin.close()
        self.process.wait()


def measure(contest, case, peer):
    """Return the texts of a row."""
    ends = contest.ends(case)
    rounds = len(ends)
    took = {"ours": [], "simulated": [], "decent-bench": []}
    difference = "-"
    if peer is not None:
        ours = contest.loop(case, rounds, keep=True)[1]
        theirs = peer.run(case, keep=True)[1][np.array(ends) - 1]
        difference = f"{np.abs(ours - theirs).max():.1e}"
    error = np.abs(contest.loop(case, rounds, keep=True)[1][-1] - contest.costs.optimum)
    for _ in range(TURNS):
        took["ours"].append(contest.loop(case, rounds, keep=False)[0])
        took["simulated"].append(contest.simulated(case, rounds))
        if peer is not None:
            took["decent-bench"].append(peer.run(case, keep=False)[0])
    rates = [
        f"{rounds / statistics.median(times):.0f}" if times else "-"
        for times in took.values()
    ]
    return [case.name, str(rounds), difference, f"{error.max():.1e}", *rates]


def main():
    """Print a row for each algorithm."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--python", help="Python with decent-bench")
    parser.add_argument("--agents", type=int, default=20)
    parser.add_argument("--size", type=int, default=10)
    arguments = parser.parse_args()
    contest = Contest(arguments.agents, arguments.size)
    peer = Peer(arguments.python, contest) if arguments.python else None
    table = Table(title=f"{arguments.agents} agents, x of {arguments.size}")
    for title in ("algorithm", "rounds", "difference", "from the optimum"):
        table.add_column(title)
    for title in ("ours", "simulated", "decent-bench"):
        table.add_column(f"{title} rounds/s")
    for case in contest.cases():
        table.add_row(*measure(contest, case, peer))
    if peer is not None:
        peer.close()
    Console().print(table)


if __name__ == "__main__":
    main()
