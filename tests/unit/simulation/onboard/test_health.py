"""The health tests: each propeller in turn, and all motors at once."""

import numpy as np
import pytest
from virtual_drones import Hangar

from crazychoir.platforms import CRAZYFLIE_21, CRAZYFLIE_21_BRUSHLESS
from crazychoir.simulation.onboard import loop
from crazychoir.simulation.onboard.onboard import Onboard

FINISHED = 128


def resting(platform=CRAZYFLIE_21):
    """Return a drone that has weighed itself on a bench, and is told to keep its motors off."""
    board = Onboard(platform)
    loop.run(board.rows, 400.0, 0, 0, 0, 0, 0, 9.80665)
    board.emergency_stop()
    return board


def run(board, ms, ax=0.0):
    loop.run(board.rows, float(ms), 0, 0, 0, ax, 0, 9.80665)


def ratios(board):
    return board.record["ratio"].tolist()


def test_each_propeller_turns_for_50_ms_of_a_second():
    board = resting()
    board.set("health.startPropTest", 1)
    run(board, 100)
    assert board.get("health.startPropTest") == 0
    assert ratios(board) == [0.0] * 4
    for k in range(4):
        run(board, 1)
        assert ratios(board) == [65535.0 * (j == k) for j in range(4)]
        run(board, 48)
        assert ratios(board)[k] == 65535.0
        run(board, 1)
        assert ratios(board) == [0.0] * 4
        assert not int(board.log("health.motorPass"))
        run(board, 950)
    assert int(board.log("health.motorPass")) == FINISHED
    assert int(board.log("health.motorTestCount")) == 1


@pytest.mark.parametrize(("most", "passed"), [(30.0, 0b1101), (0.0, 0)])
def test_a_variance_between_the_thresholds_passes(most, passed):
    """A motor's 100 samples of +1 and -1 g on one axis have a sum of squares of 100 g2."""
    board = resting()
    board.set("health.propTestThreshold", most)
    board.set("health.startPropTest", 1)
    run(board, 100)
    for k in range(4):
        shake = 9.80665 * (1.0 if k == 1 else 0.5)
        for _ in range(50):
            run(board, 1, shake)
            run(board, 1, -shake)
        run(board, 900)
    variances = [board.log(f"health.motorVarXM{k}") for k in (1, 2, 3, 4)]
    assert variances == pytest.approx([25.0, 100.0, 25.0, 25.0], rel=1e-6)
    assert int(board.log("health.motorPass")) == FINISHED | passed


def test_the_battery_is_loaded_for_50_ms_by_all_motors():
    board = resting()
    board.record["vbat"] = 4.1
    board.set("health.startBatTest", 1)
    run(board, 2)
    assert ratios(board) == [40000.0] * 4
    board.record["vbat"] = 3.5
    run(board, 48)
    assert ratios(board) == [40000.0] * 4
    run(board, 1)
    assert ratios(board) == [0.0] * 4
    assert board.log("health.batterySag") == pytest.approx(0.6)
    assert board.log("health.batteryPass") == 1
    board.record["vbat"] = 4.25
    board.set("health.startBatTest", 1)
    run(board, 2)
    board.record["vbat"] = 3.5
    run(board, 60)
    assert board.log("health.batterySag") == pytest.approx(0.75)
    assert board.log("health.batteryPass") == 0


def test_a_brushless_drone_needs_a_ratio_of_its_own():
    board = resting(CRAZYFLIE_21_BRUSHLESS)
    board.set("health.startBatTest", 1)
    run(board, 30)
    assert ratios(board) == [0.0] * 4
    run(board, 30)
    board.set("health.batTestPWMRatio", 20000)
    board.set("health.startBatTest", 1)
    run(board, 30)
    assert ratios(board) == [20000.0] * 4


def test_the_battery_of_a_virtual_drone_sags_and_the_drone_flies_afterwards():
    hangar = Hangar().run(0.5)
    hangar.drone.parameters.set("health.startBatTest", 1.0)
    hangar.run(0.2)
    assert hangar.drone.parameters.read("health.startBatTest") == 0.0
    assert 0.02 < hangar.onboard.log("health.batterySag") < 0.7
    assert hangar.onboard.log("health.batteryPass") == 1.0
    hangar.run(1.0)
    hangar.hovering(0.5)
    assert hangar.state[:3] == pytest.approx([0.0, 0.0, 0.5], abs=0.1)
    assert np.all(np.isfinite(hangar.state))
