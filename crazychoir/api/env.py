"""Drones as gymnasium environments: DroneVectorEnv, a batch in one compiled world, and DroneEnv, one drone.

`pip install 'crazychoir[gym]'`. Both are registered as "crazychoir/Drone-v0":

    import gymnasium
    envs = gymnasium.make_vec("crazychoir.api.env:crazychoir/Drone-v0", num_envs=64)
"""

from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np
from gymnasium.error import ResetNeeded
from gymnasium.spaces import Box
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from crazychoir.api.env_models import (
    CommandDelays,
    CommandRange,
    DrawnDrone,
    DroneModel,
    find_command_range,
    make_env_world,
)
from crazychoir.api.env_tasks import EnvTask, EpisodeStart, ReachPlace
from crazychoir.errors import ConfigError
from crazychoir.types import Bools, Mat, Vec

__all__ = [
    "DroneEnv",
    "DroneModel",
    "DroneVectorEnv",
    "EnvTask",
    "EpisodeStart",
    "ReachPlace",
]

ENVIRONMENT_NAME = "crazychoir/Drone-v0"
"""Name of both environments in gymnasium's registry."""
LONGEST_WORLD_STEP = 0.01
"""s: longest step of a world; a longer step of the environment is several steps of its world."""
STATE_SIZE = 13
"""Count of numbers of a state in an observation."""
LARGEST_OBSERVATION = 1000.0
"""Largest number of an observation, in its unit; larger ones are cut."""
OBSERVATION_SLICES = {
    "position": slice(0, 3),
    "quaternion": slice(3, 7),
    "velocity": slice(7, 10),
    "rates": slice(10, 13),
    "goal": slice(13, None),
}
"""Where the parts of an observation are.

position: m, world.
quaternion: [x, y, z, w], body to world.
velocity: m/s, world.
rates: rad/s, body.
goal: as the task says.
"""

Reset = tuple[Mat, dict[str, Any]]
"""Observations and infos of a reset."""
Step = tuple[Mat, Vec, Bools, Bools, dict[str, Any]]
"""Observations, rewards, terminations, truncations and infos of a step."""


class DroneVectorEnv(VectorEnv[Mat, Mat, Any]):
    """A batch of environments with one drone each; all drones advance in one compiled call.

    Actions are (n, 4) in -1..1, mapped linearly to the commands in `command_range`. Observations are
    (n, 13 + k): see OBSERVATION_SLICES. Each environment draws from a generator of its own:
    environment i with seed s flies as DroneEnv with seed s does.

    num_envs: number of drones
    model: the drones: world, commands, platforms, and how much they vary
    task: start, goal, reward and end of an episode
    frequency: Hz: steps of the environment; the world makes steps of at most 10 ms
    autoreset_mode: when a drone starts anew after its episode: "NextStep", "SameStep" or "Disabled"; with
        the last one call `reset(options={"reset_mask": mask})`
    """

    def __init__(
        self,
        num_envs: int = 1,
        model: DroneModel | None = None,
        task: EnvTask | None = None,
        frequency: float = 50.0,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
    ) -> None:
        if num_envs < 1:
            raise ConfigError("DroneVectorEnv: num_envs", num_envs, "1 or more")
        if not 0.0 < frequency <= 1000.0:
            raise ConfigError("DroneVectorEnv: frequency", frequency, "0 to 1000 Hz")
        self.num_envs = num_envs
        self.model = DroneModel() if model is None else model
        self.task: EnvTask = ReachPlace() if task is None else task
        self.autoreset_mode = AutoresetMode(autoreset_mode)
        self.metadata = {"autoreset_mode": self.autoreset_mode, "render_modes": []}
        self._substeps = max(1, round(1.0 / (frequency * LONGEST_WORLD_STEP)))
        self._dt = 1.0 / (frequency * self._substeps)
        self._platforms = self.model.find_platforms()
        self.command_range: CommandRange = find_command_range(
            self.model.command,
            self._platforms,
            (np.array(self.task.area_low), np.array(self.task.area_high)),
        )
        self.single_action_space = Box(-1.0, 1.0, (4,), np.float32)
        self.single_observation_space = Box(
            -LARGEST_OBSERVATION,
            LARGEST_OBSERVATION,
            (STATE_SIZE + self.task.goal_size,),
            np.float32,
        )
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self._world = make_env_world(num_envs, self._dt, self.model)
        self._draws = [seeding.np_random(None)[0] for _ in range(num_envs)]
        self._goals = np.zeros((num_envs, self.task.goal_size))
        self._steps = np.zeros(num_envs, np.int64)
        self._most_steps = max(1, round(self.task.duration * frequency))
        self._has_ended = np.ones(num_envs, bool)
        self._delays = CommandDelays(num_envs, self._count_delay(self.model.latency[1]))

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> Reset:
        """Begin an episode of all drones, or of those in options["reset_mask"], booleans (n,).

        seed: of drone 0, the others get the next ones; or one a drone
        Raises ConfigError for a mask or seeds of another length.
        """
        mask = self._read_mask(options or {})
        seeds = self._list_seeds(seed)
        for row in np.flatnonzero(mask).tolist():
            if seeds[row] is not None:
                self._draws[row] = seeding.np_random(seeds[row])[0]
        self._begin(mask)
        return self._observe(), {}

    def step(self, actions: Mat) -> Step:
        """Advance all drones by one step with these actions, (n, 4) in -1..1.

        Raises ResetNeeded if a drone's episode has ended and nothing resets it.
        """
        ended = self._has_ended
        if ended.any() and self.autoreset_mode != AutoresetMode.NEXT_STEP:
            raise ResetNeeded(
                f"drones {np.flatnonzero(ended).tolist()}: their episode has not begun: "
                'call reset(), or reset(options={"reset_mask": mask})'
            )
        self._advance(self.command_range.to_commands(np.asarray(actions)))
        self._steps += 1
        rewards, terminated = self.task.judge(self._world.states, self._goals)
        truncated = (self._steps >= self._most_steps) & ~terminated
        infos: dict[str, Any] = {}
        if ended.any():
            self._begin(ended)
            rewards[ended] = 0.0
            terminated[ended] = False
            truncated[ended] = False
        self._has_ended = terminated | truncated
        observations = self._observe()
        if self.autoreset_mode == AutoresetMode.SAME_STEP and self._has_ended.any():
            for row in np.flatnonzero(self._has_ended).tolist():
                final = {"final_obs": observations[row].copy(), "final_info": {}}
                infos = self._add_info(infos, final, row)
            self._begin(self._has_ended)
            observations = self._observe()
        return observations, rewards, terminated, truncated, infos

    def _advance(self, commands: Mat) -> None:
        """Advance the world by one step of the environment; each drone gets its commands late."""
        for _ in range(self._substeps):
            self._world.step(self._delays.pass_on(commands))

    def _begin(self, mask: Bools) -> None:
        """Begin an episode of the drones of this mask."""
        for row in np.flatnonzero(mask).tolist():
            draw = self._draws[row]
            start = self.task.begin(draw)
            drawn = self._draw_drone(draw)
            delay = self._count_delay(float(draw.uniform(*self.model.latency)))
            self._world.begin(row, drawn, start.position, start.yaw)
            self._goals[row] = start.goal
            command = self._find_hover_command(drawn.platform, start)
            self._delays.begin(row, delay, command)
        self._steps[mask] = 0
        self._has_ended = self._has_ended & ~mask

    def _count_delay(self, latency: float) -> int:
        """Return a latency in s as steps of the world."""
        return round(latency / self._dt)

    def _draw_drone(self, draw: np.random.Generator) -> DrawnDrone:
        return DrawnDrone(
            int(draw.integers(len(self._platforms))),
            float(draw.uniform(*self.model.mass)) - 1.0,
            float(draw.uniform(*self.model.thrust)) - 1.0,
        )

    def _find_hover_command(self, platform: int, start: EpisodeStart) -> Vec:
        """Return the command (4,) that a drone obeys until its first command arrives."""
        if self.model.command == "position":
            return np.array([*start.position, start.yaw])
        if self.model.command == "velocity":
            return np.zeros(4)
        return np.array([self._platforms[platform].weight, 0.0, 0.0, 0.0])

    def _observe(self) -> Mat:
        states = self._world.states
        observations = np.concatenate(
            (
                states[:, 0:3],
                states[:, 6:10],
                states[:, 3:6],
                states[:, 10:13],
                self._goals,
            ),
            axis=1,
            dtype=np.float32,
        )
        return np.clip(observations, -LARGEST_OBSERVATION, LARGEST_OBSERVATION)

    def _read_mask(self, options: dict[str, Any]) -> Bools:
        mask = options.get("reset_mask")
        if mask is None:
            return np.ones(self.num_envs, bool)
        flags = np.asarray(mask)
        if flags.shape != (self.num_envs,) or flags.dtype != bool or not flags.any():
            raise ConfigError(
                "reset: reset_mask",
                mask,
                f"{self.num_envs} booleans, at least one of them true",
            )
        return flags

    def _list_seeds(
        self, seed: int | Sequence[int | None] | None
    ) -> Sequence[int | None]:
        if seed is None:
            return [None] * self.num_envs
        if isinstance(seed, int | np.integer):
            return [int(seed) + i for i in range(self.num_envs)]
        if len(seed) != self.num_envs:
            raise ConfigError(
                "reset: seed", seed, f"a whole number, or {self.num_envs} of them"
            )
        return seed


class DroneEnv(gymnasium.Env[Vec, Vec]):
    """One drone as an environment: a DroneVectorEnv with one row.

    model: the drone: world, commands, platforms, and how much it varies
    task: start, goal, reward and end of an episode
    frequency: Hz: steps of the environment
    """

    metadata = {"render_modes": []}  # noqa: RUF012 - so declared by gymnasium.Env

    def __init__(
        self,
        model: DroneModel | None = None,
        task: EnvTask | None = None,
        frequency: float = 50.0,
    ) -> None:
        self._batch = DroneVectorEnv(1, model, task, frequency, AutoresetMode.DISABLED)
        self.action_space = self._batch.single_action_space
        self.observation_space = self._batch.single_observation_space
        self.command_range = self._batch.command_range

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Vec, dict[str, Any]]:
        """Begin an episode; the same seed gives the same episode."""
        super().reset(seed=seed)
        observations, infos = self._batch.reset(seed=seed)
        return observations[0], infos

    def step(self, action: Vec) -> tuple[Vec, float, bool, bool, dict[str, Any]]:
        """Advance by one step with this action, (4,) in -1..1.

        Raises ResetNeeded if the episode has ended.
        """
        observations, rewards, terminated, truncated, infos = self._batch.step(
            np.asarray(action)[None, :]
        )
        return (
            observations[0],
            float(rewards[0]),
            bool(terminated[0]),
            bool(truncated[0]),
            infos,
        )


gymnasium.register(
    ENVIRONMENT_NAME,
    entry_point=f"{__name__}:DroneEnv",
    vector_entry_point=f"{__name__}:DroneVectorEnv",
)
