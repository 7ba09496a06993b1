"""Flights that an operator commands while the mission waits.

The mission waits while the drone is held, and before the start.
"""

from typing import Any, NoReturn

import numpy as np

from crazychoir.agent.command_arguments import (
    OnBoardFlight,
    OperatorGoal,
    OperatorVelocity,
    convert_arguments,
    convert_path,
)
from crazychoir.agent.drone import Drone
from crazychoir.errors import Refused
from crazychoir.guidance.flights import FLIGHT_LIMITS
from crazychoir.guidance.guidance import require_feasible
from crazychoir.guidance.member import describe_state
from crazychoir.guidance.turns import is_blocked
from crazychoir.planning.piecewise import Piecewise
from crazychoir.planning.point_to_point import PEAK_SPEED
from crazychoir.planning.scaling import PICK_UP_TIME, ResumedTrajectory
from crazychoir.planning.trajectory import Trajectory
from crazychoir.safety.rules.modes import Mode
from crazychoir.simulation.remote import RemoteLink
from crazychoir.types import FullState, Vec, Velocity

STEERING_INTERVAL = 0.05
"""s: interval at which a flight is checked."""
ARRIVAL_ALLOWANCE = 60.0
"""s beyond the planned time of a flight to an operator's goal, for other drones in the way."""
STOPPED_REFUSAL = "emergency stop in force: no flight until `crazychoir stop --clear`"
"""Reason for a refusal during an emergency stop."""
FIRMWARE_DEADLINE = 4.5
"""s: longest time for an answer of a drone's firmware."""
UPLOAD_DEADLINE = 30.0
"""s: longest time for the upload of a trajectory: 171 packets."""
LOADED_AGE = 60.0
"""s after `load` within which its trajectory is not uploaded again."""


def require_firmware(drone: Drone) -> RemoteLink:
    """Return the link to the firmware of a drone; raise Refused if it has none."""
    if drone.remote is None or drone.radio_watch is None:
        raise Refused(
            f"drone {drone.id}",
            "it has no firmware here: only drones with a uri udp:// or radio:// have",
        )
    return drone.remote


class Steering:
    """The operator's flights of one drone. A newer command ends an older one."""

    def __init__(self, drone: Drone) -> None:
        self.drone = drone
        self._count = 0
        self._loaded: Piecewise | None = None
        self._loaded_at = 0.0
        self._on_board_turn = 0

    async def go_to(self, arguments: dict[str, Any]) -> str:
        """Fly to the OperatorGoal in the arguments, and return when the drone is there.

        Raises Refused with the reason if it does not get there.
        """
        goal = convert_arguments("go-to", arguments, OperatorGoal)
        self._require_cleared()
        self._require_steerable()
        here = self._get_set_point()
        wanted = np.array(goal.p)
        yaw = goal.yaw
        if goal.relative:
            wanted = here.p + wanted
            yaw = None if yaw is None else here.yaw + yaw
        duration = goal.duration
        if goal.speed is not None:
            distance = float(np.linalg.norm(wanted - here.p))
            duration = max(duration, PEAK_SPEED * distance / goal.speed)
        place = self.drone.pilot.follower.require_goal("go-to", wanted, yaw, duration)
        await self._reach(place, yaw, duration, self._turn())
        return "there"

    async def move(self, arguments: dict[str, Any]) -> str:
        """Fly with the OperatorVelocity in the arguments, then come to rest.

        The fence and the collision filter act as on the velocity of a law.
        Raises Refused with the reason if the drone is stopped on its way.
        """
        asked = convert_arguments("velocity", arguments, OperatorVelocity)
        self._require_cleared()
        self._require_steerable()
        pilot = self.drone.pilot
        turn = self._turn()
        yaw = self._get_set_point().yaw
        began = pilot.clock.now()
        while (t := pilot.clock.now() - began) < asked.duration:
            wanted = Velocity(np.array(asked.v), yaw + asked.yaw_rate * t)
            if not pilot.follow(wanted, commanded=True):
                self._refuse(pilot.notes.text)
            await self._look(turn)
        pilot.hover(commanded=True)
        return "flown"

    async def load(self, arguments: dict[str, Any]) -> str:
        """Upload the path in the arguments of a `fly` that follows, without moving the drone.

        Several drones that are loaded one after another can then begin together. A drone that its
        mission flies is left as it is: the mission takes the path itself.
        Raises Refused with the reason if the path is not uploaded.
        """
        path, _ = convert_path(arguments)
        pilot = self.drone.pilot
        if pilot.airborne and not pilot.permission.steerable:
            return "flown by its mission"
        if self._on_board_turn:
            self._refuse("it flies a trajectory from its memory: hold the drone first")
        self._loaded = None
        await self._upload(path)
        self._loaded = path
        self._loaded_at = self.drone.pilot.clock.now()
        return "loaded"

    async def fly(self, arguments: dict[str, Any]) -> str:
        """Go to the start of the path in the arguments, and fly the path.

        With `relative` in the arguments, the path begins where the drone is. With `on_board`, an
        OnBoardFlight, the planner on board flies it from its memory. A leader of a formation
        that flies its mission takes the path into the mission.
        Raises Refused with the reason if the path is not flown.
        """
        self._require_cleared()
        path, asked = convert_path(arguments)
        pilot = self.drone.pilot
        on_board = asked.on_board
        flown = path if on_board is None else on_board.apply(path)
        if asked.relative and pilot.airborne:
            here = self._get_set_point().p
            flown = flown.shifted((here - flown.sample(0.0).p).tolist())
        if pilot.airborne and not pilot.permission.steerable:
            return self.drone.guidance.led(flown)
        self._require_steerable()
        require_feasible(flown, pilot)
        turn = self._turn()
        pilot.permission.may_fly(
            by_operator=True
        )  # from here on, a hold ends the flight
        if on_board is not None and not self._take_loaded(path):
            await self._upload(path)
            self._require_turn(turn)
        start = flown.sample(0.0)
        await self._reach(start.p, start.yaw, 0.0, turn)
        if on_board is None:
            return await self._follow(flown, turn)
        self._on_board_turn = turn
        try:
            await self._start_on_board(flown, on_board, asked.relative)
            self._require_turn(turn)
            return await self._follow(flown, turn)
        finally:
            if self._on_board_turn == turn:
                self._on_board_turn = 0

    async def _follow(self, path: Piecewise, turn: int) -> str:
        """Fly the path from its start, where the drone is.

        The drone's agent continues a path that the safety table brakes, from where the drone stopped.
        Raises Refused if it is not flown to its end.
        """
        pilot = self.drone.pilot
        left: Trajectory = path
        for _ in range(FLIGHT_LIMITS.most_attempts):
            braked = pilot.judge.braked
            t = await self._fly_until_stopped(left, turn)
            if pilot.flights.plan is left and pilot.gap(path.end[0:3]) <= (
                FLIGHT_LIMITS.arrival_distance
            ):
                return "flown"
            if pilot.judge.braked == braked or not 0.0 < t < left.duration:
                break
            flight = pilot.setup.limits
            pace = 4.0 * flight.speed_limit / flight.acceleration_limit
            left = ResumedTrajectory(left, t, max(PICK_UP_TIME, pace))
            start = left.sample(0.0)
            await self._reach(start.p, start.yaw, 0.0, turn)
        self._refuse(
            f"its path was not flown to the end: {pilot.notes.text or pilot.mode.value}"
        )

    async def _fly_until_stopped(self, path: Trajectory, turn: int) -> float:
        """Fly a path until it ends or is stopped, and return how many s of it were flown."""
        pilot = self.drone.pilot
        t = 0.0
        left = pilot.fly(path, commanded=True)
        while left > 0.0 and pilot.flights.plan is path:
            t = pilot.clock.now() - pilot.flights.start
            await self._look(turn)
            left = pilot.remaining()
        return t

    def _take_loaded(self, path: Piecewise) -> bool:
        """Return whether `load` has just uploaded this path; it does so for one flight only."""
        loaded = self._loaded
        self._loaded = None
        return (
            loaded is not None
            and self.drone.pilot.clock.now() < self._loaded_at + LOADED_AGE
            and np.array_equal(loaded.durations, path.durations)
            and np.array_equal(loaded.coefficients, path.coefficients)
        )

    async def _upload(self, path: Piecewise) -> None:
        """Upload the path into the memory of the drone. Raises Refused with the reason."""
        remote = require_firmware(self.drone)
        told = {"coefficients": path.coefficients.copy(), "durations": path.durations}
        await remote.request("trajectory_upload", UPLOAD_DEADLINE, **told)

    async def _start_on_board(
        self, flown: Piecewise, on_board: OnBoardFlight, is_relative: bool
    ) -> None:
        """Let the planner on board begin the uploaded path. Raises Refused with the reason.

        flown: the path in the world, as it will be flown
        """
        await require_firmware(self.drone).request(
            "trajectory_start",
            FIRMWARE_DEADLINE,
            coefficients=flown.coefficients.copy(),
            durations=flown.durations,
            timescale=on_board.timescale,
            reversed=on_board.reversed,
            relative=is_relative,
        )

    def _get_set_point(self) -> FullState:
        """Return the set-point of the planned flight now; without a plan, the state of the drone."""
        pilot = self.drone.pilot
        return pilot.flights.departure(pilot.row.get_state(), pilot.clock.now())

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
                else f"it is {describe_state(pilot)}"
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
        """Wait for STEERING_INTERVAL s, then do as `_require_turn`."""
        await self.drone.pilot.clock.sleep(STEERING_INTERVAL, drone=self.drone.id)
        self._require_turn(turn)

    def _require_turn(self, turn: int) -> None:
        """Raise Refused when the drone does not fly for this command any more."""
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
