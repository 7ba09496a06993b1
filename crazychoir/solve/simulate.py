"""Run any distributed algorithm on simulated agents in this process.

The agents exchange messages over the communicator and a simulated network.
"""

import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, TypeVar

import numpy as np

from crazychoir.bus.impairment.model import Impairment
from crazychoir.config.network import network_rules
from crazychoir.config.tables import NetworkTable
from crazychoir.errors import AgentFailed, CrazyChoirError, RoundTimeout
from crazychoir.optimization.history import History
from crazychoir.optimization.rounds.checks import require_team
from crazychoir.runtime.clock import run_virtual
from crazychoir.solve.followed_agent import FollowedAgent
from crazychoir.solve.lockstep import MESSAGE_DELAY, LockstepTeam, goes_in_lockstep
from crazychoir.solve.networked_team import NetworkedTeam, Run
from crazychoir.team.algorithm_run import Interval, WakingTimes
from crazychoir.team.graph import Graph, GraphSequence
from crazychoir.team.round import Round

A = TypeVar("A", bound=Round)


class SimulationInterrupted(KeyboardInterrupt):
    """Ctrl-C has ended a simulation.

    history: the history until then; agents may have stopped in different rounds
    """

    def __init__(self, history: History) -> None:
        super().__init__()
        self.history = history


def simulate(
    agents: Mapping[int, A],
    graph: Graph | GraphSequence,
    *,
    loss: float = 0.0,
    network: Mapping[str, float] | None = None,
    seed: int = 0,
    rounds: int | None = None,
    record: Sequence[str] | None = None,
    sleep: Interval = (0.0, 0.02),
    compute: Interval = (0.0, 0.0),
    watch: Callable[[Mapping[int, A]], None] | None = None,
    run: Run = run_virtual,
    channel: str = "optimize",
) -> History:
    """Run the agents of a team together until all are done, or have made `rounds` rounds.

    Synchronous algorithms get the same messages, whatever is lost. Where nothing is lost they run
    without the messages of the network, see lockstep.py, with the same result. Asynchronous algorithms
    (`asynchronous = True`) wake after a random `sleep`, take the messages that have arrived, and
    compute for a random time `compute`.

    agents: {id: agent}, one for each node of the graph
    graph: communication graph, or a sequence of graphs
    loss: share of messages that are lost
    network: more effects of the network, with the names of EdgeEffects, such as {"delay": 0.01}, or
        {"burst": 4}: with `loss`, mean number of messages that are lost in a row
    seed: seed of the losses and of the random times
    rounds: largest number of rounds; None for no limit but MOST_ROUNDS
    record: attributes of each agent to keep after each step; None for x, if all agents have one
    sleep: (shortest, longest) s
    compute: (shortest, longest) s
    watch: called with the agents after each step; None for no call
    run: run_virtual, or run_wall for real time
    channel: name of the channel of the messages

    A NaN in a message, or in a recorded value after a step, is a failure of the agent. The error
    names the agent and the round. An infinity is accepted, because some algorithms use it (the
    maximum of nothing, the price of an impossible task). An infinity from an overflow becomes a NaN
    in the next difference.
    Raises ConfigError if the agents do not fit each other or the graph.
    Raises the error of an agent, or AgentFailed.
    Raises SimulationInterrupted, a KeyboardInterrupt with the history until then, on Ctrl-C.
    """
    began = time.perf_counter()
    require_team(agents, graph)
    names = list_recorded_names(agents, record)
    watch_all = None if watch is None else partial(watch, agents)
    followed = {
        i: FollowedAgent(i, agents[i], names, rounds, watch_all) for i in graph.ids
    }
    rules = network_rules(NetworkTable(loss=loss, delay=MESSAGE_DELAY), network)
    pace = WakingTimes(sleep, compute, seed)
    team: LockstepTeam | NetworkedTeam
    if (
        run is run_virtual
        and isinstance(graph, Graph)
        and goes_in_lockstep(agents, graph, rules)
    ):
        team = LockstepTeam(followed, graph, channel)
    else:
        lossy = Impairment(seed, rules)
        team = NetworkedTeam(followed, graph, channel, pace, lossy, run)
    interrupted = False
    try:
        simulated_s = team.run()
    except KeyboardInterrupt:
        if not team.has_begun:
            raise
        interrupted = True
        simulated_s = max(agent.whole() for agent in followed.values())
    if team.errors:
        raise _find_original_error(team.errors)
    counters = team.counters
    history = History(
        values={i: agent.values() for i, agent in followed.items()},
        times={i: np.array(agent.times) for i, agent in followed.items()},
        cpu={i: np.array(agent.cpu) for i, agent in followed.items()},
        traffic={i: np.array(agent.traffic) for i, agent in followed.items()},
        messages=sum(c.sent for c in counters),
        lost=sum(c.lost for c in counters),
        resent=sum(c.resent for c in counters),
        bytes=sum(c.bytes for c in counters),
        simulated_s=simulated_s,
        wall_s=time.perf_counter() - began,
        common=all(getattr(agent, "common", True) for agent in agents.values()),
        results={
            i: end
            for i in graph.ids
            if not callable(end := getattr(agents[i], "result", len))
        },
        violations={
            i: v
            for i in graph.ids
            if (v := _find_largest(getattr(agents[i], "violation", None))) is not None
        },
    )
    if interrupted:
        raise SimulationInterrupted(history)
    return history


def list_recorded_names(
    agents: Mapping[int, Any], record: Sequence[str] | None = None
) -> tuple[str, ...]:
    """Return the names of the attributes to record: `record`, or "x" if all agents have it."""
    if record is not None:
        return tuple(record)
    return ("x",) if all(hasattr(agent, "x") for agent in agents.values()) else ()


def _find_largest(violation: Any) -> float | None:
    """Return the largest entry of a violation, or None if it is not numbers."""
    if not isinstance(violation, float | int | np.ndarray | np.generic):
        return None
    entries = np.asarray(violation)
    return float(entries.max(initial=0.0)) if entries.dtype.kind in "fiu" else None


def _find_original_error(errors: Mapping[int, CrazyChoirError]) -> CrazyChoirError:
    """Return the error of the agent that failed by itself; of several, the lowest id."""
    errors = {
        i: error.simulated() if isinstance(error, RoundTimeout) else error
        for i, error in errors.items()
    }
    own = [errors[i] for i in sorted(errors) if not isinstance(errors[i], AgentFailed)]
    return own[0] if own else errors[min(errors)]
