"""`crazychoir bench routing`: the team beside VROOM, OR-tools, the arc-flow MILP and others.

The others are auctions and DISROPT's rule. All solve the same random instances, one after the
other on an idle machine. The cost is that of the routes as they are flown, checked by the
package's own checker.
"""

import importlib.util
import json
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from rich import box
from rich.console import Group as Shown
from rich.table import Table
from rich.text import Text

from crazychoir.bench.harness import NOT_INSTALLED_NOTE, peer_command
from crazychoir.bench.significance import compare_pairs, relative_excess, spread
from crazychoir.errors import ConfigError, CrazyChoirError, error_text
from crazychoir.routing.distributed.member import ProofSettings, RoutingSettings
from crazychoir.routing.distributed.pickup_delivery import PLANNING_METHODS
from crazychoir.routing.instance.checker import check_plan
from crazychoir.routing.instance.generate import InstanceShape, random_instance
from crazychoir.routing.instance.instance import Instance
from crazychoir.routing.instance.plan import Route, RoutePlan
from crazychoir.solve.group import ProgramGroup
from crazychoir.solve.solve_options import SolveOptions
from crazychoir.solve.solving import solve_here
from crazychoir.solve.team import merge_best_points, solve_in_processes
from crazychoir.team.graph import graph_from_name

INSTANCE_SIZES = {
    "tiny": (3, 5),
    "small": (10, 20),
    "middle": (20, 40),
    "large": (50, 100),
}
"""Robots and tasks, in a room of 10 m by 10 m, with routes of at most ROUTING_BENCH.route_length_limit m."""
INSTANCE_COUNTS = {"tiny": 5, "small": 20, "middle": 5, "large": 5}
"""Number of instances of each size, if the command line does not give it."""


@dataclass(frozen=True, slots=True)
class RoutingBenchSettings:
    """Settings of `crazychoir bench routing`: its instances, the team's network and its limits."""

    most_instances: int = 1000
    """Largest number of instances of a size."""
    default_sizes: str = "small:20,middle:5,large:5"
    """Sizes and numbers of instances, if the command line does not give them."""
    provable_sizes: tuple[str, ...] = ("tiny", "small", "middle")
    """Sizes for which a proof may end in reasonable time."""
    route_length_limit: float = 25.0
    """Largest length of a route, m."""
    message_loss: float = 0.1
    """Share of the team's messages that is lost."""
    team_processes: int = 2
    """Number of processes of the team."""
    peer_timeout: float = 300.0
    """Seconds that a peer gets at most."""
    optimality_gap: float = 1e-6
    """Relative gap up to which a plan counts as proven optimal."""
    rival_methods: tuple[str, ...] = ("cbba", "auction")
    """Methods of the team that are measured as peers, in virtual time."""


ROUTING_BENCH = RoutingBenchSettings()


TEAM_ROW = "crazychoir"
PROOF_ROW = "crazychoir, proof"
RESULT_LEGEND = """
Medians over the instances that are done, that is, solved. opt.: proven optimal.
gap, worst: % over the proven optimum, else over the bound. wall, CPU: s.
path: s, of the critical path. wins: of the team, p: that it is better."""


@dataclass(frozen=True)
class PeerSolver:
    """A program that solves an instance."""

    name: str
    """Name of the program."""
    module: str
    """Its module in crazychoir.bench.peers."""
    extra: str = ""
    """Package that must be installed; empty for none."""
    options: dict[str, Any] = field(default_factory=dict)
    """Its options."""
    sizes: tuple[str, ...] = tuple(INSTANCE_SIZES)
    """Sizes that it solves."""
    covers: bool = False
    """Whether its model lets several robots serve the same task."""


PEER_SOLVERS = (
    PeerSolver(
        "VROOM", "vroom_peer", "vroom", {"exploration": 5, "threads": 2, "restarts": 5}
    ),
    PeerSolver("OR-tools", "ortools_peer", "ortools", {"seconds": 10.0}),
    PeerSolver("arc-flow MILP", "compact", "", {"nodes": 20_000}, ("tiny",)),
    PeerSolver(
        "DISROPT's rule",
        "disropt_peer",
        "",
        {"rounds": 100},
        ("tiny", "small", "middle"),
        covers=True,
    ),
)


def run(
    sizes: str = ROUTING_BENCH.default_sizes,
    *,
    graph: str = "k-regular:4",
    method: str | None = None,
    prove: bool = False,
    quick: bool = False,
    say: Callable[[str], None] = lambda text: None,
) -> dict[str, Any]:
    """Measure all solvers on the instances 1, 2, ... of each size.

    sizes: sizes and numbers of instances, such as "small:20,middle"
    graph: communication graph of the team
    method: method of the team, None for the default
    prove: whether the team also tries to prove an optimum, in a run of its own, for the sizes in
        ROUTING_BENCH.provable_sizes
    quick: two tiny instances, and OR-tools for 1 s
    say: called with a text that says what is being measured
    Raises ConfigError for an unknown size, graph or method.
    """
    chosen = {"tiny": 2} if quick else parse_sizes(sizes)
    method = method or PLANNING_METHODS[0]
    if method not in PLANNING_METHODS:
        raise ConfigError("--method", method, ", ".join(PLANNING_METHODS))
    for size in chosen:
        graph_from_name(
            _graph(graph, INSTANCE_SIZES[size][0]), INSTANCE_SIZES[size][0], 1
        )
    rows: list[dict[str, Any]] = []
    cases = [
        (size, seed) for size, count in chosen.items() for seed in range(1, count + 1)
    ]
    for number, (size, seed) in enumerate(cases, 1):
        tell = partial(_tell, say, f"instance {number} of {len(cases)}")
        of_one = list(_rows(size, seed, graph, method, quick, tell))
        of_one += (
            [_prove_with_team(size, seed, graph, method, tell)]
            if prove and size in ROUTING_BENCH.provable_sizes
            else []
        )
        rows += rate_rows(of_one)
    return {
        "rows": rows,
        "summary": summary(rows),
        "graph": graph,
        "method": method,
        "loss": ROUTING_BENCH.message_loss,
        "processes": ROUTING_BENCH.team_processes,
    }


def _tell(say: Callable[[str], None], where: str, what: str) -> None:
    say(f"{where}: {what}")


def parse_sizes(sizes: str) -> dict[str, int]:
    """Return the number of instances of each size of a text such as "small:20,middle".

    Raises ConfigError for a text that is not valid.
    """
    chosen: dict[str, int] = {}
    for word in sizes.split(","):
        size, _, count = word.strip().partition(":")
        if size not in INSTANCE_SIZES or size in chosen:
            raise ConfigError(
                "--sizes",
                word,
                f"each of {', '.join(INSTANCE_SIZES)} once",
                f"As {ROUTING_BENCH.default_sizes}.",
            )
        if count and not (
            count.isdecimal() and 1 <= int(count) <= ROUTING_BENCH.most_instances
        ):
            raise ConfigError(
                "--sizes",
                word,
                f"1 to {ROUTING_BENCH.most_instances} instances after the colon",
                f"As {ROUTING_BENCH.default_sizes}.",
            )
        chosen[size] = int(count or INSTANCE_COUNTS[size])
    return chosen


def _rows(
    size: str,
    seed: int,
    graph: str,
    method: str,
    quick: bool,
    say: Callable[[str], None],
) -> Iterator[dict[str, Any]]:
    """Yield the row of each solver for one instance."""
    instance = _instance(size, seed)
    head = _head(size, seed)
    robots = instance.robots
    say(
        f"{size} {seed}: {TEAM_ROW}: {robots} robots in {ROUTING_BENCH.team_processes} "
        f"processes, {ROUTING_BENCH.message_loss:.0%} of messages lost"
    )
    ours = _team(
        instance,
        lambda: solve_in_processes(
            instance,
            ROUTING_BENCH.team_processes,
            SolveOptions(
                method=method,
                loss=ROUTING_BENCH.message_loss,
                graph=_graph(graph, robots),
                seed=seed,
            ),
        ),
    )
    yield head | {"name": TEAM_ROW} | ours
    for rival in ROUTING_BENCH.rival_methods:
        say(f"{size} {seed}: {rival}")
        known = rival in PLANNING_METHODS
        yield (
            head
            | {"name": rival}
            | (
                _team(
                    instance,
                    lambda rival=rival: solve_here(  # type: ignore[misc]
                        instance,
                        SolveOptions(
                            method=rival,
                            loss=ROUTING_BENCH.message_loss,
                            graph=_graph(graph, robots),
                            seed=seed,
                        ),
                    ),
                )
                if known
                else _row_without_result("no such method")
            )
        )
    for peer in (peer for peer in PEER_SOLVERS if size in peer.sizes):
        say(f"{size} {seed}: {peer.name}")
        options = peer.options | {
            "seed": seed,
            "neighbors": _neighbors(graph, robots, seed),
        }
        options.setdefault("seconds", ours["wall_s"] or 1.0)
        options |= {"seconds": min(1.0, options["seconds"])} if quick else {}
        yield head | {"name": peer.name} | measure_peer(instance, peer, options)


def _prove_with_team(
    size: str, seed: int, graph: str, method: str, say: Callable[[str], None]
) -> dict[str, Any]:
    """Return the row of the team when it runs until it has proven what it can."""
    say(f"{size} {seed}: proof")
    instance = _instance(size, seed)
    settings = RoutingSettings(proof=ProofSettings(prove=True))
    return (
        _head(size, seed)
        | {"name": PROOF_ROW}
        | _team(
            instance,
            lambda: solve_in_processes(
                instance,
                ROUTING_BENCH.team_processes,
                SolveOptions(
                    method=method,
                    loss=ROUTING_BENCH.message_loss,
                    graph=_graph(graph, instance.robots),
                    seed=seed,
                    settings=settings,
                ),
            ),
        )
    )


def _instance(size: str, seed: int) -> Instance:
    return random_instance(
        *INSTANCE_SIZES[size],
        seed,
        InstanceShape(route_length_limit=ROUTING_BENCH.route_length_limit),
    )


def _head(size: str, seed: int) -> dict[str, Any]:
    robots, tasks = INSTANCE_SIZES[size]
    return {"size": size, "robots": robots, "tasks": tasks, "seed": seed}


def measure_peer(
    instance: Instance, peer: PeerSolver, options: dict[str, Any]
) -> dict[str, Any]:
    """Return the row of a peer; if it has no result, the note says why."""
    if peer.extra and importlib.util.find_spec(peer.extra) is None:
        return _row_without_result(NOT_INSTALLED_NOTE)
    with tempfile.TemporaryDirectory(prefix="crazychoir-bench-") as folder:
        file = Path(folder) / "instance.json"
        file.write_text(json.dumps(instance.to_json()), encoding="utf-8")
        command = peer_command(peer.module, options | {"instance": str(file)})
        try:
            with ProgramGroup([command]) as group:
                ((_, answer),) = group.answers(
                    1, ROUTING_BENCH.peer_timeout, "do not answer"
                )
        except TimeoutError as error:
            return _row_without_result(f"failed: {error}")
    return judge_answer(instance, answer, peer.covers)


def judge_answer(
    instance: Instance, answer: dict[str, Any], covers: bool = False
) -> dict[str, Any]:
    """Return the row of a peer's answer: its routes as they are flown, and their faults.

    instance: the instance
    answer: answer of the peer
    covers: whether a task served by several robots is only noted, not a fault
    """
    if answer["routes"] is None:
        return _row_without_result(answer["note"]) | {
            key: answer[key] for key in ("wall_s", "cpu_s")
        }
    routes = [
        _route(instance, route["robot"], route["nodes"])
        for route in answer["routes"]
        if route["nodes"]
    ]
    plan = RoutePlan(tuple(routes))
    services = Counter(task for route in routes for task in route.tasks)
    repeated = sum(count > 1 for count in services.values())
    wrong = check_plan(instance, plan)
    note = answer["note"]
    if repeated and covers:
        note += f"; {repeated} tasks are served by several"
        wrong = wrong if len(wrong) > repeated else []
    note += f"; {len(wrong)} faults, the first: {wrong[0]}" if wrong else ""
    return {
        "cost": plan.cost,
        "feasible": not wrong,
        "wall_s": answer["wall_s"],
        "cpu_s": answer["cpu_s"],
        "critical_path_s": None,
        "lower_bound": None,
        "bound_exact": False,
        "curve": merge_best_points(answer["curve"]),
        "note": note,
    }


def _route(instance: Instance, robot: int, nodes: list[int]) -> Route:
    m = len(instance.tasks)
    distance = instance.local(robot).vehicle.distance
    tour = [2 * m, *nodes, 2 * m + 1]
    return Route.from_nodes(robot, nodes, m, float(distance[tour[:-1], tour[1:]].sum()))


def _team(instance: Instance, solve: Callable[[], dict[str, Any]]) -> dict[str, Any]:
    """Return the row of the team's own result."""
    try:
        result = solve()
    except CrazyChoirError as error:
        return _row_without_result(error_text(error))
    keys = (
        "cost",
        "feasible",
        "wall_s",
        "critical_path_s",
        "lower_bound",
        "bound_exact",
        "rounds",
        "bytes",
    )
    row = {key: result[key] for key in keys}
    return (
        row
        | {key: result.get(key) for key in ("cpu_s", "startup_s", "curve")}
        | {"note": ""}
    )


def _row_without_result(note: str) -> dict[str, Any]:
    keys = ("cost", "wall_s", "cpu_s", "critical_path_s", "lower_bound")
    return dict.fromkeys(keys) | {
        "feasible": False,
        "bound_exact": False,
        "curve": [],
        "note": note,
    }


def rate_rows(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return the rows of one instance, each with its gap_percent to the `reference`.

    The reference is the proven optimum, else the best exact bound. A plan that costs less than
    that bound disproves it: then there is no gap, and the reference is "broken bound".
    """
    bounds = [row["lower_bound"] for row in rows if row["bound_exact"]]
    best = min((row["cost"] for row in rows if row["feasible"]), default=None)
    if not bounds or best is None:
        return [row | {"gap_percent": None, "reference": None} for row in rows]
    bound = max(bounds)
    if best < bound * (1.0 - ROUTING_BENCH.optimality_gap):
        return [
            row | {"gap_percent": None, "reference": "broken bound"} for row in rows
        ]
    reference = (
        "optimum" if best <= bound * (1.0 + ROUTING_BENCH.optimality_gap) else "bound"
    )
    gaps = [
        relative_excess(row["cost"], bound) if row["feasible"] else None for row in rows
    ]
    return [
        row | {"gap_percent": gap, "reference": reference}
        for row, gap in zip(rows, gaps, strict=True)
    ]


def summary(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return a row a size and solver over the instances that it solved.

    The row has the spreads of the figures and the test against the team.
    """
    found = []
    for size, name in dict.fromkeys((row["size"], row["name"]) for row in rows):
        mine = [row for row in rows if (row["size"], row["name"]) == (size, name)]
        solved = {row["seed"]: row for row in mine if row["feasible"]}
        of_team = {
            row["seed"]: row
            for row in rows
            if row["size"] == size and row["name"] == TEAM_ROW and row["feasible"]
        }
        both = [seed for seed in solved if seed in of_team]
        row: dict[str, Any] = {
            "size": size,
            "name": name,
            "instances": len(mine),
            "solved": len(solved),
        }
        row["optimal"] = sum(_is_optimal(one) for one in mine)
        row["broken_bounds"] = sum(one["reference"] == "broken bound" for one in mine)
        for key in ("cost", "gap_percent", "wall_s", "cpu_s", "critical_path_s"):
            values = [one[key] for one in solved.values() if one[key] is not None]
            row[key] = spread(values) if values else None
        pairs = (
            [(of_team[seed]["cost"], solved[seed]["cost"]) for seed in both]
            if name != TEAM_ROW
            else []
        )
        row["against_team"] = (
            compare_pairs(*zip(*pairs, strict=True)) if pairs else None
        )
        row["notes"] = list(dict.fromkeys(one["note"] for one in mine if one["note"]))
        found.append(row)
    return found


def _is_optimal(row: dict[str, Any]) -> bool:
    return (
        row["reference"] == "optimum"
        and row["gap_percent"] is not None
        and row["gap_percent"] <= 100.0 * ROUTING_BENCH.optimality_gap
    )


def table(result: dict[str, Any]) -> Shown:
    """Return the summary as tables, one a size, so that each fits into 80 columns."""
    head = f"Pickup and delivery: {result['method']} on {result['graph']}, {result['loss']:.0%} lost"
    summed = result["summary"]
    tables: list[Table | str] = []
    for size in dict.fromkeys(row["size"] for row in summed):
        tables += ["", _table_of(size, [row for row in summed if row["size"] == size])]
    broken = [f"{row['size']}: BROKEN BOUNDS" for row in summed if row["broken_bounds"]]
    notes = [
        f"{row['name']}, {row['size']}: {row['notes'][0]}"
        for row in summed
        if row["notes"]
    ]
    return Shown(
        Text(head),
        *tables,
        Text("\n".join([*dict.fromkeys([*broken, *notes]), RESULT_LEGEND])),
    )


def _table_of(size: str, rows: list[dict[str, Any]]) -> Table:
    robots, tasks = INSTANCE_SIZES[size]
    made = Table(
        title=f"{size}: {robots} robots, {tasks} tasks",
        box=box.SIMPLE_HEAD,
        padding=0,
        title_justify="left",
        show_edge=False,
    )
    for name in (
        "solver",
        "done",
        "opt.",
        "cost",
        "gap",
        "worst",
        "wall",
        "CPU",
        "path",
        "wins",
        "p",
    ):
        made.add_column(
            name, justify="left" if name == "solver" else "right", no_wrap=True
        )
    for row in rows:
        versus = row["against_team"] or {}
        wins = f"{versus['wins']}/{versus['pairs']}" if versus else ""
        p = "" if versus.get("p") is None else f"{versus['p']:.1g}"
        worst = (
            "-"
            if row["gap_percent"] is None
            else _format_figure(row["gap_percent"]["most"])
        )
        cost = "-" if row["cost"] is None else f"{row['cost']['median']:.2f}"
        gap, *times = (
            _median(row[key])
            for key in ("gap_percent", "wall_s", "cpu_s", "critical_path_s")
        )
        made.add_row(
            row["name"],
            f"{row['solved']}/{row['instances']}",
            str(row["optimal"]),
            cost,
            gap,
            worst,
            *times,
            wins,
            p,
        )
    return made


def _median(figures: dict[str, float] | None) -> str:
    return "-" if figures is None else _format_figure(figures["median"])


def _format_figure(figure: float) -> str:
    """Return a figure with three digits and at most two decimals."""
    if figure < 9.995:
        return f"{figure:.2f}"
    if figure < 99.95:
        return f"{figure:.1f}"
    return f"{figure:.0f}"


def _graph(graph: str, robots: int) -> str:
    """Return the requested graph, or a complete one if the team is too small for it."""
    return "complete" if graph == "k-regular:4" and robots <= 4 else graph


def _neighbors(graph: str, robots: int, seed: int) -> dict[int, tuple[int, ...]]:
    links = graph_from_name(_graph(graph, robots), robots, seed)
    return {i: links.neighbors(i) for i in links.ids}
