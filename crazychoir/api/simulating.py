"""Simulate a distributed algorithm over a network that loses messages, without flight."""

import inspect
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

from crazychoir.errors import ConfigError
from crazychoir.guidance.user_hook import Hook
from crazychoir.numerics.compiling import KERNEL_QUEUE
from crazychoir.optimization.history import History
from crazychoir.runtime.user_module import import_from_file
from crazychoir.solve import simulate as simulation
from crazychoir.team.graph import Graph, graph_from_name
from crazychoir.team.round import Round

if TYPE_CHECKING:
    from matplotlib.figure import Figure

DEFAULT_AGENT_COUNT = 10
"""Number of agents where neither the graph nor the caller says one."""


class Simulation(History):
    """The history of a simulated algorithm, which a notebook shows and draws."""

    def plot(self, *names: str) -> "Figure":
        """Return a figure of matplotlib: the values of each agent, and their distances from the mean.

        A value that is one number and never negative, such as an error, is drawn on a logarithmic axis.
        names: recorded attributes; without any, all of them
        Raises ConfigError if one was not recorded, or is no array of numbers.
        """
        from crazychoir.api.pictures import make_figure
        from crazychoir.optimization.picture import (
            CONVERGENCE_WIDTH,
            PANEL_HEIGHT,
            fill_convergence,
        )

        recorded = list(next(iter(self.values.values())))
        chosen = names or tuple(recorded)
        for name in chosen or ("x",):
            if name not in recorded:
                allowed = f"what was recorded: {', '.join(recorded)}"
                raise ConfigError("plot", name, allowed)
        figure = make_figure(CONVERGENCE_WIDTH, PANEL_HEIGHT)
        fill_convergence(figure, self.by_name(chosen), common=self.common)
        return figure


def simulate(
    algorithm: object,
    graph: str | Graph = "ring",
    agents: int = DEFAULT_AGENT_COUNT,
    *,
    loss: float = 0.0,
    rounds: int | None = None,
    seed: int = 0,
    record: Sequence[str] | None = None,
    network: Mapping[str, float] | None = None,
) -> Simulation:
    """Run a distributed algorithm over a simulated network, in virtual time.

    algorithm: file (.py) that defines agent(i, graph), this function itself, an object that has it, or
        {id: agent}
    graph: communication graph, or its name, as "ring"
    agents: number of agents, for a graph that is given by its name
    loss: share of the messages that is lost
    rounds: largest number of rounds; None: until all agents are done
    seed: seed of the graph, the losses and the random times
    record: attributes of the agents to keep; None for x, if they have one
    network: more effects of the network, as {"delay": 0.01}
    Raises ConfigError, or the error of an agent.
    """
    links = graph_from_name(graph, agents, seed) if isinstance(graph, str) else graph
    team = make_team(algorithm, links)
    KERNEL_QUEUE.compile()
    history = simulation.simulate(
        team,
        links,
        loss=loss,
        network=network,
        seed=seed,
        rounds=rounds,
        record=record,
    )
    return Simulation(**{f.name: getattr(history, f.name) for f in fields(history)})


def make_team(algorithm: object, links: Graph) -> Mapping[int, Round]:
    """Return the agents of an algorithm for a graph.

    algorithm: see `simulate`
    Raises ConfigError if there is no function agent(i, graph), or if it returns no agent.
    """
    if isinstance(algorithm, Mapping):
        return algorithm
    hook = _find_agent_hook(algorithm)
    hook.check()
    return {i: hook.make_agent(i, links) for i in links.ids}


def _find_agent_hook(algorithm: object) -> Hook:
    """Return the function that makes the agents of an algorithm."""
    source = algorithm
    if isinstance(algorithm, str | Path):
        source = import_from_file(Path(algorithm), "algorithm")
    make = source if inspect.isroutine(source) else getattr(source, "agent", None)
    if make is None:
        where = f"algorithm {algorithm}"
        if isinstance(algorithm, str | Path):
            allowed = "a file that defines agent(i, graph)"
        else:
            allowed = "a function agent(i, graph), or an object or a file that has one"
        raise ConfigError(where, "no function agent(i, graph)", allowed)
    file = str(getattr(source, "__file__", "") or _find_file(make))
    arguments = ("i", "graph")
    returns = "an agent: message(), step(heard), done"
    return Hook(file, "agent", make, arguments, returns, "algorithm")


def _find_file(make: Callable[..., Any]) -> str:
    """Return the file or the cell that defines a function."""
    code = getattr(inspect.unwrap(make), "__code__", None)
    return "" if code is None else str(code.co_filename)
