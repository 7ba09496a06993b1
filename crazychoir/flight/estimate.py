"""Where a pilot takes its drone to be: its filter, and what it believes of one that is not seen."""

import math

import numpy as np

from crazychoir.control.choice import Controls
from crazychoir.control.margin import rate_loop
from crazychoir.control.senders import FPQRSender
from crazychoir.filters.kalman import KalmanFilter
from crazychoir.filters.motion import Commanded
from crazychoir.filters.state_filter import StateFilter
from crazychoir.filters.velocity import VelocityFilter
from crazychoir.platforms import MOST_TURN, Platform
from crazychoir.types import FullState, Mat, State, Vec

SEEN = 0.1
"""s, the age of a state beyond which it is a prediction, of which the controllers learn nothing."""
BLIND = 2.0
"""s, how far it predicts its own motion without a pose: as long as the safety table lets it fly so."""


def filter_of(name: str, chosen: Controls, ground: float, rate: float) -> StateFilter:
    """The filter of [control], "kalman" or "derivative"; it knows what is commanded, if that is thrust and body rates.

    ground: m, height of the floor;  rate: Hz, of the poses.
    """
    motion = (
        Commanded(chosen.platform.flat, ground)
        if isinstance(chosen.sender, FPQRSender)
        else None
    )
    if name == "kalman":
        loop = rates_on_board(chosen.platform) if chosen.plant == "motors" else None
        return KalmanFilter(horizon=BLIND, period=1.0 / rate, motion=motion, loop=loop)
    return VelocityFilter(horizon=BLIND, period=1.0 / rate, motion=motion)


def rates_on_board(platform: Platform) -> Mat:
    """(3, 5): the loop of KalmanFilter for roll, pitch and yaw, of the firmware's rate controllers; see `rate_loop`.

    As the firmware is compiled: its parameters pid_rate may make it another. Left out: that it holds a heading rather
    than a yaw rate, and the limit of its integrals.
    """
    firmware = platform.firmware
    rows = []
    for axis, (gain, _, _) in enumerate(
        (firmware.rate_pid, firmware.rate_pid, firmware.yaw_rate_pid)
    ):
        lag, damped, kp, ki = rate_loop(platform, axis)[1]
        rows.append(
            (lag, kp, ki, damped - 1.0, kp * MOST_TURN / (gain * math.degrees(1.0)))
        )
    return np.array(rows)


def believed(state: State, flown: FullState | None) -> Vec:
    """Where a drone is that is not seen and whose filter does not know its commands: where it is to be.

    The filter lets it go on at its last speed. A controller would brake that forever, and the drone fly backwards.
    flown: its reference, if there is one.
    """
    if flown is None:
        return state.flat
    half = 0.5 * flown.yaw
    return np.array(
        [*flown.p, *flown.v, 0.0, 0.0, math.sin(half), math.cos(half), 0.0, 0.0, 0.0]
    )
