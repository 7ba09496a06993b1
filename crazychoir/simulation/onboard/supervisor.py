"""The supervisor: permission for motors, missing set-points, and tumbled drones."""

import math
from typing import NamedTuple

from crazychoir.firmware.planning import PLANNER_STATES
from crazychoir.firmware.supervision import SUPERVISOR_BITS, SUPERVISOR_STATES
from crazychoir.firmware.timeouts import FIRMWARE_TIMEOUTS
from crazychoir.numerics.kernels import kernel
from crazychoir.simulation.onboard.commander import SETPOINT_PRIORITIES
from crazychoir.simulation.onboard.planner import is_finished
from crazychoir.simulation.onboard.record import Fleet, Record, rows, whole


class SupervisorLimits(NamedTuple):
    """Accelerations from which the supervisor knows how a drone lies."""

    upright_acceleration: float = 0.5
    """g along z: at least this much means upright."""
    inverted_acceleration: float = -0.2
    """g along z: less means on its back."""
    falling_acceleration: float = 0.1
    """g on every axis: less means free fall."""


SUPERVISOR_LIMITS = SupervisorLimits()


@kernel()
def _has_hit(fw: Record) -> bool:
    """Return True if the acceleration differs from 1 g by more than supervisor.crashDetectGs.

    Source: crazyflie-firmware, pull request 1644.
    """
    norm = math.sqrt(fw.ax * fw.ax + fw.ay * fw.ay + fw.az * fw.az)
    hit: bool = fw.crash_deviation > 0.0 and abs(norm - 1.0) > fw.crash_deviation
    return hit


@kernel()
def _see_tumbling(fw: Record) -> None:
    """Detect tumbling: below 0.5 g along z for 1 s, below -0.2 g for 0.1 s, or a hit.

    Free fall restarts both times, because it says nothing about the attitude.
    """
    if (
        max(abs(fw.ax), max(abs(fw.ay), abs(fw.az)))
        < SUPERVISOR_LIMITS.falling_acceleration
    ):
        fw.upright_at = fw.not_upside_at = fw.tick
    if fw.az >= SUPERVISOR_LIMITS.upright_acceleration:
        fw.upright_at = fw.tick
    if fw.az >= SUPERVISOR_LIMITS.inverted_acceleration:
        fw.not_upside_at = fw.tick
    tilted = (
        fw.tick - fw.upright_at > FIRMWARE_TIMEOUTS.tilted
        or fw.tick - fw.not_upside_at > FIRMWARE_TIMEOUTS.inverted
    )
    fw.tumbled = 1 if fw.tumble_check and (tilted or _has_hit(fw)) else 0


@kernel()
def _see_motors(fw: Record) -> None:
    """Detect turning motors: one was above idle in the last 2 s."""
    m = fw.ratio
    if max(max(m[0], m[1]), max(m[2], m[3])) > fw.idle:
        fw.stopping_at = fw.tick
    fw.turning = 1 if fw.tick - fw.stopping_at < FIRMWARE_TIMEOUTS.resting else 0


@kernel()
def _enter(fw: Record, state: int) -> None:
    fw.state = state
    fw.since = fw.tick
    if state in (
        SUPERVISOR_STATES.reset,
        SUPERVISOR_STATES.checks_not_passed,
        SUPERVISOR_STATES.locked,
        SUPERVISOR_STATES.crashed,
    ):
        fw.armed = 0
        fw.arm_requested = 0
        fw.planner.state = (
            PLANNER_STATES.idle
        )  # a drone that may not fly has no plan either
    if state == SUPERVISOR_STATES.free_fall:
        fw.priority = SETPOINT_PRIORITIES.no_sender


@kernel()
def _update_on_ground(fw: Record, waited: int) -> None:
    if fw.state == SUPERVISOR_STATES.not_initialised:
        _enter(fw, SUPERVISOR_STATES.checks_not_passed)
    elif fw.state == SUPERVISOR_STATES.checks_not_passed:
        if not fw.tumbled:
            _enter(fw, SUPERVISOR_STATES.checks_passed)
    elif fw.tumbled:
        _enter(fw, SUPERVISOR_STATES.checks_not_passed)
    elif fw.state == SUPERVISOR_STATES.checks_passed:
        if fw.arm_requested or fw.auto_arm:
            fw.armed = 1
            _enter(fw, SUPERVISOR_STATES.arming)
    elif fw.state == SUPERVISOR_STATES.arming:
        _enter(
            fw,
            SUPERVISOR_STATES.ready
            if fw.armed
            else SUPERVISOR_STATES.checks_not_passed,
        )
    elif fw.turning and fw.armed:
        _enter(fw, SUPERVISOR_STATES.flying)
    elif not fw.armed or waited > fw.preflight_timeout:
        _enter(fw, SUPERVISOR_STATES.checks_not_passed)


@kernel()
def _update_in_air(fw: Record, age: int) -> None:
    if fw.tumbled:
        _enter(fw, SUPERVISOR_STATES.crashed)
    elif not fw.armed:
        _enter(fw, SUPERVISOR_STATES.reset)
    elif age > FIRMWARE_TIMEOUTS.free_fall:
        _enter(fw, SUPERVISOR_STATES.free_fall)
    elif not fw.turning:
        _enter(fw, SUPERVISOR_STATES.landed)
    elif age > FIRMWARE_TIMEOUTS.level_out:
        if fw.state != SUPERVISOR_STATES.level_out:
            _enter(fw, SUPERVISOR_STATES.level_out)
    elif fw.state != SUPERVISOR_STATES.flying:
        _enter(fw, SUPERVISOR_STATES.flying)


@kernel()
def _update_after_landing(fw: Record, waited: int) -> None:
    if fw.turning and fw.armed:
        _enter(fw, SUPERVISOR_STATES.flying)
    elif not fw.armed or waited >= fw.landed_timeout:
        _enter(fw, SUPERVISOR_STATES.reset)


@kernel()
def _update_state(fw: Record) -> None:
    """Make at most one change of state."""
    if fw.watchdog and fw.tick - fw.watchdog_at >= FIRMWARE_TIMEOUTS.watchdog:
        fw.estop = 1
    waited = fw.tick - fw.since
    if fw.state == SUPERVISOR_STATES.locked:
        return
    if fw.estop or fw.state == SUPERVISOR_STATES.free_fall:
        _enter(fw, SUPERVISOR_STATES.locked)
    elif fw.state <= SUPERVISOR_STATES.ready:
        _update_on_ground(fw, waited)
    elif (
        fw.state == SUPERVISOR_STATES.flying or fw.state == SUPERVISOR_STATES.level_out
    ):
        _update_in_air(fw, fw.tick - fw.stamp)
    elif fw.state == SUPERVISOR_STATES.landed:
        _update_after_landing(fw, waited)
    elif fw.state == SUPERVISOR_STATES.reset:
        _enter(fw, SUPERVISOR_STATES.checks_not_passed)


@kernel()
def may_fly(fw: Record) -> bool:
    """Return True if the supervisor allows motors; an emergency stop counts at once."""
    return not fw.estop and fw.state in (
        SUPERVISOR_STATES.ready,
        SUPERVISOR_STATES.flying,
        SUPERVISOR_STATES.landed,
        SUPERVISOR_STATES.level_out,
    )


def name_flown_setpoint(fw: Record) -> str:
    """Return the field of the set-point that the controller follows."""
    if fw["state"] == SUPERVISOR_STATES.level_out:
        return "level"
    return "avoided" if fw["avoids"] else "wanted"


@kernel()
def may_arm(fw: Record) -> bool:
    """Return True if a drone that is not armed can be armed: the checks before flight are passed."""
    may: bool = fw.state == SUPERVISOR_STATES.checks_passed
    return may


@kernel()
def _write_information(fw: Record) -> None:
    """Write whether the drone flies, and the bits of supervisor.info.

    The bit deck_fault is never set.
    """
    is_flying = fw.state in (SUPERVISOR_STATES.flying, SUPERVISOR_STATES.level_out)
    fw.flying = 1 if is_flying else 0
    word = 0
    if may_arm(fw):
        word |= SUPERVISOR_BITS.can_arm
    if fw.armed:
        word |= SUPERVISOR_BITS.armed
    if fw.auto_arm:
        word |= SUPERVISOR_BITS.auto_arm
    if may_fly(fw):
        word |= SUPERVISOR_BITS.can_fly
    if is_flying:
        word |= SUPERVISOR_BITS.flying
    if fw.tumbled:
        word |= SUPERVISOR_BITS.tumbled
    if fw.state == SUPERVISOR_STATES.locked:
        word |= SUPERVISOR_BITS.locked
    if fw.state == SUPERVISOR_STATES.crashed:
        word |= SUPERVISOR_BITS.crashed
    plan = fw.planner.state
    if plan == PLANNER_STATES.flying or plan == PLANNER_STATES.landing:
        word |= SUPERVISOR_BITS.planned
    if plan == PLANNER_STATES.disabled:
        word |= SUPERVISOR_BITS.plan_disabled
    if is_finished(fw):
        word |= SUPERVISOR_BITS.plan_ended
    fw.info = word


@kernel()
def update(fw: Record) -> None:
    """Update the supervisor, with at most one change of state. Call it at 25 Hz.

    Programs read what it has found until its next pass: `flying` and the bits of supervisor.info.
    Choices of this model, which may differ from the firmware:
    - A drone counts as landed when its motors have been at idle for 2 s, also while it levels out.
    - After a landing, motors stay allowed for landed_timeout ms, for another take-off.
    - Free fall lasts one pass. Then the drone is locked. Both states keep the motors off, and free
      fall takes control from all sources of set-points.
    - Arming always succeeds at the next pass, because motor speeds are not checked.
    """
    _see_tumbling(fw)
    _see_motors(fw)
    _update_state(fw)
    _write_information(fw)


@kernel(rows, whole)
def can_fly(fleet: Fleet, i: int) -> bool:
    """Return True if the planner accepts plans: the supervisor allows motors.

    The planner of a firmware with a self-test that has failed accepts plans too: nothing has
    blocked it, and nothing will fly them.
    """
    fw = fleet[i]
    can: bool = fw.self_tested == 0 or may_fly(fw)
    return can


@kernel(rows, whole)
def request_arming(fleet: Fleet, i: int) -> bool:
    """Request armed motors; return False if the checks before flight do not allow it."""
    fw = fleet[i]
    if fw.armed == 0 and not may_arm(fw):
        return False
    fw.arm_requested = 1
    return True


@kernel(rows, whole)
def information(fleet: Fleet, i: int) -> int:
    """Return the bits of supervisor.info, as they were at the last pass of the supervisor."""
    word: int = fleet[i].info
    return word


@kernel(rows, whole)
def recover(fleet: Fleet, i: int) -> bool:
    """Reset a crashed drone that stands upright again.

    Return True also if nothing has crashed, False if the drone is locked.
    """
    fw = fleet[i]
    if (
        fw.state == SUPERVISOR_STATES.crashed
        and not fw.tumbled
        and fw.az >= SUPERVISOR_LIMITS.upright_acceleration
    ):
        _enter(fw, SUPERVISOR_STATES.reset)
    recovered: bool = fw.state not in (
        SUPERVISOR_STATES.crashed,
        SUPERVISOR_STATES.locked,
    )
    return recovered


@kernel(rows, whole)
def feed_watchdog(fleet: Fleet, i: int) -> None:
    """Feed the watchdog; after the first call, 1 s without a call stops the drone for good."""
    fw = fleet[i]
    fw.watchdog = 1
    fw.watchdog_at = fw.tick
