"""Runs a mission at one drone, from GO to its end.

The result is final when the drone is on the ground.
"""

import asyncio
import logging
from collections.abc import Awaitable, Coroutine
from dataclasses import dataclass
from typing import Any

from crazychoir.agent.drone import Drone
from crazychoir.agent.mission_result import (
    ENDED_KEY,
    ENDS_ON_COMMAND,
    MISSION_REASONS,
    Result,
    add_flight_times,
    add_forgotten_calls,
    check_result,
    judge_flight,
    result_of_failure,
    result_of_operator_end,
)
from crazychoir.bus.topics import DRONE_TOPICS
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.errors import (
    AgentFailed,
    CrazyChoirError,
    Hung,
    Refused,
    error_text,
    exit_call,
    raised_at,
    reason_or,
)
from crazychoir.guidance.decision.law_stage import LawStage
from crazychoir.guidance.member import Member, make_raisable, wait_for_touchdown
from crazychoir.guidance.turns import is_blocked
from crazychoir.runtime.actor import Actor
from crazychoir.runtime.user_code_guard import GuardedCoroutine, GuardFactory
from crazychoir.types import Failure

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class MissionTimes:
    """Times that the end of a mission, and the wait for a drone, may take."""

    landing_deadline: float = 30.0
    """s beyond the planned time of the descent after which the motors are cut."""
    blocked_deadline: float = 1800.0
    """s after which the motors of a landing drone are cut though others keep it up.

    No battery lasts so long: this ends simulated flights.
    """
    last_messages: float = 1.0
    """s that an aborted mission gets for its last messages after its drone is down. Then it is
    cancelled again.
    """
    readiness_time: float = 5.0
    """s beyond the deadline of its link after which a drone that cannot take off is left out.
    """
    farewell_time: float = 1.5
    """s that the agent of a drone stays after its mission.

    Other drones may still need its last messages, or a roster that it issues.
    """


MISSION_TIMES = MissionTimes()


class MissionRunner(Actor):
    """Waits for the team, runs the mission, and leaves the drone on the ground, with the result.

    The mission ends by itself, or is aborted.

    drone: the drone
    config: the swarm file
    watchdog: guard against user code that does not return, None for no guard
    laws: the decide stage of the process, None for one of this drone alone
    """

    name = "guidance"

    def __init__(
        self,
        drone: Drone,
        config: SwarmConfig,
        watchdog: GuardFactory | None,
        laws: LawStage | None = None,
    ) -> None:
        self.drone = drone
        self.config = config
        self.watchdog = watchdog
        self.laws = laws
        self._life: asyncio.Task[Result] | None = None
        self._member: Member | None = None
        self._abort: asyncio.Future[str] = asyncio.get_running_loop().create_future()
        self._by_operator = False

    async def run(self) -> None:
        """Run the mission from start to end.

        Afterwards the agent stays for MISSION_TIMES.farewell_time s, and as long as an emergency
        stop is in force: other drones may need its messages.
        """
        drone = self.drone
        life = self._life = asyncio.create_task(
            self._mission(), name=f"drone {drone.id} guidance"
        )
        telling: list[asyncio.Task[None]] = []
        try:
            ends: list[asyncio.Future[Any]] = [life, self._abort]
            await asyncio.wait(ends, return_when=asyncio.FIRST_COMPLETED)
            if not life.done():
                await self._last_words(life)
            drone.result = add_forgotten_calls(
                self._outcome(life), drone, has_returned(life) and not self._aborted
            )
            if drone.barrier.apart:
                drone.result = {**drone.result, "apart": drone.barrier.apart}
            if not drone.result["success"] or ENDED_KEY in drone.result:
                telling.append(
                    asyncio.create_task(drone.communicator.fail(self._last_word(life)))
                )
        except asyncio.CancelledError:
            drone.result = result_of_failure("the mission was cancelled")
            drone.pilot.land("the mission was cancelled")
            raise
        finally:
            life.cancel()
            self._forbid("the mission has ended")
            await self._down()
            drone.result = self._judged(drone.result)
            drone.port.publish(DRONE_TOPICS.result, drone.result)
        await asyncio.gather(*telling)  # sent while the drone lands
        await drone.port.bus.clock.sleep(MISSION_TIMES.farewell_time, drone=drone.id)
        await self._until_cleared(MISSION_REASONS.stays)

    def abort(self, reason: str, by_operator: bool = False) -> None:
        """End the mission for good, where it is. The first reason counts.

        reason: why, in words.
        by_operator: a command of the drone's operator has ended it. Then the mission has not
            failed.
        """
        # A mission that ends after a cut has ended for the reason of the cut.
        cut_for = self.drone.pilot.permission.cut_for
        reason = reason_or(cut_for or reason, "its mission was ended")
        if not self._abort.done():
            self._abort.set_result(reason)
            self._by_operator = by_operator and not cut_for
        self._forbid(reason)
        if self._life is not None:
            self._life.cancel()

    @property
    def over(self) -> str:
        """Why the mission is over. Empty if it is not."""
        ended = self._life is not None and self._life.done()
        return self._aborted or ("it has ended" if ended else "")

    @property
    def _aborted(self) -> str:
        """Why the mission was aborted. Empty if it was not."""
        return self._abort.result() if self._abort.done() else ""

    def _forbid(self, reason: str) -> None:
        """Prevent code that the mission leaves behind from flying the drone again."""
        if self._member is not None:
            self._member.ended = self._member.ended or reason

    async def _mission(self) -> Result:
        """Wait for GO, then run the mission's own code. Returns its checked result."""
        drone = self.drone
        if self._aborted:
            raise Refused(f"drone {drone.id}", self._aborted)
        await self._until_cleared(MISSION_REASONS.stopped)
        await self._until_fit()
        await drone.barrier.go()
        if drone.port.bus.stopped:
            raise Refused(f"drone {drone.id}", MISSION_REASONS.stopped)
        member = Member(
            drone.id,
            self.config,
            drone.port.bus.clock,
            drone.communicator,
            drone.pilot,
            self.watchdog,
            self.laws,
        )
        member.sensors = drone.sensors
        member.announce = lambda: drone.port.publish(
            DRONE_TOPICS.status, drone.status()
        )
        self._member = member
        try:
            drone.guidance.bind(member)
            return check_result(await self._guarded(drone.guidance.mission()))
        except SystemExit as end:
            raise RuntimeError(f"the mission called {exit_call(end)}").with_traceback(
                end.__traceback__
            ) from end
        except asyncio.CancelledError as cancelled:
            if self._life is not None and self._life.cancelling():
                raise
            raise make_raisable(cancelled, "the mission") from cancelled

    def _guarded(self, mission: Coroutine[Any, Any, Any]) -> Awaitable[Any]:
        """Return the mission under the watchdog.

        It must not hang, but may compute for a while on the ground.
        """
        if self.watchdog is None:
            return mission
        pilot = self.drone.pilot
        name = f"drone {self.drone.id} guidance"
        return GuardedCoroutine(
            mission, self.watchdog, name, lambda: not pilot.airborne
        )

    async def _until_cleared(self, why: str) -> None:
        """Wait until no emergency stop is in force.

        A stop outlives its mission: a drone that starts or restarts learns of it from drones that
        stay.
        """
        drone = self.drone
        bus = self.drone.port.bus
        if bus.stopped and not self._aborted:
            log.warning("drone %d: %s", drone.id, why)
            drone.waits = why
        while bus.stopped and not self._aborted:
            await bus.clock.sleep(0.1, drone=drone.id)
        drone.waits = ""

    async def _until_fit(self) -> None:
        """Wait until a drone with a radio can fly. Until then it is not a member of the team.

        Raises Refused with its problems if that takes too long. The others then learn the reason.
        """
        drone = self.drone
        clock = self.drone.port.bus.clock
        monitor = self.drone.barrier.monitor
        if drone.id not in self.config.topology.reached:
            return
        patience = self.config.radio.connect_deadline + MISSION_TIMES.readiness_time
        ends = clock.now() + patience
        monitor.silent = True
        while (problems := drone.unfit()) and clock.now() < ends:
            await clock.sleep(0.05, drone=drone.id)
        drone.barrier.refused = "; ".join(problems)
        monitor.silent = False
        if problems:
            raise Refused(f"drone {drone.id}", drone.barrier.refused)

    async def _last_words(self, life: asyncio.Task[Result]) -> None:
        """Let an aborted mission send messages while its drone lands, then cancel it."""
        clock = self.drone.port.bus.clock
        i = self.drone.id
        await self._down()
        patient = clock.now() + MISSION_TIMES.last_messages
        while not life.done() and clock.now() < patient + MISSION_TIMES.last_messages:
            if clock.now() >= patient:
                life.cancel()
            await clock.sleep(0.05, drone=i)
        if not life.done():
            log.error(
                "drone %d: its mission does not end when it is cancelled; left behind",
                i,
            )

    async def _down(self) -> None:
        """Wait until the drone is on the ground. Its pilot lands already.

        A drone that others block hovers on and looks for a place beside them: without motors it
        would fall on them.
        """
        i, pilot = self.drone.id, self.drone.pilot
        gives_up = pilot.clock.now() + MISSION_TIMES.blocked_deadline
        await wait_for_touchdown(pilot, MISSION_TIMES.landing_deadline)
        while pilot.airborne and is_blocked(pilot) and pilot.clock.now() < gives_up:
            log.warning("drone %d: others keep it up: %s", i, pilot.notes.text)
            await wait_for_touchdown(pilot, MISSION_TIMES.landing_deadline)
        # A cut that arrives late would be a fall.
        if pilot.airborne and pilot.judge.touchdown.is_unreached:
            log.error(
                "drone %d: its radio is silent: its firmware lands it when it is reached",
                i,
            )
        elif pilot.airborne:
            blocked = f": {pilot.notes.text}" if is_blocked(pilot) else ""
            pilot.cut(f"does not come down{blocked}")

    def _outcome(self, life: asyncio.Task[Result]) -> Result:
        """Return the result of the mission before its drone is down.

        An aborted mission has failed, whatever it returns, unless its operator ended it, or ended a
        member that it waits for. A mission has failed if its own code fails while it is being
        ended.
        """
        pilot = self.drone.pilot
        error = life.exception() if life.done() and not life.cancelled() else None
        if self._by_operator:
            return self._aborted_by_operator(error)
        if self._aborted:
            return result_of_failure(self._aborted)
        if error is None:
            pilot.land("the mission has ended in the air")
            return life.result()
        if isinstance(error, AgentFailed) and error.reason in ENDS_ON_COMMAND:
            pilot.land(str(error))
            return result_of_operator_end(
                f"drone {error.agent}: {error.reason}, and with it the team"
            )
        if isinstance(error, CrazyChoirError) and not isinstance(
            error, Hung
        ):  # such as a lost drone or a refusal
            log.warning(
                "drone %d: %s",
                self.drone.id,
                str(error).removeprefix(f"drone {self.drone.id}: "),
            )
            pilot.land(str(error))
            return result_of_failure(str(error))
        return result_of_failure(self._broken(error))

    def _aborted_by_operator(self, error: BaseException | None) -> Result:
        """Return the result of a mission that its operator ended.

        It is a failure if the mission's own code has failed meanwhile.
        """
        if error is None or _is_expected(error):
            return result_of_operator_end(self._aborted)
        return result_of_failure(f"{self._aborted}; {self._broken(error)}")

    def _last_word(self, life: asyncio.Task[Result]) -> Failure:
        """Return the message to drones that wait for this drone.

        It names the first agent that failed, and why.
        """
        error = life.exception() if life.done() and not life.cancelled() else None
        if isinstance(error, AgentFailed):
            return Failure(error.agent, error.reason)
        return Failure(
            self.drone.id, str(self.drone.result.get("reason", "no success"))
        )

    def _broken(self, error: BaseException) -> str:
        """Handle an error of the mission's own code: the pilot hovers, then lands.

        Returns the error in words, which observers receive too.
        """
        at = raised_at(error)
        cause = f"{error_text(error)} ({at.filename}:{at.lineno} {at.name})"
        text = f"drone {self.drone.id}: guidance failed: {cause}"
        log.error("%s", text, exc_info=error)
        self.drone.port.publish(DRONE_TOPICS.log, text)
        self.drone.pilot.guidance_failed(cause)
        return text

    def _judged(self, result: Result) -> Result:
        """Return the final result, now that the drone is down."""
        aborted = "" if self._by_operator else self._aborted
        ended = self._aborted if self._by_operator else ""
        return judge_flight(
            add_flight_times(result, self.drone.pilot), self.drone, aborted, ended
        )


def _is_expected(error: BaseException) -> bool:
    """Return whether a mission may end with this error when it is told to end.

    Only errors of this package and cancellation are expected.
    """
    if isinstance(error, BaseExceptionGroup):
        return all(map(_is_expected, error.exceptions))
    return isinstance(
        error, CrazyChoirError | asyncio.CancelledError
    ) and not isinstance(error, Hung)


def has_returned(life: asyncio.Task[Result]) -> bool:
    """Return whether a mission has ended by itself, without an error."""
    return life.done() and not life.cancelled() and life.exception() is None
