"""What the simulated network does with a state: it arrives, is lost, or arrives late."""

import numba
import numpy as np

from crazychoir.bus.impairment.compiled_draws import draw_first_attempt, is_bad_state
from crazychoir.numerics.kernels import kernel
from crazychoir.safety.airspace.airspace_rows import LinkKind, LinkKinds
from crazychoir.types import Records

link_kinds = numba.uint16[::1]
"""An array (n,) of LinkKind."""


@kernel()
def needs_pair(kind: int) -> bool:
    """Return whether a drone hears another one as a pair, however far it is.

    Rounds are heard at once or not at all. So they do not travel over links that delay messages.

    kind: of the link, LinkKind
    """
    return bool(kind == LinkKind.BY_HAND or kind >= LinkKind.LATE)


@kernel()
def find_losses(losses: Records, kind: int) -> Records:
    """Return the row of LOSS_ROW of a link, from its kind, which is at least DRAW."""
    first = LinkKind.LATE if kind >= LinkKind.LATE else LinkKind.DRAW
    return losses[kind - first]


@kernel()
def is_lost(key: np.uint64, losses: Records, number: int) -> bool:
    """Return whether a draw loses a message, as Impairment.verdict.

    key: of the draws of the link
    losses: one row of LOSS_ROW
    number: number of the message
    """
    threshold = losses.threshold
    if losses.p_good_bad > 0.0 and is_bad_state(
        key, number, losses.p_good_bad, losses.p_bad_good
    ):
        if losses.loses_bad != 0:
            return True
        threshold = losses.bad_threshold
    return bool(draw_first_attempt(key, number) < threshold)


@kernel()
def judge_link(
    links: Records, kinds: LinkKinds, losses: Records, at: int, number: int
) -> LinkKind:
    """Return what happens to a message.

    links: LINK_ROW
    kinds: (links,): LinkKind of each link
    losses: LOSS_ROW
    at: row of the link
    number: number of the message
    Returns CLEAR (it arrives), CUT (it is lost), LATE (see late_states.py) or BY_HAND.
    """
    kind = int(kinds[at])
    if kind < LinkKind.DRAW:
        if kind == LinkKind.BY_HAND:
            return LinkKind.BY_HAND
        return LinkKind.CUT if kind == LinkKind.CUT else LinkKind.CLEAR
    if is_lost(links[at].key, find_losses(losses, kind), number):
        return LinkKind.CUT
    return LinkKind.LATE if kind >= LinkKind.LATE else LinkKind.CLEAR


@kernel()
def pass_link(
    links: Records, kinds: LinkKinds, losses: Records, at: int, number: int
) -> LinkKind:
    """Return what happens to a message, as `judge_link`, and count it.

    Arguments as there.
    """
    fate = judge_link(links, kinds, losses, at, number)
    if fate != LinkKind.BY_HAND:
        links[at].sent += 1
        links[at].lost += fate == LinkKind.CUT
    return fate
