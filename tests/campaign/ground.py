"""Scenarios without flight: rounds, allocations, whole plans, memberships and commands over a bad network."""

import asyncio
from collections import Counter
from contextlib import suppress
from typing import Any
from unittest.mock import patch

import numpy as np
from coupled import random_blocks
from living import Team, as_graph_says, counting, team

from campaign import faults
from campaign.faults import Draw
from campaign.report import Report, digest
from crazychoir.bus.commands import ANSWER_TEXTS, Commander, CommandServer
from crazychoir.bus.port import PORT_ADDRESSES, Bus
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
        with suppress(RosterChanged, PeerLost):
            got = await c.neighbors_exchange(said, channel="anew")
            assert all(value == said for value in got.values()), (
                f"{said}, and hears {got}"
            )
        await t.clock.sleep(0.05)


def members(report: Report, draw: Draw) -> None:
    """All but one at most are killed and come again, the network is cut, loses, and heals; all agree in the end.

    And all that live exchange with each other again, however long one was without the others.
    In half of the seeds they are on hosts whose clocks differ by hours.
    Meanwhile whoever hears anything in a round hears what was said in that very round, and in that very epoch on a
    channel that begins anew with each; and since the last of them has come or gone all hear in each round just their
    neighbours.
    """
    n = int(draw.integers(3, 8))
    graph, ids = faults.graph(draw, n), tuple(range(n))
    rules = faults.rules(draw, report, ids, 0.35)
    cuts = faults.partitions(draw, report, ids, EVENTS)
    events: list[tuple[float, int, float]] = []

    def crashes(those: list[int]) -> None:
        for i in those:
            at = float(draw.uniform(0.5, EVENTS))
            pause = float(draw.choice([0.1, 1.0, 4.0, LATEST, np.inf]))
            events.append((at, i, pause))
            report.inject("crashes")
            if pause < np.inf:
                report.inject("restarts")

    order, few = draw.permutation(n).tolist(), int(draw.integers(0, n // 2 + 1))
    crashes(order[:few])
    ahead = (
        tuple(draw.uniform(-1e4, 1e4, int(draw.integers(2, 4))))
        if draw.random() < 0.5
        else ()
    )
    if ahead:
        report.inject("clock skew")
    if (
        draw.random() < 0.5
    ):  # the other seeds tell what they told when at most half were killed
        crashes(order[few : int(draw.integers(few, n))])

    async def story(t: Team) -> None:
        heard: dict[int, Any] = {}
        incarnations = dict.fromkeys(ids, 1)
        lives, anew = dict[int, Any](), dict[int, Any]()

        def begin(i: int) -> None:
            t.start(i, incarnation=incarnations[i])
            lives[i] = t.run(i, counting(t, i, heard, np.inf, 0.02))
            anew[i] = t.run(i, beginning_anew(t, i))

        def kill(i: int) -> None:
            lives.pop(i, None)
            anew.pop(i, None)
            t.kill(i)

        def again(i: int) -> None:
            incarnations[i] += 1
            begin(i)

        for i in ids:
            begin(i)
        async with asyncio.timeout(60.0):
            while any(rosters is None for rosters in t.rosters().values()):
                await t.clock.sleep(0.05)
        went = t.clock.now_ns()
        for at, i, pause in events:
            t.clock.call_at(went + round(at * 1e9), kill, i)
            if pause < np.inf:
                t.clock.call_at(went + round((at + pause) * 1e9), again, i)
        await t.clock.sleep(EVENTS + LATEST)
        for bus in t.buses:
            bus.impairment.replace(
                [], []
            )  # of a network that loses most, somebody is taken for lost now and then
        await t.clock.sleep(CALM - 4.0)
        before = {i: newest(heard, i) for i in t.members}
        await t.clock.sleep(2.0)
        for i, k in before.items():
            report.holds(
                newest(heard, i) > k, f"drone {i} stands still in the round after {k}"
            )
        for i, life in [*lives.items(), *anew.items()]:
            if (
                life.done()
                and not life.cancelled()
                and (error := life.exception()) is not None
            ):
                known = isinstance(error, CrazyChoirError)
                report.holds(known, f"drone {i}: {type(error).__name__}: {error}")
        alive = {i: incarnations[i] for i in sorted(t.members)}
        rosters = t.rosters()
        for i, roster in rosters.items():
            found = None if roster is None else dict(roster.members)
            report.holds(found == alive, f"drone {i} counts {found}, there are {alive}")
        checksums = {roster.checksum if roster else 0 for roster in rosters.values()}
        report.holds(len(checksums) == 1, f"{len(checksums)} rosters")
        roster = next(iter(rosters.values()), None)
        for k in sorted(heard) if roster is not None and len(checksums) == 1 else ():
            whole = k >= roster.first_round and all(i in heard[k] for i in roster.ids)
            theirs = {
                i: by for i, by in heard[k].items() if i in roster.members
            }  # who has died was in another, maybe
            right = not whole or as_graph_says(roster.graph, k, {k: theirs})
            report.holds(
                right,
                f"in round {k} of an epoch since {roster.first_round} they hear {heard[k]}",
            )
        report.simulated_s = t.clock.now()
        report.digest = digest(
            sorted(heard.items()), sorted(alive.items()), t.clock.now_ns()
        )

    team(graph, story, rules, cuts, report.seed, ahead=ahead)


def commands(report: Report, draw: Draw) -> None:
    """An operator over a bad network: what is answered was done once, nothing is done twice, every wait ends.

    Of stops and clears the one that was ordered last is in force, whatever of the others comes late.
    """
    n, count = int(draw.integers(1, 6)), int(draw.integers(5, 30))
    loss, slow = float(draw.uniform(0.0, 0.7)), float(draw.uniform(0.0, 0.4))
    report.inject("loss")
    report.inject("duplicates")
    report.inject("replays")

    async def main(clock: Clock) -> None:
        bus, done, stopped = Bus(clock), Counter[tuple[int, int]](), dict[int, bool]()
        operator = Commander(bus.port(PORT_ADDRESSES.first_observer, 0xF1))
        kept: list[tuple[Any, ...]] = []

        def server(i: int) -> None:
            async def execute(verb: str, arguments: dict[str, Any]) -> int:
                if arguments["k"] % 7 == 6:
                    raise Refused(f"drone {i}", "no")
                await clock.sleep(slow * arguments["k"] % 0.5)
                done[i, arguments["k"]] += 1
                return int(arguments["k"])

            CommandServer(bus.port(i), execute, lambda on: stopped.update({i: on}))

        for i in range(n):
            server(i)
        for port in bus.ports.values():
            deliver = port.deliver

            def lossy(*message: Any, deliver: Any = deliver) -> None:
                if draw.random() < loss:
                    kept.extend(
                        [(deliver, message)]
                        * (message[0] == MESSAGE_TOPICS.emergency_stop.number)
                    )  # it comes for the first time then
                    return
                for _ in range(1 + (draw.random() < 0.2)):
                    deliver(*message)
                if message[1] == PORT_ADDRESSES.first_observer and draw.random() < 0.2:
                    kept.append((deliver, message))

            port.deliver = lossy  # type: ignore[method-assign]

        async def ask(k: int) -> None:
            await clock.sleep(float(k) * 0.1)
            began, i, deadline = clock.now(), k % n, float(draw.uniform(0.3, 4.0))
            try:
                answer = await operator.request(i, "do", deadline, k=k)
                report.holds(
                    answer.kind in (ANSWER_TEXTS.done, ANSWER_TEXTS.accepted)
                    or k % 7 == 6,
                    f"request {k}: {answer}",
                )
                if answer.kind == ANSWER_TEXTS.done:
                    once = done[i, k] == 1 and answer.detail == k
                    report.holds(once, f"request {k} done {done[i, k]} times: {answer}")
            except TimeoutError:
                pass
            report.holds(
                clock.now() - began <= deadline + 0.01,
                f"request {k} waits {clock.now() - began:g} s",
            )

        async with asyncio.timeout(LONGEST):
            await asyncio.gather(*(ask(k) for k in range(count)))
            for clear in (
                clears := (draw.random(int(draw.integers(1, 5))) < 0.5).tolist()
            ):
                await operator.emergency_stop(
                    list(range(n)), clear, deadline=float(draw.choice([0.05, 1.0]))
                )
            missing = await operator.emergency_stop(
                list(range(n)), clears[-1], deadline=60.0
            )
            report.holds(not missing, f"a stop, or a clear, has not reached {missing}")
            for deliver, message in reversed(kept):  # all of it once more, much later
                deliver(*message[:-1], 0.0)
            await clock.sleep(5.0)
        for i, on in [*stopped.items(), ("all", bus.stopped)]:
            report.holds(
                on is not clears[-1], f"stop of {i} is {on} after clears {clears}"
            )
        twice = [key for key, times in done.items() if times > 1]
        report.holds(not twice, f"done twice: {twice}")
        report.simulated_s = clock.now()
        report.digest = digest(sorted(done.items()), clock.now_ns())

    run_virtual(main)


KINDS = {
    "rounds": rounds,
    "allocation": allocation,
    "plan": plan,
    "members": members,
    "commands": commands,
}
