"""Plan the time of a dongle, and refuse drones that it cannot carry.

A dongle exchanges a packet with a drone in some time. Before it speaks to another drone it must be told
the address of that drone, which takes longer. So it visits its drones in turn, and a visit has several
exchanges.

    load = sum_i (v_i c + e_i x) + p (k_c c + k_x x)

    x, c: s for an exchange, and for a change of the settings of the dongle
    v_i, e_i: visits and exchanges a second of drone i
    p, k_c, k_x: broadcasts of all poses a second; the changes and packets of each
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass

from crazychoir.config.radio_checks import drones_by_dongle, radio_settings
from crazychoir.config.tables import Swarm
from crazychoir.errors import ConfigError


@dataclass(frozen=True, slots=True)
class RadioTraffic:
    """Packets a second that drones need, and the time of a dongle."""

    echo_rate: float = 10.0
    """Most packets a second and drone: echoes."""
    dongle_echo_rate: float = 40.0
    """Most packets a second and dongle: echoes."""
    planner_rate: float = 10.0
    """Packets a second and drone: lines for the planner on board."""
    request_rate: float = 2.0
    """Packets a second and drone: other requests."""
    least_attitude_rate: float = 20.0
    """Least Hz at which a drone that cameras see reports its attitude."""
    uncertainty_rate: float = 10.0
    """Hz at which a drone that estimates its own pose reports the uncertainty of it."""
    least_visit_rate: float = 10.0
    """Least visits a second of each drone; so a packet waits for 0.1 s at most."""
    longest_visit: int = 4
    """Most exchanges of a visit."""
    poses_per_packet: int = 2
    """Poses in a broadcast packet."""
    single_drone_capacity: float = 1000.0
    """Packets a second of a dongle that reaches one drone, and so never changes its channel and
    address. Source: reports of users of cflib; it was not measured here.
    """
    shared_capacity: float = 250.0
    """Packets a second of a dongle that changes its address before each. Source: as above."""
    inline_capacity: float = 1250.0
    """Packets a second of a Crazyradio 2.0 in its inline mode, with any number of drones. Its
    developers report 1274 to 1370 (crazyradio2-firmware, issue 23); it was not measured here.
    """
    planned_share: float = 0.85
    """Share of the time of a dongle that is planned. Close to 1, packets wait for each other."""
    largest_command_rate: float = 100.0
    """Hz: one command for each pose."""


RADIO_TRAFFIC = RadioTraffic()
LEAST_COMMAND_RATES = {"fpqr": 50.0, "frpy": 30.0, "vel": 10.0, "fullstate": 20.0}
"""Least Hz of set-points, by the kind of command; a drone does not fly with fewer."""


@dataclass(frozen=True, slots=True)
class DongleTime:
    """How long a dongle takes."""

    exchange: float
    """s for a packet up and its acknowledgement, which carries a packet down."""
    change: float
    """s to set another address, channel, data rate or way to acknowledge."""

    @classmethod
    def of(cls, capacity: float, drones: int) -> "DongleTime":
        """Return the times of a dongle.

        capacity: packets a second, if each goes to another drone than the last
        drones: number of its drones
        """
        if drones == 1:
            return cls(1.0 / capacity, 0.0)
        exchange = 1.0 / max(capacity, RADIO_TRAFFIC.single_drone_capacity)
        return cls(exchange, 1.0 / capacity - exchange)

    def broadcast(self, packets: int) -> float:
        """Return the s of a broadcast.

        The dongle is told to wait for no acknowledgement, the address, and to wait again.
        """
        return 3.0 * self.change + packets * self.exchange


@dataclass(frozen=True, slots=True)
class DonglePlan:
    """The packets of a dongle that its drones need."""

    setpoint_rate: float
    """Hz of set-points of each streamed drone; 0 without one."""
    echo_rate: float
    """Hz of echoes of each drone."""
    broadcasts: bool
    """True: poses are broadcast. False: each drone is sent its own."""
    load: float
    """Share of the time of the dongle that is needed."""
    up: float
    """Packets a second to the drones."""

    @property
    def packet_rate(self) -> float:
        """Packets a second to the drones, if the dongle sends the same mix all the time."""
        return self.up / self.load


def is_inline(swarm: Swarm, dongle: int) -> bool:
    """Return whether a dongle is said to take its settings with each packet."""
    row = next((row for row in swarm.radio.dongles if row.dongle == dongle), None)
    return swarm.radio.inline if row is None or row.inline is None else row.inline


def capacity_of(swarm: Swarm, dongle: int) -> float:
    """Return the packets a second of a dongle, from its row, else from [radio], else by its kind.

    A dongle that never changes its channel has at least single_drone_capacity.
    """
    row = next((row for row in swarm.radio.dongles if row.dongle == dongle), None)
    said = row.capacity if row is not None else None
    capacity = said or swarm.radio.capacity
    if capacity is None:
        capacity = (
            RADIO_TRAFFIC.inline_capacity
            if is_inline(swarm, dongle)
            else RADIO_TRAFFIC.shared_capacity
        )
    return (
        max(capacity, RADIO_TRAFFIC.single_drone_capacity)
        if len(drones_by_dongle(swarm)[dongle]) == 1
        else capacity
    )


def plan_dongle(swarm: Swarm, dongle: int, senders: Mapping[int, str]) -> DonglePlan:
    """Return the plan of a dongle, with as many set-points as it carries.

    senders: {drone: kind of command}
    Raises ConfigError, with the numbers, if the dongle cannot carry its drones.
    """
    loads = _Loads(swarm, dongle, senders)
    radio = swarm.radio
    least = loads.least_rate
    most = 1.0 if radio.command_rate and loads.streamed else RADIO_TRAFFIC.planned_share
    rate = radio.command_rate or min(
        loads.fitting_rate(most), RADIO_TRAFFIC.largest_command_rate
    )
    rate = rate if loads.streamed else 0.0
    if rate >= least and loads.total(rate) <= most:
        return loads.plan(rate)
    fits = loads.fitting_rate(1.0)
    if 0.0 < radio.command_rate < least <= fits:
        kinds = loads.kinds
        allowed = (
            f"{least:g} to {fits:g} Hz, for what is sent by dongle {dongle} ({kinds})"
        )
        do = "Leave it out to choose the rate automatically."
        raise ConfigError("radio.command_rate", rate, allowed, do)
    raise loads.refusal(max(rate, least), fits)


def unchecked_plan(
    swarm: Swarm, dongle: int, senders: Mapping[int, str], rate: float
) -> DonglePlan:
    """Return the plan of a dongle, even if it cannot carry its drones.

    senders: {drone: kind of command}
    rate: Hz of set-points of each streamed drone
    """
    return _Loads(swarm, dongle, senders).plan(rate)


class _Loads:
    """The time that a dongle needs for its drones.

    senders: {drone: kind of command}
    """

    def __init__(self, swarm: Swarm, dongle: int, senders: Mapping[int, str]) -> None:
        self.swarm = swarm
        self.dongle = dongle
        self.ids = drones_by_dongle(swarm)[dongle]
        self.senders = {i: senders[i] for i in self.ids}
        self.streamed = [i for i in self.ids if senders[i] in LEAST_COMMAND_RATES]
        self.capacity = capacity_of(swarm, dongle)
        self.time = DongleTime.of(self.capacity, len(self.ids))
        self.echo = min(
            RADIO_TRAFFIC.echo_rate, RADIO_TRAFFIC.dongle_echo_rate / len(self.ids)
        )
        poses = {drone.id: drone.pose for drone in swarm.drones}
        self.seen = [i for i in self.ids if poses[i] == "mocap"]
        self.broadcasts = self._choose_broadcast()

    @property
    def kinds(self) -> str:
        """The kinds of command, as text."""
        return ", ".join(sorted(set(self.senders.values())))

    @property
    def least_rate(self) -> float:
        """Least Hz of set-points that the drones need."""
        return max(
            (LEAST_COMMAND_RATES[self.senders[i]] for i in self.streamed), default=0.0
        )

    def _choose_broadcast(self) -> bool:
        """Return whether poses are broadcast.

        Without a word of the swarm file: if that needs less time, or the dongle needs no time for
        changes, so that broadcast poses are younger.
        """
        said = self.swarm.radio.broadcast
        if len(self.ids) == 1 or len(self.seen) < 2:
            return False
        if said is not None:
            return said
        if self.time.change == 0.0:
            return True
        loads = {}
        for self.broadcasts in (False, True):
            loads[self.broadcasts] = self.total(self.least_rate)
        return loads[True] < loads[False]

    def _settings(self) -> int:
        """Return the number of different channels and data rates."""
        rows = {drone.id: drone for drone in self.swarm.drones}
        return len({radio_settings(rows[i]) for i in self.ids})

    def _exchanges(self, i: int, rate: float) -> tuple[float, float, float]:
        """Return the packets a second to drone i and from it, and its visits a second.

        rate: Hz of set-points
        """
        radio = self.swarm.radio
        asked = self.echo + RADIO_TRAFFIC.request_rate
        is_streamed = i in self.streamed
        commands = rate if is_streamed else RADIO_TRAFFIC.planner_rate
        answers = 0.0 if is_streamed else RADIO_TRAFFIC.planner_rate
        logs = (
            max(radio.log_rate, RADIO_TRAFFIC.least_attitude_rate)
            if i in self.seen
            else radio.log_rate + RADIO_TRAFFIC.uncertainty_rate
        ) + self._extra_logs(i)
        poses = radio.pose_rate if i in self.seen and not self.broadcasts else 0.0
        visits = max(
            commands,
            poses,
            RADIO_TRAFFIC.least_visit_rate,
            0.0 if i in self.seen else radio.log_rate,
        )
        return asked + commands + poses, asked + answers + logs, visits

    def _extra_logs(self, i: int) -> float:
        """Return the packets a second of the [[logs]] of drone i."""
        return sum(
            row.rate for row in self.swarm.logs if row.drones is None or i in row.drones
        )

    def parts(self, rate: float) -> dict[str, float]:
        """Return the share of time for each use of the dongle.

        rate: Hz of set-points of each streamed drone
        """
        rows = [self._exchanges(i, rate) for i in self.ids]
        settings = self._settings()
        change = self.time.change * (1 if settings == 1 else 2)
        single = len(self.ids) == 1
        return {
            "exchanges": self.time.exchange
            * sum(max(up, down) for up, down, _ in rows),
            "changes of the drone": 0.0
            if single
            else change * sum(row[2] for row in rows),
            "broadcast poses": self._broadcast_time(settings),
        }

    def _broadcast_time(self, settings: int) -> float:
        """Return the share of time for broadcasts.

        settings: number of different channels and data rates
        """
        if not self.broadcasts:
            return 0.0
        packets = math.ceil(len(self.seen) / RADIO_TRAFFIC.poses_per_packet)
        once = settings * self.time.broadcast(0) + packets * self.time.exchange
        return self.swarm.radio.pose_rate * once

    def total(self, rate: float) -> float:
        """Return the share of time that is needed."""
        return sum(self.parts(rate).values())

    def fitting_rate(self, most: float) -> float:
        """Return the largest whole Hz of set-points that need at most this share of the time."""
        if not self.streamed:
            return 0.0
        rate = 0
        while rate < 1000 and self.total(rate + 1.0) <= most:
            rate += 1
        return float(rate)

    def plan(self, rate: float) -> DonglePlan:
        """Return the plan with so many Hz of set-points."""
        up = sum(self._exchanges(i, rate)[0] for i in self.ids)
        if self.broadcasts:
            packets = math.ceil(len(self.seen) / RADIO_TRAFFIC.poses_per_packet)
            up += self.swarm.radio.pose_rate * packets
        return DonglePlan(rate, self.echo, self.broadcasts, self.total(rate), up)

    def refusal(self, asked: float, fits: float) -> ConfigError:
        """Return the error that says what the dongle cannot carry.

        asked: Hz of set-points
        fits: Hz that it carries
        """
        radio = self.swarm.radio
        named = ", ".join(map(str, self.ids))
        found = f"drones {named} ({self.kinds}) need {100.0 * self.total(asked):.0f} % of its time"
        problem = ", ".join(
            f"{name} {100.0 * share:.0f} %"
            for name, share in self.parts(asked).items()
            if share
        )
        share = RADIO_TRAFFIC.planned_share
        carries = f"it exchanges {self.capacity:g} packets a second"
        if self.streamed:
            problem = f"{len(self.streamed)} x {asked:g} set-points a second; {problem}"
            room = (
                f"{carries}, {self.fitting_rate(share):g} set-points a second and drone"
            )
        else:
            room = f"{carries}; {100.0 * share:g} % may be planned"
        ways = ["Use more dongles"]
        if self.time.change > 0.0 and not is_inline(self.swarm, self.dongle):
            ways.append("a Crazyradio 2.0 with inline = true ([radio])")
        if self.streamed and fits >= self.least_rate:
            ways.append(f"set command_rate = {self.least_rate:g} to {fits:g} ([radio])")
        elif self.streamed:
            lighter = [
                kind for kind, rate in LEAST_COMMAND_RATES.items() if rate <= fits
            ]
            if lighter:
                ways.append(f"send {' or '.join(lighter)} ({fits:g} Hz at most)")
        if any(self._extra_logs(i) for i in self.ids):
            ways.append("lower rates in [[logs]]")
        if radio.log_rate > RADIO_TRAFFIC.least_attitude_rate:
            ways.append("a lower log_rate ([radio])")
        if radio.pose_rate > RADIO_TRAFFIC.least_visit_rate:
            ways.append("a lower pose_rate ([radio])")
        do = f"{', '.join(ways)}, or measure its capacity."
        return ConfigError(f"dongle {self.dongle}", found, room, do, problem)
