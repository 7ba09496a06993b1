from dataclasses import replace

import numpy as np
import pytest

from crazychoir.config.tables import ControlTable
from crazychoir.control.choice import make_controls
from crazychoir.control.gains import STANDARD_GAINS
from crazychoir.control.parameters import ControllerParameters
from crazychoir.errors import ConfigError
from crazychoir.platforms import PLATFORM_BY_NAME
from crazychoir.types import FullState, State

HERE = State.at((0.0, 0.0, 1.0))


def test_a_gain_that_is_set_flies_from_the_next_tick_on():
    chosen = make_controls()
    parameters, far = ControllerParameters(chosen), FullState.at((0.5, 0, 1))
    before = chosen.tracker.command(HERE, far, 0.0).flat[2]
    assert parameters.set("control.kr", [7.0, 7.0, 4.0]) == (7.0, 7.0, 4.0)
    assert chosen.tracker.command(HERE, far, 0.5).flat[2] == pytest.approx(
        7.0 / 8.0 * before, rel=1e-6
    )
    assert parameters.get("control.kr") == (7.0, 7.0, 4.0)


@pytest.mark.parametrize(
    ("name", "value", "says"),
    [
        ("control.kr", [30.0, 30.0, 4.0], "bear 14 ms"),
        ("control.kp", [6.0, 6.0], "three finite numbers"),
        ("control.kp", [6.0, float("nan"), 6.0], "three finite numbers"),
        ("control.max_tilt", "high", "a finite number"),
        (
            "control.max_tilt",
            2.0,
            r"0\.2 to 1\.2",
        ),  # beyond pi/2 it would fly away from where it is to be
        ("control.max_tilt", 0.0, r"0\.2 to 1\.2"),
        ("control.thrust_delay", 5.0, r"0 to 0\.2"),
        ("control.rate_delay", 5.0, r"0 to 0\.2"),
        ("control.lead", 1.0, "no such parameter"),  # only acceleration laws have it
        ("control.kx", 1.0, "control.kp"),
        ("trim.thrust", 1.0, "can only be read"),
    ],
)
def test_what_cannot_be_flown_is_refused_and_changes_nothing(name, value, says):
    chosen = make_controls()
    parameters, before = (
        ControllerParameters(chosen),
        ControllerParameters(chosen).all(),
    )
    with pytest.raises(ConfigError, match=says):
        parameters.set(name, value)
    assert parameters.all() == before


def test_gains_of_the_swarm_file_are_checked_before_the_flight():
    assert make_controls(ControlTable(gains={"kr": [7, 7, 4]})).gains.kr == (
        7.0,
        7.0,
        4.0,
    )
    with pytest.raises(ConfigError, match=r"roles\[0\].gains = .*Move towards"):
        make_controls(ControlTable(gains={"kr": [40, 40, 4]}), where="roles[0]")
    with pytest.raises(ConfigError, match=r"control.gains.kpp"):
        make_controls(ControlTable(gains={"kpp": 3}))
    with pytest.raises(ConfigError, match=r"control.gains.max_tilt.*0\.2 to 1\.2"):
        make_controls(ControlTable(gains={"max_tilt": 2.0}))


def test_gains_are_judged_with_the_attitude_control_that_flies_them():
    """Behind roll and pitch that is the firmware's, of 6 1/s."""
    fast = {"kp": [20, 20, 10], "kv": [3, 3, 5], "kr": [10, 10, 4]}
    chosen = make_controls(
        ControlTable(sender="frpy"), PLATFORM_BY_NAME["cf21"], "motors"
    )
    assert make_controls(
        ControlTable(gains=fast), PLATFORM_BY_NAME["cf21"], "motors"
    ).gains.kr == (
        10.0,
        10.0,
        4.0,
    )
    with pytest.raises(ConfigError, match="bear 0 ms"):
        make_controls(
            ControlTable(sender="frpy", gains=fast), PLATFORM_BY_NAME["cf21"], "motors"
        )
    with pytest.raises(ConfigError, match="bear 0 ms"):
        chosen.retune(replace(chosen.gains, kp=(20.0, 20.0, 10.0), kv=(3.0, 3.0, 5.0)))


@pytest.mark.parametrize("sender", ["vel", "xyz", "fullstate"])
def test_gains_that_the_firmware_does_not_obey_are_refused(sender):
    with pytest.raises(ConfigError, match=r"control.gains.*fpqr or frpy"):
        make_controls(
            ControlTable(sender=sender, gains={"kp": [5, 5, 9]}), plant="motors"
        )
    with pytest.raises(ConfigError, match="no such parameter"):
        ControllerParameters(
            make_controls(ControlTable(sender=sender), plant="motors")
        ).set("control.kp", [5.0, 5.0, 9.0])


@pytest.mark.parametrize(
    "platform", PLATFORM_BY_NAME.values(), ids=lambda row: row.name
)
@pytest.mark.parametrize("sender", ["fpqr", "frpy", "vel", "xyz", "fullstate"])
def test_every_sender_hovers_every_platform(platform, sender):
    chosen = make_controls(ControlTable(sender=sender), platform, "motors")
    command = chosen.tracker.command(HERE, FullState.at((0, 0, 1)), 0.0)
    expected = {
        "fpqr": [platform.weight, 0, 0, 0],
        "frpy": [platform.weight, 0, 0, 0],
        "vel": np.zeros(4),
    }
    expected["fullstate"] = FullState.at((0, 0, 1)).flat
    np.testing.assert_allclose(
        command.flat, expected.get(sender, [0, 0, 1, 0, 0.2]), atol=1e-12
    )
    assert (chosen.follower is None) == (sender in ("vel", "xyz", "fullstate"))


def test_all_of_it_can_be_read():
    values = ControllerParameters(make_controls()).values(None)
    assert values["control.kp"] == STANDARD_GAINS.kp
    assert values["trim.thrust"] == 1.0
    assert values["platform.name"] == "paper"
