"""What one dongle carries: the radio model of virtual drones, in virtual time.

Neither agents nor firmware take part: packets flow at the rates that the plan of the dongle has.
"""

import math
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np
from rich.table import Table

from crazychoir.config.dongle_plan import (
    LEAST_COMMAND_RATES,
    RADIO_TRAFFIC,
    DonglePlan,
    capacity_of,
    unchecked_plan,
)
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.radio.virtual.air import Air, Deliver, VirtualDongle
from crazychoir.radio.virtual.faults import Faults
from crazychoir.runtime.clock import NS_PER_SECOND, Clock, run_virtual


@dataclass(frozen=True, slots=True)
class DongleCase:
    """One row: the drones of a dongle, and how it reaches them."""

    drones: int
    """Number of drones."""
    sender: str
    """Kind of their commands."""
    rate: float = 0.0
    """Hz of set-points; 0 for lines to the planner on board."""
    inline: bool = False
    """Whether the dongle takes its settings with each packet."""
    broadcast: bool | None = None
    """Whether poses are broadcast; None: as planned."""
    pose_rate: float = 10.0
    """Hz of poses."""
    loss: float = 0.0
    """Probability that a packet is lost, each way."""
    visit: int = RADIO_TRAFFIC.longest_visit
    """Most exchanges of a visit; 1 is cflib's way."""

    def make_swarm(self) -> SwarmConfig:
        """Return a swarm with this dongle."""
        side = math.ceil(math.sqrt(self.drones))
        rows = [
            {
                "id": i,
                "home": [0.5 * (i % side), 0.5 * (i // side), 0.0],
                "uri": f"udp://127.0.0.1:{19850 + i}",
            }
            for i in range(self.drones)
        ]
        radio: dict[str, Any] = {"inline": self.inline, "pose_rate": self.pose_rate}
        if self.broadcast is not None:
            radio["broadcast"] = self.broadcast
        return SwarmConfig.of(
            {
                "name": "bench",
                "drones": rows,
                "control": {"sender": self.sender},
                "radio": radio,
                "fence": {"min": [-4.0, -4.0, 0.0], "max": [9.0, 9.0, 3.0]},
            }
        )


@dataclass(frozen=True, slots=True)
class DongleBenchSettings:
    """The rows, and how long each is measured."""

    seconds: float = 20.0
    """Seconds of virtual time of a row."""
    settling: float = 1.0
    """Seconds at the start that do not count."""
    answer_delay: float = 0.002
    """Seconds until a drone has its answer to a packet."""
    age_step: float = 0.005
    """Seconds between two samples of the age of the last pose at a drone."""
    cases: tuple[DongleCase, ...] = (
        DongleCase(4, "xyz", visit=1),
        DongleCase(6, "xyz", visit=1),
        DongleCase(12, "xyz", visit=1),
        DongleCase(12, "xyz"),
        DongleCase(12, "xyz", broadcast=True),
        DongleCase(12, "xyz", inline=True),
        DongleCase(12, "xyz", inline=True, loss=0.1),
        DongleCase(12, "xyz", inline=True, pose_rate=50.0),
        DongleCase(12, "xyz", inline=True, pose_rate=50.0, loss=0.1),
        DongleCase(4, "frpy", 31.0, visit=1),
        DongleCase(6, "frpy", 50.0, visit=1),
        DongleCase(6, "frpy", 50.0),
        DongleCase(6, "frpy", 50.0, inline=True),
        DongleCase(6, "frpy", 50.0, inline=True, loss=0.1),
        DongleCase(12, "frpy", 50.0, inline=True),
        DongleCase(6, "fpqr", 100.0, inline=True),
    )
    """Rows, in order."""


DONGLE_BENCH = DongleBenchSettings()


@dataclass
class DongleTally:
    """What arrived at the drones and at the client, in the counted time."""

    commands: dict[int, int] = field(default_factory=lambda: defaultdict(int))
    """Set-points or lines that arrived, by drone."""
    command_ages: list[float] = field(default_factory=list)
    """s from making a command to its arrival."""
    poses: dict[int, list[tuple[float, float]]] = field(
        default_factory=lambda: defaultdict(list)
    )
    """Times in s at which poses arrived, and at which they were made, by drone."""
    trips: list[float] = field(default_factory=list)
    """s of round trips of echoes."""

    def pose_ages(self) -> list[float]:
        """Return samples of the age in s of the last pose at the drones."""
        return [
            float(age)
            for rows in self.poses.values()
            for (arrived, made), (ends, _) in pairwise(rows)
            for age in np.arange(arrived, ends, DONGLE_BENCH.age_step) - made
        ]


class DongleTraffic:
    """The packets of one dongle at the planned rates.

    case: what is sent
    """

    def __init__(self, clock: Clock, case: DongleCase) -> None:
        config = case.make_swarm()
        senders = dict.fromkeys(config.ids, case.sender)
        self.clock = clock
        self.case = case
        self.plan: DonglePlan = unchecked_plan(config, 0, senders, case.rate)
        self.dongle = VirtualDongle(
            clock, config.ids, capacity_of(config, 0), case.visit
        )
        self.tally = DongleTally()
        self._airs = {
            i: Air(clock, i, Faults(loss=case.loss), None) for i in config.ids
        }
        self._counts_from = clock.now() + DONGLE_BENCH.settling
        self._newest: dict[tuple[str, int], float] = {}

    def begin(self) -> None:
        """Let all packets flow, each kind of each drone with its own phase."""
        for i in self._airs:
            for row, (rate, send) in enumerate(self._flows()):
                self._repeat(rate, (0.37 * i + 0.29 * row) % 1.0, send, i)
        # Cameras see all drones at once.
        if self.plan.broadcasts:
            self._repeat(self.case.pose_rate, 0.0, self._broadcast, 0)
        else:
            for i in self._airs:
                self._repeat(self.case.pose_rate, 0.0, self._send_pose, i)

    def _flows(self) -> Iterator[tuple[float, Callable[[int], None]]]:
        """Return the rate in Hz of each kind of packet, and the function that sends one to a drone."""
        if self.case.sender in LEAST_COMMAND_RATES:
            yield self.plan.setpoint_rate, self._send_setpoint
        else:
            yield RADIO_TRAFFIC.planner_rate, self._send_line
        yield self.plan.echo_rate, self._send_echo
        yield RADIO_TRAFFIC.request_rate, self._ask
        yield RADIO_TRAFFIC.least_attitude_rate, self._log

    def _repeat(
        self, rate: float, phase: float, send: Callable[[int], None], i: int, k: int = 0
    ) -> None:
        def act() -> None:
            send(i)
            self._repeat(rate, phase, send, i, k + 1)

        self.clock.call_at(round((k + phase) / rate * NS_PER_SECOND), act)

    def _is_counted(self) -> bool:
        return self.clock.now() >= self._counts_from

    # To the drones

    def _send_newest(self, kind: str, i: int, arrives: Callable[[float], None]) -> None:
        """Send a value in place of the waiting one of the same kind."""
        key = (kind, i)
        is_waiting = key in self._newest
        self._newest[key] = self.clock.now()
        if not is_waiting:
            self.dongle.up(i, lambda: self._pass(i, arrives, self._newest.pop(key)))

    def _pass(self, i: int, arrives: Callable[[float], None], made: float) -> None:
        """Let a packet reach drone i, unless it is lost."""
        self._airs[i].rise(lambda: arrives(made))

    def _send(self, i: int, deliver: Deliver) -> None:
        self.dongle.up(i, lambda: self._airs[i].rise(deliver))

    def _send_setpoint(self, i: int) -> None:
        self._send_newest("command", i, lambda made: self._note_command(i, made))

    def _send_line(self, i: int) -> None:
        def arrive(made: float) -> None:
            self._note_command(i, made)
            self._answer(i)

        self._send_newest("command", i, arrive)

    def _send_echo(self, i: int) -> None:
        began = self.clock.now()

        def come_back() -> None:
            if self._is_counted():
                self.tally.trips.append(self.clock.now() - began)

        self._send(i, lambda: self._answer(i, come_back))

    def _ask(self, i: int) -> None:
        self._send(i, lambda: self._answer(i))

    def _send_pose(self, i: int) -> None:
        self._send_newest("pose", i, lambda made: self._note_pose(i, made))

    def _broadcast(self, _: int) -> None:
        """Send the poses of all drones, several in a packet; each drone waits for its own packet."""
        made = self.clock.now()
        for i in self._airs:
            content = bytes([i // RADIO_TRAFFIC.poses_per_packet])
            arrives = partial(self._note_pose, i)
            self.dongle.spread(content, partial(self._pass, i, arrives, made))

    # From the drones

    def _say(self, i: int, deliver: Deliver = lambda: None) -> None:
        self.dongle.down(i, lambda: self._airs[i].sink(deliver))

    def _answer(self, i: int, deliver: Deliver = lambda: None) -> None:
        delay_ns = round(DONGLE_BENCH.answer_delay * NS_PER_SECOND)
        self.clock.call_at(
            self.clock.now_ns() + delay_ns, lambda: self._say(i, deliver)
        )

    def _log(self, i: int) -> None:
        self._say(i)

    # Counting

    def _note_command(self, i: int, made: float) -> None:
        if self._is_counted():
            self.tally.commands[i] += 1
            self.tally.command_ages.append(self.clock.now() - made)

    def _note_pose(self, i: int, made: float) -> None:
        if self._is_counted():
            self.tally.poses[i].append((self.clock.now(), made))


def measure_dongle(
    case: DongleCase, seconds: float = DONGLE_BENCH.seconds
) -> dict[str, Any]:
    """Return the figures of a dongle: shares of its time, Hz, and ms as [50 %, 95 %, largest].

    seconds: s of virtual time
    """

    async def main(clock: Clock) -> dict[str, Any]:
        traffic = DongleTraffic(clock, case)
        traffic.begin()
        await clock.sleep(seconds)
        return _summarize(traffic, seconds)

    return run_virtual(main)


def _summarize(traffic: DongleTraffic, seconds: float) -> dict[str, Any]:
    case = traffic.case
    tally = traffic.tally
    dongle = traffic.dongle
    counted = seconds - DONGLE_BENCH.settling
    changes = dongle.visits + 3 * dongle.spreads
    return {
        "drones": case.drones,
        "sender": case.sender,
        "inline": case.inline,
        "broadcast": traffic.plan.broadcasts,
        "pose_rate_hz": case.pose_rate,
        "loss": case.loss,
        "visit": case.visit,
        "planned": round(traffic.plan.load, 3),
        "busy": round(dongle.busy_ns / NS_PER_SECOND / seconds, 3),
        "busy_changing": round(changes * dongle.time.change / seconds, 3),
        "exchanges_hz": round(dongle.exchanges / seconds, 1),
        "commands_hz": round(
            min(tally.commands[i] for i in range(case.drones)) / counted, 1
        ),
        "command_age_ms": _percentiles(tally.command_ages),
        "pose_age_ms": _percentiles(tally.pose_ages()),
        "round_trip_ms": _percentiles(tally.trips),
        "refused": dongle.refused,
    }


def _percentiles(seconds: Sequence[float]) -> list[float]:
    """Return 50 %, 95 % and the largest, ms."""
    found = np.percentile(seconds, (50.0, 95.0, 100.0))
    return [round(1e3 * float(x), 1) for x in found]


def run(quick: bool, say: Callable[[str], None]) -> list[dict[str, Any]]:
    """Return the figures of all rows.

    quick: shorter rows
    say: called with a text that says what is measured
    """
    say("a dongle, on the radio model")
    seconds = DONGLE_BENCH.seconds / (4.0 if quick else 1.0)
    return [measure_dongle(case, seconds) for case in DONGLE_BENCH.cases]


def table(rows: Sequence[dict[str, Any]]) -> Table:
    """Return a table with one row a case."""
    found = Table(
        "drones",
        "sent",
        "dongle",
        "poses",
        "loss",
        "planned",
        "busy",
        "changing",
        "commands Hz",
        "command ms",
        "pose age ms",
        "round trip ms",
        title="one dongle on the radio model; ms: 50 %, 95 %, largest",
    )
    for row in rows:
        way = "inline" if row["inline"] else f"visits of {row['visit']}"
        poses = "broadcast" if row["broadcast"] else "each"
        found.add_row(
            str(row["drones"]),
            row["sender"],
            way,
            f"{row['pose_rate_hz']:g} Hz, {poses}",
            f"{row['loss']:.0%}",
            f"{row['planned']:.0%}",
            f"{row['busy']:.0%}",
            f"{row['busy_changing']:.0%}",
            f"{row['commands_hz']:g}",
            *(
                " ".join(f"{x:.0f}" for x in row[key])
                for key in ("command_age_ms", "pose_age_ms", "round_trip_ms")
            ),
        )
    return found
