"""crazychoir solve: a team of robots solves a pickup-and-delivery instance, without flight."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Group
from rich.table import Table
from rich.text import Text

from crazychoir.errors import CrazyChoirError
from crazychoir.launch import number_options as options
from crazychoir.launch.console import (
    ANSWER_CONSOLE,
    ERROR_CONSOLE,
    CommandOutputs,
    LiveTable,
    exit_interrupted,
    exit_with_error,
    require_drawable,
    set_up_logging,
    write_json,
)

if TYPE_CHECKING:
    from crazychoir.routing.instance.instance import Instance
    from crazychoir.solve.solving import Team
    from crazychoir.solve.team import Progress as TeamProgress

INTERRUPTION_TEXT = "Ctrl-C: the search ends here, with the best plan so far"
MOST_SECONDS = 1e6
"""s: longest search."""
SHOWN_ROBOTS = 20
"""Number of robots shown while they solve; the plan shows all."""


def solve(
    instance: Annotated[
        Path, typer.Argument(help="Instance file (JSON, or of Li and Lim).")
    ],
    method: Annotated[
        str,
        typer.Option(
            help="Recovery of the plan: columns, resource-columns, resource, resource-argmax, cbba, auction."
        ),
    ] = "columns",
    loss: Annotated[
        float, options.share("Share of messages between robots that is lost.")
    ] = 0.0,
    burst: Annotated[
        float | None,
        options.real(
            "Messages that are lost in a row, on average; else losses are independent.",
            least=1.0,
            most=1e9,
        ),
    ] = None,
    graph: Annotated[
        str,
        typer.Option(
            help="Communication graph: ring, path, complete, star, k-regular:4, ..."
        ),
    ] = "ring",
    seed: Annotated[int, options.seed("Seed of the simulated network.")] = 0,
    processes: Annotated[
        int | None,
        options.whole(
            "Run in so many processes, in real time over Zenoh; else in virtual time."
        ),
    ] = None,
    prove: Annotated[
        bool,
        typer.Option(
            "--prove",
            help="Prove the plan optimal, or a bound for large teams, whatever it costs.",
        ),
    ] = False,
    seconds: Annotated[
        float | None,
        options.real(
            "Seconds to search for better plans; else the method ends by itself.",
            least=0.0,
            most=MOST_SECONDS,
        ),
    ] = None,
    work: Annotated[
        int | None,
        options.whole(
            "Search steps in place of seconds: the same plan on every machine.",
            least=0,
        ),
    ] = None,
    picture: Annotated[
        Path | None, typer.Option(help="Where to draw the routes (PNG).")
    ] = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print one JSON object, nothing else.")
    ] = False,
) -> None:
    """Solve a routing instance; each robot solves its own part.

    The file is one JSON object of N robots and M tasks, in metres: home (N points
    of 2 or 3 numbers), pickup and delivery (M points), load (M numbers), capacity
    (N numbers, in the unit of load); agents/data/lab6.json is an example.
    Optional keys: route_length_limit (m), capability (N rows of M booleans),
    initial_load (N numbers), end (N points), open_tours (boolean), distance (N +
    2M rows of m: homes, pickups, deliveries), recharge (trips), speed (m/s),
    service_time (s), time_windows and release (s), penalty (for refusing a task),
    priority, fixed_cost, objective (total, makespan, or both in order, or
    vehicles and total); crazychoir/routing/README.md describes each. Files of Li
    and Lim can be read too: they minimise vehicles first, then the total.

    lower_bound: m; no plan costs less. If vehicles come first, this holds among
    plans with as few vehicles.
    gap: how much of the cost a better plan could save at most.
    bound_exact: whether this bound is proven. A plan that costs its lower_bound
    is optimal.
    bound_relaxation: the kind of routes that priced a bound that is not exact.
    curve, work_curve: the cost of each better plan after s, and after search
    steps. ended_by: seconds, work or interrupted, if the team had to stop.

    Ctrl-C ends the search: the best plan is printed, and the exit code is 130.
    """
    set_up_logging()
    from crazychoir.api.solving import choose_solve_options
    from crazychoir.cli.shared.option_names import naming_options
    from crazychoir.optimization.rounds.budget import BudgetSettings
    from crazychoir.routing.distributed.pickup_delivery import choose_routing_settings
    from crazychoir.routing.instance.instance import Instance
    from crazychoir.solve.interruption import Interruption
    from crazychoir.solve.solving import solve_here
    from crazychoir.solve.team import (
        solve_in_processes,
    )  # takes 1 s, which --help does not need

    outputs = CommandOutputs()
    interruption = Interruption()
    try:
        require_drawable(picture)
        problem = Instance.load(instance)
        with naming_options():
            how = choose_solve_options(problem, method, loss, graph, seed)
            settings = choose_routing_settings(
                method, BudgetSettings(seconds, work), prove
            )
        how = replace(how, burst=burst, settings=settings)
        if processes is None:
            with (
                LiveTable(_team_table, enabled=not as_json) as shown,
                interruption.caught(),
            ):
                result = solve_here(
                    problem, how, watch=shown, interruption=interruption
                )
        else:
            with (
                LiveTable(_progress_table, enabled=not as_json) as progress,
                interruption.caught(),
            ):
                result = solve_in_processes(
                    problem,
                    processes,
                    how,
                    watch=None if as_json else progress,
                    interruption=interruption,
                )
        if picture is not None:
            with outputs.writing("--picture"):
                _draw(problem, result, picture)
    except CrazyChoirError as error:
        exit_with_error(error, as_json)
    except KeyboardInterrupt:
        exit_interrupted(as_json)
    if as_json:
        write_json(result | outputs.told)
    else:
        ANSWER_CONSOLE.print(_tables(result))
    outputs.say()
    if result["ended_by"] == "interrupted":
        ERROR_CONSOLE.print(INTERRUPTION_TEXT)
        raise typer.Exit(130)
    raise typer.Exit(0 if result["feasible"] and not outputs.failed else 1)


def _draw(problem: "Instance", result: dict[str, Any], path: Path) -> None:
    from crazychoir.routing.instance.picture import draw_routes
    from crazychoir.routing.instance.plan import Route, RoutePlan

    draw_routes(
        problem,
        RoutePlan(tuple(Route.from_json(route) for route in result["routes"])),
        path,
    )


def _team_table(team: "Team") -> Table:
    progress = {i: agent.progress for i, agent in team.items()}
    return _progress_table(
        {i: (p.phase, p.round, p.cost, p.bound) for i, p in progress.items()}
    )


def _progress_table(progress: "TeamProgress") -> Table:
    """Return a table of the progress of the first robots, one row a robot."""
    from crazychoir.routing.instance.plan import compute_gap

    table = Table("robot", "phase", "round", "cost", "lower bound", "gap")
    for i, (phase, k, cost, bound) in list(progress.items())[:SHOWN_ROBOTS]:
        gap = compute_gap(cost, bound)
        table.add_row(
            str(i),
            phase,
            str(k),
            "" if cost is None else f"{cost:.3f}",
            "" if bound is None else f"{bound:.3f}",
            "" if gap is None else f"{100.0 * gap:.2f} %",
        )
    if len(progress) > SHOWN_ROBOTS:
        table.add_row("...", f"and {len(progress) - SHOWN_ROBOTS} more")
    return table


def _tables(result: dict[str, Any]) -> Group:
    """Return the figures of the result and a table with one row a trip."""
    figures = Table(
        "figure",
        "value",
        title="plan" if result["feasible"] else Text("not feasible", "red"),
    )
    for name, text in _figures(result).items():
        figures.add_row(name, Text(text))
    for wrong in result["violations"]:
        figures.add_row("wrong", Text(wrong, "red"))
    if not result["trips"]:
        return Group(figures, Text("No robot leaves home."))
    times = "; @: s, when service begins" if result["timed"] else ""
    return Group(
        figures,
        Text(f"+3: picks task 3 up, -3: delivers it{times}"),
        _trip_table(result),
    )


def _figures(result: dict[str, Any]) -> dict[str, str]:
    """Return the rows of the first table; rows without meaning for this instance are left out."""
    rows = {"cost": f"{result['cost']:.6g}{_unit(result)}"}
    if result["objective"][0] == "vehicles":
        bound = result["vehicles_bound"]
        rows = {
            "vehicles": str(result["vehicles"]),
            "vehicles_bound": "none" if bound is None else str(bound),
        } | rows
    if result["penalties"] or result["objective"] not in (
        ["total"],
        ["vehicles", "total"],
    ):
        rows["total_m"] = f"{result['total_m']:.6g} m"
    if result["timed"]:
        rows["makespan_s"] = f"{result['makespan_s']:.6g} s"
    if result["refused"]:
        rows["refused"] = ", ".join(
            f"task {one['task']} (penalty {one['penalty']:g})"
            for one in result["refused"]
        )
    rows["lower_bound"] = (
        "none"
        if result["lower_bound"] is None
        else f"{result['lower_bound']:.6g}{_unit(result)}"
    )
    if result["gap"] is not None:
        rows["gap"] = f"{100.0 * result['gap']:.2f} %"
    rows["bound_exact"] = str(result["bound_exact"])
    if result["bound_relaxation"] is not None:
        rows["bound_relaxation"] = result["bound_relaxation"]
    rows["method"] = result["method"]
    if result["ended_by"] is not None:
        rows["ended_by"] = result["ended_by"]
        rows["work"] = f"{result['work']} search steps"
    rows["disclosed"] = f"{len(result['disclosed'])} kinds of facts; --json lists them"
    rows |= {
        name: str(result[name])
        for name in ("rounds", "messages", "lost", "resent", "bytes")
    }
    times = ("startup_s", "wall_s", "cpu_s", "critical_path_s")
    rows |= {name: f"{result[name]:.3g} s" for name in times if name in result}
    return rows | {"plan_digest": result["plan_digest"][:16]}


def _unit(result: dict[str, Any]) -> str:
    """Return the unit of the cost; empty if penalties, which have no unit, are part of it."""
    if result["penalties"]:
        return ""
    return " s" if result["objective"][0] == "makespan" else " m"


def _trip_table(result: dict[str, Any]) -> Table:
    """Return a table with one row a trip.

    Trips are numbered if a robot makes several, and times are shown if they matter.
    """
    several = any(trip["trip"] > 1 for trip in result["trips"])
    timed = result["timed"]
    made = Table()
    made.add_column("robot", justify="right")
    if several:
        made.add_column("trip", justify="right")
    made.add_column("length m", justify="right")
    if timed:
        made.add_column("done at s", justify="right")
    made.add_column("stops")
    for trip in result["trips"]:
        row = [
            str(trip["robot"]),
            *([str(trip["trip"])] if several else []),
            f"{trip['length_m']:.3f}",
        ]
        times = [f"@{begin:.2f}" if timed else "" for begin in trip["begin_s"]]
        stops = " ".join(
            stop + time for stop, time in zip(trip["stops"], times, strict=True)
        )
        made.add_row(*row, *([f"{trip['end_s']:.2f}"] if timed else []), Text(stops))
    return made
