"""The supervisor: permission for motors, missing set-points, and tumbled drones."""

from typing import NamedTuple

from crazychoir.numerics.kernels import kernel
from crazychoir.simulation.onboard.commander import SETPOINT_PRIORITIES
from crazychoir.simulation.onboard.planner import PLANNER_STATES, is_finished
from crazychoir.simulation.onboard.record import Fleet, Record, rows, whole

(
    STATE_NOT_INITIALISED,
    STATE_CHECKS_NOT_PASSED,
    STATE_CHECKS_PASSED,
    STATE_ARMING,
    STATE_READY,
    STATE_FLYING,
) = range(6)
(
    STATE_LANDED,
    STATE_RESET,
    STATE_LEVEL_OUT,
    STATE_FREE_FALL,
    STATE_LOCKED,
    STATE_CRASHED,
) = range(6, 12)
STATE_NAMES = (
    "not initialised",
    "pre-flight checks not passed",
    "pre-flight checks passed",
    "arming",
    "ready to fly",
    "flying",
    "landed",
    "reset",
    "warning: level out",
    "exception: free fall",
    "locked",
    "crashed",
)


class SupervisorLimits(NamedTuple):
    """Times and accelerations at which the supervisor changes its mind about a drone."""

    level_out_time: int = 500
    """ms without a set-point before a flying drone levels out."""
    free_fall_time: int = 2000
    """ms without a set-point before the motors of a flying drone are cut."""
    watchdog_time: int = 1000
    """ms without a feed before the watchdog stops the motors."""
    resting_time: int = 2000
    """ms with the motors at idle before a drone no longer counts as flying."""
    upright_acceleration: float = 0.5
    """g along z: at least this much means upright."""
    inverted_acceleration: float = -0.2
    """g along z: less means on its back."""
    falling_acceleration: float = 0.1
    """g on every axis: less means free fall."""
    tilted_time: int = 1000
    """ms not upright before a drone counts as tumbled."""
    inverted_time: int = 100
    """ms on its back before a drone counts as tumbled."""


SUPERVISOR_LIMITS = SupervisorLimits()


@kernel()
def _see_tumbling(fw: Record) -> None:
    """Detect tumbling: below 0.5 g along z for 1 s, or below -0.2 g for 0.1 s.

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
        fw.tick - fw.upright_at > SUPERVISOR_LIMITS.tilted_time
        or fw.tick - fw.not_upside_at > SUPERVISOR_LIMITS.inverted_time
    )
    fw.tumbled = 1 if fw.tumble_check and tilted else 0


@kernel()
def _see_flying(fw: Record) -> None:
    """Detect flight: a motor was above idle in the last 2 s."""
    m = fw.request
    if max(max(m[0], m[1]), max(m[2], m[3])) > fw.idle:
        fw.stopping_at = fw.tick
    fw.flying = 1 if fw.tick - fw.stopping_at < SUPERVISOR_LIMITS.resting_time else 0


@kernel()
def _enter(fw: Record, state: int) -> None:
    fw.state = state
    fw.since = fw.tick
    if state in (STATE_RESET, STATE_CHECKS_NOT_PASSED, STATE_LOCKED, STATE_CRASHED):
        fw.armed = 0
        fw.arm_requested = 0
        fw.planner.state = (
            PLANNER_STATES.idle
        )  # a drone that may not fly has no plan either
    if state == STATE_FREE_FALL:
        fw.priority = SETPOINT_PRIORITIES.nobody


@kernel()
def _update_on_ground(fw: Record, waited: int) -> None:
    if fw.state == STATE_NOT_INITIALISED:
        _enter(fw, STATE_CHECKS_NOT_PASSED)
    elif fw.state == STATE_CHECKS_NOT_PASSED:
        if not fw.tumbled:
            _enter(fw, STATE_CHECKS_PASSED)
    elif fw.tumbled:
        _enter(fw, STATE_CHECKS_NOT_PASSED)
    elif fw.state == STATE_CHECKS_PASSED:
        if fw.arm_requested or fw.auto_arm:
            fw.armed = 1
            _enter(fw, STATE_ARMING)
    elif fw.state == STATE_ARMING:
        _enter(fw, STATE_READY if fw.armed else STATE_CHECKS_NOT_PASSED)
    elif fw.flying and fw.armed:
        _enter(fw, STATE_FLYING)
    elif not fw.armed or waited > fw.preflight_timeout:
        _enter(fw, STATE_CHECKS_NOT_PASSED)


@kernel()
def _update_in_air(fw: Record, age: int) -> None:
    if fw.tumbled:
        _enter(fw, STATE_CRASHED)
    elif not fw.armed:
        _enter(fw, STATE_RESET)
    elif age > SUPERVISOR_LIMITS.free_fall_time:
        _enter(fw, STATE_FREE_FALL)
    elif not fw.flying:
        _enter(fw, STATE_LANDED)
    elif age > SUPERVISOR_LIMITS.level_out_time:
        if fw.state != STATE_LEVEL_OUT:
            _enter(fw, STATE_LEVEL_OUT)
    elif fw.state != STATE_FLYING:
        _enter(fw, STATE_FLYING)


@kernel()
def _update_after_landing(fw: Record, waited: int) -> None:
    if fw.flying and fw.armed:
        _enter(fw, STATE_FLYING)
    elif not fw.armed or waited >= fw.landed_timeout:
        _enter(fw, STATE_RESET)


@kernel()
def update(fw: Record) -> None:
    """Update the supervisor at 25 Hz: at most one change of state.

    Chosen: a flying drone with resting motors has landed, also under level-out. After landing a
        new
    take-off is allowed for landedTimeout. Free fall becomes locked at the next pass; both cut the
    motors, and no source of set-points is in control then. The speeds of the motors are not
    checked, so arming succeeds at its next pass.
    """
    _see_tumbling(fw)
    _see_flying(fw)
    if fw.watchdog and fw.tick - fw.watchdog_at >= SUPERVISOR_LIMITS.watchdog_time:
        fw.estop = 1
    waited = fw.tick - fw.since
    if fw.state == STATE_LOCKED:
        return
    if fw.estop or fw.state == STATE_FREE_FALL:
        _enter(fw, STATE_LOCKED)
    elif fw.state <= STATE_READY:
        _update_on_ground(fw, waited)
    elif fw.state == STATE_FLYING or fw.state == STATE_LEVEL_OUT:
        _update_in_air(fw, fw.tick - fw.stamp)
    elif fw.state == STATE_LANDED:
        _update_after_landing(fw, waited)
    elif fw.state == STATE_RESET:
        _enter(fw, STATE_CHECKS_NOT_PASSED)


@kernel()
def may_fly(fw: Record) -> bool:
    """Return True if the supervisor allows motors; an emergency stop counts at once."""
    return not fw.estop and fw.state in (
        STATE_READY,
        STATE_FLYING,
        STATE_LANDED,
        STATE_LEVEL_OUT,
    )


@kernel()
def may_arm(fw: Record) -> bool:
    """Return True if an arming request would succeed: the checks before flight are passed."""
    return not fw.estop and fw.state >= STATE_CHECKS_PASSED and fw.state <= STATE_READY


@kernel(rows, whole)
def can_fly(fleet: Fleet, i: int) -> bool:
    """Return True if the supervisor allows motors."""
    return may_fly(fleet[i])


@kernel(rows, whole)
def can_arm(fleet: Fleet, i: int) -> bool:
    """Return True if an arming request would succeed."""
    return may_arm(fleet[i])


@kernel(rows, whole)
def information(fleet: Fleet, i: int) -> int:
    """Return the bits of supervisor.info.

    0 can arm, 1 armed, 2 arms itself, 3 can fly, 4 flying, 5 tumbled, 6 locked, 7 crashed,
    8 planner in control, 9 plan ended. Never set: 10 planner disabled, 11 a fault of a deck.
    """
    fw = fleet[i]
    ended = is_finished(fw)
    bits = (
        may_arm(fw),
        fw.armed != 0,
        fw.auto_arm != 0,
        may_fly(fw),
        fw.flying != 0,
        fw.tumbled != 0,
        fw.state == STATE_LOCKED,
        fw.state == STATE_CRASHED,
        fw.priority == SETPOINT_PRIORITIES.high_level
        and fw.planner.state != PLANNER_STATES.idle,
        ended,
    )
    word = 0
    for k in range(10):
        word |= (1 if bits[k] else 0) << k
    return word


@kernel(rows, whole)
def recover(fleet: Fleet, i: int) -> bool:
    """Reset a crashed drone that stands upright again.

    Return True also if nothing has crashed, False if the drone is locked.
    """
    fw = fleet[i]
    if (
        fw.state == STATE_CRASHED
        and not fw.tumbled
        and fw.az >= SUPERVISOR_LIMITS.upright_acceleration
    ):
        _enter(fw, STATE_RESET)
    recovered: bool = fw.state not in (STATE_CRASHED, STATE_LOCKED)
    return recovered


@kernel(rows, whole)
def feed_watchdog(fleet: Fleet, i: int) -> None:
    """Feed the watchdog; after the first call, 1 s without a call stops the drone for good."""
    fw = fleet[i]
    fw.watchdog = 1
    fw.watchdog_at = fw.tick
