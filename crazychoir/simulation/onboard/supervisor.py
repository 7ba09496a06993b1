"""The supervisor: permission for motors, missing set-points, and tumbled drones."""

from crazychoir.numerics.kernels import kernel
from crazychoir.simulation.onboard.commander import HIGH_LEVEL, NOBODY
from crazychoir.simulation.onboard.planner import IDLE, finished
from crazychoir.simulation.onboard.record import Fleet, Record, rows, whole

NOT_INITIALISED, NOT_PASSED, PASSED, ARMING, READY, FLYING = range(6)
LANDED, RESET, LEVEL_OUT, FREE_FALL, LOCKED, CRASHED = range(6, 12)
STATES = (
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
LEVEL_OUT_AFTER = 500  # ms without a set-point before a flying drone levels out
FREE_FALL_AFTER = 2000  # ms without a set-point before its motors are cut
WATCHDOG = 1000  # ms without a feed before the watchdog stops the motors
STILL = 2000  # ms with the motors at idle before a drone no longer counts as flying
UPRIGHT = 0.5  # g along z: at least this much means upright
ON_ITS_BACK = -0.2  # g along z: less means on its back
FALLING = 0.1  # g on every axis: less means free fall
TILTED_FOR = 1000  # ms not upright before a drone counts as tumbled
ON_ITS_BACK_FOR = 100  # ms on its back before a drone counts as tumbled


@kernel()
def _see_tumbling(fw: Record) -> None:
    """Detect tumbling: below 0.5 g along z for 1 s, or below -0.2 g for 0.1 s.

    Free fall restarts both times, because it says nothing about the attitude.
    """
    if max(abs(fw.ax), max(abs(fw.ay), abs(fw.az))) < FALLING:
        fw.upright_at = fw.not_upside_at = fw.tick
    if fw.az >= UPRIGHT:
        fw.upright_at = fw.tick
    if fw.az >= ON_ITS_BACK:
        fw.not_upside_at = fw.tick
    tilted = (
        fw.tick - fw.upright_at > TILTED_FOR
        or fw.tick - fw.not_upside_at > ON_ITS_BACK_FOR
    )
    fw.tumbled = 1 if fw.tumble_check and tilted else 0


@kernel()
def _see_flying(fw: Record) -> None:
    """Detect flight: a motor was above idle in the last 2 s."""
    m = fw.request
    if max(max(m[0], m[1]), max(m[2], m[3])) > fw.idle:
        fw.stopping_at = fw.tick
    fw.flying = 1 if fw.tick - fw.stopping_at < STILL else 0


@kernel()
def _enter(fw: Record, state: int) -> None:
    fw.state = state
    fw.since = fw.tick
    if state in (RESET, NOT_PASSED, LOCKED, CRASHED):
        fw.armed = 0
        fw.arm_requested = 0
        fw.planner.state = IDLE  # a drone that may not fly has no plan either
    if state == FREE_FALL:
        fw.priority = NOBODY


@kernel()
def _on_ground(fw: Record, waited: int) -> None:
    if fw.state == NOT_INITIALISED:
        _enter(fw, NOT_PASSED)
    elif fw.state == NOT_PASSED:
        if not fw.tumbled:
            _enter(fw, PASSED)
    elif fw.tumbled:
        _enter(fw, NOT_PASSED)
    elif fw.state == PASSED:
        if fw.arm_requested or fw.auto_arm:
            fw.armed = 1
            _enter(fw, ARMING)
    elif fw.state == ARMING:
        _enter(fw, READY if fw.armed else NOT_PASSED)
    elif fw.flying and fw.armed:
        _enter(fw, FLYING)
    elif not fw.armed or waited > fw.preflight_timeout:
        _enter(fw, NOT_PASSED)


@kernel()
def _in_air(fw: Record, age: int) -> None:
    if fw.tumbled:
        _enter(fw, CRASHED)
    elif not fw.armed:
        _enter(fw, RESET)
    elif age > FREE_FALL_AFTER:
        _enter(fw, FREE_FALL)
    elif not fw.flying:
        _enter(fw, LANDED)
    elif age > LEVEL_OUT_AFTER:
        if fw.state != LEVEL_OUT:
            _enter(fw, LEVEL_OUT)
    elif fw.state != FLYING:
        _enter(fw, FLYING)


@kernel()
def _down(fw: Record, waited: int) -> None:
    if fw.flying and fw.armed:
        _enter(fw, FLYING)
    elif not fw.armed or waited >= fw.landed_timeout:
        _enter(fw, RESET)


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
    if fw.watchdog and fw.tick - fw.watchdog_at >= WATCHDOG:
        fw.estop = 1
    waited = fw.tick - fw.since
    if fw.state == LOCKED:
        return
    if fw.estop or fw.state == FREE_FALL:
        _enter(fw, LOCKED)
    elif fw.state <= READY:
        _on_ground(fw, waited)
    elif fw.state == FLYING or fw.state == LEVEL_OUT:
        _in_air(fw, fw.tick - fw.stamp)
    elif fw.state == LANDED:
        _down(fw, waited)
    elif fw.state == RESET:
        _enter(fw, NOT_PASSED)


@kernel()
def may_fly(fw: Record) -> bool:
    """Return True if the supervisor allows motors; an emergency stop counts at once."""
    return not fw.estop and fw.state in (READY, FLYING, LANDED, LEVEL_OUT)


@kernel()
def may_arm(fw: Record) -> bool:
    """Return True if an arming request would succeed: the checks before flight are passed."""
    return not fw.estop and fw.state >= PASSED and fw.state <= READY


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
    ended = finished(fw)
    bits = (
        may_arm(fw),
        fw.armed != 0,
        fw.auto_arm != 0,
        may_fly(fw),
        fw.flying != 0,
        fw.tumbled != 0,
        fw.state == LOCKED,
        fw.state == CRASHED,
        fw.priority == HIGH_LEVEL and fw.planner.state != IDLE,
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
    if fw.state == CRASHED and not fw.tumbled and fw.az >= UPRIGHT:
        _enter(fw, RESET)
    recovered: bool = fw.state not in (CRASHED, LOCKED)
    return recovered


@kernel(rows, whole)
def feed_watchdog(fleet: Fleet, i: int) -> None:
    """Feed the watchdog; after the first call, 1 s without a call stops the drone for good."""
    fw = fleet[i]
    fw.watchdog = 1
    fw.watchdog_at = fw.tick
