"""`crazychoir bench routing`: the team beside VROOM, OR-tools, the arc-flow MILP and others.

The others are auctions and DISROPT's rule. All solve the same random instances, one after the
other on an idle machine. The cost is that of the routes as they are flown, checked by the
package's own checker.
"""

import importlib.util
import json
import sys
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

from crazychoir.bench.exchange import BARE, INSTALL, PACKAGE
from crazychoir.bench.significance import paired, relative, spread
from crazychoir.errors import ConfigError, CrazyChoirError, error_text
from crazychoir.routing.distributed.member import Settings
from crazychoir.routing.distributed.pickup_delivery import METHODS
from crazychoir.routing.instance.checker import check
from crazychoir.routing.instance.generate import random_instance
from crazychoir.routing.instance.instance import Instance
from crazychoir.routing.instance.plan import Plan, Route
from crazychoir.solve.group import Group
from crazychoir.solve.solving import solve_here
from crazychoir.solve.team import best_so_far, solve_in_processes
from crazychoir.team.graph import named

SIZES = {"tiny": (3, 5), "small": (10, 20), "middle": (20, 40), "large": (50, 100)}
"""Robots and tasks, in a room of 10 m by 10 m, with routes of at most LIMIT m."""
INSTANCES = {"tiny": 5, "small": 20, "middle": 5, "large": 5}
"""Number of instances of each size, if the command line does not give it."""
MOST_INSTANCES = 1000
"""Largest number of instances of a size."""
DEFAULT = "small:20,middle:5,large:5"
"""Sizes and numbers of instances, if the command line does not give them."""
PROVABLE = ("tiny", "small", "middle")
"""Sizes for which a proof may end in reasonable time."""
LIMIT = 25.0
"""Largest length of a route, m."""
OURS = "crazychoir"
PROOF = "crazychoir, proof"
LOSS = 0.1
"""Share of the team's messages that is lost."""
PROCESSES = 2
"""Number of processes of the team."""
PATIENCE = 300.0
"""Seconds that a peer gets at most."""
LEGEND = """
Medians over the instances that are done, that is, solved. opt.: proven optimal.
gap, worst: % over the proven optimum, else over the bound. wall, CPU: s.
path: s, of the critical path. wins: of the team, p: that it is better."""
CLOSED = 1e-6
"""Relative gap up to which a plan counts as proven optimal."""


@dataclass(frozen=True)
class Peer:
    """A program that solves an instance."""

    name: str
    """Name of the program."""
    module: str
    """Its module in crazychoir.bench.peers."""
    extra: str = ""
    """Package that must be installed; empty for none."""
    options: dict[str, Any] = field(default_factory=dict)
    """Its options."""
    sizes: tuple[str, ...] = tuple(SIZES)
    """Sizes that it solves."""
    covers: bool = False
    """Whether its model lets several robots serve the same task."""


PEERS = (
    Peer(
        "VROOM", "vroom_peer", "vroom", {"exploration": 5, "threads": 2, "restarts": 5}
    ),
    Peer("OR-tools", "ortools_peer", "ortools", {"seconds": 10.0}),
    Peer("arc-flow MILP", "compact", "", {"nodes": 20_000}, ("tiny",)),
    Peer(
        "DISROPT's rule",
        "disropt_peer",
        "",
        {"rounds": 100},
        ("tiny", "small", "middle"),
        covers=True,
    ),
)
RIVALS = ("cbba", "auction")
"""Methods of the team that are measured as peers, in virtual time."""


def run(
    sizes: str = DEFAULT,
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
        PROVABLE
    quick: two tiny instances, and OR-tools for 1 s
    say: called with a text that says what is being measured
    Raises ConfigError for an unknown size, graph or method.
    """
    chosen = {"tiny": 2} if quick else instances(sizes)
    method = method or METHODS[0]
    if method not in METHODS:
        raise ConfigError("--method", method, ", ".join(METHODS))
    for size in chosen:
        named(_graph(graph, SIZES[size][0]), SIZES[size][0], 1)
    rows: list[dict[str, Any]] = []
    cases = [
        (size, seed) for size, count in chosen.items() for seed in range(1, count + 1)
    ]
    for number, (size, seed) in enumerate(cases, 1):
        tell = partial(_tell, say, f"instance {number} of {len(cases)}")
        of_one = list(_rows(size, seed, graph, method, quick, tell))
        of_one += (
            [_proof(size, seed, graph, method, tell)]
            if prove and size in PROVABLE
            else []
        )
        rows += rated(of_one)
    return {
        "rows": rows,
        "summary": summary(rows),
        "graph": graph,
        "method": method,
        "loss": LOSS,
        "processes": PROCESSES,
    }


def _tell(say: Callable[[str], None], where: str, what: str) -> None:
    say(f"{where}: {what}")


def instances(sizes: str) -> dict[str, int]:
    """Return the number of instances of each size of a text such as "small:20,middle".

    Raises ConfigError for a text that is not valid.
    """
    chosen: dict[str, int] = {}
    for word in sizes.split(","):
        size, _, count = word.strip().partition(":")
        if size not in SIZES or size in chosen:
            raise ConfigError(
                "--sizes", word, f"each of {', '.join(SIZES)} once", f"As {DEFAULT}."
            )
        if count and not (count.isdecimal() and 1 <= int(count) <= MOST_INSTANCES):
            raise ConfigError(
                "--sizes",
                word,
                f"1 to {MOST_INSTANCES} instances after the colon",
                f"As {DEFAULT}.",
            )
        chosen[size] = int(count or INSTANCES[size])
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
        f"{size} {seed}: {OURS}: {robots} robots in {PROCESSES} processes, {LOSS:.0%} of messages lost"
    )
    ours = _team(
        instance,
        lambda: solve_in_processes(
            instance,
            PROCESSES,
            method=method,
            loss=LOSS,
            graph=_graph(graph, robots),
            seed=seed,
        ),
    )
    yield head | {"name": OURS} | ours
    for rival in RIVALS:
        say(f"{size} {seed}: {rival}")
        known = rival in METHODS
        yield (
            head
            | {"name": rival}
            | (
                _team(
                    instance,
                    lambda rival=rival: solve_here(  # type: ignore[misc]
                        instance,
                        method=rival,
                        loss=LOSS,
                        graph=_graph(graph, robots),
                        seed=seed,
                    ),
                )
                if known
                else _nothing("no such method")
            )
        )
    for peer in (peer for peer in PEERS if size in peer.sizes):
        say(f"{size} {seed}: {peer.name}")
        options = peer.options | {
            "seed": seed,
            "neighbors": _neighbors(graph, robots, seed),
        }
        options.setdefault("seconds", ours["wall_s"] or 1.0)
        options |= {"seconds": min(1.0, options["seconds"])} if quick else {}
        yield head | {"name": peer.name} | measured(instance, peer, options)


def _proof(
    size: str, seed: int, graph: str, method: str, say: Callable[[str], None]
) -> dict[str, Any]:
    """Return the row of the team when it runs until it has proven what it can."""
    say(f"{size} {seed}: proof")
    instance = _instance(size, seed)
    settings = Settings(prove=True)
    return (
        _head(size, seed)
        | {"name": PROOF}
        | _team(
            instance,
            lambda: solve_in_processes(
                instance,
                PROCESSES,
                method=method,
                loss=LOSS,
                graph=_graph(graph, instance.robots),
                seed=seed,
                settings=settings,
            ),
        )
    )


def _instance(size: str, seed: int) -> Instance:
    return random_instance(*SIZES[size], seed, route_length_limit=LIMIT)


def _head(size: str, seed: int) -> dict[str, Any]:
    robots, tasks = SIZES[size]
    return {"size": size, "robots": robots, "tasks": tasks, "seed": seed}


def measured(instance: Instance, peer: Peer, options: dict[str, Any]) -> dict[str, Any]:
    """Return the row of a peer; if it has no result, the note says why."""
    if peer.extra and importlib.util.find_spec(peer.extra) is None:
        return _nothing(INSTALL)
    with tempfile.TemporaryDirectory(prefix="crazychoir-bench-") as folder:
        file = Path(folder) / "instance.json"
        file.write_text(json.dumps(instance.to_json()), encoding="utf-8")
        spec = json.dumps(options | {"instance": str(file)})
        command = [
            sys.executable,
            "-c",
            BARE,
            str(PACKAGE),
            f"crazychoir.bench.peers.{peer.module}",
            spec,
        ]
        try:
            with Group([command]) as group:
                ((_, answer),) = group.answers(1, PATIENCE, "do not answer")
        except TimeoutError as error:
            return _nothing(f"failed: {error}")
    return judged(instance, answer, peer.covers)


def judged(
    instance: Instance, answer: dict[str, Any], covers: bool = False
) -> dict[str, Any]:
    """Return the row of a peer's answer: its routes as they are flown, and their faults.

    instance: the instance
    answer: answer of the peer
    covers: whether a task served by several robots is only noted, not a fault
    """
    if answer["routes"] is None:
        return _nothing(answer["note"]) | {
            key: answer[key] for key in ("wall_s", "cpu_s")
        }
    routes = [
        _route(instance, route["robot"], route["nodes"])
        for route in answer["routes"]
        if route["nodes"]
    ]
    plan = Plan(tuple(routes))
    services = Counter(task for route in routes for task in route.tasks)
    repeated = sum(count > 1 for count in services.values())
    wrong = check(instance, plan)
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
        "curve": best_so_far(answer["curve"]),
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
        return _nothing(error_text(error))
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


def _nothing(note: str) -> dict[str, Any]:
    keys = ("cost", "wall_s", "cpu_s", "critical_path_s", "lower_bound")
    return dict.fromkeys(keys) | {
        "feasible": False,
        "bound_exact": False,
        "curve": [],
        "note": note,
    }


def rated(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return the rows of one instance, each with its gap_percent to the `reference`.

    The reference is the proven optimum, else the best exact bound. A plan that costs less than
    that bound disproves it: then there is no gap, and the reference is "broken bound".
    """
    bounds = [row["lower_bound"] for row in rows if row["bound_exact"]]
    best = min((row["cost"] for row in rows if row["feasible"]), default=None)
    if not bounds or best is None:
        return [row | {"gap_percent": None, "reference": None} for row in rows]
    bound = max(bounds)
    if best < bound * (1.0 - CLOSED):
        return [
            row | {"gap_percent": None, "reference": "broken bound"} for row in rows
        ]
    reference = "optimum" if best <= bound * (1.0 + CLOSED) else "bound"
    gaps = [relative(row["cost"], bound) if row["feasible"] else None for row in rows]
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
            if row["size"] == size and row["name"] == OURS and row["feasible"]
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
            if name != OURS
            else []
        )
        row["against_team"] = paired(*zip(*pairs, strict=True)) if pairs else None
        row["notes"] = list(dict.fromkeys(one["note"] for one in mine if one["note"]))
        found.append(row)
    return found


def _is_optimal(row: dict[str, Any]) -> bool:
    return (
        row["reference"] == "optimum"
        and row["gap_percent"] is not None
        and row["gap_percent"] <= 100.0 * CLOSED
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
        Text("\n".join([*dict.fromkeys([*broken, *notes]), LEGEND])),
    )


def _table_of(size: str, rows: list[dict[str, Any]]) -> Table:
    robots, tasks = SIZES[size]
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
            "-" if row["gap_percent"] is None else _short(row["gap_percent"]["most"])
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
    return "-" if figures is None else _short(figures["median"])


def _short(figure: float) -> str:
    """Return a figure with three digits and at most two decimals."""
    return (
        f"{figure:.2f}"
        if figure < 9.995
        else f"{figure:.1f}"
        if figure < 99.95
        else f"{figure:.0f}"
    )


def _graph(graph: str, robots: int) -> str:
    """Return the requested graph, or a complete one if the team is too small for it."""
    return "complete" if graph == "k-regular:4" and robots <= 4 else graph


def _neighbors(graph: str, robots: int, seed: int) -> dict[int, tuple[int, ...]]:
    links = named(_graph(graph, robots), robots, seed)
    return {i: links.neighbors(i) for i in links.ids}
