"""Member: what a guidance gets from its drone; and how flights end or fail."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.errors import CrazyChoirError, error_text
from crazychoir.flight.pilot import Pilot
from crazychoir.guidance.decision.law_stage import LawStage
from crazychoir.guidance.sensors import Sensors
from crazychoir.guidance.turns import is_blocked
from crazychoir.runtime.clock import Clock
from crazychoir.runtime.user_code_guard import GuardFactory
from crazychoir.safety.rules.modes import Mode
from crazychoir.team.communicator import Communicator
from crazychoir.types import State

FLIGHT_LOOK_INTERVAL = 0.05
"""s: interval at which a mission looks again."""
HELD_FLIGHT_PATIENCE = 300.0
"""s: how long a flight waits while the pilot is held or the safety table stops it.

A take-off also waits this long for the first pose.
"""


@dataclass
class Member:
    """What a guidance gets from its drone: its id, its team, its communicator and its pilot."""

    id: int
    """Id of the drone."""
    config: SwarmConfig
    """The swarm file."""
    clock: Clock
    """Clock of the swarm."""
    communicator: Communicator
    """The link to the neighbours."""
    pilot: Pilot
    """The pilot that flies the drone."""
    watchdog: GuardFactory | None = None
    """Guard against user code that does not return. None: no guard."""
    laws: LawStage | None = None
    """The decide stage of the process. None: the law of this drone has one of its own."""
    report: Callable[[], dict[str, Any]] = dict
    """Returns the state of the mission for the status: task, round, cost."""
    announce: Callable[[], None] = lambda: None
    """Publishes the status now, not at its next tick."""
    ended: str = ""
    """Why the mission is over. Empty while it runs.

    From then on the mission cannot fly, even if it catches the exception and continues.
    """
    sensors: Sensors | None = None
    """Readings of the drone's sensors. None: it has none."""
    gate: str = ""
    """Key of GATE_STATUS_TEXTS: the command of the operator that the mission waits for. Empty: none."""
    rise: float | None = None
    """m above the ground: height of the take-off that the mission waits for.

    None: that of the swarm file.
    """


def get_state(member: Member) -> State:
    """Return the newest estimate of the drone's own state.

    Before the first pose it is a level state at the home of the drone.
    """
    state = member.pilot.state
    return State.at(member.config.drone(member.id).home) if state is None else state


class Interrupted(CrazyChoirError):
    """The pilot does something else than the guidance asked: it lands, or its motors are cut."""


UNNOTED_REASONS = {
    Mode.GROUND: "it has not taken off, or has landed",
    Mode.TAKEOFF: "it still rises",
    Mode.HOVER: "nothing has stopped it",
    Mode.FOLLOW: "nothing has stopped it",
    Mode.RETURN: "its operator has sent it home",
    Mode.LAND: "it was told to land",
    Mode.CUT: "its motors were cut",
}
"""Reason for each mode when the pilot has noted none."""


def describe_state(pilot: Pilot) -> str:
    """Return what a drone does and why, such as "landing: pose 0.61 s old".

    The reason is never empty.
    """
    return f"{pilot.mode.value}: {pilot.notes.text or UNNOTED_REASONS[pilot.mode]}"


async def wait_for_touchdown(pilot: Pilot, grace: float) -> None:
    """Wait until the motors of a pilot are off.

    While the drone gives way to others it waits at most HELD_FLIGHT_PATIENCE s.

    grace: s to wait beyond the end of the planned flight, even if the pilot plans a new one
        meanwhile.
    """
    clock = pilot.clock
    ends = clock.now() + grace
    patient = clock.now() + HELD_FLIGHT_PATIENCE
    while pilot.airborne and clock.now() < ends:
        if (
            pilot.permission.held and pilot.mode is Mode.HOVER
        ):  # the operator has sent it home
            ends = clock.now() + grace
            if clock.now() > patient:
                pilot.land(
                    f"held for {HELD_FLIGHT_PATIENCE:g} s after the end of its mission: landing"
                )
        if pilot.remaining() > 0.0 or (is_blocked(pilot) and clock.now() < patient):
            ends = clock.now() + pilot.remaining() + grace
        await clock.sleep(FLIGHT_LOOK_INTERVAL, drone=pilot.port.address)


def make_raisable(error: BaseException, where: str) -> BaseException:
    """Return an error with which a task may end.

    asyncio and generators use some exceptions as signals of their own, such as StopIteration. Such
    an exception becomes an ordinary RuntimeError.

    where: the code that raised it, for the text.
    """
    if isinstance(error, Exception | SystemExit) and not isinstance(
        error, StopIteration
    ):
        return error
    ordinary = RuntimeError(f"{where} raised {error_text(error)}")
    ordinary.__cause__ = error
    return ordinary.with_traceback(error.__traceback__)
