"""The result of a mission at one drone, and how a flight changes it."""

from dataclasses import dataclass
from typing import Any

from crazychoir.agent.drone import Drone
from crazychoir.bus.codec import decode, encode
from crazychoir.errors import CodecError, reason_or
from crazychoir.flight.pilot import Pilot
from crazychoir.guidance.awaited_call import describe_forgotten_calls
from crazychoir.runtime.clock import NS_PER_SECOND
from crazychoir.safety.rules.modes import Mode


@dataclass(frozen=True, slots=True)
class MissionReasons:
    """Reasons of missions that did not start, that ended on command, or that failed without a
    reason of their own.
    """

    stopped: str = (
        "emergency stop in force: it does not take off until `crazychoir stop --clear`"
    )
    """Reason of a drone that does not start during an emergency stop."""
    stays: str = (
        "emergency stop in force: this agent stays, so that agents that start later hear of it, "
        "until `crazychoir stop --clear` or Ctrl-C"
    )
    """Reason of a drone that stays after its mission during an emergency stop."""
    landed: str = "landed on command"
    """Reason of a mission that ended with a command to land."""
    sent_home: str = "sent home on command"
    """Reason of a mission that ended with a command to go home."""
    unsaid: str = "its mission returned success = False, without a reason"
    """Reason of a failed mission that gave none."""


MISSION_REASONS = MissionReasons()


ENDS_ON_COMMAND = (MISSION_REASONS.landed, MISSION_REASONS.sent_home)
"""Reasons of missions that an operator has ended: they have not failed."""
ENDED_KEY = "ended"
"""Key of a result that says how an operator has ended the mission.

All other results do not have it.
"""

Result = dict[str, Any]
"""The result of a mission at one drone."""


def check_result(returned: object) -> Result:
    """Return the result of a mission after the codec, with `success` as a bool.

    All readers in all worlds therefore get the same form.
    Raises TypeError for anything but None or a dictionary that the codec can encode.
    """
    if returned is None:
        returned = {}
    if not isinstance(returned, dict):
        raise TypeError(
            f"mission() returned a {type(returned).__name__}; allowed: a dictionary, or nothing"
        )
    try:
        result: Result = decode(encode(dict(returned)))
    except CodecError as error:
        raise TypeError(f"mission() returned what cannot travel: {error}") from error
    success = result.get("success", True)
    if not isinstance(success, bool | int):
        raise TypeError(
            f"mission() returned success = {success!r}; allowed: True or False"
        )
    return result | {"success": bool(success)}


def result_of_operator_end(words: str) -> Result:
    """Return the result of a mission that its operator has ended: not a failure."""
    return {"success": True, "reason": words, ENDED_KEY: words}


def result_of_failure(reason: str, result: Result | None = None) -> Result:
    """Return the result of a failed mission. Its reason is never empty.

    reason: why, in words.
    result: what else is known.
    """
    told = {key: value for key, value in (result or {}).items() if key != ENDED_KEY}
    return {
        **told,
        "success": False,
        "reason": reason_or(reason, MISSION_REASONS.unsaid),
    }


def add_forgotten_calls(result: Result, drone: Drone, has_returned: bool) -> Result:
    """Return the result, as a failure if the mission has forgotten to await calls.

    The failure names the calls. An error that has ended the mission is named first, because it may
    have another cause.

    has_returned: whether the mission has ended by itself, without an error.
    """
    words = describe_forgotten_calls(drone.guidance, has_returned)
    if not words:
        return result
    if result["success"]:
        return result_of_failure(f"drone {drone.id}: {words}", result)
    return result_of_failure(f"{result['reason']}; {words}", result)


def add_flight_times(result: Result, pilot: Pilot) -> Result:
    """Return the result with two times in s, as far as they are not 0.

    kept_clear_s: time in which the drone gave way to other drones
    at_fence_s: time in which the fence kept the drone from its target
    """
    ticks = {
        "kept_clear_s": pilot.follower.clearance.ticks,
        "at_fence_s": pilot.row.fence_ticks,
    }
    times = {
        key: round(count * pilot.setup.period_ns / NS_PER_SECOND, 2)
        for key, count in ticks.items()
        if count
    }
    return {**result, **times} if times else result


def judge_flight(result: Result, drone: Drone, aborted: str, ended: str) -> Result:
    """Return the final result, now that the drone is down.

    It is a success only if the drone was not brought down, and is not damaged.

    result: result of the mission's own code
    aborted: reason why the mission was aborted, empty if it was not
    ended: reason with which an operator has ended it, empty without one
    """
    pilot = drone.pilot
    harm = drone.harm()
    cut = pilot.notes.text if pilot.mode is Mode.CUT else ""
    brought_down = aborted or cut or pilot.guard.latched or pilot.notes.brought_down
    if result.get("success"):
        reasons = [text for text in (brought_down, harm) if text]
        if reasons:
            return result_of_failure(f"drone {drone.id}: {'; '.join(reasons)}", result)
        if not ended:
            return result
        return {**result, ENDED_KEY: result.get(ENDED_KEY, ended)}
    reason = str(result.get("reason") or "")
    if harm and harm not in reason:
        reason = "; ".join(filter(None, (reason, harm)))
    return result_of_failure(reason, result)
