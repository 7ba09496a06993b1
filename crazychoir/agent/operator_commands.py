"""Commands of an operator to a drone.

Each command is refused with the reason, or done when its effect is complete.
"""

from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from typing import Any, NoReturn

from crazychoir.agent.command_arguments import (
    CommandArguments,
    LandArguments,
    TakeOffArguments,
    convert_arguments,
)
from crazychoir.agent.drone import Drone
from crazychoir.agent.mission_result import MISSION_REASONS
from crazychoir.agent.mission_runner import MISSION_TIMES
from crazychoir.bus.commands import ANSWER_TEXTS
from crazychoir.bus.port import Port
from crazychoir.bus.topics import DRONE_TOPICS
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.errors import Refused
from crazychoir.flight.homecoming import compute_return_height
from crazychoir.guidance.flights import FLYING_MODES, OBEYING_GATE
from crazychoir.guidance.member import (
    HELD_FLIGHT_PATIENCE,
    Member,
    describe_state,
    wait_for_touchdown,
)
from crazychoir.planning.landing import Descent
from crazychoir.runtime.mailbox import Latest
from crazychoir.safety.rules.guard import EDGE_MARGIN
from crazychoir.safety.rules.modes import Mode, ModeEvent
from crazychoir.types import Point, State, Status


@dataclass(frozen=True, slots=True)
class OrderTimes:
    """Times and rates of the commands of an operator."""

    poll_interval: float = 0.05
    """s: interval at which a command checks its progress."""
    take_off_allowance: float = 10.0
    """s beyond the planned time of a take-off within which the drone must hover."""
    listening_time: float = 0.5
    """s: how long a drone that is sent home first listens for the places of the others.

    It is the period of a status, and a bit more.
    """
    state_rate: float = 10.0
    """Hz: rate of the states that it receives for this."""


ORDER_TIMES = OrderTimes()


@dataclass(frozen=True, slots=True)
class OrderTexts:
    """Answers to the commands of an operator, and the task of a drone that is sent home."""

    homing_task: str = "sent home"
    """Task of a drone that its operator has sent home."""
    unseen: str = "it is not seen by the cameras yet"
    """Reason for a refusal without a pose."""
    ready: str = "ready"
    """Answer to a successful command to arm."""
    waiting_advice: str = "crazychoir run --wait, or [flight] operator = true, makes missions wait for an operator"
    """Advice for a mission that waits for no operator."""


ORDER_TEXTS = OrderTexts()


GROUNDED_PHASES = (Mode.GROUND.value, Mode.CUT.value)
"""Phases of a drone that does not fly."""


ORDER_ARGUMENTS: dict[ModeEvent, type[CommandArguments]] = {
    ModeEvent.TAKE_OFF: TakeOffArguments,
    ModeEvent.LAND: LandArguments,
}
"""Arguments of the commands that have some."""


class OperatorCommands:
    """The commands of one drone's operator.

    drone: the drone.
    config: the swarm file.
    abort: ends its mission with a reason, on behalf of the operator.
    over: returns why its mission is over. Empty if it is not.
    arm: arms the motors of a drone with a radio, and returns the outcome. None: the first command
        arms.
    """

    def __init__(
        self,
        drone: Drone,
        config: SwarmConfig,
        abort: Callable[[str], None],
        over: Callable[[], str],
        arm: Callable[[], Awaitable[str]] | None = None,
    ) -> None:
        self.drone = drone
        self.config = config
        self.abort = abort
        self.over = over
        self.arm = arm
        self._others: _OtherDrones | None = None
        self._methods: dict[ModeEvent, Callable[[Any], Awaitable[str]]] = {
            ModeEvent.ARM: self._arm,
            ModeEvent.TAKE_OFF: self._take_off,
            ModeEvent.START: self._start,
            ModeEvent.HOLD: self._hold,
            ModeEvent.GO: self._go_on,
            ModeEvent.LAND: self._land,
            ModeEvent.HOME: self._home,
        }

    @property
    def verbs(self) -> list[str]:
        """The commands that are executed here. An emergency stop has its own way."""
        return [command.value for command in self._methods]

    async def execute(self, verb: str, arguments: dict[str, Any]) -> str:
        """Execute a command, and return its outcome.

        Raises Refused with the reason, and ConfigError for wrong arguments.
        """
        command = ModeEvent(verb)
        kind = ORDER_ARGUMENTS.get(command, CommandArguments)
        asked = convert_arguments(verb, arguments, kind)
        if why := self.drone.pilot.permission.refuses(command):
            self._refuse(why)
        return await self._methods[command](asked)

    def _refuse(self, why: str) -> NoReturn:
        raise Refused(f"drone {self.drone.id}", why)

    def _gate(self, command: str) -> Member:
        """Return the mission that waits for this command. Raises Refused if none does."""
        guidance = self.drone.guidance
        if over := self.over():
            self._refuse(f"its mission is over: {over}")
        awaits_start = self.drone.pilot.permission.awaits_start
        if not (self.config.flight.operator or awaits_start):
            self._refuse(
                f"its mission does not wait for a start: {ORDER_TEXTS.waiting_advice}"
            )
        if not awaits_start:
            self._refuse("its mission has started")
        if not hasattr(guidance, "member") or not guidance.member.gate:
            self._refuse(
                f"{ANSWER_TEXTS.not_ready}: {self.drone.status().task or 'its mission prepares'}"
            )
        if guidance.member.gate != command:
            self._refuse(f"it {guidance.member.report()['task']}")
        return guidance.member

    @property
    def _obeys(self) -> bool:
        """Whether the mission does nothing but obey its operator until it has landed."""
        guidance = self.drone.guidance
        return hasattr(guidance, "member") and guidance.member.gate == OBEYING_GATE

    def _end_mission(self, reason: str) -> None:
        """End the mission, unless it ends by itself when the drone has landed."""
        if not self._obeys:
            self.abort(reason)

    async def _arm(self, asked: CommandArguments) -> str:
        """Check the conditions of a take-off now, then arm motors that wait for arming."""
        pilot = self.drone.pilot
        if why := pilot.unready()[1]:
            self._refuse(why)
        if pilot.state is None:
            self._refuse(ORDER_TEXTS.unseen)
        return ORDER_TEXTS.ready if self.arm is None else await self.arm()

    async def _take_off(self, asked: TakeOffArguments) -> str:
        member = self._gate("take-off")
        pilot = self.drone.pilot
        self.drone.guidance.require_height(asked.height, "take-off")
        height = member.rise if asked.height is None else asked.height
        seconds = pilot.take_off(height, asked.duration)
        if seconds == 0.0:
            self._refuse(pilot.notes.text or ORDER_TEXTS.unseen)
        ends = pilot.clock.now() + seconds + ORDER_TIMES.take_off_allowance
        while pilot.mode is Mode.TAKEOFF and pilot.clock.now() < ends:
            await pilot.clock.sleep(ORDER_TIMES.poll_interval, drone=self.drone.id)
        if pilot.mode not in FLYING_MODES:
            self._refuse(describe_state(pilot))
        return pilot.mode.value

    async def _start(self, asked: CommandArguments) -> str:
        self._gate("start")
        self.drone.pilot.permission.start()
        return "its mission goes on"

    async def _hold(self, asked: CommandArguments) -> str:
        pilot = self.drone.pilot
        pilot.hold()
        return "held" if pilot.airborne else "held on the ground"

    async def _go_on(self, asked: CommandArguments) -> str:
        pilot = self.drone.pilot
        was_held = pilot.permission.held
        pilot.hold(on=False)
        return "goes on" if was_held else "was not held"

    async def _land(self, asked: LandArguments) -> str:
        descent = Descent(asked.height, asked.duration)
        self.drone.pilot.land("landing on command", descent=descent)
        self._end_mission(MISSION_REASONS.landed)
        return await self._on_the_ground()

    async def _home(self, asked: CommandArguments) -> str:
        """Return home above all other drones that it hears of.

        Drones that return at the same time have different levels.
        """
        drone = self.drone
        pilot = self.drone.pilot
        self._end_mission(MISSION_REASONS.sent_home)
        pilot.permission.commanded = False
        pilot.hover()
        self._others = self._others or _OtherDrones(
            drone.port, tuple(i for i in self.config.ids if i != drone.id)
        )
        if hasattr(drone.guidance, "member"):
            drone.guidance.member.report = lambda: {"task": ORDER_TEXTS.homing_task}
        drone.port.publish(DRONE_TOPICS.status, drone.status())
        await pilot.clock.sleep(ORDER_TIMES.listening_time, drone=drone.id)
        state = pilot.state
        if why := pilot.permission.refuses(ModeEvent.HOME):
            self._refuse(why)
        if state is None:
            self._refuse("it is not seen")
        home = (
            pilot.permission.started_at
            if pilot.permission.started_at is not None
            else self.config.drone(drone.id).home
        )
        pilot.go_home(
            home,
            self._others.level(state.p, home, pilot.setup.fence.high[2] - EDGE_MARGIN),
        )
        return await self._on_the_ground()

    async def _on_the_ground(self) -> str:
        pilot = self.drone.pilot
        await wait_for_touchdown(
            pilot, MISSION_TIMES.landing_deadline + HELD_FLIGHT_PATIENCE
        )
        if pilot.mode is not Mode.GROUND:
            self._refuse(describe_state(pilot))
        return str(pilot.mode.value)


class _OtherDrones:
    """Where the other drones are and what they do, as far as this drone hears."""

    def __init__(self, port: Port, ids: tuple[int, ...]) -> None:
        bus = port.bus
        i = port.address
        self.id = i
        self._states: dict[int, Latest[State]] = {
            j: Latest(bus.clock, "state", DRONE_TOPICS.state.max_age) for j in ids
        }
        self._statuses: dict[int, Latest[Status]] = {
            j: Latest(bus.clock, "status", DRONE_TOPICS.status.max_age) for j in ids
        }
        for j in ids:
            bus.subscribe(
                DRONE_TOPICS.state, j, i, self._states[j], ORDER_TIMES.state_rate
            )
            bus.subscribe(
                DRONE_TOPICS.status, j, i, self._statuses[j], DRONE_TOPICS.status.rate
            )

    def level(self, p: Point, home: Point, top: float) -> float:
        """Return the height in m of a return from p above the drones in the air.

        See `compute_return_height`.
        """
        statuses = {
            j: status
            for j, box in self._statuses.items()
            if (status := box.fresh()) is not None
        }
        states = {
            j: state
            for j, box in self._states.items()
            if (state := box.fresh()) is not None
        }
        up = [
            state.p
            for j, state in states.items()
            if j not in statuses or statuses[j].phase not in GROUNDED_PHASES
        ]
        before = [
            j
            for j, status in statuses.items()
            if status.task == ORDER_TEXTS.homing_task and j < self.id
        ]
        return compute_return_height(p, home, up, len(before), top)
