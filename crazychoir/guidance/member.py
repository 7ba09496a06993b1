"""What a guidance gets from its drone, and what both of them know about flights: how they end, and how they fail."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.errors import CrazyChoirError
from crazychoir.flight.pilot import Pilot
from crazychoir.guidance.sensors import Sensors
from crazychoir.guidance.turns import blocked
from crazychoir.runtime.clock import Clock
from crazychoir.runtime.user_code_guard import Guards
from crazychoir.safety.rules.modes import Mode
from crazychoir.team.communicator import Communicator

SETTLE = 0.05
PATIENCE = 300.0
"""s that a flight waits for a pilot that is held, or that the safety table has stopped; and for a first pose."""


@dataclass
class Member:
    """What a guidance gets from its drone: who it is, its team, its way to talk, its way to fly."""

    id: int
    config: SwarmConfig
    clock: Clock
    communicator: Communicator
    pilot: Pilot
    watchdog: Guards | None = None
    report: Callable[[], dict[str, Any]] = dict
    """Says how the mission goes: task, round, cost, for the status."""
    announce: Callable[[], None] = lambda: (
        None
    )  # publishes the status now, not at its next tick
    ended: str = ""
    """Why the mission is over; from then on it flies no more, whatever it catches and goes on with."""
    sensors: Sensors | None = None
    gate: str = ""
    """The command of its operator, of GATES, that the mission waits for."""
    rise: float | None = None
    """m, the height of the take-off that it waits for; None: that of the swarm file."""


class Interrupted(CrazyChoirError):
    """The pilot does something else than what guidance asked: it lands, or its motors are cut."""


UNSAID_OF = {
    Mode.GROUND: "it has not taken off, or has landed",
    Mode.TAKEOFF: "it still rises",
    Mode.HOVER: "nothing has stopped it",
    Mode.FOLLOW: "nothing has stopped it",
    Mode.RETURN: "its operator has sent it home",
    Mode.LAND: "it was told to land",
    Mode.CUT: "its motors were cut",
}
"""Why a drone is in a mode, where its pilot has noted nothing."""


def standing(pilot: Pilot) -> str:
    """Return what a drone does and why, such as "landing: pose 0.61 s old"; the why is never empty."""
    return f"{pilot.mode.value}: {pilot.note or UNSAID_OF[pilot.mode]}"


async def touch_down(pilot: Pilot, grace: float) -> None:
    """Wait until a pilot's motors are off; at most `grace` s beyond the flight that it has planned, whenever it did.

    At most PATIENCE s while it gives way to others.
    """
    clock = pilot.clock
    ends = clock.now() + grace
    patient = clock.now() + PATIENCE
    while pilot.airborne and clock.now() < ends:
        if pilot.held and pilot.mode is Mode.HOVER:  # on its way home
            ends = clock.now() + grace
            if clock.now() > patient:
                pilot.land(f"held for {PATIENCE:g} s, with its mission over: landing")
        if pilot.remaining() > 0.0 or (blocked(pilot) and clock.now() < patient):
            ends = clock.now() + pilot.remaining() + grace
        await clock.sleep(SETTLE, drone=pilot.drone)


def raisable(error: BaseException, where: str) -> BaseException:
    """An error that a task may end with: what asyncio and generators take for signals of their own becomes ordinary."""
    if isinstance(error, Exception | SystemExit) and not isinstance(
        error, StopIteration
    ):
        return error
    ordinary = RuntimeError(f"{where} raised {error!r}")
    ordinary.__cause__ = error
    return ordinary.with_traceback(error.__traceback__)
