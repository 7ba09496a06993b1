"""The records of an airspace: drones of the swarm, their rounds, pairs, and listeners."""

from enum import IntEnum

import numpy as np
import numpy.typing as npt

LinkKinds = npt.NDArray[np.uint16]
"""An array (n,) of LinkKind."""

SWARM_ROW = np.dtype(
    [
        ("drone", np.int64),  # id
        ("listener", np.int64),  # row of LISTENER_ROW; -1: flown by another process
        ("host", np.int64),  # number of the host of the processes that may fly it
        # bit of the process that flies it, see AirspaceFrames; all bits: it is not known yet
        ("process_bits", np.int64),
        ("number", np.int64),  # tick of the sender at its newest state
        ("is_fresh", np.int64),  # 1: a newer state has come since the last step
        ("state_time", np.float64),  # s, time of the newest state; -inf: none
        ("age", np.float64),  # s, of the newest state when it was sent
        ("round_count", np.int64),  # rounds so far
        ("round_due_ns", np.int64),  # ns, time of the next round
        # drones of this process without a pair that have not heard its last round
        ("lacking_count", np.int64),
        ("state", np.float64, 13),  # the newest state, as State.flat
        ("acceleration", np.float64, 3),  # m/s2, as State.a
        ("phase_ns", np.int64),  # ns, shift of the drone's grid of times
        ("seen_state", np.float64, 13),  # what the cameras saw last
        ("seen_time", np.float64),  # s, time of seen_state; -inf: none
        ("share", np.float64),  # 1: gives way to no other drone; else 0.5
        (
            "is_deaf",
            np.int64,
        ),  # 1: its radio is silent; it goes on with its last command
    ]
)
"""One flying drone of the swarm, as this process knows it."""

FRAME_ROW = np.dtype(
    [
        ("drone", np.int64),  # id
        ("number", np.int64),  # tick of the drone
        ("age", np.float64),  # s, of the state when it was sent
        ("state", np.float64, 13),  # as State.flat
        ("acceleration", np.float64, 3),  # m/s2, as State.a
    ]
)
"""The state of one drone in a frame for another process."""

ROUND_ROW = np.dtype(
    [
        ("state_time", np.float64),  # s
        ("state", np.float64, 13),  # as State.flat
        ("acceleration", np.float64, 3),  # m/s2, as State.a
    ]
)
"""One state that a drone said to all far drones."""

PAIR_ROW = np.dtype(
    [
        ("state_time", np.float64),  # s, time of the state; -inf: none is known
        # s, time of the last state that the other drone sent itself. Others may relay newer ones.
        ("heard_time", np.float64),
        ("state", np.float64, 13),  # newest known state, as State.flat
        ("acceleration", np.float64, 3),  # m/s2, as State.a
        ("other", np.int64),  # row of SWARM_ROW
        ("drone", np.int64),  # id of the other drone
        ("share", np.float64),  # 1: the other drone gives way to no other; else 0.5
        ("meeting_time", np.float64),  # s until both could be near each other
        # s, age of the state beyond which this drone brakes for want of a newer one
        ("age_limit", np.float64),
        ("turns", np.int64),  # how often others were asked about the other drone
        ("asked_time", np.float64),  # s, last turn of its questions; -inf: none yet
        ("is_by_hand", np.int64),  # 1: a state waits for the verdict of Impairment
        ("need", np.int64),  # Need: why others should be asked for a newer state
    ]
)
"""What one drone of this process knows of another drone that may be near."""

MOTION_ROW = np.dtype(
    [
        ("state_time", np.float64),  # s, as in PAIR_ROW
        ("heard_time", np.float64),  # s, as in PAIR_ROW
        ("place", np.float64, 3),  # m, p~ of the state, see predict_late_motion
        ("velocity", np.float64, 3),  # m/s, v~ of the state
        ("acceleration", np.float64, 3),  # m/s2, as in PAIR_ROW
        ("height", np.float64),  # m, of the state
        ("share", np.float64),  # as in PAIR_ROW
        ("drone", np.int64),  # id of the other drone
    ]
)
"""How the other drone of a pair moves: what each tick reads of each row of PAIR_ROW, in few bytes."""

PACE_ROW = np.dtype(
    [
        ("other", np.int64),  # row of SWARM_ROW, as in PAIR_ROW
        ("interval_ns", np.int64),  # ns, between two states that this drone hears
        # ns, between two states that this drone sends to the other one
        ("sending_interval_ns", np.int64),
        (
            "is_told",
            np.int64,
        ),  # 1: the law of this drone hears each state of the other one
    ]
)
"""How often the drones of a pair hear each other: one row for each row of PAIR_ROW."""

DUE_ROW = np.dtype(
    [
        ("hearing_ns", np.int64),  # ns, when this drone hears the next state
        # ns, when it sends the next one; NEVER_NS: this process flies the other drone
        ("sending_ns", np.int64),
    ]
)
"""When the drones of a pair hear each other: one row for each row of PAIR_ROW."""

ALL_BITS = -1
"""Bits of all processes."""
NEVER_NS = np.iinfo(np.int64).max
"""ns, a time that does not come."""

FAR_ROW = np.dtype(
    [
        ("place", np.float64, 3),  # m, newest known place
        ("velocity", np.float64, 3),  # m/s
        # s, time of place and velocity; -inf: none is known
        ("state_time", np.float64),
        ("heard_time", np.float64),  # s, time of the last round; -inf: none
        ("kind", np.int64),  # FarKind
        ("cell", np.int64),  # cell of the grid, or FarCell
    ]
)
"""What a drone that has missed no round of another drone knows of it."""

GRID_ROW = np.dtype(
    [
        ("corner", np.float64, 3),  # m, scaled by S: lowest corner of the first cell
        ("size", np.float64),  # m, edge of a cell
        ("counts", np.int64, 3),  # number of cells along each axis
        ("oldest", np.float64),  # s, largest age of a state in the grid
        ("fastest", np.float64),  # m/s, largest speed of a drone in the grid
        ("late_first", np.int64),  # first late drone in the order of the cells
        ("late_end", np.int64),  # end of the late drones in this order
        ("lacking", np.int64),  # sum of lacking_count
        ("heard", np.int64),  # drones of kind HEARD
        ("silent", np.int64),  # drones of kind SILENT
    ]
)
"""The cells over the last places of all drones, and the number of drones of each kind."""

LISTENER_ROW = np.dtype(
    [
        ("place", np.int64),  # row of SWARM_ROW
        ("first_pair", np.int64),  # first row of PAIR_ROW
        ("pair_count", np.int64),  # number of rows of PAIR_ROW, ordered by id
        ("pair_capacity", np.int64),  # number of rows that are reserved
        ("pairs_needed", np.int64),  # number of rows that the last check needed
        ("first_told", np.int64),  # first place in the table `told` of the airspace
        ("told_count", np.int64),  # number of drones there
        ("check_ns", np.int64),  # ns, time of the next check of the distances
        ("check_count", np.int64),  # checks so far
        ("sought_count", np.int64),  # pairs of which others should be asked
        ("keeps_all", np.int64),  # 1: every other drone has a pair
        ("far_heard", np.int64),  # flying drones without a pair that are heard
        ("far_silent", np.int64),  # flying drones without a pair that are silent
        ("sent", np.int64),  # messages since the last count
        ("lost", np.int64),  # messages of these that were lost
        # bits of the processes with drones that get the newest state, as in SWARM_ROW
        ("frame_due", np.int64),
    ]
)
"""One drone of this process."""

LINK_ROW = np.dtype(
    [
        ("key", np.uint64),  # of the draws
        ("sent", np.uint32),  # messages since the last count
        ("lost", np.uint32),  # messages of these that were lost
        ("delayed", np.uint32),  # messages that arrive late
        ("duplicated", np.uint32),  # messages that arrive twice
    ]
)
"""The simulated network on the way from one drone to a drone of this process."""

LOSS_ROW = np.dtype(
    [
        ("threshold", np.uint64),  # draws below it lose the message in the good state
        # draws below it lose the message in the bad state
        ("bad_threshold", np.uint64),
        ("loses_bad", np.int64),  # 1: all messages are lost in the bad state
        # probability that the burst chain turns bad; 0: no chain
        ("p_good_bad", np.float64),
        ("p_bad_good", np.float64),  # probability that it turns good
        # As in EdgeEffects; all zero unless the link has a kind from LATE on.
        ("delay", np.float64),  # s
        ("jitter", np.float64),  # s
        ("reorder", np.float64),  # probability
        ("reorder_delay", np.float64),  # s
        ("duplicate", np.float64),  # probability
    ]
)
"""How links of one kind lose, delay and duplicate messages by draws."""

AIRSPACE_RULES_ROW = np.dtype(
    [
        ("scale", np.float64, 3),  # diagonal of S
        ("width", np.float64),  # m, D
        ("range", np.float64),  # m, distance within which others count
        ("v_max", np.float64),  # m/s, largest speed of the others
        ("silent_gap", np.float64),  # m, see compute_silent_gap
        ("lag", np.float64),  # s, with which the others obey
        ("standing_height", np.float64),  # m, world; a lower drone stands on the floor
        ("far_interval_ns", np.int64),  # ns, between two rounds
        ("round_capacity", np.int64),  # rounds that are kept of each drone
        ("began_ns", np.int64),  # ns, first step; -1: none yet
        ("has_seen", np.int64),  # 1: the cameras have seen a drone
        ("has_late", np.int64),  # 1: a link may delay messages, see needs_pair
    ]
)
"""What holds for all pairs of an airspace."""


class LinkKind(IntEnum):
    """How a message is lost on its way.

    Links from DRAW on lose messages by draws, and by the state of a burst chain: links of the kinds
    DRAW + k and LATE + k as in row k of LOSS_ROW.
    """

    CLEAR = 0
    """Never."""
    CUT = 1
    """Always."""
    BY_HAND = 2
    """By the verdict of Impairment: the bandwidth is limited, so earlier messages of all topics count."""
    DRAW = 3
    """By draws as in the first row of LOSS_ROW."""
    LATE = 1 << 15
    """The same. Draws also delay and duplicate messages."""


class FarKind(IntEnum):
    """How a far drone counts for a drone that has missed none of its rounds."""

    GROUNDED = 0
    """It does not fly, or is gone: it does not count."""
    HEARD = 1
    """It flies and is heard."""
    SILENT = 2
    """It flies and is not heard."""


class FarCell(IntEnum):
    """Values of FAR_ROW.cell of drones that are in no cell of the grid."""

    UNKNOWN = -1
    """No place is known."""
    LATE = -2
    """No round came for so long that the drone may be far from its last place."""


class Need(IntEnum):
    """Why a drone asks others for a newer state of another one in this check."""

    NONE = 0
    """It does not ask."""
    SOON = 1
    """It will soon brake for want of a newer state."""
    NOW = 2
    """It brakes for want of a newer state."""
    STANDING = 3
    """The other drone stands on the floor: it does not brake for want of a newer state."""
    GONE = 4
    """The other drone counts as gone, or was never heard."""


class Missed(IntEnum):
    """Values of the number of rounds that a drone has missed in a row, beyond real numbers."""

    MOST = 253
    """Largest real number."""
    PAIRED = 254
    """The drone hears the other one as a pair, not in rounds."""
    ALL = 255
    """The drone has heard none of the rounds that are kept."""
