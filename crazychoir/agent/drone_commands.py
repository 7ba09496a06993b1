"""The commands that operators send to one drone."""

from collections.abc import Awaitable, Callable, Mapping
from functools import partial
from typing import Any

from crazychoir.agent.dead_man import WATCHED_COMMAND
from crazychoir.agent.drone import Drone
from crazychoir.agent.operator_commands import OperatorCommands
from crazychoir.agent.steering import FIRMWARE_DEADLINE, Steering, require_firmware
from crazychoir.bus.commands import COMMANDED_PREFIX
from crazychoir.bus.topics import DRONE_TOPICS
from crazychoir.errors import Refused

STREAMED_COMMAND = "velocity"
"""The command that a stick sends many times a second."""
STREAM_INTERVAL = 1.0
"""s: a velocity that follows another one so soon is not published to observers."""
Arguments = dict[str, Any]
CommandMethod = Callable[[Arguments], Awaitable[Any]]
"""Executes a command with these arguments, and returns its outcome."""


class DroneCommands:
    """Executes the commands of operators at one drone, each by the method of its verb.

    drone: the drone
    orders: its commands that change its mode, such as take-off
    hear_console: called when an operator's console reports that it is there
    """

    def __init__(
        self,
        drone: Drone,
        orders: OperatorCommands,
        hear_console: Callable[[], None],
    ) -> None:
        self.drone = drone
        self._orders = orders
        self._hear_console = hear_console
        self._last_command = ""
        self._last_time = 0.0
        steering = Steering(drone)
        self._changes: Mapping[str, CommandMethod] = {
            **{verb: partial(self._order, verb) for verb in orders.verbs},
            "go-to": steering.go_to,
            STREAMED_COMMAND: steering.move,
            "load": steering.load,
            "fly": steering.fly,
            "impair": self._impair,
            "param_set": self._set_parameter,
            "firmware_set": partial(self._ask_firmware, "firmware_set"),
            "task_add": partial(self._ask_mission, "task_add"),
            "task_cancel": partial(self._ask_mission, "task_cancel"),
        }
        self._queries: Mapping[str, CommandMethod] = {
            "param_get": self._list_parameters,
            "firmware_get": partial(self._ask_firmware, "firmware_get"),
            "firmware_list": partial(self._ask_firmware, "firmware_list"),
            "task_list": partial(self._ask_mission, "task_list"),
            "overview": self._overview,
            "ping": self._ping,
            WATCHED_COMMAND: self._note_console,
        }

    async def execute(self, verb: str, arguments: Arguments) -> Any:
        """Execute a command of an operator, and return its outcome.

        Commands that change something are published to all observers; a stream of velocities once.
        Raises Refused with the reason.
        """
        if verb in self._queries:
            return await self._queries[verb](arguments)
        self._publish(verb)
        if verb not in self._changes:
            verbs = ", ".join((*self._changes, *self._queries))
            raise Refused(
                f"drone {self.drone.id}", f"no command {verb!r}; there are {verbs}"
            )
        return await self._changes[verb](arguments)

    def stop(self, on: bool) -> None:
        """Begin or clear an emergency stop: at its begin the motors are cut."""
        self._publish("emergency stop" if on else "clear stop")
        if on:
            self.drone.pilot.cut("emergency stop")

    def _publish(self, command: str) -> None:
        """Publish a command to all observers; of velocities in quick succession the first."""
        drone = self.drone
        now = drone.port.bus.clock.now()
        is_repeated = command == self._last_command == STREAMED_COMMAND
        is_quick = now - self._last_time < STREAM_INTERVAL
        self._last_command = command
        self._last_time = now
        if not (is_repeated and is_quick):
            drone.port.publish(
                DRONE_TOPICS.log, f"drone {drone.id}: {COMMANDED_PREFIX}{command}"
            )

    async def _order(self, verb: str, arguments: Arguments) -> str:
        return await self._orders.execute(verb, arguments)

    async def _impair(self, arguments: Arguments) -> dict[str, Any]:
        network = self.drone.port.bus.impairment
        network.update(arguments)
        return network.describe()

    async def _set_parameter(self, arguments: Arguments) -> Any:
        return self.drone.pilot.follower.set_parameter(
            arguments["name"], arguments["value"]
        )

    async def _list_parameters(self, arguments: Arguments) -> Any:
        return self.drone.pilot.follower.parameters.values(arguments.get("name"))

    async def _ask_firmware(self, verb: str, arguments: Arguments) -> Any:
        remote = require_firmware(self.drone)
        return await remote.request(verb, FIRMWARE_DEADLINE, **arguments)

    async def _ask_mission(self, verb: str, arguments: Arguments) -> Any:
        guidance = self.drone.guidance
        if not hasattr(guidance, "member"):
            raise Refused(f"drone {self.drone.id}", "its mission has not begun")
        return await guidance.asked(verb, arguments)

    async def _overview(self, arguments: Arguments) -> dict[str, Any]:
        """Return what an observer needs and no topic holds.

        links: by drone: messages sent there through the simulated network, and messages lost.
        network: what is simulated.
        route: see CFGuidance.
        """
        drone = self.drone
        network = drone.port.bus.impairment
        has_begun = hasattr(drone.guidance, "member")
        route = drone.guidance.route() if has_begun else ()
        return {
            "links": {
                j: [to.sent, to.lost]
                for (i, j), to in network.counters.items()
                if i == drone.id
            },
            "network": network.describe(),
            "route": [list(map(float, p)) for p in route],
        }

    async def _ping(self, arguments: Arguments) -> str:
        return self.drone.pilot.mode.value

    async def _note_console(self, arguments: Arguments) -> None:
        self._hear_console()
