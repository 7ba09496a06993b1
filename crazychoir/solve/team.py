"""Solve an instance with robots in several processes, over Zenoh, in real time.

All processes run on this machine.
"""

import json
import secrets
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict
from typing import Any

import numpy as np

from crazychoir.config.addresses import LOCAL_ADDRESS
from crazychoir.config.network import network_rules, require_loss_of_burst
from crazychoir.config.tables import NetworkTable
from crazychoir.errors import ConfigError, ProcessFailed
from crazychoir.files.private_folder import scratch_folder
from crazychoir.launch.network import reserve_ports
from crazychoir.numerics.kernel_cache import (
    announce_compiling,
    print_first_warning,
    share_with_children,
)
from crazychoir.routing.distributed.pickup_delivery import PLANNING_METHODS
from crazychoir.routing.distributed.plain_loop import join_solutions
from crazychoir.routing.instance.instance import Instance
from crazychoir.routing.instance.plan import Solution
from crazychoir.routing.instance.schedule import summarise_plan
from crazychoir.solve.group import ProgramEnded, ProgramGroup
from crazychoir.solve.interruption import Interruption
from crazychoir.solve.solve_options import DEFAULT_SOLVE_OPTIONS, SolveOptions
from crazychoir.team.graph import Graph, describe_ids, graph_from_name

START_PATIENCE = 300.0
"""s until all processes have found each other, after the last of them has loaded its kernels.

Kernels are compiled at the first use. A process that compiles reports that it still does.
"""
ROUND_DEADLINE = 600.0
"""s of a round, in which the slowest robot makes its longest step."""
PROOF_ROUND_DEADLINE = 3600.0
"""s of a round of a proof, which takes its time."""
SHOWN_REPORT_PERIOD = 0.25
"""s between two reports of a process if its progress is shown."""
REPORT_PERIOD = 10.0
"""s between two reports of a process if its progress is not shown."""
REPORT_PATIENCE = 300.0
"""s without a report of a process until the team is given up; it reports in long steps too."""

Progress = dict[int, tuple[str, int, float | None, float | None]]
"""{robot: (phase, round, cost of the best plan in m, lower bound in m)}; None if unknown."""
Answer = tuple[int, dict[str, Any]]
"""(number of a process, its answer)."""


def solve_in_processes(
    instance: Instance,
    processes: int,
    options: SolveOptions = DEFAULT_SOLVE_OPTIONS,
    *,
    deadline: float | None = None,
    watch: Callable[[Progress], None] | None = None,
    interruption: Interruption | None = None,
) -> dict[str, Any]:
    """Solve the instance together, with the robots spread over several processes.

    Returns what `crazychoir solve --json` prints. It contains these figures:

    - wall_s: s from GO until the last robot has the plan
    - startup_s: s until GO
    - cpu_s: s of CPU time of all processes, from GO
    - curve: [[s, m], ...], the cost of the best plan over time
    - critical_path_s: s that the team would need if each robot had a computer of its own

        critical_path_s = sum over the rounds k of (max_i c_ik + T_k)

    c_ik: s, CPU time of the thread of robot i in round k
    T_k: s, duration of round k when the same processes repeat it with the same payloads and loss, but
        without computation

    instance: the pickup-and-delivery problem
    processes: number of processes
    options: method, network and seed
    deadline: s, limit of each round; a solution may take any number of rounds. None for
        ROUND_DEADLINE, or PROOF_ROUND_DEADLINE if the team proves
    watch: called with the progress of all robots, or None
    interruption: ends the computation with the best plan, None if nothing can
    Raises InstanceError, ConfigError, or ProcessFailed if a process fails, ends, or is silent for
    too long.
    """
    began = time.perf_counter()
    if deadline is None:
        proves = options.settings.proof.prove
        deadline = PROOF_ROUND_DEADLINE if proves else ROUND_DEADLINE
    links = graph_from_name(options.graph, instance.robots, options.seed)
    if not 1 <= processes <= instance.robots:
        raise ConfigError(
            "processes",
            processes,
            f"1 to {instance.robots}, the robots of {instance.name}",
        )
    if options.method not in PLANNING_METHODS:
        raise ConfigError(
            "method", options.method, ", ".join(PLANNING_METHODS), "Choose one of them."
        )
    network = NetworkTable(loss=options.loss, burst=options.burst)
    require_loss_of_burst(network)
    parts = [
        part.tolist() for part in np.array_split(np.arange(instance.robots), processes)
    ]
    with scratch_folder("crazychoir-solve-") as folder:
        file = folder / "instance.json"
        file.write_text(json.dumps(instance.to_json()), encoding="utf-8")
        common = {
            "instance": str(file),
            "method": options.method,
            "seed": options.seed,
            "deadline": deadline,
            "rules": [rule.effects for rule in network_rules(network)],
            "settings": asdict(options.settings),
        }
        common |= {
            "neighbors": {i: links.neighbors(i) for i in links.ids},
            "report_period": REPORT_PERIOD if watch is None else SHOWN_REPORT_PERIOD,
        }
        with (
            reserve_ports(dict.fromkeys(range(len(parts)), LOCAL_ADDRESS)) as base,
            share_with_children(folder),
            ProgramGroup(_build_commands(parts, common | {"base": base})) as group,
        ):
            run = SolverRun(group, parts, watch or (lambda progress: None))
            run.wait("ready", START_PATIENCE, "do not find each other")
            run.expect_reports()
            started = time.perf_counter() - began
            group.tell("go")
            with (interruption or Interruption()).telling(lambda: group.tell("stop")):
                solved = run.wait("solved", REPORT_PATIENCE, "have no plan")
            group.tell("replay")
            replayed = run.wait(
                "replayed_s", REPORT_PATIENCE, "do not repeat the rounds"
            )
            group.tell("end")
    return _combine_results(instance, links, solved, replayed) | {
        "startup_s": started,
        "processes": processes,
    }


class SolverRun:
    """The answers of the processes, in order; raises ProcessFailed if something goes wrong.

    Each process reports its progress, so that a team is never given up while all of it works.

    group: the processes
    parts: the robots of each process
    watch: called with the progress of all robots
    now: returns the time in s
    """

    def __init__(
        self,
        group: ProgramGroup,
        parts: list[list[int]],
        watch: Callable[[Progress], None],
        now: Callable[[], float] = time.perf_counter,
    ) -> None:
        self._group = group
        self._parts = parts
        self._watch = watch
        self._now = now
        self._progress: Progress = {}
        self._heard_at: dict[int, float] = {}

    def expect_reports(self) -> None:
        """Let the team be given up from now on if a single process is silent.

        Before, while processes compile and wait for each other, any answer will do.
        """
        self._heard_at = dict.fromkeys(range(len(self._parts)), self._now())

    def wait(self, key: str, patience: float, complaint: str) -> list[Any]:
        """Return this answer of every process.

        key: name of the answer
        patience: s, longest time without an answer; see `expect_reports`
        complaint: what the missing processes have not done, for the error text
        """
        found: dict[int, Any] = {}
        for number, answer in self._heard(patience, complaint):
            if key in answer:
                found[number] = answer[key]
            if len(found) == len(self._parts):
                return [found[number] for number in sorted(found)]
        raise ProcessFailed("the team", "no answer")

    def _heard(self, patience: float, complaint: str) -> Iterator[Answer]:
        while True:
            rest = patience
            if self._heard_at:
                silent = min(self._heard_at, key=self._heard_at.__getitem__)
                rest -= self._now() - self._heard_at[silent]
            try:
                yield from map(self._look, self._group.answers(1, rest, complaint))
            except ProgramEnded as error:
                raise ProcessFailed(
                    f"robots {describe_ids(self._parts[error.number])}", str(error)
                ) from None
            except TimeoutError as error:
                if not self._heard_at:
                    raise ProcessFailed("the team's processes", str(error)) from None
                raise ProcessFailed(
                    f"robots {describe_ids(self._parts[silent])}",
                    f"their process has not reported for {patience:g} s. Is it stopped?",
                ) from None

    def _look(self, heard: Answer) -> Answer:
        number, answer = heard
        if self._heard_at:
            self._heard_at[number] = self._now()
        if "compiles" in answer:
            announce_compiling()
        if "warning" in answer:
            print_first_warning(answer["warning"])
        if "error" in answer:
            raise ProcessFailed(
                f"robots {describe_ids(self._parts[number])}",
                f"{answer['kind']}: {answer['error']}",
            )
        if "progress" in answer:
            self._progress |= {
                int(i): tuple(values) for i, values in answer["progress"].items()
            }
            self._watch(dict(sorted(self._progress.items())))
        return heard


def _build_commands(parts: list[list[int]], common: dict[str, Any]) -> list[list[str]]:
    """Return one command for each process.

    Each process listens on a port of its own and connects to the ports of the processes before it.
    """
    swarm = f"solve-{secrets.token_hex(4)}"
    endpoints = (
        [f"tcp/{LOCAL_ADDRESS}:{common['base'] + p}" for p in range(len(parts))]
        if len(parts) > 1
        else [""]
    )
    commands = []
    for p, mine in enumerate(parts):
        own = {
            "mine": mine,
            "swarm": swarm,
            "process": f"{p}-{swarm}",
            "connect": endpoints[:p],
        }
        own["listen"] = endpoints[p : p + 1] if len(parts) > 1 else []
        commands.append(
            [
                sys.executable,
                "-m",
                "crazychoir.solve.solver_process",
                json.dumps(common | own),
            ]
        )
    return commands


def _combine_results(
    instance: Instance,
    links: Graph,
    solved: list[dict[str, Any]],
    replayed: list[float],
) -> dict[str, Any]:
    """Combine the results of all processes into the result of the team."""
    solution = join_solutions(
        instance,
        [Solution.from_json(raw) for part in solved for raw in part["solutions"]],
    )
    robots = [robot for part in solved for robot in part["robots"]]
    steps = [
        max(times) for times in zip(*(part["steps"] for part in solved), strict=True)
    ]
    totals = {
        key: sum(robot[key] for robot in robots)
        for key in ("messages", "lost", "resent", "bytes")
    }
    return (
        solution.to_json()
        | summarise_plan(instance, solution.routes)
        | totals
        | {
            "wall_s": max(part["wall_s"] for part in solved),
            "cpu_s": sum(part["cpu_s"] for part in solved),
            "critical_path_s": compute_critical_path(steps, max(replayed)),
            "critical_cpu_s": sum(steps),
            "exchange_s": max(replayed),
            "diameter": links.diameter(),
            "robots": robots,
            "curve": merge_best_points(
                [point for part in solved for point in part["curve"]]
            ),
        }
    )


def compute_critical_path(steps: list[float], exchange: float) -> float:
    """Return the critical path in s: sum_k max_i c_ik + sum_k T_k.

    steps: max_i c_ik of each round, s
    exchange: sum_k T_k, s: the rounds without computation follow each other
    """
    return sum(steps, exchange)


def merge_best_points(points: list[list[float]]) -> list[list[float]]:
    """Return the points [s, m] of all processes that are below every earlier point."""
    best: list[list[float]] = []
    for point in sorted(points):
        if not best or point[1] < best[-1][1]:
            best.append(point)
    return best
