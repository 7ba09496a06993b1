"""How often drones hear each other's states, and when a state that they heard is too old."""

from typing import NamedTuple

from crazychoir.numerics.kernels import kernel
from crazychoir.runtime.clock import NS_PER_SECOND


class NeighbourAges(NamedTuple):
    """Ages, s, of the news of another drone from which on it is treated differently."""

    usable: float = 0.6
    """Age in s beyond which a state is of no use."""
    unheard: float = 0.2
    """Seconds without a state after which a place from the cameras counts."""
    silent: float = 1.5
    """Seconds of silence after which a drone that flew counts as not heard.

    If this holds for more than half of the other flying drones, this drone is cut off, see
    `is_cut_off` in AVOID_ROW.
    """
    gone: float = 10.0
    """Seconds after which a drone that no other drone hears has come down, see RelayedStates.

    It is cut off itself, or has failed.
    """
    deaf: float = 0.3
    """Seconds of silence of its radio after which a drone does not do what its agent says."""


NEIGHBOUR_AGES = NeighbourAges()

SPEED_ALLOWANCE = 0.3
"""Speed in m/s that two drones may gain at once."""


class StateRates(NamedTuple):
    """How often drones hear each other's states.

    Several states in a row may be lost before a drone brakes for want of a newer one.
    """

    lowest: float = 2.0
    """Least rate in Hz at which a far drone is heard."""
    highest: float = 20.0
    """Largest rate in Hz at which a far drone is heard."""
    total: float = 100.0
    """Rate in Hz at which all far drones together are heard, within the two limits above."""
    soon: float = 0.7
    """Seconds until a meeting, within which two drones hear each other at `soon_rate`."""
    soon_rate: float = 50.0
    """Hz."""
    later: float = 3.0
    """Seconds until a meeting, within which two drones hear each other at `later_rate`."""
    later_rate: float = 20.0
    """Hz."""
    short_wait: float = 1.0
    """Age in s of a state beyond which a drone brakes, below which both hear each other at
    `short_wait_rate`.
    """
    short_wait_rate: float = 10.0
    """Hz."""
    long_wait: float = 2.0
    """Age in s of a state beyond which a drone brakes, below which both hear each other at
    `long_wait_rate`.
    """
    long_wait_rate: float = 5.0
    """Hz."""
    check_interval: float = 0.1
    """Seconds between two checks of the distances."""


STATE_RATES = StateRates()
SOON_NS = int(
    NS_PER_SECOND / STATE_RATES.soon_rate
)  # ns, between states if both meet soon


class RelayRequests(NamedTuple):
    """When a drone asks others for a newer state of a third one, and how many of them."""

    least_age: float = 0.25
    """Age in s of a state before which no newer one is asked for."""
    interval_if_unanswered: float = 0.5
    """Seconds between two questions about a drone unanswered for RELAY_LEAD_TIME s."""
    interval_if_gone: float = 1.0
    """Seconds between two checks in which a drone asks about drones that are gone or were never
    heard. It first asks about such a drone at once.
    """
    most_soon: int = 4
    """Largest number of drones about which a drone asks in one check before it brakes for them."""
    most_now: int = 4
    """Largest number of further drones about which it asks in one check: drones for which it brakes.

    It asks about each of 100 such drones every 2.5 s, and each counts as gone after
    NEIGHBOUR_AGES.gone s.
    """
    most_standing: int = 4
    """Largest number of further drones about which it asks in one check: drones on the floor."""
    most_gone: int = 40
    """Largest number of further drones about which it asks in one check: drones that are gone or were
    never heard. It asks the same few drones about all of them, about each of 100 every 2.5 s on
    average.
    """
    nearest_asked: int = 2
    """Number of drones that are asked each time about one drone.

    They are the heard drones that are nearest to it. One more drone is asked in turn. About drones
    that are gone it asks the heard drones that are nearest to itself, because only there they matter.
    """


RELAY_REQUESTS = RelayRequests()
RELAY_LEAD_TIME = (
    1.0  # s, before a drone would brake for want of a state, when it begins to ask
)
CHECKS_UNTIL_GONE_SOUGHT = round(
    RELAY_REQUESTS.interval_if_gone / STATE_RATES.check_interval
)
FIRST_NEWS_TIME = 1.0  # s after the first step, when each drone should have been heard


def compute_far_rate(others: int) -> float:
    """Return the rate in Hz at which a drone hears each far drone.

    others: number of all other drones
    """
    return min(max(STATE_RATES.total / others, STATE_RATES.lowest), STATE_RATES.highest)


@kernel()
def find_interval(meeting_time: float, age_limit: float, far_interval_ns: int) -> int:
    """Return the ns between two states that a drone sends to another one.

    meeting_time: s until both could be near each other
    age_limit: s, age of a state beyond which the receiver brakes
    far_interval_ns: ns, interval of far drones, which is the longest
    """
    rate = 0.0
    if meeting_time < STATE_RATES.soon:
        rate = STATE_RATES.soon_rate
    elif meeting_time < STATE_RATES.later:
        rate = STATE_RATES.later_rate
    elif age_limit < STATE_RATES.short_wait:
        rate = STATE_RATES.short_wait_rate
    elif age_limit < STATE_RATES.long_wait:
        rate = STATE_RATES.long_wait_rate
    if rate == 0.0:
        return far_interval_ns
    return min(int(NS_PER_SECOND / rate), far_interval_ns)
