"""States on their way over links of the simulated network that delay or duplicate messages."""

import numpy as np

from crazychoir.bus.impairment.compiled_draws import draw_first_attempt
from crazychoir.bus.impairment.model import IMPAIRMENT_DRAWS
from crazychoir.numerics.kernels import kernel
from crazychoir.runtime.clock import NS_PER_SECOND
from crazychoir.safety.airspace.airspace_rows import LinkKinds
from crazychoir.safety.airspace.link_fates import find_losses
from crazychoir.types import Ints, Records

LATE_ROW = np.dtype(
    [
        ("arrival_ns", np.int64),  # ns
        # number of the drone in this process that hears it, or of the edge along which a law does
        ("receiver", np.int64),
        ("other", np.int64),  # row of the sender in the swarm; not used for laws
        ("state_time", np.float64),  # s, time of the state
        ("state_age", np.float64),  # s, of the state when it was sent
        ("state", np.float64, 13),  # as State.flat
        ("acceleration", np.float64, 3),  # m/s2, as State.a
    ]
)
"""A state on its way."""

MOST_COPIES = 2
"""Largest number of copies of a message that arrive."""
NO_COPY = -1.0
"""Delay of a copy that does not exist."""
DELAY_SALT = np.uint64(IMPAIRMENT_DRAWS.delay_salt)
DUPLICATE_SALT = np.uint64(IMPAIRMENT_DRAWS.duplicate_salt)
HALF_BITS = np.uint64(32)
LOW_HALF = np.uint64(IMPAIRMENT_DRAWS.half_range - 1)
HALF_RANGE = float(IMPAIRMENT_DRAWS.half_range)


class LateStates:
    """States on their way, in the order in which they were sent.

    Attributes:
    rows: (n,) of LATE_ROW: the states on their way, then room for more
    count: (1,): number of states on their way
    """

    def __init__(self) -> None:
        self.rows = np.zeros(0, LATE_ROW)
        self.count = np.zeros(1, np.int64)

    def make_room(self, states: int) -> None:
        """Make room for all copies of so many more states."""
        needed = int(self.count[0]) + MOST_COPIES * states
        if needed > len(self.rows):
            larger = np.zeros(2 * needed, LATE_ROW)
            larger[: len(self.rows)] = self.rows
            self.rows = larger

    def add(self, state: Records, receiver: int) -> None:
        """Add a state on its way to another receiver.

        state: a record of LATE_ROW
        receiver: as in LATE_ROW
        """
        self.make_room(1)
        at = int(self.count[0])
        self.rows[at] = state
        self.rows[at]["receiver"] = receiver
        self.count[0] = at + 1


@kernel()
def draw_halves(key: np.uint64, number: int) -> tuple[float, float]:
    """Return the upper and the lower 32 bits of a draw.

    key: of the draws
    number: number of the message
    """
    word = draw_first_attempt(key, number)
    return float(word >> HALF_BITS), float(word & LOW_HALF)


@kernel()
def draw_delays(key: np.uint64, effects: Records, number: int) -> tuple[float, float]:
    """Return the delays in s of a message and of its copy, or NO_COPY, as Impairment.verdict.

    key: of the draws of the link
    effects: one row of LOSS_ROW
    number: number of the message
    """
    first, second = draw_halves(key ^ DELAY_SALT, number)
    delay = effects.delay + effects.jitter * (first / HALF_RANGE)
    if second < effects.reorder * HALF_RANGE:
        delay += effects.reorder_delay
    if effects.duplicate <= 0.0:
        return delay, NO_COPY
    first, second = draw_halves(key ^ DUPLICATE_SALT, number)
    if first >= effects.duplicate * HALF_RANGE:
        return delay, NO_COPY
    return delay, effects.delay + effects.jitter * (second / HALF_RANGE)


@kernel()
def copy_late(source: Records, target: Records) -> None:
    """Copy one row of LATE_ROW to another one."""
    target.arrival_ns = source.arrival_ns
    target.receiver = source.receiver
    target.other = source.other
    target.state_time = source.state_time
    target.state_age = source.state_age
    for c in range(13):
        target.state[c] = source.state[c]
    for c in range(3):
        target.acceleration[c] = source.acceleration[c]


@kernel()
def keep_late(late: Records, k: int, kept: int) -> int:
    """Keep row k, which is still on its way, behind the rows that are kept before it.

    late: LATE_ROW
    kept: number of these rows
    Returns the number of rows that are kept now.
    """
    if kept < k:
        copy_late(late[k], late[kept])
    return kept + 1


@kernel()
def send_late(
    late: Records,
    count: Ints,
    links: Records,
    kinds: LinkKinds,
    losses: Records,
    at: int,
    sender: Records,
    receiver: int,
    other: int,
    state_time: float,
    is_counted: bool,
    now_ns: int,
) -> None:
    """Send a state over a link that delays or duplicates messages, and does not lose this one.

    late: LATE_ROW, with room for MOST_COPIES more
    count: (1,): number of states on their way
    links, kinds, losses, at: as in judge_link
    sender: a record of SWARM_ROW or DRONE_ROW, with the state
    receiver, other, state_time: as in LATE_ROW
    is_counted: whether the link counts it
    now_ns: ns
    """
    link = links[at]
    delay, copy_delay = draw_delays(
        link.key, find_losses(losses, int(kinds[at])), sender.number
    )
    if is_counted:
        link.delayed += delay > 0.0
        link.duplicated += copy_delay != NO_COPY
    copies = 1 if copy_delay == NO_COPY else 2
    for k in range(copies):
        row = late[count[0]]
        count[0] += 1
        seconds = delay if k == 0 else copy_delay
        row.arrival_ns = now_ns + int(np.rint(seconds * NS_PER_SECOND))
        row.receiver = receiver
        row.other = other
        row.state_time = state_time
        row.state_age = sender.age
        for c in range(13):
            row.state[c] = sender.state[c]
        for c in range(3):
            row.acceleration[c] = sender.acceleration[c]
