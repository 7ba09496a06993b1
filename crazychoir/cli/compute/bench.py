"""crazychoir bench: measure speed and accuracy, beside other programs in the same run."""

import json
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

import typer
from rich.console import RenderableType
from rich.text import Text

from crazychoir.bench.latency import latency
from crazychoir.errors import ConfigError, CrazyChoirError
from crazychoir.launch import number_options as options
from crazychoir.launch.console import (
    ANSWER_CONSOLE,
    ERROR_CONSOLE,
    exit_with_error,
    set_up_logging,
)

app = typer.Typer(
    no_args_is_help=True, help="Measure speed and accuracy, beside other programs."
)
app.command()(latency)

JsonOption = Annotated[
    bool, typer.Option("--json", help="Print one JSON object, nothing else.")
]
QuickOption = Annotated[
    bool,
    typer.Option(
        help="Fewer and shorter cases; the figures are not exact enough to quote."
    ),
]
Say = Callable[[str], None]
ExchangeGraph = Literal["ring", "4-regular"]
"""Names of the graphs of BENCH_GRAPHS."""


@app.command()
def exchange(
    as_json: JsonOption = False,
    quick: QuickOption = False,
    agents: Annotated[
        list[int] | None,
        options.whole(
            "Number of agents; several times for several rows. Without it: 10 and 30.",
            least=2,
            most=options.OPTION_LIMITS.drones,
        ),
    ] = None,
    processes: Annotated[
        list[int] | None,
        options.whole(
            "Number of processes of a host; several times for several rows. "
            "Without it: 1, 2, and one an agent.",
        ),
    ] = None,
    graph: Annotated[
        ExchangeGraph | None,
        typer.Option(help="Graph of the team. Without it: both."),
    ] = None,
    round_trips: Annotated[
        bool,
        typer.Option("--round-trips", help="Round trips alone, and no exchange."),
    ] = False,
) -> None:
    """Measure rounds a second of the exchange between neighbours, and round trips of 64 bytes.

    Plain sockets, Zenoh alone, ZeroMQ, CycloneDDS and MPI run beside it, with as many processes
    and the same payload. Also shows the processor's time of a message, and the share of messages
    that were sent again. A choice of agents, processes or a graph leaves out the round trips.
    """
    from crazychoir.bench import exchange as bench_exchange

    choice = None
    if agents or processes or graph:
        choice = bench_exchange.ExchangeChoice(
            tuple(agents or ()), tuple(processes or ()), (graph,) if graph else ()
        )

    def measure(say: Say) -> dict[str, Any]:
        if round_trips and choice:
            raise ConfigError(
                "bench exchange",
                "--round-trips with a choice of agents, processes or a graph",
                "one of the two: round trips are between two agents in two processes",
            )
        if round_trips:
            return bench_exchange.run_trips(quick=quick, say=say)
        return bench_exchange.run(quick=quick, say=say, choice=choice)

    _show(measure, bench_exchange.table, as_json)


@app.command()
def scale(
    as_json: JsonOption = False,
    quick: QuickOption = False,
    namespaces: Annotated[
        bool,
        typer.Option(
            help="Give each process a network namespace; needs root and iproute2."
        ),
    ] = False,
    repeats: Annotated[
        int, options.whole("Repetitions; each figure is their median.")
    ] = 3,
    agents: Annotated[
        list[int] | None,
        options.whole(
            "Number of agents; several times for several rows. Without it: 10 to 1000.",
            least=5,
        ),
    ] = None,
    processes: Annotated[
        list[int] | None,
        options.whole(
            "Number of processes; several times for several rows. Without it: 1 to 8."
        ),
    ] = None,
) -> None:
    """Measure the cost of 10 to 1000 agents in 1 to 8 processes.

    Each agent has four neighbours, and each process five agents or more. A model of the cost then
    says what 10 000 agents on 100 hosts need; a choice of agents or processes leaves it out.
    """
    from crazychoir.bench import scale as bench_scale

    choice = None
    if agents or processes:
        choice = bench_scale.ScaleChoice(tuple(agents or ()), tuple(processes or ()))
    _show(
        lambda say: bench_scale.run(quick, namespaces, repeats, say, choice),
        bench_scale.table,
        as_json,
    )


@app.command()
def flight(
    as_json: JsonOption = False,
    quick: QuickOption = False,
    drones: Annotated[
        list[int] | None,
        options.whole(
            "Number of drones of a lattice; several times for several rows. Without it: 30 to 1000.",
            least=5,
            most=options.OPTION_LIMITS.drones,
        ),
    ] = None,
    plant: Annotated[
        Literal["lightweight", "motors"] | None,
        typer.Option(
            help="Simulated engine of all rows: that of sim://, or of sim://motors."
        ),
    ] = None,
    window: Annotated[
        float | None,
        options.seconds(
            "Length of one measurement, s of virtual time. Without it: 1, or 0.5 for 1000 drones.",
            open_below=True,
        ),
    ] = None,
    collision: Annotated[
        Literal["barrier", "cells", "off"] | None,
        typer.Option(help="How the drones of all rows keep clear of each other."),
    ] = None,
) -> None:
    """Measure how much faster than real time one core flies 30 to 1000 drones.

    Also shows how often the collision filter acts, the memory, and where the time
    goes; without --drones the speed of the simulated worlds too. The first run
    compiles the laws; memory counts from the second run on.
    """
    from crazychoir.bench import flight as bench_flight

    choice = bench_flight.FlightChoice(tuple(drones or ()), plant, window, collision)
    _show(
        lambda say: bench_flight.run(quick, say, choice), bench_flight.tables, as_json
    )


@app.command()
def radio(
    as_json: JsonOption = False,
    quick: QuickOption = False,
    model: Annotated[
        bool, typer.Option("--model", help="The radio model only; this takes seconds.")
    ] = False,
) -> None:
    """Measure what a dongle carries on the radio model, and what many links cost a process.

    The rows of the model run in virtual time. The rest is the delay of an agent's
    event loop while dongle owners serve twenty links and open one more.
    """
    from crazychoir.bench import radio as bench_radio

    _show(lambda say: bench_radio.run(quick, say, model), bench_radio.tables, as_json)


@app.command()
def filters(as_json: JsonOption = False, quick: QuickOption = False) -> None:
    """Measure the velocity errors of the filters, beside the original's difference equation."""
    from crazychoir.bench import filters as bench_filters

    seeds = (
        bench_filters.FILTER_BENCH.seeds[:1]
        if quick
        else bench_filters.FILTER_BENCH.seeds
    )
    _show(
        lambda say: bench_filters.run(seeds=seeds, say=say),
        bench_filters.table,
        as_json,
    )


@app.command()
def tracking(as_json: JsonOption = False, quick: QuickOption = False) -> None:
    """Measure how exactly a drone flies a circle and an eight.

    First with the controllers alone, then with the whole stack and its errors.
    """
    from crazychoir.bench import tracking as bench_tracking

    _show(lambda say: bench_tracking.run(quick, say), bench_tracking.table, as_json)


@app.command()
def formation(
    as_json: JsonOption = False,
    quick: QuickOption = False,
    seeds: Annotated[int, options.whole("Number of random starts.")] = 50,
    drones: Annotated[int | None, options.size("4 or 30 alone.")] = None,
) -> None:
    """Measure how fast four and thirty drones with motors form up by bearings.

    The result is the worst of many starts.
    """
    from crazychoir.bench import formation as bench_formation

    cases = tuple(
        case
        for case in bench_formation.FORMATION_CASES
        if drones in (None, case.drones)
    )
    found = range(3 if quick else seeds)
    _show(
        lambda say: bench_formation.run(found, cases, say),
        bench_formation.table,
        as_json,
    )


@app.command()
def routing(
    as_json: JsonOption = False,
    quick: QuickOption = False,
    sizes: Annotated[
        str,
        typer.Option(
            help="Sizes with commas: tiny, small, middle, large; a number of instances after a colon."
        ),
    ] = "small:20,middle:5,large:5",
    graph: Annotated[
        str, typer.Option(help="Communication graph of the team.")
    ] = "k-regular:4",
    method: Annotated[
        str | None, typer.Option(help="Method of the team, instead of the default.")
    ] = None,
    prove: Annotated[
        bool,
        typer.Option(help="A further run of the team that tries to prove an optimum."),
    ] = False,
) -> None:
    """Compare plans of pickups and deliveries: the team beside other solvers.

    They are VROOM, OR-tools, MILP, auctions and DISROPT's rule.
    """
    from crazychoir.bench import routing as bench_routing

    measure = partial(
        bench_routing.run, sizes, graph=graph, method=method, prove=prove, quick=quick
    )
    _show(lambda say: measure(say=say), bench_routing.table, as_json)


@app.command()
def optimization(as_json: JsonOption = False, quick: QuickOption = False) -> None:
    """Measure rounds a second of consensus and dual decomposition.

    The peer is DISROPT's pattern of MPI ranks.
    """
    from crazychoir.bench import optimization as bench_optimization

    _show(
        lambda say: bench_optimization.run(quick=quick, say=say),
        bench_optimization.table,
        as_json,
    )


@app.command()
def algorithms(
    names: Annotated[
        str | None,
        typer.Option(
            "--algorithms",
            help="Algorithms with commas, as extra,admm,my.py:MyAlgorithm. Without it: nine of them.",
        ),
    ] = None,
    problem: Annotated[
        Literal["least-squares", "logistic"],
        typer.Option(help="Random problem that the team shares."),
    ] = "least-squares",
    agents: Annotated[
        list[int] | None,
        options.whole(
            "Number of agents; several times for several. Without it: 8 and 16.",
            least=2,
            most=options.OPTION_LIMITS.drones,
        ),
    ] = None,
    graph: Annotated[
        list[str] | None,
        typer.Option(
            help="Communication graph, as k-regular:4; several times for several. "
            "Without it: ring and complete."
        ),
    ] = None,
    loss: Annotated[
        list[float] | None,
        options.share(
            "Share of messages that is lost; several times for several. Without it: 0, 0.2 and 0.4."
        ),
    ] = None,
    rounds: Annotated[int, options.whole("Rounds of each run.")] = 150,
    seeds: Annotated[int, options.whole("Random problems for each case.")] = 5,
    accuracy: Annotated[
        float,
        options.real("Relative error to reach.", least=1e-12, most=0.5),
    ] = 1e-3,
    out: Annotated[Path, typer.Option(help="Where the tables and pictures go.")] = Path(
        "out/algorithms"
    ),
    as_json: JsonOption = False,
    quick: QuickOption = False,
) -> None:
    """Compare distributed algorithms on random problems, with tables and pictures for a paper.

    The pictures (PNG, PDF) show the error against rounds, messages and bytes, and what an
    accuracy costs over loss, graph and size. The first of several agents, graphs and losses is the
    base; the others vary alone.
    """
    from crazychoir.bench.convergence import convergence as bench_convergence
    from crazychoir.bench.convergence.study import StudyRequest

    def measure(say: Say) -> dict[str, Any]:
        standard = bench_convergence.ComparisonChoice()
        chosen = None
        if names is not None:
            chosen = tuple(name.strip() for name in names.split(",") if name.strip())
        choice = bench_convergence.ComparisonChoice(
            algorithms=chosen,
            agents=tuple(agents or standard.agents),
            graphs=tuple(graph or standard.graphs),
            losses=tuple(loss or standard.losses),
        )
        request = StudyRequest(problem, rounds, seeds, accuracy)
        return bench_convergence.run(out, request, choice, quick, say)

    _show(measure, bench_convergence.table, as_json)


@app.command()
def paper(
    out: Annotated[Path, typer.Option(help="Where the tables and pictures go.")] = Path(
        "out/paper"
    ),
    peers: Annotated[
        bool, typer.Option(help="Run the other solvers too; this takes an hour.")
    ] = True,
    as_json: JsonOption = False,
    quick: QuickOption = False,
) -> None:
    """Write tables (CSV) and pictures (PNG) for a paper.

    They show what loss, graph, size and method cost a team, and what other
    solvers find.
    """
    from crazychoir.bench.paper import paper as bench_paper

    _show(
        lambda say: bench_paper.run(out, quick, peers, say), bench_paper.table, as_json
    )


@app.command(name="all")
def everything(quick: QuickOption = False) -> None:
    """Run the short benches one after the other.

    They are exchange, flight, tracking, filters, optimization and latency.
    """
    exchange(quick=quick)
    flight(quick=quick)
    tracking(quick=quick)
    filters(quick=quick)
    optimization(quick=quick)
    latency()


def _show(
    measure: Callable[[Say], dict[str, Any]],
    table: Callable[[dict[str, Any]], RenderableType],
    as_json: bool,
) -> None:
    """Measure while a line shows the progress, then print the result.

    Without a terminal each step of the progress is printed as a line of its own.
    """
    set_up_logging()
    try:
        if ERROR_CONSOLE.is_terminal:
            with ERROR_CONSOLE.status("starting") as status:
                result = measure(lambda text: status.update(Text(text)))
        else:
            result = measure(
                lambda text: ERROR_CONSOLE.print(
                    text, markup=False, highlight=False, soft_wrap=True
                )
            )
    except CrazyChoirError as error:
        exit_with_error(error, as_json)
    if as_json:
        sys.stdout.write(json.dumps(result) + "\n")
    else:
        ANSWER_CONSOLE.print(table(result))
