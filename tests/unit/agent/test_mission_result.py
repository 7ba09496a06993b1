"""Results of missions, and what a flight changes in them."""

from types import SimpleNamespace

import numpy as np
import pytest
from pilots import make_stand_in

from crazychoir.agent.mission_result import ENDED_KEY, check_result, judge_flight
from crazychoir.bus.codec import MAX_PAYLOAD
from crazychoir.safety.rules.modes import Mode
from crazychoir.types import State


def test_a_result_arrives_as_it_would_over_the_network():
    result = check_result(
        {
            "far": np.float32(0.5),
            "n": np.int64(3),
            "by": {1: (2, 3)},
            "at": np.arange(3.0),
        }
    )
    assert (result["success"], result["far"], result["n"], result["by"]) == (
        True,
        0.5,
        3,
        {1: [2, 3]},
    )
    assert (type(result["far"]), type(result["n"])) == (float, int)
    assert isinstance(result["at"], np.ndarray)
    assert not result["at"].flags.writeable
    assert isinstance(check_result({"me": State.at((1, 2, 3))})["me"], State)


@pytest.mark.parametrize("yes", [True, np.True_, 1])
@pytest.mark.parametrize("no", [False, np.False_, 0])
def test_success_is_a_truth_value(yes, no):
    assert check_result({"success": yes})["success"] is True
    assert check_result({"success": no})["success"] is False


@pytest.mark.parametrize("nothing", [None, {}])
def test_nothing_is_a_success(nothing):
    assert check_result(nothing) == {"success": True}


@pytest.mark.parametrize(
    ("returned", "said"),
    [
        ([1], "a list; allowed: a dictionary, or nothing"),
        ({"success": "False"}, "success = 'False'; allowed: True or False"),
        ({"success": np.array([True, False])}, "success = array"),
        ({"seen": {1, 2}}, r"value\['seen'\]: found a set"),
        ({"film": bytes(MAX_PAYLOAD)}, "bytes when encoded; allowed: "),
    ],
)
def test_what_a_mission_may_not_return(returned, said):
    with pytest.raises(TypeError, match=said):
        check_result(returned)


@pytest.mark.parametrize(
    ("note", "harm", "reason"),
    [("", "", ""), ("it fell", "", "drone 4: it fell"), ("", "bent", "drone 4: bent")],
)
def test_success_needs_a_drone_that_came_down_whole(note, harm, reason):
    pilot = make_stand_in(
        {
            "mode": Mode.CUT if note else Mode.GROUND,
            "notes.text": note,
            "notes.brought_down": "",
            "guard.latched": "",
        }
    )
    drone = SimpleNamespace(id=4, pilot=pilot, harm=lambda: harm)
    judged = judge_flight({"success": True}, drone, "", "landed on command")
    assert judged.get("reason", "") == reason
    assert judged["success"] is not bool(reason)
    assert (ENDED_KEY in judged) is not bool(reason)
