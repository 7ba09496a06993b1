"""The way of a state from a drone to a neighbour in the same process, without a message.

Each directed edge has a record: the source, the rate, and what the simulated network does. A link
with a loss only is drawn here. Links with bursts, delays, duplicates, partitions or a bandwidth are
marked, and the caller lets them pass the Impairment.
"""

from collections.abc import Sequence
from enum import IntEnum
from typing import Any, NamedTuple

import numba
import numpy as np
import numpy.typing as npt

from crazychoir.bus.impairment.compiled_draws import draw_word, split_threshold
from crazychoir.bus.impairment.random_draws import draw_key
from crazychoir.bus.impairment.rules import EdgeEffects
from crazychoir.guidance.decision.hearing_rows import HEARING_ROW, put_row
from crazychoir.guidance.decision.velocity_sums import whole
from crazychoir.numerics.kernels import kernel, rows_of
from crazychoir.types import Ints, Vec

STATE_CHANNEL = "state"
"""Channel of the draws of states."""
FIRST_ATTEMPT = np.uint64(0)
"""Attempt of the draws: states are sent once."""


class LinkKind(IntEnum):
    """Who draws what becomes of a state on a link."""

    COMPILED = 0
    """`deliver_rows` draws the loss."""
    BY_HAND = 1
    """The caller asks the Impairment."""
    ABSENT = 2
    """The source is in another process: nothing is delivered here."""


LINK_ROW = np.dtype(
    [
        ("kind", np.int64),  # LinkKind
        ("source", np.int64),  # row of the source among the drones of this process
        ("interval_ns", np.int64),  # ns between two states; 0: every state
        ("due_ns", np.int64),  # ns: no state is due before
        ("key", np.uint64),  # key of the draws of the edge
        ("loss", np.uint64),  # a draw below it loses the state
        ("is_cut", np.int64),  # 1: every state is lost
        ("sent", np.int64),  # states that were due
        ("lost", np.int64),  # states that were lost
        ("is_due", np.int64),  # 1: a state is due now that the caller must deliver
    ],
    align=True,
)
"""The link of one directed edge."""


class PublishedStates(NamedTuple):
    """The states that the drones of this process publish in a tick."""

    states: npt.NDArray[np.float64]
    """(n, 13)."""
    accelerations: npt.NDArray[np.float64]
    """(n, 3) m/s2."""
    ages: Vec
    """(n,) s: age of each state."""
    numbers: Ints
    """(n,): tick of each drone; 0: it publishes no state in this tick."""


@kernel()
def _is_due(link: Any, now_ns: int) -> bool:
    """Return whether a state is due on a link, and begin the next interval of its grid."""
    if link.interval_ns == 0:
        return True
    if now_ns < link.due_ns:
        return False
    passed = (now_ns - link.due_ns) // link.interval_ns + 1
    link.due_ns += passed * link.interval_ns
    return True


@kernel(
    rows_of(LINK_ROW),
    rows_of(HEARING_ROW),
    numba.types.Array(numba.float64, 2, "C", readonly=True),
    numba.types.Array(numba.float64, 2, "C", readonly=True),
    numba.types.Array(numba.float64, 1, "C", readonly=True),
    numba.types.Array(numba.int64, 1, "C", readonly=True),
    whole,
)
def deliver_rows(
    links: Any,
    hearings: Any,
    states: Vec,
    accelerations: Vec,
    ages: Vec,
    numbers: Ints,
    now_ns: int,
) -> int:
    """Deliver the states of this tick to the neighbours for which they are due.

    links: (e,) of LINK_ROW
    hearings: (e,) of HEARING_ROW: the other end of each link
    states, accelerations, ages, numbers: as in PublishedStates
    now_ns: ns: the present time
    Returns the number of links that the caller must serve: these have `is_due`.
    """
    by_hand = 0
    for e in range(links.shape[0]):
        link = links[e]
        link.is_due = 0
        if link.kind == LinkKind.ABSENT or numbers[link.source] == 0:
            continue
        if not _is_due(link, now_ns):
            continue
        j = link.source
        if link.kind == LinkKind.BY_HAND:
            link.is_due = 1
            by_hand += 1
            continue
        link.sent += 1
        drawn = draw_word(link.key, np.uint64(numbers[j]), FIRST_ATTEMPT)
        if link.is_cut == 1 or drawn < link.loss:
            link.lost += 1
            continue
        put_row(hearings[e], states[j], accelerations[j], ages[j], ages[j], now_ns)
    return by_hand


def set_link(
    links: Any, seed: int, edge: tuple[int, int], effects: EdgeEffects
) -> None:
    """Set what the simulated network does on a link.

    links: (1,) of LINK_ROW, with `source` and `interval_ns`
    seed: of the simulated network
    edge: ids of source and destination
    effects: on this edge; partitions are not among them
    """
    links["kind"] = LinkKind.BY_HAND if _needs_model(effects) else LinkKind.COMPILED
    links["key"] = np.uint64(draw_key(seed, *edge, STATE_CHANNEL))
    links["loss"], links["is_cut"] = split_threshold(effects.loss)


def _needs_model(effects: EdgeEffects) -> bool:
    """Return whether more than a loss acts on an edge."""
    others: Sequence[float] = (
        effects.p_good_bad,
        effects.delay,
        effects.jitter,
        effects.duplicate,
        effects.reorder,
        effects.bandwidth,
    )
    return max(others) > 0.0
