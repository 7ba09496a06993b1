"""The commands that a drone obeyed, and its motion under them."""

import math
from typing import NamedTuple

from crazychoir.filters.motion import STANDING_TOLERANCE, advance_flight
from crazychoir.filters.poses import POSE_TIMING
from crazychoir.filters.rows import FilterRow
from crazychoir.numerics.kernels import kernel
from crazychoir.numerics.math3d import (
    Triple,
    clip,
    is_finite,
    quaternion_product,
    rotation_exponential,
)
from crazychoir.types import Mat, Vec


class HistorySize(NamedTuple):
    """How many commands a history holds."""

    spare: float = 0.25
    """Share of the horizon that is kept besides it, for poses that are old when they arrive."""
    step: int = 64
    """Commands by which histories differ in size."""
    without_rate: int = 512
    """Size without a steady rate of the cameras: 2.1 s at 240 Hz."""


HISTORY_SIZE = HistorySize()


class RateLoopModel(NamedTuple):
    """How the known rate loop on board is integrated."""

    lag: float = 0.02
    """Lag in s that stands for the delays of command and measurement behind a known rate loop.
    """
    step: float = 0.0025
    """s, longest step of the integration of that loop."""
    command_timeout: float = 0.5
    """s without a command, after which that loop is at rest."""


RATE_LOOP_MODEL = RateLoopModel()


def compute_history_size(horizon: float, period: float) -> int:
    """Return the number of commands to remember for predictions as long as the horizon.

    A new command is remembered at each tick.

    horizon: s, longest prediction
    period: s, of the ticks; 0 if they have no steady rate
    """
    if not period > 0.0:
        return HISTORY_SIZE.without_rate
    commands = (1.0 + HISTORY_SIZE.spare) * horizon / period
    return HISTORY_SIZE.step * math.ceil(commands / HISTORY_SIZE.step)


@kernel()
def _get_loop_rate(row: FilterRow) -> Triple:
    """Return r of the rate loop, rad/s."""
    return (row.loop_rate[0], row.loop_rate[1], row.loop_rate[2])


@kernel()
def _set_loop_at_rest(row: FilterRow) -> Triple:
    """Let the rates of the loop be those of the command, and return them, rad/s."""
    for c in range(3):
        row.loop_rate[c] = row.command[1 + c]
        row.loop_acceleration[c] = 0.0
        row.loop_integral[c] = 0.0
    return _get_loop_rate(row)


@kernel()
def _step_loop_axis(row: FilterRow, c: int, step: float) -> None:
    """Advance the loop of one axis by one step of Euler's method.

    row: record of the filter
    c: axis: 0 roll, 1 pitch, 2 yaw
    step: s
    """
    lag = row.loop[c, 0]
    kp = row.loop[c, 1]
    ki = row.loop[c, 2]
    kd = row.loop[c, 3]
    most = row.loop[c, 4]
    error = row.command[1 + c] - row.loop_rate[c]
    wanted = 0.0
    if row.command[0] > 0.0:
        row.loop_integral[c] = row.loop_integral[c] + step * error
        wanted = clip(
            kp * error + ki * row.loop_integral[c] - kd * row.loop_acceleration[c],
            -most,
            most,
        )
    else:
        row.loop_integral[c] = 0.0
    row.loop_acceleration[c] = (lag * row.loop_acceleration[c] + step * wanted) / (
        lag + step
    )
    row.loop_rate[c] += step * row.loop_acceleration[c]


@kernel()
def _advance_rate_loop(row: FilterRow, h: float) -> Triple:
    """Advance the rates of the loop by h s under the command, and return their means, rad/s.

    It is Euler's method, with the lag backwards. Without thrust the firmware resets its loops, and
    the rotors run down.

    row: record of the filter
    h: s
    """
    if h <= 0.0:  # a refused pose: this tick has already been recorded
        return _get_loop_rate(row)
    if not h < RATE_LOOP_MODEL.command_timeout:
        return _set_loop_at_rest(row)
    steps = math.ceil(h / RATE_LOOP_MODEL.step)
    step = h / steps
    mean = (0.0, 0.0, 0.0)
    for _ in range(steps):
        for c in range(3):
            _step_loop_axis(row, c, step)
        r = _get_loop_rate(row)
        mean = (mean[0] + r[0] / steps, mean[1] + r[1] / steps, mean[2] + r[2] / steps)
    return mean


@kernel()
def _append_command(row: FilterRow, history: Mat, thrust: float, rates: Triple) -> None:
    """Append a command that was obeyed from the last tick on, if it is new.

    It replaces a command that was obeyed for no time.

    row: record of the filter
    history: (R, 5)
    thrust: N
    rates: rad/s
    """
    k = row.newest_command
    if (
        history[k, 1] == thrust
        and history[k, 2] == rates[0]
        and history[k, 3] == rates[1]
        and history[k, 4] == rates[2]
    ):
        return
    if history[k, 0] != row.call_time:
        k = (k + 1) % history.shape[0]
    row.newest_command = k
    history[k, 0] = row.call_time
    history[k, 1] = thrust
    for c in range(3):
        history[k, 2 + c] = rates[c]


@kernel()
def record_command(row: FilterRow, history: Mat, now: float) -> None:
    """Record that the drone obeyed the command from the last tick until now.

    For a known loop the recorded rates are the response of the loop to the commands. A command that
    is not finite is left out.

    row: record of the filter
    history: (R, 5)
    now: s
    """
    if is_finite(row.command[:]):
        rates = (row.command[1], row.command[2], row.command[3])
        if row.knows_loop > 0:
            rates = _advance_rate_loop(row, now - row.call_time)
        _append_command(row, history, row.command[0], rates)
    row.call_time = now


@kernel()
def _move_state(row: FilterRow, x: Vec, d: Triple, u: Vec, h: float) -> bool:
    """Advance x (13,) by h s under the command u (4,) and the acceleration d.

    Return whether it then stands on the floor.
    """
    if row.knows_commands > 0 and (
        u[0] > 0.0 or x[2] < row.floor_height + STANDING_TOLERANCE
    ):
        return bool(
            advance_flight(
                x,
                u,
                row.platform[:],
                row.floor_height,
                row.rate_lag,
                d,
                h,
            )
        )
    for c in range(3):
        x[c] += h * (x[3 + c] + 0.5 * h * d[c])
        x[3 + c] += h * d[c]
    x[6], x[7], x[8], x[9] = quaternion_product(
        (x[6], x[7], x[8], x[9]), rotation_exponential(h * x[10], h * x[11], h * x[12])
    )
    return False


@kernel()
def _find_command(row: FilterRow, history: Mat, t: float) -> int:
    """Return the index of the command that the drone obeyed at the time t s."""
    rows = history.shape[0]
    k: int = row.newest_command
    for _ in range(rows - 1):
        if history[k, 0] <= t:
            break
        k = (k - 1) % rows
    return k


@kernel()
def advance_state(
    row: FilterRow,
    history: Mat,
    x: Vec,
    d: Triple,
    t: float,
    end: float,
    fade: float,
) -> Triple:
    """Advance x from the time t to `end` under the commands of that time; return d then.

    row: record of the filter
    history: (R, 5)
    x: (13,), changed in place
    d: m/s2. It fades; each part of the time takes its mean.
    t: s
    end: s
    fade: 1/s, rate at which d fades
    """
    rows = history.shape[0]
    k = _find_command(row, history, t)
    while t < end:
        after = (k + 1) % rows
        until = end if k == row.newest_command else min(end, history[after, 0])
        h = until - t
        if h > POSE_TIMING.rounding:
            keep = math.exp(-fade * h)
            mean = (1.0 - keep) / (fade * h) if fade > 0.0 else 1.0
            push = (mean * d[0], mean * d[1], mean * d[2])
            stands = _move_state(row, x, push, history[k, 1:5], h)
            d = (0.0, 0.0, 0.0) if stands else (keep * d[0], keep * d[1], keep * d[2])
        t = max(t, until)
        k = after
    return d
