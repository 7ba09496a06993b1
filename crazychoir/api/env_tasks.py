"""What a drone has to do in a gymnasium environment: where it starts, its goal, its reward and its end."""

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from crazychoir.types import Bools, Mat, Vec

Corner = tuple[float, float, float]
"""A corner of a box: (3,) m, world."""


@dataclass(frozen=True, slots=True)
class EpisodeStart:
    """How an episode begins: the drone hovers at rest, and gets a goal."""

    position: Vec
    """(3,) m, world, above the floor."""
    yaw: float
    """rad: heading."""
    goal: Vec
    """(k,): numbers that the drone observes behind its state; they stay until the episode ends."""


class EnvTask(ABC):
    """The task of all drones of an environment; a subclass is a task of your own.

    Rows are laid out as State.flat: position (3,) m and velocity (3,) m/s, world; attitude (4,)
    [x, y, z, w], body to world; angular velocity (3,) rad/s, body.
    """

    goal_size = 0
    """Count of numbers in a goal."""
    area_low: Corner = (-5.0, -5.0, 0.0)
    """Lower corner of the flight area, m, world: the least position that can be commanded."""
    area_high: Corner = (5.0, 5.0, 5.0)
    """Upper corner of the flight area, m, world: the greatest position that can be commanded."""
    duration = 10.0
    """Seconds after which an episode is truncated."""

    @abstractmethod
    def begin(self, draw: np.random.Generator) -> EpisodeStart:
        """Return the beginning of an episode of one drone.

        draw: the random numbers of this drone
        """

    @abstractmethod
    def judge(self, states: Mat, goals: Mat) -> tuple[Vec, Bools]:
        """Return the rewards of one step, and which drones have come to an end.

        states: (n, 13): rows laid out as State.flat, after the step
        goals: (n, goal_size)
        Returns (n,) rewards and (n,) booleans.
        """


@dataclass(frozen=True)
class ReachPlace(EnvTask):
    """Fly to a place and stay there; with one place as start and goal it is hovering.

        reward = 1 - |p - goal| / 1 m - tilt_cost (1 - z_b . e_z) - rate_cost |w|
        reward = - crash_cost  in the step in which the drone leaves its area

    An episode ends when the drone leaves its area, for instance because it falls to the floor.
    """

    start_low: Corner = (-1.0, -1.0, 0.5)
    """Lower corner of the box of starts, m, world."""
    start_high: Corner = (1.0, 1.0, 1.5)
    """Upper corner of the box of starts, m, world."""
    goal_low: Corner = (-1.0, -1.0, 0.5)
    """Lower corner of the box of goals, m, world."""
    goal_high: Corner = (1.0, 1.0, 1.5)
    """Upper corner of the box of goals, m, world."""
    area_low: Corner = (-2.5, -2.5, 0.05)
    """Lower corner of the flight area, m, world."""
    area_high: Corner = (2.5, 2.5, 3.0)
    """Upper corner of the flight area, m, world."""
    largest_yaw: float = 0.0
    """rad: headings at the start are drawn from both sides of 0 up to this one."""
    tilt_cost: float = 0.2
    """Reward lost for a thrust that points sideways."""
    rate_cost: float = 0.02
    """Reward lost for each rad/s of angular velocity, s/rad."""
    crash_cost: float = 20.0
    """Reward lost for leaving the area."""
    duration: float = 10.0
    """Seconds after which an episode is truncated."""
    goal_size = 3

    def begin(self, draw: np.random.Generator) -> EpisodeStart:
        """Return a start and a goal that are uniform in their boxes."""
        position = draw.uniform(self.start_low, self.start_high)
        goal = draw.uniform(self.goal_low, self.goal_high)
        yaw = float(draw.uniform(-self.largest_yaw, self.largest_yaw))
        return EpisodeStart(position, yaw, goal)

    def judge(self, states: Mat, goals: Mat) -> tuple[Vec, Bools]:
        """Return the rewards of one step, and which drones have left their area."""
        p = states[:, 0:3]
        w = states[:, 10:13]
        away = p - goals
        distance = np.sqrt(np.einsum("ij,ij->i", away, away))
        tilt = 2.0 * (states[:, 6] ** 2 + states[:, 7] ** 2)
        rate = np.sqrt(np.einsum("ij,ij->i", w, w))
        is_outside = (p < self.area_low) | (p > self.area_high)
        has_left: Bools = np.any(is_outside, axis=1)
        reward = 1.0 - distance - self.tilt_cost * tilt - self.rate_cost * rate
        reward[has_left] = -self.crash_cost
        return reward, has_left
