"""Nearness: whether two drones could meet soon, or need each other's states often."""

import math

from crazychoir.numerics.kernels import kernel
from crazychoir.numerics.math3d import Triple
from crazychoir.runtime.clock import NS_PER_SECOND
from crazychoir.safety.airspace.airspace_rows import Missed, Need
from crazychoir.safety.airspace.distances import BRAKING_MODEL
from crazychoir.safety.airspace.motion import compute_norm
from crazychoir.safety.airspace.state_rates import (
    FIRST_NEWS_TIME,
    NEIGHBOUR_AGES,
    RELAY_LEAD_TIME,
    RELAY_REQUESTS,
    SPEED_ALLOWANCE,
    STATE_RATES,
)
from crazychoir.types import Records, Vec

FIRST_NEWS_NS = int(NS_PER_SECOND * FIRST_NEWS_TIME)
SPARE_CHECKED_ROUNDS = 4  # oldest rounds that are left until the next checks
DISTANCE_ROUNDING = 1e-3  # m, more than the rounding of distances


@kernel()
def compute_distance(p: Vec, q: Vec | Triple, scale: Vec) -> float:
    """Return |S (p - q)| in m."""
    return compute_norm(
        (
            scale[0] * (p[0] - q[0]),
            scale[1] * (p[1] - q[1]),
            scale[2] * (p[2] - q[2]),
        )
    )


@kernel()
def compute_speed(x: Vec) -> float:
    """Return the speed in a state (13,), m/s."""
    return compute_norm((x[3], x[4], x[5]))


@kernel()
def compute_relative_speed(x: Vec, v: Vec | Triple) -> float:
    """Return the speed in m/s at which two drones move relative to each other.

    x: (13,): state of one drone
    v: (3,) m/s: velocity of the other one
    """
    return compute_norm((x[3] - v[0], x[4] - v[1], x[5] - v[2]))


@kernel()
def compute_age_limit(apart: float, rules: Records) -> float:
    """Return the age in s of a state beyond which a drone brakes for want of a newer one.

    apart: m
    rules: one row of AIRSPACE_RULES_ROW
    """
    return float(
        NEIGHBOUR_AGES.usable
        + max(apart - rules.width - rules.silent_gap, 0.0) / rules.v_max
    )


@kernel()
def compute_near_distance(speed: float, rules: Records) -> float:
    """Return the distance in m below which two drones could meet soon.

    speed: m/s, of one relative to the other
    rules: one row of AIRSPACE_RULES_ROW
    """
    meets = 2.0 * rules.width + STATE_RATES.later * (speed + SPEED_ALLOWANCE)
    brakes = (
        rules.width
        + rules.silent_gap
        + rules.v_max * (STATE_RATES.long_wait - NEIGHBOUR_AGES.usable)
    )
    return float(max(rules.range, meets, brakes))


@kernel()
def compute_flown_distance(age: float, rules: Records) -> float:
    """Return the distance in m by which two drones may have come nearer by the next check.

    A drone that is not heard may be anywhere within its largest speed times its age.

    age: s, of the state of the other drone
    rules: one row of AIRSPACE_RULES_ROW
    """
    return float(
        2.0
        * rules.v_max
        * (min(age, BRAKING_MODEL.silent_flight_time) + STATE_RATES.check_interval)
    )


@kernel()
def is_near(apart: float, speed: float, age: float, rules: Records) -> bool:
    """Return whether two drones could meet, or need each other's states more often than in rounds.

    apart: m, between the newest known places
    speed: m/s, of one relative to the other
    age: s, of the state of the other drone
    rules: one row of AIRSPACE_RULES_ROW
    """
    if not age < NEIGHBOUR_AGES.gone:
        return True
    if age > compute_age_limit(apart, rules) - RELAY_LEAD_TIME:
        return True
    return bool(
        apart - compute_flown_distance(age, rules) < compute_near_distance(speed, rules)
    )


@kernel()
def compute_reach(speed: float, age: float, rules: Records) -> float:
    """Return a distance in m beyond which no drone is near: `is_near` is false there.

    speed: m/s, largest speed of one relative to the other
    age: s, largest age of the state of the other drone, below NEIGHBOUR_AGES.gone
    rules: one row of AIRSPACE_RULES_ROW
    """
    meets = compute_flown_distance(age, rules) + compute_near_distance(speed, rules)
    brakes = (
        rules.width
        + rules.silent_gap
        + rules.v_max * max(age + RELAY_LEAD_TIME - NEIGHBOUR_AGES.usable, 0.0)
    )
    return float(max(meets, brakes) + DISTANCE_ROUNDING)


@kernel()
def measure_pair(
    pair: Records, apart: float, speeds: float, rules: Records, now: float
) -> None:
    """Store how soon a pair could meet if both turn, and how old its state may become.

    pair: one row of PAIR_ROW
    apart: m, between the newest known places
    speeds: m/s, sum of the speeds of both
    rules: one row of AIRSPACE_RULES_ROW
    now: s
    """
    age = now - pair.state_time
    stands = pair.state[2] < rules.standing_height
    if not age < NEIGHBOUR_AGES.gone and not (stands and age < math.inf):
        pair.meeting_time = math.inf
        pair.age_limit = math.inf
        return
    pair.meeting_time = (apart - 2.0 * rules.width) / (speeds + SPEED_ALLOWANCE)
    pair.age_limit = compute_age_limit(apart, rules)


@kernel()
def find_need(
    pair: Records, standing_height: float, seeks_gone: bool, now: float
) -> int:
    """Return why a drone should ask others for a newer state in this check, as a Need.

    It asks less often for a drone if RELAY_LEAD_TIME s without an answer have passed. A drone that
    stands on the floor is heard in rounds, and no drone brakes for want of its state.

    pair: one row of PAIR_ROW
    standing_height: m, of the world; a lower drone stands on the floor
    seeks_gone: whether it asks about drones that are gone in this check
    now: s
    """
    age = now - pair.state_time
    if not age < NEIGHBOUR_AGES.gone:
        is_new = pair.asked_time == -math.inf
        return Need.GONE if seeks_gone or is_new else Need.NONE
    stands = pair.state[2] < standing_height
    least = NEIGHBOUR_AGES.usable if stands else RELAY_REQUESTS.least_age
    needed = max(least, pair.age_limit - RELAY_LEAD_TIME)
    # Checks are not exactly in time.
    waited = now - pair.asked_time + 0.5 * STATE_RATES.check_interval
    is_unanswered = age >= needed + RELAY_LEAD_TIME
    if age <= needed:
        return Need.NONE
    if is_unanswered and waited < RELAY_REQUESTS.interval_if_unanswered:
        return Need.NONE
    if stands:
        return Need.STANDING
    return Need.NOW if age > pair.age_limit else Need.SOON


@kernel()
def is_told_newer(pair: Records, known: Records) -> bool:
    """Return whether others have told of a newer state than the latest round of another drone.

    A drone must not forget such a pair: it would then take the other one to be where it was in that
    round.

    pair: one row of PAIR_ROW
    known: what is known of the other drone, one row of FAR_ROW
    """
    return bool(pair.state_time > max(pair.heard_time, known.state_time))


@kernel()
def is_behind(pair: Records, known: Records) -> bool:
    """Return whether a drone has heard nothing since the latest round of another one.

    It must not forget the pair: it would then count as having heard that round.

    pair: one row of PAIR_ROW
    known: what is known of the other drone, one row of FAR_ROW
    """
    return bool(known.heard_time == -math.inf or pair.heard_time < known.heard_time)


@kernel()
def is_unknown(missed: int, rules: Records, now_ns: int) -> bool:
    """Return whether another drone may be anywhere, because it was not heard for long.

    missed: rounds missed in a row, or Missed.ALL
    rules: one row of AIRSPACE_RULES_ROW
    now_ns: ns
    """
    if missed == Missed.ALL:
        return bool(now_ns - rules.began_ns >= FIRST_NEWS_NS)
    return bool(missed >= rules.round_capacity - SPARE_CHECKED_ROUNDS)
