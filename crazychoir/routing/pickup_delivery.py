"""Pickup and delivery solved by the robots themselves: one robot's part, as rounds."""

from collections.abc import Mapping
from typing import Any

from crazychoir.errors import ConfigError, SolverError
from crazychoir.optimization.agreement import flood
from crazychoir.optimization.program import Exchange, Program
from crazychoir.routing.column_recovery import DISCLOSED, Assignment, ColumnRecovery
from crazychoir.routing.instance import LocalProblem
from crazychoir.routing.member import Member, Place, Progress, Settings
from crazychoir.routing.plan import Route, Solution, digest_of
from crazychoir.routing.pricing import shortest_route
from crazychoir.routing.primal_decomposition import PriceRounds
from crazychoir.routing.resource_recovery import ResourceRecovery

METHODS = ("resource-columns", "resource", "resource-argmax")


class PickupDelivery(Program[Solution]):
    """Robot i of a team that shares out pickup-and-delivery tasks: a Round.

        price rounds (primal decomposition)  ->  recovery of an integer plan  ->  confirmation of its hash

    resource-columns: the robots also share route columns; the plan is proven optimal where the tables are complete.
    resource, resource-argmax: only prices and claims travel; quick, private, not optimal.
    diameter: of the connected, undirected graph;  degree_of: degree of each neighbour.
    All robots are done in the same round, with the same plan digest, cost and bound.
    Raises ConfigError for an unknown method, SolverError if the team cannot agree on a plan.
    """

    heavy = True
    """`step` computes for milliseconds to seconds: runtimes run it in a thread."""

    def __init__(
        self,
        local: LocalProblem,
        neighbors: list[int],
        n: int,
        diameter: int,
        degree_of: dict[int, int],
        method: str = METHODS[0],
        settings: Settings | None = None,
    ) -> None:
        if method not in METHODS:
            raise ConfigError("method", method, ", ".join(METHODS), "Choose one of them.")
        place = Place(local.robot, n, tuple(sorted(neighbors)), diameter, dict(degree_of))
        self._member = Member(local, place, settings or Settings())
        self._method = method
        super().__init__()

    @property
    def solution(self) -> Solution:
        """What this robot knows of the plan; only when `done`."""
        if not self.done:
            raise SolverError(f"robot {self._member.place.robot}: {self._method}", f"not done in round {self.k}")
        return self.result

    @property
    def progress(self) -> Progress:
        """Phase, round, cost so far, unserved demand."""
        return self._member.progress

    def step(self, heard: Mapping[int, Any]) -> None:
        """Take the neighbours' messages of this round."""
        self._member.report(round=self.k + 1)
        super().step(heard)

    def run(self) -> Exchange[Solution]:
        """Prices, recovery, confirmation."""
        yield from self._hello()
        prices = PriceRounds(self._member)
        yield from prices.run()
        if self._method == "resource-columns":
            assignment, disclosed = (yield from ColumnRecovery(self._member, prices).run()), DISCLOSED
        else:
            recovery = ResourceRecovery(self._member, prices, by_share=self._method == "resource-argmax")
            assignment, disclosed = (yield from recovery.run()), recovery.disclosed
        return (yield from self._confirm(assignment, disclosed))

    def _hello(self) -> Exchange[None]:
        """One light round: the same tasks, method and constants everywhere, or an error."""
        mine = self._member.fingerprint(self._method)
        heard = yield mine
        different = [j for j, theirs in heard.items() if theirs != mine]
        if different:
            raise ConfigError(
                f"robot {self._member.place.robot}: neighbour(s) {', '.join(map(str, different))}",
                "another task list, method, number of robots, diameter or settings",
                "the same at all robots",
                "Start all agents with the same instance file and options.",
            )

    def _confirm(self, assignment: Assignment, disclosed: tuple[str, ...]) -> Exchange[Solution]:
        """Flood lengths and hashes of the routes, then the plan's hash; all must be equal."""
        member, place = self._member, self._member.place
        member.report(phase="confirm", violation=0.0)
        nodes, length = shortest_route(
            member.local.vehicle, assignment.routes.get(place.robot, ()), member.local.objective
        )
        route = Route.from_nodes(place.robot, nodes, len(member.local.tasks), length)
        known = yield from flood(place.robot, [length, route.digest if nodes else ""], place.diameter)
        cost = sum((float(value) for value, _ in known.values()), 0.0)
        digest = digest_of({i: text for i, (_, text) in known.items() if text})
        heard = yield from flood(place.robot, digest, place.diameter)
        if any(other != digest for other in heard.values()):
            raise SolverError(f"robot {place.robot}: confirmation", f"different plans at the robots: {heard}")
        member.report(phase="done", cost=cost)
        bound = None if assignment.lower_bound is None else min(assignment.lower_bound, cost)
        return Solution(
            cost=cost,
            feasible=True,
            lower_bound=bound,
            bound_exact=bound is not None,
            method=self._method,
            disclosed=disclosed,
            rounds=self.k,
            plan_digest=digest,
            routes=(route,) if nodes else (),
        )
