"""The drones of a gymnasium environment: their world, their commands, and how much they vary."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from crazychoir.errors import ConfigError
from crazychoir.platforms import Platform, find_platform
from crazychoir.simulation.common.mismatch import (
    apply_model_errors,
    find_lightweight_platform,
)
from crazychoir.simulation.lightweight.integrator import CFIntegrator
from crazychoir.simulation.motor_level.crazyflies import CrazyflieWorld
from crazychoir.simulation.motor_level.imu import Imu
from crazychoir.simulation.motor_level.motors import MotorConditions
from crazychoir.types import Ints, Mat, Vec

LARGEST_TILT = 0.5
"""rad: largest roll and pitch that an action commands."""
LARGEST_SPEED = 1.0
"""m/s: largest velocity along an axis that an action commands, as the firmware's own limit."""
LARGEST_YAW_RATE = 2.0
"""rad/s: largest yaw rate of an action that commands angles or velocities."""
LARGEST_YAW = np.pi
"""rad: largest heading of an action that commands positions."""
HELD_STEPS = 100
"""Steps of the warm-up in which the drones are held while their rotors start."""
FREE_STEPS = 500
"""Steps of the warm-up in which a firmware that controls positions or velocities hovers."""
WARM_UP_STEP = 0.01
"""Seconds of a step of the warm-up."""
WARM_UP_HEIGHT = 1.0
"""m: height at which the firmware starts."""
ENV_CONDITIONS = MotorConditions(imu=Imu().scaled(0.0, 0.0), has_downwash=False)
"""Still air without other drones, and exact sensors: an episode follows from its seed and its actions."""
RETURN_RATE = 1.0
"""1/s: velocity over distance with which a drone returns to its place in the warm-up."""
Range = tuple[float, float]
"""Lower and upper bound of a uniform draw."""


@dataclass(frozen=True)
class DroneModel:
    """The drones of an environment; each episode draws a platform and errors that no controller knows.

    world: "lightweight": the paper's model, which obeys thrust and body rates exactly
           "motors": rotors that lag, battery, air, and the firmware on board
    command: "fpqr": thrust and body rates
             "frpy": thrust, roll, pitch and yaw rate (needs "motors")
             "velocity": velocity and yaw rate (needs "motors")
             "position": position and heading (needs "motors")
    """

    world: str = "lightweight"
    """Model of the drones."""
    command: str = "fpqr"
    """Kind of the commands."""
    platforms: tuple[str, ...] = ("cf21",)
    """Names of the platforms; each episode draws one, see `crazychoir.platforms`."""
    mass: Range = (1.0, 1.0)
    """Mass of the body as a multiple of its platform's."""
    thrust: Range = (1.0, 1.0)
    """Thrust at the same command as a multiple of the platform's."""
    latency: Range = (0.0, 0.0)
    """s: delay of the commands, rounded to whole steps of the world."""

    def __post_init__(self) -> None:
        """Raise ConfigError for a value that is not allowed."""
        if self.world not in COMMANDS_OF_WORLD:
            raise ConfigError(
                "DroneModel: world", self.world, " or ".join(COMMANDS_OF_WORLD)
            )
        allowed = COMMANDS_OF_WORLD[self.world]
        if self.command not in allowed:
            raise ConfigError(
                "DroneModel: command",
                self.command,
                f"with world {self.world}: {', '.join(allowed)}",
            )
        for name in ("mass", "thrust", "latency"):
            low, high = getattr(self, name)
            least = 0.0 if name == "latency" else 0.1
            if not least <= low <= high:
                raise ConfigError(
                    f"DroneModel: {name}",
                    (low, high),
                    f"(low, high) with {least:g} <= low <= high",
                )
        if not self.platforms:
            raise ConfigError("DroneModel: platforms", self.platforms, "at least one")

    def find_platforms(self) -> tuple[Platform, ...]:
        """Return the platforms; raise ConfigError for a name that is not known."""
        return tuple(
            find_platform(name, "DroneModel: platforms") for name in self.platforms
        )


THRUST_COMMANDS = ("fpqr", "frpy")
"""Kinds of commands with a thrust."""
COMMANDS_OF_WORLD = {
    "lightweight": ("fpqr",),
    "motors": (*THRUST_COMMANDS, "velocity", "position"),
}
"""Kinds of commands of each world."""


@dataclass(frozen=True, slots=True)
class CommandRange:
    """Commands to which the actions -1 and 1 are mapped, linearly between."""

    low: Vec
    """(4,) SI: command of the action -1."""
    high: Vec
    """(4,) SI: command of the action 1."""

    def to_commands(self, actions: Mat) -> Mat:
        """Return commands (n, 4) in SI of actions (n, 4)."""
        share = 0.5 * (np.clip(actions, -1.0, 1.0) + 1.0)
        return np.asarray(self.low + share * (self.high - self.low), dtype=float)

    def to_actions(self, commands: Mat) -> Mat:
        """Return the actions (n, 4) that give these commands (n, 4) in SI."""
        return np.asarray(
            2.0 * (commands - self.low) / (self.high - self.low) - 1.0, np.float32
        )


def find_command_range(
    command: str, platforms: Sequence[Platform], area: tuple[Vec, Vec]
) -> CommandRange:
    """Return the range of the commands of this kind.

    All the platforms can follow this thrust and these rates.

    area: (3,) m, world: corners of the flight area
    """
    thrust = min(platform.max_thrust for platform in platforms)
    if command == "fpqr":
        rates = np.min([platform.max_rate for platform in platforms], axis=0)
        return CommandRange(np.array([0.0, *-rates]), np.array([thrust, *rates]))
    if command == "frpy":
        angles = np.array([LARGEST_TILT, LARGEST_TILT, LARGEST_YAW_RATE])
        return CommandRange(np.array([0.0, *-angles]), np.array([thrust, *angles]))
    if command == "velocity":
        high = np.array([*[LARGEST_SPEED] * 3, LARGEST_YAW_RATE])
        return CommandRange(-high, high)
    low, high = area
    return CommandRange(np.array([*low, -LARGEST_YAW]), np.array([*high, LARGEST_YAW]))


class EnvWorld(Protocol):
    """All drones of an environment, a row a drone."""

    states: Mat
    """(n, 13): rows laid out as State.flat."""

    def begin(self, row: int, drawn: "DrawnDrone", p: Vec, yaw: float) -> None:
        """Let a drone hover at rest at p (3,) m, world, with this heading in rad."""
        ...

    def step(self, commands: Mat) -> None:
        """Advance all drones by one step of the world with these commands (n, 4)."""
        ...


@dataclass(frozen=True, slots=True)
class DrawnDrone:
    """The drone of an episode."""

    platform: int
    """Its platform, as an index in the platforms of the model."""
    mass_error: float
    """Share by which it is heavier than its platform."""
    thrust_error: float
    """Share by which its rotors pull harder than its platform's."""


class CommandDelays:
    """The commands on their way to the drones of an environment, each with its own delay.

    n: number of drones
    longest: steps of the longest delay
    """

    def __init__(self, n: int, longest: int) -> None:
        self._sent = np.zeros((longest + 1, n, 4))
        self._delays = np.zeros(n, np.int64)
        self._rows = np.arange(n)
        self._step = 0

    def begin(self, row: int, delay: int, command: Vec) -> None:
        """Let a drone obey this command (4,) until its first one arrives.

        delay: steps by which its commands are late
        """
        self._delays[row] = delay
        self._sent[:, row] = command

    def pass_on(self, commands: Mat) -> Mat:
        """Take the commands (n, 4) of a step of the world, and return the commands (n, 4) that are due."""
        slots = len(self._sent)
        self._sent[self._step % slots] = commands
        due = self._sent[(self._step - self._delays) % slots, self._rows]
        self._step += 1
        return due


class LightweightEnvWorld:
    """The paper's model: it obeys thrust and body rates exactly.

    n: number of drones
    dt: s: step of the world
    model: the drones
    """

    def __init__(self, n: int, dt: float, model: DroneModel) -> None:
        self._platforms = model.find_platforms()
        places = np.tile([0.0, 0.0, 1.0], (n, 1))
        self._world = CFIntegrator(range(n), places, platform=self._platforms[0], dt=dt)
        self._is_new = np.ones(n, np.int64)
        self.states = self._world.states

    def begin(self, row: int, drawn: DrawnDrone, p: Vec, yaw: float) -> None:
        """Let a drone hover at rest at p (3,) m, world, with this heading in rad."""
        body = find_lightweight_platform(
            self._platforms[drawn.platform], drawn.mass_error, drawn.thrust_error
        )
        self._world.replace_body(row, body)
        self._world.put(row, p, yaw)

    def step(self, commands: Mat) -> None:
        """Advance all drones by one step of the world with these commands (n, 4)."""
        self._world.take_commands(commands, self._is_new)
        self._world.step()


class MotorEnvWorld:
    """Crazyflies with rotors, battery and firmware, far apart from each other.

    A drone begins an episode with rotors at the speed of hover and a firmware that flies: one drone
    of each platform is warmed up, and copied. Its estimator gets its true pose each step.

    n: number of drones
    dt: s: step of the world
    model: the drones
    """

    def __init__(self, n: int, dt: float, model: DroneModel) -> None:
        self._platforms = model.find_platforms()
        self._warm = _warm_up(self._platforms, model.command)
        places = np.tile([0.0, 0.0, WARM_UP_HEIGHT], (n, 1))
        self._world = CrazyflieWorld(
            range(n),
            places,
            platform=self._platforms[0],
            dt=dt,
            conditions=ENV_CONDITIONS,
        )
        self._is_new = np.ones(n, np.int64)
        self._seen = np.ones(n, bool)
        self._poses = np.empty((n, 7))
        self._obey = _find_way_in(self._world, model.command)
        self.states = self._world.states

    def begin(self, row: int, drawn: DrawnDrone, p: Vec, yaw: float) -> None:
        """Let a drone hover at rest at p (3,) m, world, with this heading in rad."""
        self._world.replace_drone(row, self._warm, drawn.platform)
        body = apply_model_errors(
            self._platforms[drawn.platform], drawn.mass_error, drawn.thrust_error
        )
        self._world.replace_body(row, body)
        self._world.put(row, p, yaw)

    def step(self, commands: Mat) -> None:
        """Advance all drones by one step of the world with these commands (n, 4)."""
        self._obey(commands, self._is_new)
        self._world.step()
        self._poses[:, 0:3] = self.states[:, 0:3]
        self._poses[:, 3:7] = self.states[:, 6:10]
        self._world.see_frame(self._poses, self._seen)


def make_env_world(n: int, dt: float, model: DroneModel) -> EnvWorld:
    """Return a world of n drones with steps of dt s."""
    if model.world == "lightweight":
        return LightweightEnvWorld(n, dt, model)
    return MotorEnvWorld(n, dt, model)


def _find_way_in(world: CrazyflieWorld, command: str) -> Callable[[Mat, Ints], None]:
    """Return the function that takes the commands (n, 4) of all drones of the world."""
    if command in THRUST_COMMANDS:
        return world.take_commands

    def take_motions(inputs: Mat, is_new: Ints) -> None:
        world.take_motions(inputs, is_new, command == "position")

    return take_motions


def _warm_up(platforms: Sequence[Platform], command: str) -> CrazyflieWorld:
    """Return a world with a hovering drone of each platform, which obeys this kind of commands.

    The drones are held at their places until their rotors turn. Then a firmware that controls
    positions or velocities finds the thrust of hover in free flight.
    """
    n = len(platforms)
    places = np.tile([0.0, 0.0, WARM_UP_HEIGHT], (n, 1))
    world = CrazyflieWorld(
        range(n), places, platform=platforms, dt=WARM_UP_STEP, conditions=ENV_CONDITIONS
    )
    held = world.states.copy()
    is_new = np.ones(n, np.int64)
    hover = np.zeros((n, 4))
    if command in THRUST_COMMANDS:
        hover[:, 0] = [platform.weight for platform in platforms]
    elif command == "position":
        hover[:, 0:3] = places
    flies_freely = command not in THRUST_COMMANDS
    for i in world.ids:
        world.link(i, "fullstate" if flies_freely else command)
    obey = _find_way_in(world, command)
    for step in range(HELD_STEPS + FREE_STEPS * flies_freely):
        if command == "velocity":
            hover[:, 0:3] = RETURN_RATE * (places - world.states[:, 0:3])
        for onboard in world.onboard.values():
            if onboard.firmware.needs_arming and not onboard.record["armed"]:
                onboard.arm()  # it is refused until the checks on board are done
        obey(hover, is_new)
        world.step()
        if step < HELD_STEPS:
            world.states[:] = held
        poses = world.states[:, [0, 1, 2, 6, 7, 8, 9]]
        world.see_frame(np.ascontiguousarray(poses), np.ones(n, bool))
    return world
