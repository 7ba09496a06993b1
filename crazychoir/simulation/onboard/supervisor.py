"""The supervisor: permission for motors, missing set-points, and tumbled drones."""

import math
from typing import NamedTuple

from crazychoir.firmware.planning import PLANNER_STATES
from crazychoir.firmware.supervision import SUPERVISOR_BITS, SUPERVISOR_STATES
from crazychoir.firmware.timeouts import FIRMWARE_TIMEOUTS
from crazychoir.numerics.kernels import kernel
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
    """Detect tumbling: below 0.5 g along z for 1 s, or for 0.1 s and then below -0.2 g, or a hit.

    Free fall restarts the time, because it says nothing about the attitude.
    """
    strongest = max(abs(fw.ax), max(abs(fw.ay), abs(fw.az)))
    is_falling = strongest < SUPERVISOR_LIMITS.falling_acceleration
    is_upright = fw.az >= SUPERVISOR_LIMITS.upright_acceleration
    fw.falling = 1 if is_falling else 0
    if is_falling or is_upright or not fw.tilted:
        fw.tilted_at = fw.tick
    fw.tilted = 0 if is_upright else 1
    tilted_for = fw.tick - fw.tilted_at
    is_inverted = fw.az < SUPERVISOR_LIMITS.inverted_acceleration
    has_tumbled = tilted_for > FIRMWARE_TIMEOUTS.tilted or (
        is_inverted and tilted_for > FIRMWARE_TIMEOUTS.inverted
    )
    fw.tumbled = 1 if fw.tumble_check and (has_tumbled or _has_hit(fw)) else 0


@kernel()
def _see_motors(fw: Record) -> None:
    """Detect turning motors: one was above idle in the last 2 s."""
    m = fw.ratio
    if max(max(m[0], m[1]), max(m[2], m[3])) > fw.idle:
        fw.stopping_at = fw.tick
    fw.turning = 1 if fw.tick - fw.stopping_at < FIRMWARE_TIMEOUTS.resting else 0


@kernel()
def may_fly(fw: Record) -> bool:
    """Return True if the supervisor allows motors."""
    return fw.state in (
        SUPERVISOR_STATES.ready,
        SUPERVISOR_STATES.flying,
        SUPERVISOR_STATES.landed,
        SUPERVISOR_STATES.level_out,
    )


@kernel()
def _enter(fw: Record, state: int) -> None:
    """Enter a state; a drone that may not fly is disarmed, and has no plan."""
    fw.state = state
    fw.since = fw.tick
    if not may_fly(fw):
        if fw.planner.state != PLANNER_STATES.disabled:
            fw.planner.state = PLANNER_STATES.idle
        if state != SUPERVISOR_STATES.arming:
            fw.armed = 0
    if state == SUPERVISOR_STATES.checks_passed and fw.auto_arm:
        fw.armed = 1
    if state == SUPERVISOR_STATES.crashed:
        fw.crashed = 1


@kernel()
def _is_stopped(fw: Record) -> bool:
    """Return True if a packet, the parameter stabilizer.stop or the watchdog stops the drone."""
    starves: bool = (
        fw.watchdog != 0 and fw.tick - fw.watchdog_at >= FIRMWARE_TIMEOUTS.watchdog
    )
    return starves or fw.emergency != 0 or fw.estop != 0


@kernel()
def _update_on_ground(fw: Record, waited: int) -> None:
    """Change a state from the start of the firmware to the take-off."""
    if _is_stopped(fw):
        _enter(fw, SUPERVISOR_STATES.free_fall)
    elif fw.state == SUPERVISOR_STATES.checks_not_passed:
        if not fw.tumbled:
            _enter(fw, SUPERVISOR_STATES.checks_passed)
    elif fw.tumbled:
        _enter(fw, SUPERVISOR_STATES.checks_not_passed)
    elif fw.state == SUPERVISOR_STATES.checks_passed:
        if fw.armed or fw.auto_arm:
            fw.armed = 1
            _enter(fw, SUPERVISOR_STATES.arming)
    elif not fw.armed:
        _enter(fw, SUPERVISOR_STATES.checks_not_passed)
    elif fw.state == SUPERVISOR_STATES.arming:
        _enter(fw, SUPERVISOR_STATES.ready)
    elif waited > fw.preflight_timeout:
        _enter(fw, SUPERVISOR_STATES.checks_not_passed)
    elif fw.turning:
        _enter(fw, SUPERVISOR_STATES.flying)


@kernel()
def _update_flying(fw: Record, age: int) -> None:
    if age > FIRMWARE_TIMEOUTS.free_fall or _is_stopped(fw):
        _enter(fw, SUPERVISOR_STATES.free_fall)
    elif fw.tumbled:
        _enter(fw, SUPERVISOR_STATES.crashed)
    elif not fw.armed:
        _enter(fw, SUPERVISOR_STATES.reset)
    elif age > FIRMWARE_TIMEOUTS.level_out:
        _enter(fw, SUPERVISOR_STATES.level_out)
    elif not fw.turning:
        _enter(fw, SUPERVISOR_STATES.landed)


@kernel()
def _update_level_out(fw: Record, age: int) -> None:
    if age > FIRMWARE_TIMEOUTS.free_fall or fw.tumbled or _is_stopped(fw):
        _enter(fw, SUPERVISOR_STATES.free_fall)
    elif age <= FIRMWARE_TIMEOUTS.level_out:
        _enter(fw, SUPERVISOR_STATES.flying)


@kernel()
def _update_landed(fw: Record, waited: int) -> None:
    if not fw.armed or waited > fw.landed_timeout:
        _enter(fw, SUPERVISOR_STATES.reset)
    elif fw.turning:
        _enter(fw, SUPERVISOR_STATES.flying)


@kernel()
def _update_crashed(fw: Record) -> None:
    if not fw.crashed and not fw.tumbled:
        _enter(fw, SUPERVISOR_STATES.checks_not_passed)
    elif _is_stopped(fw):
        _enter(fw, SUPERVISOR_STATES.locked)


@kernel()
def _update_state(fw: Record) -> None:
    """Make at most one change of state."""
    state = fw.state
    waited = fw.tick - fw.since
    age = fw.tick - fw.stamp
    if state == SUPERVISOR_STATES.not_initialised or state == SUPERVISOR_STATES.reset:
        _enter(fw, SUPERVISOR_STATES.checks_not_passed)
    elif state <= SUPERVISOR_STATES.ready:
        _update_on_ground(fw, waited)
    elif state == SUPERVISOR_STATES.flying:
        _update_flying(fw, age)
    elif state == SUPERVISOR_STATES.level_out:
        _update_level_out(fw, age)
    elif state == SUPERVISOR_STATES.landed:
        _update_landed(fw, waited)
    elif state == SUPERVISOR_STATES.crashed:
        _update_crashed(fw)
    elif state == SUPERVISOR_STATES.free_fall:
        _enter(fw, SUPERVISOR_STATES.locked)


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
    if fw.crashed:
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
    An emergency stop too counts from the next pass on, within 40 ms. A landed drone is locked by it
    when it has been disarmed, or takes off again.
    Choice of this model: arming always succeeds at the next pass, because motor speeds are not
    checked.
    Source: crazyflie-firmware, supervisor.c and supervisor_state_machine.c.
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
    """Arm the motors; return False if the checks before flight do not allow it."""
    fw = fleet[i]
    if fw.armed == 0 and not may_arm(fw):
        return False
    fw.armed = 1
    return True


@kernel(rows, whole)
def information(fleet: Fleet, i: int) -> int:
    """Return the bits of supervisor.info, as they were at the last pass of the supervisor."""
    word: int = fleet[i].info
    return word


@kernel(rows, whole)
def recover(fleet: Fleet, i: int) -> bool:
    """Forget a crash; return False if the drone lies on its back.

    Return True also if nothing has crashed, for example if the drone is locked.
    """
    fw = fleet[i]
    if fw.crashed and fw.tumbled:
        return False
    fw.crashed = 0
    return True


@kernel(rows, whole)
def feed_watchdog(fleet: Fleet, i: int) -> None:
    """Feed the watchdog; after the first call, 1 s without a call stops the drone for good."""
    fw = fleet[i]
    fw.watchdog = 1
    fw.watchdog_at = fw.tick
