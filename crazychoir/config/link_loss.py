"""How far a streamed drone flies on after its radio fails, and its distance from the fence for that.

A streamed drone gets each set-point by radio. It has no plan on board to continue without them.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass

from crazychoir.config.checks import SWARM_LIMITS, limit_area
from crazychoir.config.radio_checks import drones_by_dongle, has_radio
from crazychoir.config.tables import Position, Swarm


@dataclass(frozen=True, slots=True)
class LinkLossRules:
    """What a streamed drone does after its link fails, and how far it stays from the fence for that."""

    cut_time: float = 2.0
    """Time without set-points after which the motors are off."""
    braking_factor: float = 0.67
    """Factor on v^2 / a that gives the braking distance in m, with the delays of the drone."""
    offered_senders: tuple[str, ...] = ("frpy", "vel")
    """Senders that an error offers in place of one with a longer
    distance, in addition to xyz, which has none.
    """
    home_clearance: float = 0.3
    """Room that is left around each home."""
    largest_share: float = 0.25
    """Largest share of half the fence's width that is given up."""


LINK_LOSS_RULES = LinkLossRules()


TILT_TIMES = {"fpqr": 0.0, "frpy": 0.2, "vel": 0.0, "fullstate": 0.2}
"""s: additional metres for each m/s of speed, because the last tilt is held."""
STRAY_DISTANCES = {"fpqr": 0.5, "frpy": 0.15, "vel": 0.05, "fullstate": 0.15}
"""m: additional distance because the last rates or the last tilt are held, even at low speed.

With these values no drone of the motor level has flown further in 2 s. There were 150 flights on
circles of 0.25 to 0.5 m at 0.02 to 1 m/s for each sender but "fullstate", which is assumed to be as
"frpy".
"""


@dataclass(frozen=True)
class FenceInset:
    """The distance that streamed drones keep from the sides of the fence."""

    needed: float
    """m: distance that a drone needs to stop inside [keep_out]."""
    given: float
    """m: distance that the homes and the size of the fence allow, at most `needed`."""
    slow_enough: float
    """m/s: speed_limit with which `given` suffices; 0 if there is none."""

    @property
    def problem(self) -> str:
        """Text for an error, with what to change; empty if `given` suffices."""
        if self.given >= self.needed:
            return ""
        v = int(100.0 * self.slow_enough) / 100.0  # rounded down
        slower = f"lower speed_limit to {v:.2f} m/s, or " if v else ""
        return (
            f"are kept {self.given:.2f} m inside the fence, room permitting; {self.needed:.2f} m are needed, lest they "
            f"end beyond [keep_out] if a radio fails: {slower}widen [keep_out]"
        )


def distance_without_link(speed: float, acceleration: float, sender: str) -> float:
    """Return how far beyond the fence, in m, a drone's motors stop if its radio fails inside.

        s + max_d (c + t) v(d) - d,   v(d) = min(v_max, sqrt(d a / b))

    c, b: cut_time in s and braking_factor of LINK_LOSS_RULES
    s, t: STRAY_DISTANCES in m and TILT_TIMES in s of the sender

    The drone brakes in front of the fence, so it is slower the nearer it is.
    speed: m/s: v_max
    acceleration: m/s2: a
    sender: kind of command
    """
    seconds = LINK_LOSS_RULES.cut_time + TILT_TIMES[sender]
    k = acceleration / LINK_LOSS_RULES.braking_factor
    v = min(speed, 0.5 * seconds * k)
    return STRAY_DISTANCES[sender] + seconds * v - v * v / k


def allowed_speed(far: float, acceleration: float, sender: str) -> float:
    """Return the largest speed_limit in m/s for which a drone stops at most `far` m beyond the fence.

    See `distance_without_link`. Returns 0 if there is none.

    far: m
    acceleration: m/s2: a
    sender: kind of command
    """
    seconds = LINK_LOSS_RULES.cut_time + TILT_TIMES[sender]
    k = acceleration / LINK_LOSS_RULES.braking_factor
    rest = far - STRAY_DISTANCES[sender]
    if rest <= 0.0:
        return 0.0
    return 0.5 * k * (seconds - math.sqrt(max(0.0, seconds * seconds - 4.0 * rest / k)))


def fence_inset(swarm: Swarm, sender: str) -> FenceInset:
    """Return how far inside [fence] streamed drones stay, so that none ends beyond [keep_out].

    sender: kind of command of these drones
    """
    low, high = limit_area(swarm)
    fence = swarm.fence
    room = min(
        min(f - b, a - e)
        for f, b, a, e in zip(
            fence.min[:2], low[:2], high[:2], fence.max[:2], strict=True
        )
    )
    needed = max(
        0.0,
        distance_without_link(
            swarm.flight.speed_limit, swarm.flight.acceleration_limit, sender
        )
        - room,
    )
    half = min(b - a for a, b in zip(fence.min[:2], fence.max[:2], strict=True)) / 2.0
    homes = [drone.home for drone in swarm.drones if has_radio(drone)]
    given = max(
        0.0,
        min(
            needed,
            LINK_LOSS_RULES.largest_share * half,
            *(
                _distance_to_fence(home, swarm) - LINK_LOSS_RULES.home_clearance
                for home in homes
            ),
        ),
    )
    return FenceInset(
        needed,
        given,
        allowed_speed(given + room, swarm.flight.acceleration_limit, sender),
    )


def describe_crowding(swarm: Swarm, i: int, senders: Mapping[int, str]) -> str:
    """Return a text for an error if drone i starts too near to another drone of the same dongle.

    If the dongle fails, both drones stray, and neither can avoid the other. Only the drone with the
    lower id reports a pair. The text is empty if there is no such drone.

    i: id of a streamed drone
    senders: {drone: kind of command} of all streamed drones
    """
    homes = {drone.id: drone.home[:2] for drone in swarm.drones}
    here = next(ids for ids in drones_by_dongle(swarm).values() if i in ids)
    needed = {
        j: STRAY_DISTANCES[senders[i]]
        + STRAY_DISTANCES[senders[j]]
        + SWARM_LIMITS.touching_distance
        for j in here
        if i < j and j in senders
    }
    near = {
        j: short
        for j in needed
        if (short := needed[j] - math.dist(homes[i], homes[j])) > 0.0
    }
    if not near:
        return ""
    j = max(near, key=near.__getitem__)
    far = math.dist(homes[i], homes[j])
    most = max(STRAY_DISTANCES[senders[i]], STRAY_DISTANCES[senders[j]])
    senders_less = [
        sender
        for sender in LINK_LOSS_RULES.offered_senders
        if STRAY_DISTANCES[sender] < most
    ]
    return (
        f"starts {far:.2f} m from drone {j}, which the same dongle reaches: when that fails, both stray, and "
        f"{needed[j]:.2f} m are needed. Put them further apart, or on two dongles, or send "
        f"{' or '.join([*senders_less, 'xyz'])}"
    )


def _distance_to_fence(p: Position, swarm: Swarm) -> float:
    """Return the distance in m from p to the nearest side of the fence."""
    sides = zip(swarm.fence.min[:2], p[:2], swarm.fence.max[:2], strict=True)
    return min((min(x - a, b - x) for a, x, b in sides), default=math.inf)
