"""The pace of pairs: how often the drones of a pair hear each other."""

from crazychoir.numerics.kernels import kernel
from crazychoir.safety.airspace.airspace_rows import NEVER_NS
from crazychoir.safety.airspace.hearing import find_sorted
from crazychoir.safety.airspace.state_rates import SOON_NS, find_interval
from crazychoir.types import Ints, Records


@kernel()
def find_pair(listener: Records, paces: Records, other: int) -> int:
    """Return the row of the pair of a drone with another one, or -1.

    listener: one row of LISTENER_ROW
    paces: PACE_ROW
    other: row of SWARM_ROW
    """
    first = listener.first_pair
    return int(find_sorted(paces["other"], first, first + listener.pair_count, other))


@kernel()
def copy_pace(source: Records, target: Records) -> None:
    """Copy one row of PACE_ROW to another one."""
    target.other = source.other
    target.interval_ns = source.interval_ns
    target.sending_interval_ns = source.sending_interval_ns
    target.is_told = source.is_told


@kernel()
def copy_due(source: Records, target: Records) -> None:
    """Copy one row of DUE_ROW to another one."""
    target.hearing_ns = source.hearing_ns
    target.sending_ns = source.sending_ns


@kernel()
def is_told(listener: Records, told: Ints, other: int) -> bool:
    """Return whether the law of a drone hears each state of another one.

    listener: one row of LISTENER_ROW
    told: (k,): rows of the others in the swarm, see Airspace.note_told
    other: row of the other drone
    """
    found = False
    for t in range(listener.first_told, listener.first_told + listener.told_count):
        found |= told[t] == other
    return found


@kernel()
def fill_pace(
    pace: Records,
    due: Records,
    other: int,
    sender: Records,
    has_law: bool,
    far_interval_ns: int,
    now_ns: int,
) -> None:
    """Set when a new pair hears and sends: as often as far drones, in the next round.

    pace: one row of PACE_ROW
    due: its row of DUE_ROW
    other: row of the other drone
    sender: the other drone, one row of SWARM_ROW
    has_law: whether the law of this drone hears each state of the other one
    far_interval_ns: ns
    now_ns: ns
    """
    pace.other = other
    pace.is_told = has_law
    pace.sending_interval_ns = far_interval_ns
    if sender.listener >= 0:
        pace.interval_ns = far_interval_ns
        due.hearing_ns = sender.round_due_ns
        due.sending_ns = NEVER_NS
    else:
        # Each state of a frame is heard: its sender decides how often it comes.
        pace.interval_ns = 1
        due.hearing_ns = 0
        due.sending_ns = now_ns


@kernel()
def set_interval(pace: Records, due: Records, interval_ns: int, phase_ns: int) -> None:
    """Change how often a pair hears; it hears at once, then on the sender's grid of times.

    Drones that could meet soon hear each state that their laws hear: these are the same messages.

    pace: one row of PACE_ROW
    due: its row of DUE_ROW
    interval_ns: ns
    phase_ns: ns, of the sender, as in SWARM_ROW
    """
    if interval_ns <= SOON_NS and pace.is_told != 0:
        interval_ns = 1
    if pace.interval_ns != interval_ns:
        pace.interval_ns = interval_ns
        due.hearing_ns = phase_ns


@kernel()
def find_sending_interval(pair: Records, own_height: float, rules: Records) -> int:
    """Return how often a drone sends its state to another one, ns.

    A drone that stands on the floor sends it as to far drones: it comes near no other drone.

    pair: what the sender knows of the receiver, one row of PAIR_ROW
    own_height: m, of the sender
    rules: one row of AIRSPACE_RULES_ROW
    """
    if own_height < rules.standing_height:
        return int(rules.far_interval_ns)
    return int(find_interval(pair.meeting_time, pair.age_limit, rules.far_interval_ns))
