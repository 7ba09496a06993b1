"""Lists of targets around the homes of drones."""

from crazychoir.guidance.defaults.targets import TargetHooks, TargetOptions

HOOKS = TargetHooks(TargetOptions)


def test_targets_are_relative_to_the_home():
    config = HOOKS.swarm(3).replace(mission_options={"targets": [[0.5, 0.0, 1.0]]})
    assert HOOKS.targets(2, config).tolist() == [[0.5, 4.0, 1.0]]
    assert HOOKS.goal(config)[1].tolist() == [0.5, 2.0, 1.0]
    assert HOOKS.check(config) == []


def test_a_drone_that_did_not_reach_all_targets_is_named():
    config = HOOKS.swarm(2)
    results = {0: {"reached_s": [1.0, 2.0, 3.0, 4.0, 5.0]}, 1: {"reached_s": [1.0]}}
    report = HOOKS.report(config, results)
    assert report["reasons"] == {1: "reached 1 of 5 targets"}
