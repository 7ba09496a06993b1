"""DISROPT's rule for pickup and delivery: primal decomposition, then each robot serves its shares.

A robot serves every task in which it has a share. Prices, columns and weights are ours, which
favours the rule: DISROPT's own local problem is the arc-flow MILP, and its step, without
weights, diverges on dense graphs.
"""

import json
import sys
import time

from crazychoir.bench.peers.peers import end_with_parent
from crazychoir.bench.peers.routing import say_plan
from crazychoir.optimization.rounds.program import Exchange, Program
from crazychoir.routing.distributed.member import (
    GraphPosition,
    PriceSettings,
    RoutingMember,
    RoutingSettings,
)
from crazychoir.routing.distributed.plain_loop import compute_diameter
from crazychoir.routing.distributed.primal_decomposition import PriceRounds
from crazychoir.routing.instance.instance import Instance
from crazychoir.routing.pricing.route_table import RouteColumn, find_shortest_route
from crazychoir.types import Vec


class ShareRule(Program[tuple[int, ...]]):
    """The choice of robot i after T rounds.

        min c_i'z  s.t.  visits(z) >= y_i - rho_i,  rho_i the least for which some route does

    Visits are 0 or 1. So the robot serves every task j with y_ij > rho_i. rho_i > 0 if no route
    serves all tasks in which the robot has a share. The result is the tasks that it serves.
    Source: the recovery of Camisa, Notarnicola & Notarstefano 2021, arXiv 2010.14446, without
    restriction.
    """

    def __init__(self, member: RoutingMember) -> None:
        self._member = member
        super().__init__()

    def run(self) -> Exchange[tuple[int, ...]]:
        """Run the prices, then the robot's own choice."""
        prices = PriceRounds(self._member)
        yield from prices.run()
        return first_serving_column(
            prices.y,
            [self._member.table.column(c) for c in range(len(self._member.table))],
        )


def first_serving_column(y: Vec, columns: list[RouteColumn]) -> tuple[int, ...]:
    """Return the tasks of the first column that serves every task with a share above rho.

    rho is the least value for which such a column exists.
    y: (M,) shares of the robot
    columns: its columns
    """
    missing = [
        max((float(y[j]) for j in range(len(y)) if j not in column.tasks), default=0.0)
        for column in columns
    ]
    rho = max(0.0, min(missing))
    return min(
        column for column, most in zip(columns, missing, strict=True) if most <= rho
    ).tasks


def main() -> None:
    """Run all robots in one loop."""
    end_with_parent()
    spec = json.loads(sys.argv[1])
    instance = Instance.load(spec["instance"])
    graph = {int(i): list(js) for i, js in spec["neighbors"].items()}
    span = compute_diameter(graph)
    settings = RoutingSettings(prices=PriceSettings(rounds=spec["rounds"], still=0.0))
    began = time.perf_counter()
    cpu = time.process_time()
    members = {
        i: RoutingMember(
            instance.local(i),
            GraphPosition(
                i, len(graph), tuple(js), span, {j: len(graph[j]) for j in js}
            ),
            settings,
        )
        for i, js in graph.items()
    }
    rules = {i: ShareRule(member) for i, member in members.items()}
    while not all(rule.done for rule in rules.values()):
        messages = {i: rule.message() for i, rule in rules.items()}
        for i, rule in rules.items():
            rule.step({j: messages[j] for j in graph[i]})
    stops = {
        i: find_shortest_route(members[i].local.vehicle, rule.result)[0]
        for i, rule in rules.items()
    }
    say_plan(stops, f"{spec['rounds']} rounds", began, cpu)


if __name__ == "__main__":
    main()
