"""crazychoir solve: a pickup-and-delivery instance by its robots, without flying."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Group
from rich.table import Table

from crazychoir.cli.show import STDERR, Progress, fail, set_up_logging, write_json
from crazychoir.errors import CrazyChoirError

if TYPE_CHECKING:
    from crazychoir.routing.instance import Instance
    from crazychoir.solving import Team


def solve(
    instance: Annotated[Path, typer.Argument(help="Instance file (JSON).")],
    method: Annotated[
        str, typer.Option(help="Recovery of the plan: resource-columns, resource, resource-argmax.")
    ] = "resource-columns",
    loss: Annotated[float, typer.Option(help="Share of messages between robots that is lost.")] = 0.0,
    graph: Annotated[
        str, typer.Option(help="Communication graph: ring, path, complete, star, k-regular:4, ...")
    ] = "ring",
    seed: Annotated[int, typer.Option(help="Seed of the simulated network.")] = 0,
    picture: Annotated[Path | None, typer.Option(help="Where to draw the routes (PNG).")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object, nothing else.")] = False,
) -> None:
    """Solve an instance: every robot with its own part of it.

    The file is one JSON object of N robots and M tasks, in metres: home (N points of 2 or 3 numbers), pickup and
    delivery (M points), load (M numbers), capacity (N numbers, in the unit of load); if you like route_length_limit
    (a number) and capability (N rows of M booleans). agents/data/lab6.json is one.

    lower_bound: m; no plan costs less. bound_exact: that is proven. A plan that costs its lower_bound is optimal.
    """
    set_up_logging()
    from crazychoir.routing.instance import Instance  # kernels and solvers: 1 s that --help does not need
    from crazychoir.solving import solve_here

    try:
        problem = Instance.load(instance)
        with Progress(_progress_table, enabled=not as_json) as progress:
            result = solve_here(problem, method=method, loss=loss, graph=graph, seed=seed, watch=progress)
        if picture is not None:
            _draw(problem, result, picture)
    except CrazyChoirError as error:
        fail(error, as_json)
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


def _progress_table(team: "Team") -> Table:
    """One row a robot: phase, round, cost."""
    table = Table("robot", "phase", "round", "cost")
    for i, agent in team.items():
        cost = "" if agent.progress.cost is None else f"{agent.progress.cost:.3f}"
        table.add_row(str(i), agent.progress.phase, str(agent.progress.round), cost)
    return table


def _tables(result: dict[str, Any]) -> Group:
    figures = Table("figure", "value", title="plan" if result["feasible"] else "[red]not feasible[/]")
    for key in ("cost", "lower_bound", "bound_exact", "method", "disclosed", "rounds", "messages", "bytes", "wall_s",
                "critical_path_s", "plan_digest"):  # fmt: skip
        value = result[key]
        figures.add_row(key, f"{value:.6g}" if isinstance(value, float) else str(value))
    routes = Table("robot", "length m", "stops")
    for route in result["routes"]:
        stops = " ".join(f"{'+' if stop['kind'] == 'pickup' else '-'}{stop['task']}" for stop in route["stops"])
        routes.add_row(str(route["robot"]), f"{route['length']:.3f}", stops)
    return Group(figures, routes)
