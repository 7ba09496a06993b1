"""Scenarios without flight: rounds, allocations, whole plans, memberships and commands over a bad network."""

import asyncio
from collections import Counter
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from typing import Any
from unittest.mock import patch

import numpy as np
from coupled import random_blocks
from living import Team, counting, team

from campaign import faults
from campaign.faults import Draw
from campaign.report import Report, digest
from crazychoir.bus.commands import ANSWER_TEXTS, Commander, CommandServer
from crazychoir.bus.message import Message
from crazychoir.bus.port import PORT_ADDRESSES, Bus, Handler
from crazychoir.bus.topics import MESSAGE_TOPICS
from crazychoir.errors import CrazyChoirError, PeerLost, Refused, RosterChanged
from crazychoir.optimization.algorithms.consensus import Consensus
from crazychoir.optimization.algorithms.convexified import Convexified
from crazychoir.optimization.algorithms.primal_decomposition import PrimalDecomposition
from crazychoir.optimization.rounds.step_size import Diminishing
from crazychoir.routing.distributed.pickup_delivery import PLANNING_METHODS
from crazychoir.routing.distributed.primal_decomposition import PriceRounds
from crazychoir.routing.instance.generate import InstanceShape, random_instance
from crazychoir.runtime.clock import Clock, run_virtual
from crazychoir.solve.simulate import simulate
from crazychoir.solve.solve_options import SolveOptions
from crazychoir.solve.solving import solve_here
from crazychoir.team.graph import metropolis
from crazychoir.team.messages import Roster

LONGEST = 600.0
"""s of virtual time in which every wait of a scenario must be over."""


def rounds(report: Report, draw: Draw) -> None:
    """Averaging: bit by bit the same whatever the network does, and the sum of all stays what it was."""
    graph = faults.graph(draw, int(draw.integers(2, 11)))
    x, weights = draw.normal(size=len(graph.ids)), metropolis(graph)
    length, network = int(draw.integers(5, 40)), faults.effects(draw, report)

    def averaged(network: dict[str, float]) -> tuple[list[bytes], float]:
        agents = {i: Consensus(i, [x[i]], weights[i], length) for i in graph.ids}
        history = simulate(agents, graph, network=network, seed=report.seed)
        report.simulated_s += history.simulated_s
        total = float(sum(agent.x[0] for agent in agents.values()))
        report.holds(abs(total - x.sum()) < 1e-9, f"the sum is {total}, not {x.sum()}")
        return [agents[i].x.tobytes() for i in graph.ids], history.simulated_s

    faulty, took = averaged(network)
    report.holds(faulty == averaged({})[0], "not the answer of a perfect network")
    report.holds(took < LONGEST, f"{length} rounds take {took:g} s")
    report.digest = digest(faulty, took)


def allocation(report: Report, draw: Draw) -> None:
    """Primal decomposition of a random mixed-integer program: sum y = b after each round, bit by bit the same."""
    n, length, seed = (
        int(draw.integers(2, 7)),
        int(draw.integers(4, 10)),
        int(draw.integers(1 << 30)),
    )
    graph, network = faults.graph(draw, n), faults.effects(draw, report)
    blocks, weights = random_blocks(n, seed), metropolis(graph)
    b = sum(block.share for block in blocks)

    def allocated(network: dict[str, float]) -> list[Any]:
        agents = {
            i: PrimalDecomposition(
                i,
                weights[i],
                Convexified(blocks[i], 100.0),
                blocks[i].share,
                Diminishing(0.3, 0.6),
                length,
            )
            for i in graph.ids
        }
        history = simulate(
            agents, graph, network=network, seed=report.seed, record=("y",)
        )
        report.simulated_s += history.simulated_s
        y = np.array([history.values[i]["y"] for i in graph.ids])  # (n, rounds, S)
        off = float(np.abs(y.sum(axis=0) - b).max())
        report.holds(off < 1e-9, f"sum y is {off:g} off b")
        return [y]

    faulty = digest(allocated(network))
    report.holds(
        faulty == digest(allocated({})), "not the allocation of a perfect network"
    )
    report.digest = faulty


def plan(report: Report, draw: Draw) -> None:
    """Pickups and deliveries: the plan of a perfect network, each task served once; shares of tasks sum up to one."""
    robots, tasks = int(draw.integers(2, 5)), int(draw.integers(2, 6))
    method, seed = (
        PLANNING_METHODS[int(draw.integers(len(PLANNING_METHODS)))],
        int(draw.integers(1 << 30)),
    )
    instance = random_instance(
        robots, tasks, seed, InstanceShape(capable=float(draw.uniform(0.6, 1.0)))
    )
    loss = float(draw.uniform(0.05, 0.6))
    name = ("ring", "path", "star", "complete")[int(draw.integers(4))]
    report.inject("loss")

    def planned(loss: float) -> dict[str, Any]:
        shares: dict[tuple[int, int], Any] = {}
        trade = PriceRounds._trade

        def traded(self: PriceRounds, k: int, mu: Any, heard: Any) -> float:
            change = trade(self, k, mu, heard)
            shares[k, self._member.local.robot] = self.y
            return change

        with patch.object(PriceRounds, "_trade", traded):
            found = solve_here(
                instance,
                SolveOptions(method=method, loss=loss, graph=name, seed=report.seed),
            )
        for k in sorted({k for k, _ in shares}):
            of_all = [shares[k, i] for i in range(robots) if (k, i) in shares]
            off = (
                float(np.abs(sum(of_all) - 1.0).max()) if len(of_all) == robots else 0.0
            )
            report.holds(
                off < 1e-9,
                f"round {k}: the shares of a task sum up to {off:g} too much or too little",
            )
        return found

    found, calm = planned(loss), planned(0.0)
    served = Counter(
        (stop["task"], stop["kind"])
        for route in found["routes"]
        for stop in route["stops"]
    )
    refused = {
        int(one["task"]) if isinstance(one, dict) else int(one)
        for one in found["refused"]
    }
    for j in range(tasks):
        wanted = 0 if j in refused else 1
        for kind in ("pickup", "delivery"):
            times = served[j, kind]
            report.holds(
                times == wanted,
                f"{method}: {kind} of task {j} {times} times, not {wanted}",
            )
    report.holds(not found["violations"], f"{method}: {found['violations']}")
    report.holds(
        found["plan_digest"] == calm["plan_digest"],
        f"{method}: not the plan of a perfect network",
    )
    report.digest = digest(found["plan_digest"], found["messages"], found["lost"])


CALM = 30.0
"""s after the last fault, of a network without loss, after which all that live agree."""
EVENTS, LATEST = 12.0, 8.0
"""s in which members are killed, and the network is cut; and after which the last one has come again."""


def newest(heard: dict[int, Any], i: int) -> int:
    """The last round that drone i has finished."""
    return max((k for k, by in heard.items() if i in by), default=-1)


async def beginning_anew(t: Team, i: int) -> None:
    """Exchange epoch and round on a channel that begins anew with each epoch."""
    await t.members[i].barrier.go()
    c = t.members[i].communicator
    while True:
        said = [c.epoch, c.open("anew").receiving]
        try:
            got = await c.neighbors_exchange(said, channel="anew")
        except (RosterChanged, PeerLost):
            got = {}
        for value in got.values():
            assert value == said, f"{said}, and hears {got}"
        await t.clock.sleep(0.05)


@dataclass(frozen=True)
class Crash:
    """A drone that is killed, and the pause after which it is started again."""

    drone: int
    at: float
    """s after all have begun the mission."""
    pause: float
    """s without the drone; infinite: it does not come again."""


def draw_crashes(report: Report, draw: Draw, victims: list[int]) -> list[Crash]:
    """Return a crash of each of these drones."""
    crashes = []
    for i in victims:
        at = float(draw.uniform(0.5, EVENTS))
        pause = float(draw.choice([0.1, 1.0, 4.0, LATEST, np.inf]))
        crashes.append(Crash(i, at, pause))
        report.inject("crashes")
        if pause < np.inf:
            report.inject("restarts")
    return crashes


def draw_clock_skew(report: Report, draw: Draw) -> tuple[float, ...]:
    """Return by how many s the clock of each host is ahead; in half of the seeds there is one host only."""
    if draw.random() >= 0.5:
        return ()
    report.inject("clock skew")
    return tuple(draw.uniform(-1e4, 1e4, int(draw.integers(2, 4))))


class CrashingTeam:
    """Drones that exchange in rounds, are killed, and are started again."""

    def __init__(self, t: Team, ids: tuple[int, ...]) -> None:
        self.team = t
        self.incarnations = dict.fromkeys(ids, 1)
        self.heard: dict[int, Any] = {}
        """{round: {drone: what it has heard}}."""
        self._counting: dict[int, Any] = {}
        self._beginning_anew: dict[int, Any] = {}

    async def begin(self) -> None:
        """Start all drones and wait until each has a roster."""
        for i in self.incarnations:
            self._start(i)
        async with asyncio.timeout(60.0):
            while any(roster is None for roster in self.team.rosters().values()):
                await self.team.clock.sleep(0.05)

    def schedule(self, crashes: list[Crash]) -> None:
        """Let these crashes happen, counted from now on."""
        clock = self.team.clock
        now_ns = clock.now_ns()
        for crash in crashes:
            clock.call_at(now_ns + round(crash.at * 1e9), self._kill, crash.drone)
            if crash.pause < np.inf:
                again_ns = now_ns + round((crash.at + crash.pause) * 1e9)
                clock.call_at(again_ns, self._start_again, crash.drone)

    def heal(self) -> None:
        """End the faults of the network: a network with much loss may make a living drone look lost."""
        for bus in self.team.buses:
            bus.impairment.replace([], [])

    def newest_rounds(self) -> dict[int, int]:
        """Return the last round that each living drone has finished."""
        return {i: newest(self.heard, i) for i in self.team.members}

    def failures(self) -> list[tuple[int, BaseException]]:
        """Return the errors that have ended a life, each with its drone."""
        lives = [*self._counting.items(), *self._beginning_anew.items()]
        ended = [(i, life) for i, life in lives if life.done() and not life.cancelled()]
        return [
            (i, error) for i, life in ended if (error := life.exception()) is not None
        ]

    def _start(self, i: int) -> None:
        t = self.team
        t.start(i, incarnation=self.incarnations[i])
        self._counting[i] = t.run(i, counting(t, i, self.heard, np.inf, 0.02))
        self._beginning_anew[i] = t.run(i, beginning_anew(t, i))

    def _kill(self, i: int) -> None:
        self._counting.pop(i, None)
        self._beginning_anew.pop(i, None)
        self.team.kill(i)

    def _start_again(self, i: int) -> None:
        self.incarnations[i] += 1
        self._start(i)


def check_agreement(report: Report, crashing: CrashingTeam) -> None:
    """Check that all that live have one roster, of just these, and hear just their neighbours."""
    rosters = crashing.team.rosters()
    alive = {i: crashing.incarnations[i] for i in sorted(crashing.team.members)}
    for i, roster in rosters.items():
        found = None if roster is None else dict(roster.members)
        report.holds(found == alive, f"drone {i} counts {found}, there are {alive}")
    checksums = {roster.checksum if roster else 0 for roster in rosters.values()}
    report.holds(len(checksums) == 1, f"{len(checksums)} rosters")
    roster = next(iter(rosters.values()), None)
    if roster is not None and len(checksums) == 1:
        check_rounds(report, roster, crashing.heard)


def check_rounds(report: Report, roster: Roster, heard: dict[int, Any]) -> None:
    """Check that in each whole round of this roster its drones have heard just their neighbours."""
    neighbors = {i: roster.graph.in_neighbors(i) for i in roster.graph.ids}
    for k in sorted(heard):
        whole = k >= roster.first_round and all(i in heard[k] for i in roster.ids)
        # A drone that has died may have been in another roster.
        right = not whole or neighbors == {
            i: by for i, by in heard[k].items() if i in roster.members
        }
        report.checks += 1
        if not right:
            since = roster.first_round
            report.wrong.append(
                f"in round {k} of an epoch since {since} they hear {heard[k]}"
            )


def members(report: Report, draw: Draw) -> None:
    """Kill drones and start them again, and cut, disturb and heal the network: all drones agree in the end.

    At least one drone is never killed. In half of the seeds the drones are on hosts with clocks that differ by hours.
    All living drones exchange with each other again, however long a drone was without the others.
    A message that a drone hears in a round was always sent in this very round. On a channel that begins anew with each
    epoch it was sent in this very epoch too.
    After the last drone has come or gone, each drone hears just its neighbours in each round.
    """
    n = int(draw.integers(3, 8))
    graph = faults.graph(draw, n)
    ids = tuple(range(n))
    rules = faults.rules(draw, report, ids, 0.35)
    cuts = faults.partitions(draw, report, ids, EVENTS)
    order = draw.permutation(n).tolist()
    few = int(draw.integers(0, n // 2 + 1))
    crashes = draw_crashes(report, draw, order[:few])
    ahead = draw_clock_skew(report, draw)
    # The other seeds tell what they told when at most half were killed.
    if draw.random() < 0.5:
        more = order[few : int(draw.integers(few, n))]
        crashes += draw_crashes(report, draw, more)

    async def story(t: Team) -> None:
        crashing = CrashingTeam(t, ids)
        await crashing.begin()
        crashing.schedule(crashes)
        await t.clock.sleep(EVENTS + LATEST)
        crashing.heal()
        await t.clock.sleep(CALM - 4.0)
        before = crashing.newest_rounds()
        await t.clock.sleep(2.0)
        for i, k in before.items():
            report.holds(
                newest(crashing.heard, i) > k,
                f"drone {i} stands still in the round after {k}",
            )
        for i, error in crashing.failures():
            known = isinstance(error, CrazyChoirError)
            report.holds(known, f"drone {i}: {type(error).__name__}: {error}")
        check_agreement(report, crashing)
        alive = {i: crashing.incarnations[i] for i in sorted(t.members)}
        report.simulated_s = t.clock.now()
        report.digest = digest(
            sorted(crashing.heard.items()), sorted(alive.items()), t.clock.now_ns()
        )

    team(graph, story, rules, cuts, report.seed, ahead=ahead)


class CommandTrial:
    """An operator and drones in a network that loses, duplicates and keeps messages."""

    def __init__(
        self, report: Report, draw: Draw, clock: Clock, drones: int, loss: float
    ) -> None:
        self.report = report
        self.draw = draw
        self.clock = clock
        self.bus = Bus(clock)
        self.operator = Commander(self.bus.port(PORT_ADDRESSES.first_observer, 0xF1))
        self.done = Counter[tuple[int, int]]()
        """How often each drone has done each request."""
        self.stopped: dict[int, bool] = {}
        """Whether each drone was last told to stop, or that the stop is cleared."""
        self._drones = list(range(drones))
        self._loss = loss
        self._kept: list[tuple[Handler, Message]] = []

    def serve(self, slow: float) -> None:
        """Start the drones, which obey in up to 0.5 s, and the faults of all ports."""
        for i in self._drones:
            self._start_server(i, slow)
        for port in self.bus.ports.values():
            for topic, handle in port.handlers.items():
                port.handlers[topic] = partial(self._deliver, handle)

    def _start_server(self, i: int, slow: float) -> None:
        async def execute(verb: str, arguments: dict[str, Any]) -> int:
            if arguments["k"] % 7 == 6:
                raise Refused(f"drone {i}", "no")
            await self.clock.sleep(slow * arguments["k"] % 0.5)
            self.done[i, arguments["k"]] += 1
            return int(arguments["k"])

        CommandServer(
            self.bus.port(i), execute, lambda on: self.stopped.update({i: on})
        )

    def _deliver(self, handle: Handler, message: Message, age: float) -> None:
        """Lose a message, or deliver it once or twice; some are kept to come again at the end."""
        if self.draw.random() < self._loss:
            # A lost stop comes at the end for the first time.
            if message.topic is MESSAGE_TOPICS.emergency_stop:
                self._kept.append((handle, message))
            return
        for _ in range(1 + (self.draw.random() < 0.2)):
            handle(message, age)
        is_of_operator = message.source == PORT_ADDRESSES.first_observer
        if is_of_operator and self.draw.random() < 0.2:
            self._kept.append((handle, message))

    async def ask(self, k: int) -> None:
        """Send request k, and check its answer and how long it waits."""
        await self.clock.sleep(float(k) * 0.1)
        began = self.clock.now()
        i = k % len(self._drones)
        deadline = float(self.draw.uniform(0.3, 4.0))
        with suppress(TimeoutError):
            answer = await self.operator.request(i, "do", deadline, k=k)
            self._check_answer(answer, i, k)
        waited = self.clock.now() - began
        self.report.holds(
            waited <= deadline + 0.01,
            f"request {k} waits {waited:g} s",
        )

    def _check_answer(self, answer: Any, i: int, k: int) -> None:
        self.report.holds(
            answer.kind in (ANSWER_TEXTS.done, ANSWER_TEXTS.accepted) or k % 7 == 6,
            f"request {k}: {answer}",
        )
        if answer.kind == ANSWER_TEXTS.done:
            times = self.done[i, k]
            once = times == 1 and answer.detail == k
            self.report.holds(once, f"request {k} done {times} times: {answer}")

    async def stop_and_clear(self) -> list[bool]:
        """Order stops and clears, the last until all have it; return them in order."""
        clears: list[bool] = (
            self.draw.random(int(self.draw.integers(1, 5))) < 0.5
        ).tolist()
        for clear in clears:
            await self.operator.emergency_stop(
                self._drones, clear, deadline=float(self.draw.choice([0.05, 1.0]))
            )
        missing = await self.operator.emergency_stop(
            self._drones, clears[-1], deadline=60.0
        )
        self.report.holds(not missing, f"a stop, or a clear, has not reached {missing}")
        return clears

    def deliver_again(self) -> None:
        """Deliver all that was kept once more, the newest first."""
        for handle, message in reversed(self._kept):
            handle(message, 0.0)

    def check_end(self, clears: list[bool]) -> None:
        """Check that the last order is in force, and that nothing was done twice."""
        for i, on in [*self.stopped.items(), ("all", self.bus.stopped)]:
            self.report.holds(
                on is not clears[-1], f"stop of {i} is {on} after clears {clears}"
            )
        twice = [key for key, times in self.done.items() if times > 1]
        self.report.holds(not twice, f"done twice: {twice}")


def commands(report: Report, draw: Draw) -> None:
    """Let an operator command drones over a bad network.

    A request with the answer `done` was done once. No request is done twice, and every wait ends.
    The last stop or clear that the operator ordered is in force, however late the earlier orders come.
    """
    n = int(draw.integers(1, 6))
    count = int(draw.integers(5, 30))
    loss = float(draw.uniform(0.0, 0.7))
    slow = float(draw.uniform(0.0, 0.4))
    report.inject("loss")
    report.inject("duplicates")
    report.inject("replays")

    async def main(clock: Clock) -> None:
        trial = CommandTrial(report, draw, clock, n, loss)
        trial.serve(slow)
        async with asyncio.timeout(LONGEST):
            await asyncio.gather(*(trial.ask(k) for k in range(count)))
            clears = await trial.stop_and_clear()
            trial.deliver_again()
            await clock.sleep(5.0)
        trial.check_end(clears)
        report.simulated_s = clock.now()
        report.digest = digest(sorted(trial.done.items()), clock.now_ns())

    run_virtual(main)


KINDS = {
    "rounds": rounds,
    "allocation": allocation,
    "plan": plan,
    "members": members,
    "commands": commands,
}
