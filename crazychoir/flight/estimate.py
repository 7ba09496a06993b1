"""The state that the pilot assumes for its drone: the choice of the filter, and the state without poses."""

import math

import numpy as np

from crazychoir.control.choice import Controls
from crazychoir.control.margin import make_rate_loop
from crazychoir.control.senders import FPQRSender
from crazychoir.filters.kalman import KalmanFilter
from crazychoir.filters.motion import CommandedMotion
from crazychoir.filters.rows import FilterTable
from crazychoir.filters.state_filter import StateFilter
from crazychoir.filters.velocity import VelocityFilter
from crazychoir.flight.flight_limits import BLIND_HORIZON
from crazychoir.numerics.kernels import kernel, memory, vector
from crazychoir.platforms import LARGEST_AXIS_COMMAND, Platform
from crazychoir.types import FullState, Mat, State, Vec


def choose_filter(
    name: str,
    chosen: Controls,
    ground: float,
    rate: float,
    table: FilterTable | None = None,
) -> StateFilter:
    """Return the filter of [control], "kalman" or "derivative".

    The filter knows the commands if these are thrust and body rates.

    ground: m, height of the floor
    rate: Hz, of the poses
    table: record for the filter, shared with a table of many drones; None for a record of its own
    """
    motion = (
        CommandedMotion(chosen.platform.flat, ground)
        if isinstance(chosen.sender, FPQRSender)
        else None
    )
    if name == "kalman":
        loop = compute_rate_loops(chosen.platform) if chosen.plant == "motors" else None
        return KalmanFilter(
            horizon=BLIND_HORIZON,
            period=1.0 / rate,
            motion=motion,
            loop=loop,
            table=table,
        )
    return VelocityFilter(
        horizon=BLIND_HORIZON, period=1.0 / rate, motion=motion, table=table
    )


def compute_rate_loops(platform: Platform) -> Mat:
    """Return (3, 5): the parameters of the firmware's rate loops for roll, pitch and yaw.

    They are the `loop` of KalmanFilter, see `make_rate_loop`. They are valid as the firmware is
    compiled: its parameters pid_rate may change them. Left out are the firmware's hold of a heading
    instead of a yaw rate, and the limit of its integrals.
    """
    firmware = platform.firmware
    rows = []
    for axis, (gain, _, _) in enumerate(
        (firmware.rate_pid, firmware.rate_pid, firmware.yaw_rate_pid)
    ):
        lag, damped, kp, ki = make_rate_loop(platform, axis)[1]
        rows.append(
            (
                lag,
                kp,
                ki,
                damped - 1.0,
                kp * LARGEST_AXIS_COMMAND / (gain * math.degrees(1.0)),
            )
        )
    return np.array(rows)


@kernel(vector, memory)
def write_believed_state(flown: Vec, state: Vec) -> None:
    """Compute the state to assume for an unseen drone if the filter does not know its commands.

    It is the state of the reference: the drone counts as being where it should be. The filter itself
    extrapolates the last speed. A controller would brake against that speed for ever, and the drone
    would fly backwards.

    flown: (14,): reference that the drone flies, FullState.flat
    state: (13,): the result, State.flat
    """
    half = 0.5 * flown[12]
    state[:] = 0.0
    state[0:6] = flown[0:6]
    state[8] = math.sin(half)
    state[9] = math.cos(half)


def compute_believed_state(state: State, flown: FullState | None) -> Vec:
    """Return the state (13,) of `write_believed_state`.

    state: of the filter, returned if there is no reference
    flown: reference that the drone flies, None without one
    """
    if flown is None:
        return state.flat
    believed = np.empty(13)
    write_believed_state(flown.flat, believed)
    return believed
