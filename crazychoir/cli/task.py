"""crazychoir task: give a swarm that delivers goods in flight another task, or cancel one."""

from typing import TYPE_CHECKING, Annotated, Any

import typer

from crazychoir.cli.look import JsonOption, SwarmOption, looking
from crazychoir.cli.show import STDERR, fail, write_json
from crazychoir.errors import ConfigError

if TYPE_CHECKING:
    from crazychoir.cli.window import Answers, Window

app = typer.Typer(no_args_is_help=True, help="Add or cancel tasks of a swarm that delivers goods, in flight.")
DroneOption = Annotated[int | None, typer.Option(help="Tell this drone; else the first that answers. All hear of it.")]


@app.command()
def add(
    pickup: Annotated[str, typer.Option(help="Where the goods are, as 1.5,2 (m).")],
    delivery: Annotated[str, typer.Option(help="Where they are to be, as 3,0.5 (m).")],
    load: Annotated[float, typer.Option(help="In the unit of the capacities.")] = 1.0,
    robots: Annotated[str | None, typer.Option(help="Who alone may serve it, as 0,3; else all.")] = None,
    drone: DroneOption = None,
    swarm: SwarmOption = None,
    as_json: JsonOption = False,
) -> None:
    """Another task; prints its id, as `cancel` wants it."""
    arguments = {
        "pickup": _numbers("--pickup", pickup, float, 2),
        "delivery": _numbers("--delivery", delivery, float, 2),
        "load": load,
        "robots": [] if robots is None else _numbers("--robots", robots, int),
    }
    _ask(swarm, drone, "task_add", as_json, arguments)


@app.command()
def cancel(
    task: Annotated[int, typer.Argument(help="Its id.")],
    drone: DroneOption = None,
    swarm: SwarmOption = None,
    as_json: JsonOption = False,
) -> None:
    """Cancel a task; goods that are aboard by then are delivered all the same."""
    _ask(swarm, drone, "task_cancel", as_json, {"id": task})


def _ask(swarm: str | None, drone: int | None, verb: str, as_json: bool, arguments: dict[str, Any]) -> None:
    """Ask one drone, or one after the other until one has done it; exit code 1 if none has."""

    async def work(window: "Window") -> "Answers":
        window.check("--drone", () if drone is None else (drone,))
        answers: Answers = {}
        for i in [drone] if drone is not None else await window.find():
            answers |= await window.request(verb, (i,), **arguments)
            if answers[i][0]:
                break
        return answers

    answers: Answers = looking(swarm, work, as_json)
    done = [said for good, said in answers.values() if good]
    if as_json:
        write_json(done[0] if done else {str(i): said for i, (_, said) in answers.items()})
    else:
        for i, (good, said) in answers.items():
            STDERR.print(f"drone {i}: " + (f"task {said['id']}" if good else str(said)), markup=False)
    raise typer.Exit(0 if done else 1)


def _numbers(option: str, text: str, kind: type, count: int | None = None) -> list[Any]:
    try:
        found = [kind(part) for part in text.strip("[]()").split(",")]
    except ValueError:
        found = []
    if not found or count not in (None, len(found)):
        what = f"{count} numbers, as 1.5,2" if count else "whole numbers, as 0,3"
        fail(ConfigError(option, text, what), as_json=False)
    return found
