"""crazychoir simulate: run a distributed algorithm over a network that loses messages."""

import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Group
from rich.table import Table
from rich.text import Text

from crazychoir.errors import ConfigError, CrazyChoirError, refuse_exit
from crazychoir.files.output_files import require_writable_file
from crazychoir.launch import number_options as options
from crazychoir.launch.console import (
    ANSWER_CONSOLE,
    ERROR_CONSOLE,
    CommandOutputs,
    LiveTable,
    exit_with_error,
    redirect_prints,
    require_drawable,
    set_up_logging,
    write_json,
)
from crazychoir.numerics.compiling import KERNEL_QUEUE

if TYPE_CHECKING:
    from crazychoir.optimization.history import History

    Seen = tuple[str, Mapping[int, Any]]


@dataclass(frozen=True, slots=True)
class SimulateTableLimits:
    """Limits of what the tables of `crazychoir simulate` show."""

    most_agents: int = 20
    """Largest number of agents that a table shows."""
    most_entries: int = 6
    """Number of entries of an array that a table shows."""
    longest_value: int = 60
    """Largest number of characters shown of a value that is not an array."""
    violation_tolerance: float = 1e-6
    """Constraint violations up to this are tolerances of a solver, and are not reported."""


SIMULATE_TABLE_LIMITS = SimulateTableLimits()


FIRST_PROGRESS_DELAY = 10.0
"""Seconds without output before the first progress line, where no live table is possible.

The interval doubles after each line.
"""
INTERRUPTION_TEXT = "Ctrl-C: the run ends here, with the rounds so far"


def simulate(
    file: Annotated[
        Path, typer.Argument(help="Python file that defines agent(i, graph).")
    ],
    agents: Annotated[
        int, options.whole("Number of agents.", most=options.OPTION_LIMITS.agents)
    ] = 10,
    graph: Annotated[
        str,
        typer.Option(
            help="Communication graph: ring, path, complete, star, k-regular:4, erdos-renyi:0.3, ..."
        ),
    ] = "ring",
    directed: Annotated[
        bool,
        typer.Option("--directed", help="One-way edges, for ring and erdos-renyi."),
    ] = False,
    loss: Annotated[
        float, options.share("Share of messages between agents that is lost.")
    ] = 0.0,
    rounds: Annotated[
        int | None,
        options.whole(
            "Stop after so many rounds, if the agents are not done before.", most=10**9
        ),
    ] = None,
    seed: Annotated[
        int, options.seed("Seed of the graph, the network and the agents' waking.")
    ] = 0,
    sleep: Annotated[
        float, options.seconds("Asynchronous agents: longest s between two steps.")
    ] = 0.02,
    compute: Annotated[
        float, options.seconds("Asynchronous agents: longest s that a step takes.")
    ] = 0.0,
    record: Annotated[
        str | None,
        typer.Option(
            help="Attributes of the agents to keep, as x,average; else x, if they have one."
        ),
    ] = None,
    save: Annotated[
        Path | None,
        typer.Option(help="Where to write the histories (.csv, .json, .npz)."),
    ] = None,
    picture: Annotated[
        Path | None, typer.Option(help="Where to draw the convergence (PNG).")
    ] = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print one JSON object, nothing else.")
    ] = False,
) -> None:
    """Run a distributed algorithm over a simulated network.

    The file defines agent(i, graph), which returns agent i: an object with
    `message()`, `step(heard)` and `done`, like the agents of
    crazychoir.optimization. Its attribute x, if there is one, is recorded, unless
    --record names others. Its `result` is shown at the end.
    """
    set_up_logging()
    with KERNEL_QUEUE.checks_first():
        from crazychoir.api.simulating import make_team
        from crazychoir.optimization.history import require_suffix
        from crazychoir.solve import (
            simulate as simulation,
        )  # takes 1 s, which --help does not need

    outputs = CommandOutputs()
    asked = (
        None
        if record is None
        else [name.strip() for name in record.split(",") if name.strip()]
    )
    try:
        require_drawable(picture)
        if save is not None:
            require_suffix(save, "--save")
            require_writable_file(save, "--save")
        with redirect_prints(), refuse_exit("the algorithm"):
            with KERNEL_QUEUE.checks_first():
                links = options.build_named_graph(graph, agents, seed, directed)
                team = make_team(file, links)
                names = simulation.list_recorded_names(team, asked)
                if picture is not None and not names:
                    raise ConfigError(
                        "--picture",
                        "nothing recorded",
                        "what --record names, to draw it",
                    )
            KERNEL_QUEUE.compile()
            ended = False
            try:
                with LiveTable(
                    _progress_table, enabled=ERROR_CONSOLE.is_terminal and not as_json
                ) as progress:
                    history = simulation.simulate(
                        team,
                        links,
                        loss=loss,
                        seed=seed,
                        rounds=rounds,
                        record=names,
                        watch=_ProgressDisplay(progress, rounds),
                        sleep=(0.0, sleep),
                        compute=(0.0, compute),
                    )
            except simulation.SimulationInterrupted as end:
                history = end.history
                ended = True
            if save is not None:
                with outputs.writing("--save"):
                    history.save(save)
            if picture is not None:
                with outputs.writing("--picture"):
                    awake = any(
                        getattr(agent, "asynchronous", False) for agent in team.values()
                    )
                    _draw(
                        history,
                        names,
                        awake,
                        picture,
                        f"{file.stem}: {agents} agents, {graph}, {loss:.0%} lost",
                    )
    except CrazyChoirError as error:
        exit_with_error(error, as_json)
    said = (
        {"success": False, "error": INTERRUPTION_TEXT, "kind": "KeyboardInterrupt"}
        if ended
        else {}
    )
    if as_json:
        write_json(history.to_json() | outputs.told | said)
    else:
        ANSWER_CONSOLE.print(_tables(history, file.stem))
    outputs.say()
    if ended:
        ERROR_CONSOLE.print(INTERRUPTION_TEXT)
        raise typer.Exit(130)
    if outputs.failed:
        raise typer.Exit(1)


class _ProgressDisplay:
    """Shows the progress of a simulation: a live table on a terminal, else a line now and then.

    The time between two lines doubles.
    """

    def __init__(self, progress: "LiveTable[Seen]", rounds: int | None) -> None:
        self.progress = progress
        self.steps = 0
        self.end = (
            "--rounds limits them, Ctrl-C ends the run"
            if rounds is None
            else f"of at most {rounds}"
        )
        self.began = time.perf_counter()
        self.due = FIRST_PROGRESS_DELAY

    def __call__(self, team: "Mapping[int, Any]") -> None:
        self.steps += 1
        if self.progress.live is not None:
            self.progress((self._now(team), team))
        elif time.perf_counter() - self.began > self.due:
            self.due *= 2
            self.progress.say(self._now(team))

    def _now(self, team: "Mapping[int, Any]") -> str:
        """Return the present round as text.

        Asynchronous agents make different numbers of steps: of these it is the mean.
        """
        return f"round {self.steps // len(team)}, {self.end}"


def _draw(
    history: "History", names: tuple[str, ...], awake: bool, path: Path, title: str
) -> None:
    from crazychoir.optimization.picture import draw_convergence

    recorded = history.by_name(names)
    draw_convergence(
        recorded, path, title, history.times if awake else None, history.common
    )


def _progress_table(seen: "Seen") -> Group:
    """Return the round and a table with one row an agent."""
    now, team = seen
    table = Table("agent", "x")
    for i, agent in list(team.items())[: SIMULATE_TABLE_LIMITS.most_agents]:
        table.add_row(str(i), Text(_shorten_value(getattr(agent, "x", ""))))
    return Group(Text(now), _add_hidden_count(table, len(team)))


def _add_hidden_count(table: Table, agents: int) -> Table:
    """Add the number of agents that the table leaves out."""
    if agents > SIMULATE_TABLE_LIMITS.most_agents:
        table.caption = f"and {agents - SIMULATE_TABLE_LIMITS.most_agents} more agents"
    return table


def _tables(history: "History", name: str) -> Group:
    from crazychoir.optimization.history import list_parts

    figures = Table("figure", "value", title=name)
    result = history.to_json()
    for key in (
        "rounds",
        "disagreement",
        "violation",
        "messages",
        "lost",
        "resent",
        "bytes",
        "simulated_s",
        "wall_s",
    ):
        value = result[key]
        if isinstance(value, dict):
            value = ", ".join(
                f"{name}: {v:.3g}" for name, v in value.items() if v is not None
            )
        if key == "violation":
            value = _violation_text(history)
        if value not in ("", None):
            figures.add_row(
                key, f"{value:.4g}" if isinstance(value, float) else str(value)
            )
    last = {
        i: {name: series[-1] for name, series in values.items()}
        for i, values in history.values.items()
    }
    results = {
        i: {name or "result": v for name, v in list_parts(part).items()}
        for i, part in history.results.items()
    }
    tables = [
        _agents_table(rows, title)
        for title, rows in (("at the end", last), ("result", results))
    ]
    return Group(figures, *(table for table in tables if table is not None))


def _agents_table(rows: "Mapping[int, Mapping[str, Any]]", title: str) -> Table | None:
    """Return a table with one row an agent and one column a name; None if there are no names."""
    names = dict.fromkeys(name for row in rows.values() for name in row)
    table = Table("agent", *names, title=title)
    for i, row in list(rows.items())[: SIMULATE_TABLE_LIMITS.most_agents]:
        table.add_row(
            str(i),
            *(Text(_shorten_value(row[name]) if name in row else "") for name in names),
        )
    return _add_hidden_count(table, len(rows)) if names else None


def _violation_text(history: "History") -> str | Text:
    """Return the largest constraint violation, and which agents it concerns if it is not small.

    The x of these agents is not feasible, so it is no solution. Returns "" if none is known.
    """
    if history.violation is None:
        return ""
    over = [
        i
        for i, violation in history.violations.items()
        if not violation <= SIMULATE_TABLE_LIMITS.violation_tolerance
    ]
    if not over:
        return f"{history.violation:.3g}"
    violators = (
        f"agent {over[0]}" if len(over) == 1 else f"{len(over)} agents, as {over[0]}"
    )
    return Text(
        f"{history.violation:.3g}, of {violators}: their x is not feasible", "red"
    )


def _shorten_value(x: Any) -> str:
    import numpy as np

    if not isinstance(x, float | int | list | tuple | np.ndarray | np.generic):
        return (
            str(x)
            if len(str(x)) <= SIMULATE_TABLE_LIMITS.longest_value
            else f"{str(x)[: SIMULATE_TABLE_LIMITS.longest_value - 3]}..."
        )
    entries = list(x) if isinstance(x, list | tuple) else np.ravel(x).tolist()
    text = ", ".join(
        f"{entry:.6g}" if isinstance(entry, float) else str(entry)
        for entry in entries[: SIMULATE_TABLE_LIMITS.most_entries]
    )
    return text + (", ..." if len(entries) > SIMULATE_TABLE_LIMITS.most_entries else "")
