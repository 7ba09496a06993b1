"""Inspect a running swarm and change its simulated network: topics, echo, hz, status, impair."""

import signal
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich import box
from rich.console import Group
from rich.table import Table

from crazychoir.cli.shared.drone_choice import DroneChoice, parse_one_drone
from crazychoir.config.number_lists import parse_spans
from crazychoir.errors import ConfigError, CrazyChoirError
from crazychoir.launch import number_options as options
from crazychoir.launch.console import (
    ANSWER_CONSOLE,
    ERROR_CONSOLE,
    build_status_table,
    exit_with_error,
    set_up_logging,
    write_json,
)

if TYPE_CHECKING:
    from crazychoir.bus.topics import Topic
    from crazychoir.config.swarm_config import SwarmConfig
    from crazychoir.launch.flight_observer import FlightScore
    from crazychoir.launch.observer import Answers, Window, Work
    from crazychoir.launch.run_registry import RunRecord

SwarmOption = Annotated[
    str | None,
    typer.Option(
        help="Swarm file, or its run here; else ./swarm.toml, else your only run, else the demo."
    ),
]
JsonOption = Annotated[
    bool, typer.Option("--json", help="Print JSON on standard output, nothing else.")
]
STATUS_TIMEOUT = 1.0
"""Seconds to wait for the status of every drone, which comes four times a second."""
SecondsOption = Annotated[
    float, options.seconds("How long to look, in s.", open_below=True)
]


def run_as_operator(swarm: str | None, work: "Work", as_json: bool = False) -> Any:
    """Join the swarm as `run_as_observer`, and print first which swarm the command speaks to."""
    return run_as_observer(swarm, work, as_json, _print_swarm)


def _print_swarm(config: "SwarmConfig") -> None:
    ERROR_CONSOLE.print(_describe_swarm(config), markup=False)


def _ask_for_run(found: "list[RunRecord]") -> "RunRecord":
    """Return the run that the operator chooses at the terminal."""
    ERROR_CONSOLE.print("Several of your runs could be meant:")
    for k, run in enumerate(found, start=1):
        ERROR_CONSOLE.print(f"{k}: swarm {run.swarm}, {run.what}", markup=False)
    number = 0
    while not 1 <= number <= len(found):
        number = typer.prompt(f"Which one, 1 to {len(found)}", type=int, err=True)
    return found[number - 1]


def run_as_observer(
    swarm: str | None,
    work: "Work",
    as_json: bool = False,
    begin: "Callable[[SwarmConfig], None]" = lambda config: None,
) -> Any:
    """Join the swarm as an observer, do the work and leave.

    At a terminal it asks which swarm is meant, if several of the user fly.

    begin: called with the swarm before it is joined
    Ends the command with an error if there is no swarm.
    """
    set_up_logging()
    from crazychoir.launch import (
        observer as window,
    )  # takes 1 s, which --help does not need
    from crazychoir.launch.running_swarm import refuse_choice

    is_asking = sys.stdin.isatty() and ERROR_CONSOLE.is_terminal and not as_json
    try:
        return window.observe_swarm(
            swarm, work, _ask_for_run if is_asking else refuse_choice, begin
        )
    except CrazyChoirError as error:
        exit_with_error(error, as_json)


def topics(as_json: JsonOption = False) -> None:
    """List the topics."""
    from crazychoir.bus.topics import ALL_TOPICS

    rows = [
        {
            "topic": topic.name,
            "type": topic.allowed,
            "rate_hz": topic.rate,
            "max_age_s": topic.max_age,
            "class": topic.klass.name.lower(),
            "latched": topic.latched,
            "impaired": topic.impaired,
            "public_hz": topic.public,
        }
        for topic in ALL_TOPICS
    ]
    if as_json:
        write_json(rows)
        return
    table = Table(*rows[0], box=box.SIMPLE_HEAD, padding=0)
    for row in rows:
        table.add_row(*(str(value) for value in row.values()))
    ANSWER_CONSOLE.print(table)


def parse_drone(text: str | None) -> DroneChoice | None:
    """Return the drone of --drone; end the command if the text has another form."""
    try:
        return parse_one_drone(text, "--drone")
    except ConfigError as error:
        exit_with_error(error, False)


def echo(
    topic: Annotated[str, typer.Argument(help="Topic, see `crazychoir topics`.")],
    drone: Annotated[
        str | None, typer.Option(help="Only this drone, by its id or name.")
    ] = None,
    swarm: SwarmOption = None,
    seconds: SecondsOption = 3600.0,
    rate: Annotated[
        float,
        options.real(
            "At most so many values a second and drone.",
            least=0.0,
            most=1000.0,
            open_below=True,
        ),
    ] = 10.0,
) -> None:
    """Print the values of a topic, one JSON object a line."""
    chosen = _topic(topic)
    choice = parse_drone(drone)
    # End quietly, as other programs do, when the reader of a pipe has ended.
    signal.signal(signal.SIGPIPE, signal.SIG_DFL)

    async def work(window: "Window") -> None:
        there = await window.find()
        for i in there if choice is None else choice.find(window.config):
            window.read(chosen, i, partial(_print_value, i), rate)
        await window.clock.sleep(seconds)

    run_as_observer(swarm, work)


def hz(
    topic: Annotated[str, typer.Argument(help="Topic, see `crazychoir topics`.")],
    swarm: SwarmOption = None,
    seconds: SecondsOption = 5.0,
    as_json: JsonOption = False,
) -> None:
    """Measure how often a topic arrives, for each drone."""
    chosen = _topic(topic)

    async def work(window: "Window") -> dict[int, float]:
        boxes = {
            i: window.read(chosen, i, lambda value, age: None)
            for i in await window.find()
        }
        await window.clock.sleep(0.5)
        before = {i: box.received for i, box in boxes.items()}
        await window.clock.sleep(seconds)
        return {i: (box.received - before[i]) / seconds for i, box in boxes.items()}

    _print_pairs(run_as_observer(swarm, work, as_json), ("drone", "Hz"), as_json)


def status(
    swarm: SwarmOption = None,
    watch: Annotated[bool, typer.Option(help="Refresh until Ctrl-C.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Show the state of each drone."""
    names: dict[int, str] = {}

    async def work(window: "Window") -> "tuple[FlightScore, str]":
        # The agents may be starting just now on other hosts.
        if watch and window.patience:
            window.patience = max(window.patience, window.config.start_deadline)
        there = await window.find()
        score = window.score()
        ends = window.clock.now() + STATUS_TIMEOUT
        names.update({drone.id: drone.name for drone in window.config.drones})
        while any(i not in score.statuses for i in there) and window.clock.now() < ends:
            await window.clock.sleep(0.02)
        if watch:
            from rich.live import Live

            with Live(console=ANSWER_CONSOLE, refresh_per_second=4) as live:
                async for _ in window.clock.ticks(4.0):
                    title = _describe_swarm(window.config)
                    live.update(Group(title, build_status_table(score, names)))
        return score, _describe_swarm(window.config)

    score, title = run_as_observer(swarm, work, as_json)
    if as_json:
        write_json(dict(sorted(score.statuses.items())))
    else:
        ANSWER_CONSOLE.print(Group(title, build_status_table(score, names)))


def _describe_swarm(config: "SwarmConfig") -> str:
    """Return the name and the mission of a swarm, since several may fly on one host."""
    mission = f", mission {Path(config.mission).stem}" if config.mission else ""
    return f"swarm {config.name}{mission}"


def impair(
    swarm: SwarmOption = None,
    loss: Annotated[
        float | None, options.share("Probability that a message is lost.")
    ] = None,
    burst: Annotated[
        float | None,
        options.real(
            "Messages that a burst loses in a row, on average.", least=1.0, most=1e9
        ),
    ] = None,
    delay: Annotated[float | None, options.seconds("Delay in s.")] = None,
    jitter: Annotated[float | None, options.seconds("Jitter in s.")] = None,
    duplicate: Annotated[
        float | None, options.share("Probability of a second delivery.")
    ] = None,
    reorder: Annotated[
        float | None, options.share("Probability of being late.")
    ] = None,
    bandwidth: Annotated[
        float | None, options.real("Bytes a second.", least=0.0, open_below=True)
    ] = None,
    edge: Annotated[
        str | None, typer.Option(help="Only between these two drones, as 1,2.")
    ] = None,
    drone: Annotated[
        str | None, typer.Option(help="Only at this drone, by its id or name.")
    ] = None,
    clear: Annotated[bool, typer.Option(help="Remove all changes first.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Change the simulated network of a running swarm.

    The change acts at once on messages between drones. Values without an option
    stay as they are; --loss 0 removes loss. Set partitions in the swarm file,
    under `network`.
    """
    effects: dict[str, Any] = {
        "loss": loss,
        "burst": burst,
        "delay": delay,
        "jitter": jitter,
        "duplicate": duplicate,
        "reorder": reorder,
        "bandwidth": bandwidth,
    }
    pair = _edge(edge)
    if burst is not None and not (loss is not None and 0.0 < loss < 1.0):
        found = f"{burst:g} with {'no --loss' if loss is None else f'--loss {loss:g}'}"
        exit_with_error(
            ConfigError("--burst", found, "1 or more, with a --loss between 0 and 1"),
            as_json,
        )
    choice = parse_drone(drone)

    async def work(window: "Window") -> "Answers":
        from crazychoir.config.network import impairment_changes
        from crazychoir.config.tables import LinkTable

        await window.find()
        window.check("--edge", pair or ())
        one = None if choice is None else choice.find(window.config)[0]
        scope = {"edge": pair, "drone": one, "clear": clear or None}
        given = {key: value for key, value in scope.items() if value is not None}
        arguments: dict[str, Any] = {
            **given,
            **impairment_changes(LinkTable(**effects)),
        }
        return await window.request("impair", None, **arguments)

    answers = run_as_operator(swarm, work, as_json)
    shown = (
        answers
        if as_json
        else {i: (done, _in_words(said)) for i, (done, said) in answers.items()}
    )
    _conclude(shown, ("drone", "simulated network"), as_json)


def _conclude(answers: "Answers", heads: tuple[str, str], as_json: bool) -> None:
    """Print the answer of each drone; exit with code 1 unless all have obeyed."""
    _print_pairs({i: said for i, (_, said) in answers.items()}, heads, as_json)
    raise typer.Exit(0 if all(done for done, _ in answers.values()) else 1)


def _in_words(network: Any) -> str:
    """Return the simulated network of a drone as text, one line a rule."""
    from crazychoir.config.network import rules_in_words

    # A drone that has refused gives its reason instead.
    return (
        "\n".join(rules_in_words(network))
        if isinstance(network, dict)
        else str(network)
    )


def _edge(text: str | None) -> list[int] | None:
    if text is None:
        return None
    allowed = "two drones, for example 1,2"
    try:
        pair = parse_spans(text, "--edge", allowed, ranges=False)
        if len(pair) != 2:
            raise ConfigError("--edge", text, allowed)
    except ConfigError as error:
        exit_with_error(error, as_json=False)
    return pair


def _topic(name: str) -> "Topic":
    from crazychoir.bus.topics import OBSERVABLE_TOPICS, TOPIC_BY_NAME

    if name not in OBSERVABLE_TOPICS:
        exit_with_error(
            ConfigError("topic", name, ", ".join(OBSERVABLE_TOPICS)), as_json=False
        )
    return TOPIC_BY_NAME[name]


def _print_value(i: int, value: Any, age: float) -> None:
    from crazychoir.bus.network.public_topics import fields_by_name

    fields = (
        fields_by_name(value)
        if hasattr(value, "__struct_fields__")
        else {"value": value}
    )
    write_json({"drone": i, **fields, "age": max(0.0, round(age, 4))})


def _print_pairs(pairs: dict[int, Any], heads: tuple[str, str], as_json: bool) -> None:
    if as_json:
        write_json(pairs)
        return
    table = Table(*heads)
    for i, value in pairs.items():
        table.add_row(
            str(i), f"{value:.1f}" if isinstance(value, float) else str(value)
        )
    ANSWER_CONSOLE.print(table)
