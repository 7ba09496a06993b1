"""crazychoir solve: a pickup-and-delivery instance by its robots, without flying."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Group
from rich.table import Table

from crazychoir.cli.show import STDERR, Progress, fail, interrupted, require_drawable, set_up_logging, write_json
from crazychoir.errors import CrazyChoirError

if TYPE_CHECKING:
    from crazychoir.launch.team import Progress as TeamProgress
    from crazychoir.routing.instance import Instance
    from crazychoir.solving import Team


def solve(
    instance: Annotated[Path, typer.Argument(help="Instance file (JSON, or of Li and Lim).")],
    method: Annotated[
        str,
        typer.Option(help="Recovery of the plan: columns, resource-columns, resource, resource-argmax, cbba, auction."),
    ] = "columns",
    loss: Annotated[float, typer.Option(help="Share of messages between robots that is lost.")] = 0.0,
    graph: Annotated[
        str, typer.Option(help="Communication graph: ring, path, complete, star, k-regular:4, ...")
    ] = "ring",
    seed: Annotated[int, typer.Option(help="Seed of the simulated network.")] = 0,
    processes: Annotated[
        int | None, typer.Option(help="Real time, over Zenoh: the robots in so many processes; else virtual time.")
    ] = None,
    prove: Annotated[bool, typer.Option("--prove", help="Prove the plan optimal, or a bound for large teams, whatever it costs.")] = False,
    picture: Annotated[Path | None, typer.Option(help="Where to draw the routes (PNG).")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object, nothing else.")] = False,
) -> None:
    """Solve an instance: every robot with its own part of it.

    The file is one JSON object of N robots and M tasks, in metres: home (N points of 2 or 3 numbers), pickup and
    delivery (M points), load (M numbers), capacity (N numbers, in the unit of load); agents/data/lab6.json is one.
    If you like: route_length_limit (m), capability (N rows of M booleans), initial_load (N numbers), end (N points),
    open_tours (boolean), distance (N + 2M rows of m: homes, pickups, deliveries), recharge (trips), speed (m/s),
    service_time (s), time_windows and release (s), penalty (of refusing a task), priority, fixed_cost, objective
    (total, makespan, or both in order); the README says how each is written. Files of Li and Lim are read too.

    lower_bound: m; no plan costs less. bound_exact: that is proven. A plan that costs its lower_bound is optimal.
    bound_relaxation: the kind of routes that a bound which is not exact was priced by.
    """
    set_up_logging()
    from crazychoir.launch.team import solve_in_processes  # kernels and solvers: 1 s that --help does not need
    from crazychoir.routing.instance import Instance
    from crazychoir.routing.member import Settings
    from crazychoir.solving import solve_here

    try:
        require_drawable(picture)
        problem = Instance.load(instance)
        options: dict[str, Any] = {"method": method, "loss": loss, "graph": graph, "seed": seed,
                                   "settings": Settings(prove=prove)}  # fmt: skip
        if processes is None:
            with Progress(_team_table, enabled=not as_json) as shown:
                result = solve_here(problem, watch=shown, **options)
        else:
            with Progress(_progress_table, enabled=not as_json) as progress:
                result = solve_in_processes(problem, processes, watch=None if as_json else progress, **options)
        if picture is not None:
            _draw(problem, result, picture)
    except CrazyChoirError as error:
        fail(error, as_json)
    except KeyboardInterrupt:
        interrupted(as_json)
    if as_json:
        write_json(result)
    else:
        STDERR.print(_tables(result))
    raise typer.Exit(0 if result["feasible"] else 1)


def _draw(problem: "Instance", result: dict[str, Any], path: Path) -> None:
    from crazychoir.routing.picture import draw_routes
    from crazychoir.routing.plan import Plan, Route

    path.parent.mkdir(parents=True, exist_ok=True)
    draw_routes(problem, Plan(tuple(Route.from_json(route) for route in result["routes"])), path)


def _team_table(team: "Team") -> Table:
    progress = {i: agent.progress for i, agent in team.items()}
    return _progress_table({i: (p.phase, p.round, p.cost) for i, p in progress.items()})


def _progress_table(progress: "TeamProgress") -> Table:
    """One row a robot: phase, round, cost."""
    table = Table("robot", "phase", "round", "cost")
    for i, (phase, k, cost) in progress.items():
        table.add_row(str(i), phase, str(k), "" if cost is None else f"{cost:.3f}")
    return table


def _tables(result: dict[str, Any]) -> Group:
    figures = Table("figure", "value", title="plan" if result["feasible"] else "[red]not feasible[/]")
    for key in ("cost", "lower_bound", "bound_exact", "bound_relaxation", "method", "disclosed", "rounds", "messages",
                "bytes", "wall_s", "startup_s", "cpu_s", "critical_path_s", "plan_digest"):  # fmt: skip
        if key not in result or (key == "bound_relaxation" and result[key] is None):
            continue
        value = result[key]
        figures.add_row(key, f"{value:.6g}" if isinstance(value, float) else str(value))
    routes = Table("robot", "length m", "stops")
    for route in result["routes"]:
        stops = " ".join(f"{'+' if stop['kind'] == 'pickup' else '-'}{stop['task']}" for stop in route["stops"])
        routes.add_row(str(route["robot"]), f"{route['length']:.3f}", stops)
    return Group(figures, routes)
