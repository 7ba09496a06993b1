"""Attitude control: from a desired attitude to body rates."""

from typing import Protocol

import numpy as np

from crazychoir.control.gains import STANDARD, Gains
from crazychoir.math3d import Vec, clip, columns, dot, kernel, memory, vector
from crazychoir.platforms import PAPER, Platform
from crazychoir.types import State


class AttitudeControl(Protocol):
    """The strategy that turns a desired attitude into body rates."""

    def command(self, state: State, desired: Vec) -> Vec:
        """A new (4,) = thrust N, body rates rad/s; desired: (13,) of a PositionControl."""
        ...


@kernel(vector, vector, vector, memory)
def _geometric(x: Vec, desired: Vec, figures: Vec, out: Vec) -> None:
    """The law of GeometryAttitudeCtrl into out (4,); figures: (6,) = kr, largest rates."""
    r = columns((x[6], x[7], x[8], x[9]))
    d = (
        (desired[1], desired[2], desired[3]),
        (desired[4], desired[5], desired[6]),
        (desired[7], desired[8], desired[9]),
    )
    e = (
        0.5 * (dot(d[2], r[1]) - dot(r[2], d[1])),
        0.5 * (dot(d[0], r[2]) - dot(r[0], d[2])),
        0.5 * (dot(d[1], r[0]) - dot(r[1], d[0])),
    )
    w = (
        d[0][0] * desired[10] + d[1][0] * desired[11] + d[2][0] * desired[12],
        d[0][1] * desired[10] + d[1][1] * desired[11] + d[2][1] * desired[12],
        d[0][2] * desired[10] + d[1][2] * desired[11] + d[2][2] * desired[12],
    )
    out[0] = desired[0]
    for c in range(3):
        out[1 + c] = clip(dot(r[c], w) - figures[c] * e[c], -figures[3 + c], figures[3 + c])


class GeometryAttitudeCtrl:
    """Geometric attitude control on SO(3) with body rates as output.

        e_R = 1/2 (R_d^T R - R^T R_d)^vee,   w = - K_R e_R + R^T R_d w_d

    R: body to world;  w_d: feed-forward in the axes of R_d, rad/s;  each rate is clipped to the platform's limit.
    Source: Lee, Leok & McClamroch 2010, IEEE CDC, its attitude error; the rate loop flies on board.
    """

    def __init__(self, gains: Gains = STANDARD, platform: Platform = PAPER) -> None:
        self._figures = np.array([*gains.kr, *platform.max_rate])

    def command(self, state: State, desired: Vec) -> Vec:
        """A new (4,) = thrust N, body rates rad/s."""
        out = np.empty(4)
        _geometric(state.flat, desired, self._figures, out)
        return out
