"""A process with some robots of a pickup-and-delivery team.

`crazychoir.solve.team` starts it and sends it orders.
"""

import asyncio
import ctypes
import json
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import msgspec

from crazychoir.bus.codec import decode, encode
from crazychoir.bus.impairment.model import Impairment
from crazychoir.bus.impairment.rules import ImpairmentRule
from crazychoir.bus.json_view import to_plain_values
from crazychoir.bus.network.hello_review import Introduction
from crazychoir.bus.network.zenoh_link import ZenohLink
from crazychoir.bus.network.zenoh_session import SessionEndpoints
from crazychoir.bus.port import Bus
from crazychoir.errors import CrazyChoirError, RoundTimeout
from crazychoir.launch.joining import wait_until_joined
from crazychoir.numerics import kernel_cache as cache
from crazychoir.routing.distributed.member import RoutingSettings
from crazychoir.routing.distributed.pickup_delivery import PickupDelivery
from crazychoir.routing.distributed.plain_loop import (
    compile_routing_kernels,
    make_member,
)
from crazychoir.routing.instance.instance import Instance, LocalProblem
from crazychoir.runtime.clock import NS_PER_SECOND, Clock, run_wall
from crazychoir.team.algorithm_run import run_algorithm
from crazychoir.team.communicator import Communicator
from crazychoir.team.graph import Graph
from crazychoir.types import PerNeighbor

PR_SET_PDEATHSIG = 1
"""Option of prctl: the signal that this process gets when its parent ends."""
SOLUTION_CHANNEL = "pickup_delivery"
"""Channel of the solution."""
REPLAY_CHANNEL = "replay"
"""Channel of the replay."""
Packed = bytes | dict[int, bytes]
"""A message as bytes, or as bytes for each neighbour."""


@dataclass
class SolverRobot:
    """A `Round` that runs one robot's agent and records the time and the message of each round."""

    communicator: Communicator
    """The robot's access to the network."""
    agent: PickupDelivery
    """The robot's part of the algorithm."""
    look: Callable[[PickupDelivery], None]
    """Called with the agent after each step."""
    cpu: list[float] = field(default_factory=list)
    """Thread time of each step, s."""
    payloads: list[Packed] = field(default_factory=list)
    """The message of each round, encoded."""
    counters: dict[str, int] = field(default_factory=dict)
    """Counts of its messages at the time when its plan was ready."""
    heavy = True

    @property
    def done(self) -> bool:
        """True if the plan is ready."""
        return self.agent.done

    def message(self) -> Any:
        """Return the message to the neighbours, and keep an encoded copy of it.

        No later change of the message reaches the copy.
        """
        message = self.agent.message()
        self.payloads.append(pack_message(message))
        return message

    def step(self, heard: Mapping[int, Any]) -> None:
        """Compute one round."""
        began = time.thread_time()
        self.agent.step(heard)
        self.cpu.append(time.thread_time() - began)
        self.look(self.agent)

    def report(self) -> dict[str, Any]:
        """Return the figures of this robot for the final report."""
        return {
            "robot": self.communicator.id,
            "rounds": len(self.cpu),
            "cpu_s": sum(self.cpu),
            **self.counters,
        }


class MessageReplay:
    """A `Round` that sends the recorded messages of a robot again, without computing.

    payloads: the messages
    look: called after each round
    """

    def __init__(self, payloads: list[Packed], look: Callable[[], None]) -> None:
        self._payloads = payloads
        self._look = look
        self._k = 0

    @property
    def done(self) -> bool:
        """True if all messages have been sent."""
        return self._k == len(self._payloads)

    def message(self) -> Any:
        """Return the next message."""
        return unpack_message(self._payloads[self._k])

    def step(self, heard: Mapping[int, Any]) -> None:
        """Ignore the messages, and count the round."""
        self._k += 1
        self._look()


class SolverProcess:
    """The robots `mine` of the team, from the start to their reports.

    spec: the specification that `crazychoir.solve.team` has written
    curve: [[s since GO, m], ...], each plan cost that was below the last one
    """

    def __init__(self, spec: dict[str, Any]) -> None:
        self.spec = spec
        self.robots: dict[int, SolverRobot] = {}
        self.curve: list[list[float]] = []
        self._orders: asyncio.Queue[str] = asyncio.Queue()
        self._clock: Clock
        self._go_ns = 0
        self._next_report = 0.0
        self._lock = threading.Lock()

    async def run(self, clock: Clock) -> None:
        """Join, wait for GO, solve and report; then replay the messages without computing."""
        self._clock = clock
        loop = asyncio.get_running_loop()
        threading.Thread(target=self._obey, args=(loop,), daemon=True).start()
        spec = self.spec
        instance = Instance.load(spec["instance"])
        links = Graph.from_neighbors(
            {int(i): tuple(js) for i, js in spec["neighbors"].items()}
        )
        bus = Bus(
            clock,
            Impairment(spec["seed"], map(ImpairmentRule, spec["rules"])),
            spec["process"],
            "solve",
        )
        await self._load_kernels(instance.local(0))
        neighbors = {j: links.neighbors(j) for j in links.ids}
        for i in spec["mine"]:
            agent = make_member(
                instance,
                neighbors,
                i,
                links.diameter(),
                spec["method"],
                msgspec.convert(spec["settings"], RoutingSettings),
            )
            communicator = Communicator(bus.port(i), links, deadline=spec["deadline"])
            self.robots[i] = SolverRobot(communicator, agent, self._look)
        async with asyncio.TaskGroup() as group:
            serving = None
            if spec["connect"] or spec["listen"]:
                link = ZenohLink(
                    bus,
                    Introduction(spec["swarm"], 1, "solve"),
                    SessionEndpoints(spec["listen"], spec["connect"]),
                )
                link.open()
                serving = group.create_task(link.run())
                await wait_until_joined(link, links)
            await self._work()
            if serving is not None:
                serving.cancel()

    async def _load_kernels(self, problem: LocalProblem) -> None:
        """Load the kernels, or compile them, and report meanwhile: a slow machine takes minutes."""
        async with asyncio.TaskGroup() as group:
            reporting = group.create_task(self._keep_reporting())
            await self._clock.compute(
                compile_routing_kernels, problem, self.spec["method"]
            )
            reporting.cancel()

    async def _work(self) -> None:
        """Obey the orders of the parent, and report progress until the end.

        Progress is reported during long steps too: the parent gives up a silent process.
        """
        async with asyncio.TaskGroup() as group:
            reporting = group.create_task(self._keep_reporting())
            await self._obey_orders()
            reporting.cancel()

    async def _keep_reporting(self) -> None:
        while True:
            await self._clock.sleep(self.spec["report_period"])
            with self._lock:
                if self._go_ns:
                    self._report_progress()
                elif not self.robots:
                    write_line({"loads": True})

    async def _obey_orders(self) -> None:
        clock = self._clock
        write_line({"ready": True, "start_cpu_s": time.process_time()})
        await self._order("go")
        self._go_ns, cpu = clock.now_ns(), time.process_time()
        for robot in self.robots.values():
            robot.agent.start_clock(clock.now)
        ended = await self._all(self._solve)
        write_line({"solved": self._report(time.process_time() - cpu, ended)})
        await self._order("replay")
        began = clock.now_ns()
        ended = await self._all(self._replay)
        write_line({"replayed_s": (max(ended) - began) / NS_PER_SECOND})
        await self._order("end")

    async def _all(self, work: Any) -> list[int]:
        async with asyncio.TaskGroup() as group:
            tasks = [
                group.create_task(work(robot), name=f"robot {i}")
                for i, robot in self.robots.items()
            ]
        return [task.result() for task in tasks]

    async def _solve(self, robot: SolverRobot) -> int:
        """Compute all rounds of one robot; return the time at which its plan was ready, ns."""
        try:
            await run_algorithm(robot.communicator, robot, channel=SOLUTION_CHANNEL)
        except RoundTimeout as late:
            raise late.simulated() from None
        ended = self._clock.now_ns()
        counters = robot.communicator.port.counters
        robot.counters = {
            "messages": counters.sent,
            **{k: getattr(counters, k) for k in ("bytes", "lost", "resent")},
        }
        await robot.communicator.close(SOLUTION_CHANNEL)
        return ended

    async def _replay(self, robot: SolverRobot) -> int:
        """Send the same messages once more, without any computation; return the end, ns."""
        await run_algorithm(
            robot.communicator,
            MessageReplay(robot.payloads, self._report_progress),
            channel=REPLAY_CHANNEL,
        )
        ended = self._clock.now_ns()
        await robot.communicator.close(REPLAY_CHANNEL)
        return ended

    def _look(self, agent: PickupDelivery) -> None:
        """Note a better plan, and report the progress now and then; called in the thread of a step."""
        cost = agent.work_curve[-1][1] if agent.work_curve else None
        with self._lock:
            if cost is not None and (not self.curve or cost < self.curve[-1][1]):
                self.curve.append([self._elapsed(), cost])
            self._report_progress()

    def _report_progress(self) -> None:
        """Write the progress of all robots, if the last report is old enough."""
        now = self._elapsed()
        if now < self._next_report:
            return
        self._next_report = now + self.spec["report_period"]
        progress = {i: robot.agent.progress for i, robot in self.robots.items()}
        write_line(
            {
                "progress": {
                    i: [p.phase, p.round, p.cost, p.bound] for i, p in progress.items()
                }
            }
        )

    def _elapsed(self) -> float:
        """Return the time since GO, s."""
        return (self._clock.now_ns() - self._go_ns) / NS_PER_SECOND

    def _report(self, cpu: float, ended: list[int]) -> dict[str, Any]:
        robots = self.robots.values()
        return {
            "wall_s": (max(ended) - self._go_ns) / NS_PER_SECOND,
            "cpu_s": cpu,
            "steps": [
                max(times)
                for times in zip(*(robot.cpu for robot in robots), strict=True)
            ],
            "robots": [robot.report() for robot in robots],
            "solutions": [robot.agent.solution.to_json() for robot in robots],
            "curve": self.curve,
        }

    def _obey(self, loop: asyncio.AbstractEventLoop) -> None:
        """Read orders from standard input, in a thread; end the process when the input ends."""
        for line in sys.stdin:
            if line.strip() == "stop":
                for robot in self.robots.values():
                    robot.agent.interrupt()
                continue
            loop.call_soon_threadsafe(self._orders.put_nowait, line.strip())
        os._exit(1)

    async def _order(self, expected: str) -> None:
        while await self._orders.get() != expected:
            pass


def pack_message(message: Any) -> Packed:
    """Return a message as bytes, or as bytes for each neighbour.

    The copy is small, and no later change of the message reaches it.
    """
    if type(message) is PerNeighbor:
        return {j: encode(value) for j, value in message.items()}
    return encode(message)


def unpack_message(payload: Packed) -> Any:
    """Return the message of a payload."""
    if isinstance(payload, dict):
        return PerNeighbor({j: decode(value) for j, value in payload.items()})
    return decode(payload)


def write_line(answer: dict[str, Any]) -> None:
    """Write an answer to the process that started this one, as a line of JSON on standard output."""
    sys.stdout.write(json.dumps(to_plain_values(answer)) + "\n")
    sys.stdout.flush()


def main() -> None:
    """Run the process; its command-line argument is the specification, as JSON.

    An error is written as an answer, and ends the process.
    """
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    cache.print_line = lambda text: write_line(
        {"compiles": True} if text == cache.COMPILING_MESSAGE else {"warning": text}
    )
    process = SolverProcess(json.loads(sys.argv[1]))
    try:
        run_wall(process.run)
    except* CrazyChoirError as errors:
        first: BaseException = errors
        while isinstance(first, BaseExceptionGroup):
            first = first.exceptions[0]
        write_line({"error": str(first), "kind": type(first).__name__})


if __name__ == "__main__":
    main()
