"""crazyflow as a world of crazychoir: an example of an engine in a package of its own.

Install it beside crazyflow, and write in a swarm file:

    uri = "crazyflow://"        # of a drone, with sender = "fpqr" in [control]

    [world.options]
    drone = "cf2x_L250"         # the drone of crazyflow; the platform should have its mass

crazyflow wants SCIPY_ARRAY_API=1 in the environment before anything imports scipy:

    SCIPY_ARRAY_API=1 crazychoir run swarm.toml --fast
"""

from typing import Any

import numpy as np

from crazychoir.simulation.common.links import SimulatedLink
from crazychoir.simulation.common.truth import Truth
from crazychoir.simulation.common.world import WorldSetup, make_unsupported_kind_error

STANDARD_DRONE = "cf2x_L250"
"""Drone of crazyflow if [world.options] names none: a Crazyflie 2.1."""
FLOOR_HEIGHT = 0.002
"""m: height up to which a drone without lift stands on the floor."""
CRAZYFLOW_FREQUENCY = 500
"""Hz: crazyflow's own steps."""


def engine(setup: WorldSetup) -> "CrazyflowWorld":
    """Return the world that a swarm file asks for; the entry point of this package."""
    return CrazyflowWorld(setup)


class CrazyflowWorld(Truth):
    """Drones in crazyflow: rotors and bodies by its first principles, steered by thrust and body rates.

    setup: what the swarm file asks for
    """

    flies: tuple[str, ...] = ("fpqr",)
    command_timeout: float | None = 0.5

    def __init__(self, setup: WorldSetup) -> None:
        from crazyflow.control import Control
        from crazyflow.dynamics import Dynamics
        from crazyflow.sim import Sim

        homes = np.array(setup.homes, dtype=float)
        platforms = setup.bodies or setup.platforms
        super().__init__(setup.ids, homes, np.array(setup.yaws), platforms, setup.dt)
        n = len(self.ids)
        self.commands = np.zeros((n, 4))
        self._is_alive = np.ones(n)
        self._sim: Any = Sim(
            n_worlds=1,
            n_drones=n,
            drone=setup.options.get("drone", STANDARD_DRONE),
            dynamics=Dynamics.first_principles,
            control=Control.body_rate,
            freq=CRAZYFLOW_FREQUENCY,
        )
        self._steps = round(setup.dt * CRAZYFLOW_FREQUENCY)
        data = self._sim.data
        begin = data.states.replace(
            pos=data.states.pos.at[0].set(self.states[:, 0:3]),
            quat=data.states.quat.at[0].set(self.states[:, 6:10]),
        )
        self._sim.data = data.replace(states=begin)

    def link(self, i: int, kind: str = "fpqr") -> SimulatedLink:
        """Return the link to drone i for thrust and body rates.

        Raises ConfigError for another kind of commands.
        """
        if kind not in self.flies:
            raise make_unsupported_kind_error(i, kind, self.flies)
        return SimulatedLink(self, i)

    def command(self, i: int, u: Any) -> None:
        """Hold u (4,) = thrust N, body rates rad/s for drone i from now on."""
        self.commands[self.row[i]] = u

    def cut(self, i: int) -> None:
        """Stop the motors of drone i for good."""
        self._is_alive[self.row[i]] = 0.0

    def step(self) -> None:
        """Advance every drone by dt."""
        due = self.commands * self._is_alive[:, None]
        # crazyflow wants the body rates first, then the thrust
        self._sim.body_rate_control(np.roll(due, -1, axis=1)[None].astype(np.float32))
        falling = -self.states[:, 5]
        was_flying = self._resting == 0.0
        self._sim.step(self._steps)
        seen = self._sim.data.states
        self.states[:, 0:3] = seen.pos[0]
        self.states[:, 3:6] = seen.vel[0]
        self.states[:, 6:10] = seen.quat[0]
        self.states[:, 10:13] = seen.ang_vel[0]
        is_low = self.states[:, 2] < FLOOR_HEIGHT
        self._resting[:] = is_low
        touched = is_low & was_flying
        self.impact[touched] = np.maximum(self.impact[touched], falling[touched])
        self.states[is_low, 2] = 0.0
        self.tick += 1
