"""The controllers of all drones of a process as records, and the compiled code that flies them.

Each drone has one record of CONTROL_ROW. The objects of control/ that fly it hold parts of the same
record: its gains are written there, and its memory is read there.
"""

import math
from enum import IntEnum
from typing import Any

import numba
import numpy as np

from crazychoir.control.attitude import ATTITUDE_ROW, compute_input
from crazychoir.control.feed_forward import FEED_FORWARD_ROW, lead_rates
from crazychoir.control.position import (
    FLATNESS_LAYOUT,
    POSITION_ROW,
    PositionKind,
    compute_desired,
)
from crazychoir.control.trim import TRIM_ROW
from crazychoir.control.velocity import VELOCITY_ROW, compute_velocity
from crazychoir.numerics.kernels import (
    Records,
    kernel,
    memory,
    real,
    rows_of,
    vector,
)
from crazychoir.numerics.math3d import (
    compute_yaw,
    is_finite,
    rotation_columns,
    rotation_exponential,
)
from crazychoir.types import Vec

EARLY_TOLERANCE = 1e-4
"""Seconds that a tick may be early for the next look at the position: clocks and cameras jitter."""
LONGEST_TURN = 1.0
"""Seconds between two calls beyond which the desired attitude is computed anew."""


class CompiledControllerKind(IntEnum):
    """How a controller is called: in Python, or by which compiled laws."""

    BY_HAND = 0
    """In Python: some part of it does not ship, or does not share its record."""
    FLATNESS = 1
    """By `fly_controller`: the position and attitude control that ship."""
    VELOCITY = 2
    """By `fly_controller`: VelocityCtrlStrategy."""


class DesiredSource(IntEnum):
    """The source of the desired attitude between two ticks of the position control."""

    REFUSED = 0
    """None: state or reference is not finite."""
    TURNED = 1
    """The last one, turned further by its feed-forward."""
    DUE = 2
    """The position control, because its next tick is due."""


CONTROLLER_ROW = np.dtype(
    [
        ("kind", np.int64),  # CompiledControllerKind
        ("position", POSITION_ROW),
        ("feed_forward", FEED_FORWARD_ROW),
        ("attitude", ATTITUDE_ROW),
        ("velocity", VELOCITY_ROW),
        ("position_rate", np.float64),  # Hz, of the position control; 0: in each tick
        ("called_at", np.float64),  # s, last call, if there is a position rate
        ("due_at", np.float64),  # s, next tick of the position control
        ("desired", np.float64, 13),  # desired attitude, turned since that tick
        ("thrust", np.float64),  # N, of the last input; 0 if it has none
        ("reference", np.float64, 14),  # of this call, as its handler reads it
        ("last", np.float64, 14),  # the last usable reference
        ("has_last", np.int64),  # 1 if there was a usable reference
        ("refused", np.int64),  # number of references that could not be flown
    ],
    align=True,
)
"""Record of one controller of a drone."""
CONTROL_ROW = np.dtype(
    [
        ("trim", TRIM_ROW),
        ("tracker", CONTROLLER_ROW),  # controller of FullState references
        ("follower", CONTROLLER_ROW),  # controller of Acceleration references
    ],
    align=True,
)
"""Record of the controllers of a drone."""
REFERENCE_SIZE = 14
"""Count of numbers in a reference, as FullState.flat."""
YAW_INDEX = 12
"""Index of the yaw in a reference."""
INPUT_SIZE = 4
"""Count of numbers in the input of compiled controllers.

It is a thrust and body rates or angles, or a velocity and a yaw rate.
"""


@kernel()
def find_desired_source(controller: Any, x: Vec, ref: Vec, now: float) -> int:
    """Turn the desired attitude further by its feed-forward, R_d exp(t w_d), if no tick is due.

    controller: record of CONTROLLER_ROW
    x: (13,): state
    ref: (14,): reference
    now: s
    Returns the DesiredSource.
    """
    t = now - controller.called_at
    controller.called_at = now
    if now >= controller.due_at - EARLY_TOLERANCE or not 0.0 <= t < LONGEST_TURN:
        return DesiredSource.DUE.value
    if not (is_finite(x) and is_finite(ref)):
        return DesiredSource.REFUSED.value
    desired = controller.desired
    turn = rotation_columns(
        rotation_exponential(t * desired[10], t * desired[11], t * desired[12])
    )
    for c in range(3):
        a = desired[1 + c]
        b = desired[4 + c]
        d = desired[7 + c]
        for n in range(3):
            desired[1 + 3 * n + c] = a * turn[n][0] + b * turn[n][1] + d * turn[n][2]
    return DesiredSource.TURNED.value


@kernel()
def keep_desired(controller: Any, desired: Vec, now: float) -> None:
    """Keep the result of the position control, and plan its next tick.

    controller: record of CONTROLLER_ROW
    desired: (13,), of a PositionControl
    now: s
    """
    for c in range(FLATNESS_LAYOUT.desired_size):
        controller.desired[c] = desired[c]
    period = 1.0 / controller.position_rate
    controller.due_at = max(controller.due_at, now - period) + period


@kernel(rows_of(CONTROLLER_ROW), vector, vector, real)
def find_desired_source_of(rows: Records, x: Vec, ref: Vec, now: float) -> int:
    """Apply `find_desired_source` to the first record."""
    return int(find_desired_source(rows[0], x, ref, now))


@kernel(rows_of(CONTROLLER_ROW), vector, real)
def keep_desired_of(rows: Records, desired: Vec, now: float) -> None:
    """Apply `keep_desired` to the first record."""
    keep_desired(rows[0], desired, now)


@kernel()
def _apply_laws(
    controller: Any, trim: Any, x: Vec, age: float, now: float, u: Vec
) -> bool:
    """Apply the laws of a compiled controller to the reference in the record.

    The arguments are those of `fly_controller`.
    Returns False, without an input, if state or reference is not finite.
    """
    reference = controller.reference[:]
    if controller.kind == CompiledControllerKind.VELOCITY:
        return compute_velocity(controller.velocity, x, reference, u)
    source = DesiredSource.DUE.value
    if controller.position_rate > 0.0:
        source = find_desired_source(controller, x, reference, now)
    if source == DesiredSource.REFUSED.value:
        return False
    if source == DesiredSource.DUE.value:
        position = controller.position
        if not compute_desired(position, trim, x, age, reference, now):
            return False
        desired = position.out[: FLATNESS_LAYOUT.desired_size]
        if controller.position_rate > 0.0:
            keep_desired(controller, desired, now)
    else:
        desired = controller.desired[:]
    lead = controller.feed_forward
    attitude = controller.attitude
    lead_rates(lead, attitude.kind, x, desired, now)
    compute_input(attitude, x, lead.desired[:], u)
    controller.thrust = u[0]
    return True


@kernel()
def _read_reference(controller: Any, ref: Vec) -> None:
    """Write a reference into the record, as FullStateTraj or AccelerationTraj reads it."""
    reads_all = controller.position.kind != PositionKind.ACCELERATION
    for c in range(REFERENCE_SIZE):
        is_read = reads_all or 6 <= c < 9 or c == YAW_INDEX
        controller.reference[c] = ref[c] if is_read else 0.0


@kernel()
def _hold_reference(controller: Any, x: Vec) -> None:
    """Write the reference of a drone without one, as FullStateTraj or AccelerationTraj holds it."""
    holds_place = controller.position.kind != PositionKind.ACCELERATION
    has_last = controller.has_last != 0
    for c in range(REFERENCE_SIZE):
        controller.reference[c] = 0.0
    if holds_place:
        for c in range(3):
            controller.reference[c] = controller.last[c] if has_last else x[c]
    controller.reference[YAW_INDEX] = (
        controller.last[YAW_INDEX]
        if has_last
        else compute_yaw((x[6], x[7], x[8], x[9]))
    )


@kernel()
def _keep_reference(controller: Any) -> None:
    """Keep the reference of this call as the last usable one."""
    for c in range(REFERENCE_SIZE):
        controller.last[c] = controller.reference[c]
    controller.has_last = 1


@kernel()
def fly_controller(
    controller: Any,
    trim: Any,
    x: Vec,
    age: float,
    ref: Vec,
    has_reference: bool,
    now: float,
    u: Vec,
) -> None:
    """Write the input of a compiled controller, by the rules of CrazyflieController.command.

    controller: record of CONTROLLER_ROW
    trim: record of TRIM_ROW
    x: (13,): state
    age: s, of the state
    ref: (14,): reference
    has_reference: False to hold the last good reference
    now: s
    u: (4,): the result
    """
    if has_reference:
        _read_reference(controller, ref)
        if _apply_laws(controller, trim, x, age, now, u):
            _keep_reference(controller)
            return
        controller.refused += 1
    _hold_reference(controller, x)
    _keep_reference(controller)
    if not _apply_laws(controller, trim, x, age, now, u):
        u[0] = controller.thrust
        for c in range(1, INPUT_SIZE):
            u[c] = 0.0


@kernel(
    rows_of(CONTROLLER_ROW),
    rows_of(TRIM_ROW),
    vector,
    real,
    vector,
    numba.boolean,
    real,
    memory,
)
def fly_controller_of(
    rows: Records,
    trims: Records,
    x: Vec,
    age: float,
    ref: Vec,
    has_reference: bool,
    now: float,
    u: Vec,
) -> None:
    """Apply `fly_controller` to the first record."""
    fly_controller(rows[0], trims[0], x, age, ref, has_reference, now, u)


def make_control_rows(count: int = 1) -> Records:
    """Return (count,) of CONTROL_ROW; all controllers are called by hand until they are made."""
    return np.zeros(count, CONTROL_ROW)


def start_controller_row(rows: Records) -> None:
    """Begin the record of a controller: it has seen nothing and is called by hand.

    rows: (1,) of CONTROLLER_ROW
    """
    rows["kind"] = CompiledControllerKind.BY_HAND
    rows["position_rate"] = 0.0
    rows["called_at"] = -math.inf
    rows["due_at"] = -math.inf
    rows["desired"] = 0.0
    rows["thrust"] = 0.0
    rows["last"] = 0.0
    rows["has_last"] = 0
    rows["refused"] = 0
