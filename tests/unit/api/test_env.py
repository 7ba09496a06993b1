"""Environments of gymnasium: the checker passes, and the batch does what single environments do."""

import gymnasium
import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode, SyncVectorEnv

from crazychoir.api.env import (
    OBSERVATION_SLICES,
    DroneEnv,
    DroneModel,
    DroneVectorEnv,
    EnvTask,
    EpisodeStart,
    ReachPlace,
)
from crazychoir.errors import ConfigError

VARIED = DroneModel(
    platforms=("cf21", "cf21bl"),
    mass=(0.9, 1.1),
    thrust=(0.8, 1.2),
    latency=(0.0, 0.06),
)
SHORT = ReachPlace(duration=0.5)
MODELS = [
    DroneModel(),
    VARIED,
    DroneModel("motors", "fpqr"),
    DroneModel("motors", "frpy"),
    DroneModel("motors", "velocity"),
    DroneModel("motors", "position"),
]


@pytest.mark.parametrize("model", MODELS, ids=lambda m: f"{m.world}-{m.command}")
def test_checker_of_gymnasium_finds_nothing(model):
    check_env(DroneEnv(model, SHORT), skip_render_check=True)


def test_registered_environment_passes_the_checker_too():
    env = gymnasium.make("crazychoir.api.env:crazychoir/Drone-v0")
    check_env(env.unwrapped)
    envs = gymnasium.make_vec("crazychoir/Drone-v0", num_envs=3)
    assert isinstance(envs.unwrapped, DroneVectorEnv)
    assert envs.reset(seed=1)[0].shape == (3, 16)


def fly_both(mode, model, steps=60):
    """Yield the results of the batch and of single environments, step by step."""
    batch = DroneVectorEnv(4, model, SHORT, autoreset_mode=mode)
    single = SyncVectorEnv([lambda: DroneEnv(model, SHORT)] * 4, autoreset_mode=mode)
    assert batch.single_observation_space == single.single_observation_space
    assert batch.metadata["autoreset_mode"] == single.metadata["autoreset_mode"]
    yield (*batch.reset(seed=7), *single.reset(seed=7)[:1])
    draw = np.random.default_rng(0)
    for _ in range(steps):
        actions = draw.uniform(-1.0, 1.0, (4, 4)).astype(np.float32)
        ours = batch.step(actions)
        theirs = single.step(actions)
        yield ours, theirs
        ended = ours[2] | ours[3]
        if mode == AutoresetMode.DISABLED and ended.any():
            # the wrapper of gymnasium takes the mask out of the options
            again = batch.reset(options={"reset_mask": ended})[0]
            assert np.array_equal(again, single.reset(options={"reset_mask": ended})[0])


@pytest.mark.parametrize("mode", list(AutoresetMode))
@pytest.mark.parametrize("model", [VARIED, DroneModel("motors", "fpqr")])
def test_batch_flies_as_single_environments_do(mode, model):
    flight = fly_both(mode, model)
    ours, _, theirs = next(flight)
    assert np.array_equal(ours, theirs)
    ends = 0
    for ours, theirs in flight:
        for a, b in zip(ours[:4], theirs[:4], strict=True):
            assert np.array_equal(a, b)
        assert sorted(ours[4]) == sorted(theirs[4])
        for a, b in zip(
            ours[4].get("final_obs", []), theirs[4].get("final_obs", []), strict=True
        ):
            assert np.array_equal(a, b) if b is not None else a is None
        ends += int((ours[2] | ours[3]).sum())
    assert ends >= 4


def test_same_seed_gives_the_same_episode_and_another_seed_another_one():
    envs = DroneVectorEnv(2, VARIED)
    first = envs.reset(seed=3)[0]
    assert np.array_equal(envs.reset(seed=3)[0], first)
    assert np.array_equal(envs.reset(seed=[4, 3])[0][1], first[0])
    assert not np.array_equal(envs.reset(seed=5)[0], first)


def test_masked_reset_starts_only_the_drones_of_the_mask_anew():
    envs = DroneVectorEnv(3, autoreset_mode=AutoresetMode.DISABLED)
    envs.reset(seed=1)
    before = envs.step(np.full((3, 4), 0.1, np.float32))[0]
    after = envs.reset(options={"reset_mask": np.array([False, True, False])})[0]
    assert np.array_equal(after[[0, 2]], before[[0, 2]])
    assert np.all(after[1, OBSERVATION_SLICES["velocity"]] == 0.0)


def test_step_after_the_end_of_an_episode_asks_for_a_reset():
    env = DroneEnv(task=ReachPlace(duration=0.02))
    env.reset(seed=1)
    assert env.step(np.zeros(4, np.float32))[3]
    with pytest.raises(ResetNeeded, match=r"reset\(\)"):
        env.step(np.zeros(4, np.float32))


@pytest.mark.parametrize("model", MODELS[2:], ids=lambda m: m.command)
def test_firmware_hovers_from_the_first_step_on(model):
    envs = DroneVectorEnv(
        2, DroneModel(model.world, model.command, ("cf21", "cf21bl")), frequency=100
    )
    start = envs.reset(seed=2)[0][:, OBSERVATION_SLICES["position"]]
    commands = np.zeros((2, 4))
    if model.command == "position":
        commands[:, :3] = start
    elif model.command != "velocity":
        weights = [platform.weight for platform in envs._platforms]
        commands[:, 0] = [weights[k] for k in drawn_platforms(envs)]
    actions = envs.command_range.to_actions(commands)
    for _ in range(100):
        seen, _, terminated, _, _ = envs.step(actions)
        assert not terminated.any()
    assert np.abs(seen[:, :3] - start).max() < 0.03


def drawn_platforms(envs):
    """Return the platform that each drone has, as its index in the model."""
    masses = [platform.mass for platform in envs._platforms]
    return [masses.index(body.mass) for body in envs._world._world.platforms]


def climb_after(model, seconds):
    """Return the height gained by full thrust."""
    env = DroneEnv(model, ReachPlace(start_low=(0, 0, 1), start_high=(0, 0, 1)), 100)
    start = env.reset(seed=0)[0]
    for _ in range(round(100 * seconds)):
        seen = env.step(np.array([1.0, 0.0, 0.0, 0.0], np.float32))[0]
    return seen[2] - start[2]


def test_heavy_weak_and_late_drones_climb_less():
    usual = climb_after(DroneModel(), 0.3)
    assert climb_after(DroneModel(mass=(1.2, 1.2)), 0.3) < 0.7 * usual
    assert climb_after(DroneModel(thrust=(0.8, 0.8)), 0.3) < 0.7 * usual
    late = climb_after(DroneModel(latency=(0.1, 0.1)), 0.3)
    assert late == pytest.approx(climb_after(DroneModel(), 0.2), rel=1e-5)


def test_reward_falls_with_the_distance_and_an_episode_ends_outside_the_area():
    task = ReachPlace()
    states = np.zeros((3, 13))
    states[:, 9] = 1.0
    states[:, 2] = 1.0, 1.5, 0.0
    rewards, has_ended = task.judge(states, np.tile([0.0, 0.0, 1.0], (3, 1)))
    assert rewards.tolist() == [1.0, 0.5, -20.0]
    assert has_ended.tolist() == [False, False, True]


class HoldHeight(EnvTask):
    """Keep the height of 1 m."""

    duration = 0.1

    def begin(self, draw):
        return EpisodeStart(np.array([0.0, 0.0, 1.0]), 0.0, np.empty(0))

    def judge(self, states, goals):
        return -np.abs(states[:, 2] - 1.0), np.zeros(len(states), bool)


def test_task_of_a_user_decides_start_reward_and_end():
    envs = DroneVectorEnv(2, task=HoldHeight(), frequency=50)
    assert envs.reset()[0].shape == (2, 13)
    rewards = []
    for _ in range(5):
        _, reward, terminated, truncated, _ = envs.step(-np.ones((2, 4), np.float32))
        rewards.append(reward[0])
    assert truncated.all()
    assert not terminated.any()
    assert rewards == sorted(rewards, reverse=True)


@pytest.mark.parametrize(
    ("options", "named"),
    [
        ({"world": "moon"}, "world"),
        ({"command": "frpy"}, "command"),
        ({"mass": (1.1, 0.9)}, "mass"),
        ({"latency": (-0.1, 0.0)}, "latency"),
        ({"platforms": ()}, "platforms"),
    ],
)
def test_model_with_a_wrong_value_is_refused(options, named):
    with pytest.raises(ConfigError, match=f"DroneModel: {named}"):
        DroneModel(**options)


def test_wrong_masks_and_seeds_are_refused():
    envs = DroneVectorEnv(2)
    with pytest.raises(ConfigError, match="reset_mask"):
        envs.reset(options={"reset_mask": np.zeros(2, bool)})
    with pytest.raises(ConfigError, match="seed"):
        envs.reset(seed=[1, 2, 3])
