"""How far a drone that is streamed set-points flies on when its radio fails, and how far inside it therefore stays."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

from crazychoir.config.checks import TOUCHING, limit_area
from crazychoir.config.radio_checks import dongles, is_reached
from crazychoir.config.tables import Position, Swarm

HELD, CUT = 0.5, 2.0
"""s for which the firmware holds the last set-point, then the drone is level; and after which its motors are off."""
BRAKES = 0.67
"""Of v^2 / a: m in which a drone comes to rest, with its delays."""
TILTED = {"fpqr": 0.0, "frpy": 0.2, "vel": 0.0, "fullstate": 0.2}
"""s: what holding the last tilt adds for each m/s of speed."""
STRAYS = {"fpqr": 0.5, "frpy": 0.15, "vel": 0.05, "fullstate": 0.15}
"""m that are added by the last rates, or the last tilt, however slow it was. With these, no drone of the motor level
has flown further in 2 s, of 150 on circles of 0.25 to 0.5 m at 0.02 to 1 m/s, for each sender but "fullstate", which
is taken to be as "frpy"."""
OFFERED = ("frpy", "vel")
"""Senders of those that are offered in place of one that strays further; beside them xyz, which does not stray."""
SPACE, MOST = 0.3, 0.25
"""m that is left around each home; and the share of half the fence that is given up at most."""


@dataclass(frozen=True)
class Inset:
    """needed: m, from the fence; given: m, as far as homes and the room allow; slow_enough: m/s, the speed_limit with
    which what is given is enough, 0 if none is.
    """

    needed: float
    given: float
    slow_enough: float

    @property
    def problem(self) -> str:
        """What to change; empty if there is room."""
        if self.given >= self.needed:
            return ""
        v = int(100.0 * self.slow_enough) / 100.0  # a little less
        slower = f"lower speed_limit to {v:.2f} m/s, or " if v else ""
        return (
            f"are kept {self.given:.2f} m inside the fence, room permitting; {self.needed:.2f} m are needed, lest they "
            f"end beyond [keep_out] if a radio fails: {slower}widen [keep_out]"
        )


def flies_on(speed: float, acceleration: float, sender: str) -> float:
    """m, beyond the fence, at which a drone is when its motors stop, if it was kept inside until its radio failed.

        s + max_d (CUT + t) v(d) - d,   v(d) = min(v_max, sqrt(d a / BRAKES)),   s = STRAYS,  t = TILTED

    It brakes in front of the fence, so it is slower the nearer it is.  speed: m/s;  acceleration: m/s2.
    """
    seconds = CUT + TILTED[sender]
    k = acceleration / BRAKES
    v = min(speed, 0.5 * seconds * k)
    return STRAYS[sender] + seconds * v - v * v / k


def slow_enough(far: float, acceleration: float, sender: str) -> float:
    """m/s: the speed_limit with which `flies_on` is `far` m at most; 0 where none is."""
    seconds = CUT + TILTED[sender]
    k = acceleration / BRAKES
    rest = far - STRAYS[sender]
    if rest <= 0.0:
        return 0.0
    return 0.5 * k * (seconds - math.sqrt(max(0.0, seconds * seconds - 4.0 * rest / k)))


def inset(swarm: Swarm, sender: str) -> Inset:
    """How far inside [fence] drones stay that are streamed set-points by a radio, lest they end beyond [keep_out]."""
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
        flies_on(swarm.flight.speed_limit, swarm.flight.acceleration_limit, sender)
        - room,
    )
    half = min(b - a for a, b in zip(fence.min[:2], fence.max[:2], strict=True)) / 2.0
    homes = [drone.home for drone in swarm.drones if is_reached(drone)]
    given = max(
        0.0, min(needed, MOST * half, *(_inside(home, swarm) - SPACE for home in homes))
    )
    return Inset(
        needed,
        given,
        slow_enough(given + room, swarm.flight.acceleration_limit, sender),
    )


def crowded(swarm: Swarm, i: int, senders: Mapping[int, str]) -> str:
    """Whom of the same dongle drone i may touch when that fails, by where they start; empty if nobody.

    Both stray then, and neither can keep clear of the other. A pair is said of its lower id.
    senders: of all drones that are streamed set-points, i among them.
    """
    homes = {drone.id: drone.home[:2] for drone in swarm.drones}
    here = next(ids for ids in dongles(swarm).values() if i in ids)
    needed = {
        j: STRAYS[senders[i]] + STRAYS[senders[j]] + TOUCHING
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
    most = max(STRAYS[senders[i]], STRAYS[senders[j]])
    senders_less = [sender for sender in OFFERED if STRAYS[sender] < most]
    return (
        f"starts {far:.2f} m from drone {j}, which the same dongle reaches: when that fails, both stray, and "
        f"{needed[j]:.2f} m are needed. Put them further apart, or on two dongles, or send "
        f"{' or '.join([*senders_less, 'xyz'])}"
    )


def _inside(p: Position, swarm: Swarm) -> float:
    """m from the nearest side."""
    sides = zip(swarm.fence.min[:2], p[:2], swarm.fence.max[:2], strict=True)
    return min((min(x - a, b - x) for a, x, b in sides), default=math.inf)
