"""Flights that an operator commands while the mission waits.

The mission waits while the drone is held, and before the start.
"""

from typing import Annotated, Any, NoReturn

import msgspec
import numpy as np
from msgspec import Meta, Struct

from crazychoir.agent.drone import Drone
from crazychoir.bus.codec import MAX_PAYLOAD
from crazychoir.errors import ConfigError, Refused
from crazychoir.guidance.flights import FLIGHT_LIMITS
from crazychoir.guidance.guidance import require_feasible
from crazychoir.guidance.member import describe_state
from crazychoir.guidance.turns import is_blocked
from crazychoir.planning.piecewise import POLYNOMIAL_DEGREE, Piecewise
from crazychoir.safety.rules.modes import Mode
from crazychoir.types import Vec

STEERING_INTERVAL = 0.05
"""s: interval at which a flight is checked."""
ARRIVAL_ALLOWANCE = 60.0
"""s beyond the planned time of a flight to an operator's goal, for other drones in the way."""
STOPPED_REFUSAL = "emergency stop in force: no flight until `crazychoir stop --clear`"
"""Reason for a refusal during an emergency stop."""
PIECE_SIZE = 8 * (4 * (POLYNOMIAL_DEGREE + 1) + 1)
"""Bytes of a piece of a path in a message."""
MOST_PIECES = MAX_PAYLOAD // PIECE_SIZE - 10
"""Largest number of pieces of a path in one message."""
Metres = Annotated[float, Meta(ge=-1000.0, le=1000.0)]


class OperatorGoal(Struct, frozen=True, forbid_unknown_fields=True):
    """A goal of an operator."""

    p: tuple[Metres, Metres, Metres]
    """(3,) m, world."""
    yaw: Annotated[float, Meta(ge=-7.0, le=7.0)] | None = None
    """rad. None: keep the present yaw."""
    duration: Annotated[float, Meta(ge=0.0, le=600.0)] = 0.0
    """s, or 0: as fast as the limits allow."""


def path_message(path: Piecewise) -> dict[str, Any]:
    """Return the arguments of `fly`.

    Raises ConfigError for a path that is too long for one message.
    """
    if len(path.durations) > MOST_PIECES:
        raise ConfigError(
            "path",
            f"{len(path.durations)} pieces",
            f"at most {MOST_PIECES}",
            "Draw less at once.",
        )
    return {"coefficients": path.coefficients.copy(), "durations": path.durations}


class Steering:
    """The operator's flights of one drone. A newer command ends an older one."""

    def __init__(self, drone: Drone) -> None:
        self.drone = drone
        self._count = 0

    async def go_to(self, arguments: dict[str, Any]) -> str:
        """Fly to the OperatorGoal in the arguments, and return when the drone is there.

        Raises Refused with the reason if it does not get there.
        """
        try:
            goal = msgspec.convert(arguments, OperatorGoal)
        except msgspec.ValidationError as error:
            self._refuse(f"go-to: {error}; allowed: p [x, y, z] m, yaw rad, duration s")
        self._require_cleared()
        self._require_steerable()
        try:
            place = self.drone.pilot.follower.require_goal(
                "go-to", goal.p, goal.yaw, goal.duration
            )
        except ConfigError as error:
            self._refuse(str(error))
        await self._reach(place, goal.yaw, goal.duration, self._turn())
        return "there"

    async def fly(self, arguments: dict[str, Any]) -> str:
        """Go to the start of the path in the arguments, and fly the path.

        With `relative` in the arguments, the path begins where the drone is. A leader of a formation
        that flies its mission takes the path into the mission.
        Raises Refused with the reason if the path is not flown.
        """
        self._require_cleared()
        try:
            path = Piecewise(arguments["coefficients"], arguments["durations"])
            if self.drone.pilot.airborne and not self.drone.pilot.permission.steerable:
                return self.drone.guidance.led(path)
            if arguments.get("relative", False):
                path = self._shift_here(path)
            require_feasible(path, self.drone.pilot)
        except (ConfigError, KeyError, TypeError, ValueError) as error:
            self._refuse(f"fly: {error}")
        self._require_steerable()
        pilot = self.drone.pilot
        turn = self._turn()
        start = path.sample(0.0)
        await self._reach(start.p, start.yaw, 0.0, turn)
        left = pilot.fly(path, commanded=True)
        while left > 0.0 and pilot.flights.plan is path:
            await self._look(turn)
            left = pilot.remaining()
        if (
            pilot.flights.plan is not path
            or pilot.gap(path.sample(path.duration).p) > FLIGHT_LIMITS.arrival_distance
        ):
            self._refuse(
                f"its path was not flown to the end: {pilot.notes.text or pilot.mode.value}"
            )
        return "flown"

    def _shift_here(self, path: Piecewise) -> Piecewise:
        """Return the path from the place of the drone on; its heading stays as it is in the path."""
        state = self.drone.pilot.state
        if state is None:
            self._refuse("it is not seen")
        return path.shifted((state.p - path.sample(0.0).p).tolist())

    def _turn(self) -> int:
        self._count += 1
        return self._count

    def _require_cleared(self) -> None:
        """Raise Refused during an emergency stop, and for a drone without a guidance.

        During a stop the command is refused even if the motors still turn. When its guidance has
        failed a drone must land.
        """
        if self.drone.port.bus.stopped:
            self._refuse(STOPPED_REFUSAL)
        if why := self.drone.pilot.permission.unguided:
            self._refuse(f"its guidance has failed: {why}")

    def _require_steerable(self) -> None:
        pilot = self.drone.pilot
        if not pilot.airborne:
            self._refuse(f"it is {pilot.mode.value}")
        if not pilot.permission.steerable:
            flies = pilot.mode in (Mode.HOVER, Mode.FOLLOW)
            self._refuse(
                "its mission controls it: hold the drone first"
                if flies
                else f"it is {pilot.mode.value}"
            )

    async def _reach(
        self, p: Vec, yaw: float | None, duration: float, turn: int
    ) -> None:
        pilot = self.drone.pilot
        clock = self.drone.pilot.clock
        attempts = 0
        ends = clock.now() + duration + ARRIVAL_ALLOWANCE
        while attempts < FLIGHT_LIMITS.most_attempts:
            seconds = pilot.go_to(p, yaw, duration, commanded=True)
            if pilot.guard.acts:  # flies as soon as the safety table allows it
                if clock.now() > ends:
                    break
                await self._look(turn)
                continue
            attempts = attempts + 1
            ends = max(ends, clock.now() + seconds + ARRIVAL_ALLOWANCE)
            while pilot.mode is Mode.FOLLOW or is_blocked(pilot):
                await self._look(turn)
                if clock.now() > ends:
                    break
            await self._look(turn)
            if pilot.gap(p) < FLIGHT_LIMITS.arrival_distance:
                return
        place = np.round(p, 2).tolist()
        self._refuse(
            f"does not reach {place}, still {pilot.gap(p):.2f} m from it: {pilot.notes.text or 'no reason'}"
        )

    async def _look(self, turn: int) -> None:
        """Wait for STEERING_INTERVAL s. Raises Refused when the drone does not fly for this command any more."""
        await self.drone.pilot.clock.sleep(STEERING_INTERVAL, drone=self.drone.id)
        if turn != self._count:
            self._refuse("it does what was commanded later")
        self._require_cleared()
        if not self.drone.pilot.permission.steerable:
            pilot = self.drone.pilot
            goes_on = f"it goes on with its mission: {describe_state(pilot)}"
            self._refuse(
                goes_on if pilot.permission.obeys else f"it is {pilot.mode.value}"
            )
        if not self.drone.pilot.permission.commanded:
            self._refuse("it was held on its way")

    def _refuse(self, why: str) -> NoReturn:
        raise Refused(f"drone {self.drone.id}", why)
