"""Predict windows of recorded flights open loop, with models of several kinds."""

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from scipy.spatial.transform import Rotation

from crazychoir.platforms import EVEN_MOTORS, Platform
from crazychoir.simulation.identification.flights import (
    FLIGHT_TIME_STEP,
    RealFlight,
)
from crazychoir.simulation.identification.plant import (
    follow_flights,
    make_block,
    predict_windows,
)
from crazychoir.simulation.identification.windows import WINDOW_RULES, FlightWindows
from crazychoir.simulation.motor_level.lanes import (
    LANE_COUNT,
    MOTOR_FACTOR_1,
)
from crazychoir.types import Bools, Ints, Mat, Vec

TRIM_BLOCK_ROWS = 4
"""Rows of a part of the time that trims are found in: 40 ms; their offsets are the middle of its parts."""


class TrimSource(StrEnum):
    """What a model may see of the flight before it predicts a window."""

    NONE = "no trims"
    LAST = "trims of the last 0.36 s"
    FIRST = "trims of the first 3 s"


@dataclass(frozen=True, slots=True)
class Trims:
    """What differs between the plant and the drone in a window, besides the parameters."""

    thrust: Vec
    """(w,): true thrust over that of the plant."""
    offsets: Mat
    """(w, 3) rad/s2, body: angular acceleration that the plant lacks."""


@dataclass(frozen=True, slots=True)
class MotorInputs:
    """What moves the rotors of a plant in f flights of n rows."""

    commands: Mat
    """(f, n, 4): shares of the greatest thrust."""
    ceilings: Mat
    """(f, n) N: thrust of a motor at full duty cycle."""


@dataclass(frozen=True, slots=True)
class FollowedPlant:
    """A plant in f flights of n rows, with its body held at the recorded states."""

    platform: Platform
    """Its figures."""
    inputs: MotorInputs
    """What moves its rotors."""
    rotors: Mat
    """(f, n, 8) N: thrusts and goals of the rotors."""
    slopes: Mat
    """(f, n, 6): accelerations of v (m/s2, world) and w (rad/s2, body)."""
    rest: Mat
    """(f, n, 6): the same without the thrusts."""


def predict_constant(windows: FlightWindows) -> Mat:
    """Predict that velocity (world) and rates (body) stay: states (w, predicted_rows + 1, 13)."""
    x = windows.starts
    states = np.empty((len(x), WINDOW_RULES.predicted_rows + 1, 13))
    attitude = Rotation.from_quat(x[:, 6:10])
    for row in range(states.shape[1]):
        seconds = row * FLIGHT_TIME_STEP
        states[:, row] = x
        states[:, row, :3] += seconds * x[:, 3:6]
        turn = Rotation.from_rotvec(seconds * x[:, 10:])
        states[:, row, 6:10] = (attitude * turn).as_quat()
    return states


def follow_plant(windows: FlightWindows, platform: Platform) -> FollowedPlant:
    """Run the rotors of the platform's plant over the whole flights of the windows."""
    inputs = _make_inputs(windows, platform)
    rotors, slopes = _follow(windows, platform, inputs, 1.0)
    _, rest = _follow(windows, platform, inputs, 0.0)
    return FollowedPlant(platform, inputs, rotors, slopes, rest)


def predict_plant(
    windows: FlightWindows,
    plant: FollowedPlant,
    source: TrimSource,
    rotates: bool = True,
) -> Mat:
    """Predict with the motor-level plant, fed with recorded duty cycles and voltages.

    A window starts from the recorded pose, velocity and rates, with the thrusts that the duty cycles
    before it have made.

    rotates: whether torques turn the body; otherwise its rates stay
    Returns the states (w, predicted_rows + 1, 13).
    """
    platform = plant.platform
    inputs = plant.inputs
    trims = estimate_trims(windows, plant, source)
    states = np.empty((len(windows.start), WINDOW_RULES.predicted_rows + 1, 13))
    flight = windows.flight[:, None]
    predict_windows(
        make_block(platform, rotates),
        inputs.commands[flight, windows.rows],
        inputs.ceilings[flight, windows.rows],
        windows.starts,
        plant.rotors[windows.flight, windows.start] * trims.thrust[:, None],
        trims.thrust[:, None] * np.array(platform.effects.motor_factors or EVEN_MOTORS),
        trims.offsets * np.array(platform.inertia),
        states,
    )
    return states


def find_predictable(windows: FlightWindows, source: TrimSource) -> Bools:
    """Return which windows (w,) begin after all that the source shows."""
    predictable = np.ones(len(windows.start), bool)
    for number, flight in enumerate(windows.flights):
        own = windows.flight == number
        end = _trim_rows(flight, windows.start[own], source)[1]
        predictable[own] = windows.start[own] >= end
    return predictable


def estimate_trims(
    windows: FlightWindows, plant: FollowedPlant, source: TrimSource
) -> Trims:
    """Estimate thrust and angular offsets of each window from the flight before it.

        dv = k s + s_0,   k = s (dv - s_0) / |s|^2,   a = middle of (dw - k r - r_0) / T_b

    dv: change of velocity in the time that the source shows, without gaps
    dw: change of rates in each T_b = 40 ms of it; a is the mean of the middle half of their offsets along each axis,
        because the error of a sudden turn is not an offset that lasts
    s, r: changes that the plant's thrusts make
    s_0, r_0: changes that the rest of the plant makes
    """
    count = len(windows.start)
    if source is TrimSource.NONE:
        return Trims(np.ones(count), np.zeros((count, 3)))
    thrust = np.empty(count)
    offsets = np.empty((count, 3))
    for number, flight in enumerate(windows.flights):
        own = np.flatnonzero(windows.flight == number)
        begin, end = _trim_rows(flight, windows.start[own], source)
        rows = len(flight.t)
        known = (flight.is_known[1:] & flight.is_known[:-1]).astype(float)[:, None]
        recorded = np.diff(np.hstack([flight.v, flight.w]), axis=0) * known
        rest = _mean_rows(plant.rest[number, :rows]) * known * FLIGHT_TIME_STEP
        slopes = _mean_rows(plant.slopes[number, :rows]) * known * FLIGHT_TIME_STEP
        made = slopes - rest
        change = _sum_between(recorded - rest, begin, end)
        gain = _sum_between(made, begin, end)
        k = (gain[:, :3] * change[:, :3]).sum(axis=1) / (gain[:, :3] ** 2).sum(axis=1)
        thrust[own] = k
        turned = np.hstack([(recorded - rest)[:, 3:], made[:, 3:], known])
        blocks = _sum_blocks(turned, begin, end)
        offsets[own] = _find_middle(
            blocks[..., :3] - k[:, None, None] * blocks[..., 3:6],
            FLIGHT_TIME_STEP * blocks[..., 6],
        )
    return Trims(thrust, offsets)


def _sum_blocks(values: Mat, begin: Ints, end: Ints) -> Mat:
    """Return the sums of values (n, c) over each TRIM_BLOCK_ROWS rows of [begin, end): (w, b, c).

    The spans are equally long; rows behind the last whole block are left out.
    """
    count = int((end - begin).min(initial=len(values))) // TRIM_BLOCK_ROWS
    edges = begin[:, None] + TRIM_BLOCK_ROWS * np.arange(count + 1)
    sums = np.vstack([np.zeros(values.shape[1]), np.cumsum(values, axis=0)])[edges]
    return np.asarray(np.diff(sums, axis=1))


def _find_middle(changes: Mat, seconds: Mat) -> Mat:
    """Return the mean (w, 3) of the middle half of changes over their time.

    changes: (w, b, 3)
    seconds: (w, b) s: known time of each block; blocks without any count as the mean of the others
    """
    total = seconds.sum(axis=1)[:, None]
    mean = changes.sum(axis=1) / total
    share = np.maximum(seconds, FLIGHT_TIME_STEP)[..., None]
    values = np.where(seconds[..., None] > 0.0, changes / share, mean[:, None])
    ordered = np.sort(values, axis=1)
    left_out = ordered.shape[1] // 4
    kept = ordered[:, left_out : ordered.shape[1] - left_out]
    return np.asarray(kept.mean(axis=1))


def _trim_rows(
    flight: RealFlight, start: Ints, source: TrimSource
) -> tuple[Ints, Ints]:
    """Return the rows [begin, end) that the source shows for windows with these starts."""
    if source is not TrimSource.FIRST:
        return start - WINDOW_RULES.history_rows, start
    a, b = flight.airborne
    begin = np.full(len(start), a)
    return begin, np.minimum(begin + WINDOW_RULES.first_rows, b - 1)


def _mean_rows(values: Mat) -> Mat:
    return np.asarray(0.5 * (values[1:] + values[:-1]))


def _sum_between(values: Mat, begin: Ints, end: Ints) -> Mat:
    """Return the sums of the rows [begin, end) of values (n, c): (w, c)."""
    sums = np.vstack([np.zeros(values.shape[1]), np.cumsum(values, axis=0)])
    return np.asarray(sums[end] - sums[begin])


def _make_inputs(windows: FlightWindows, platform: Platform) -> MotorInputs:
    """Return the motor commands by which the firmware of the platform would ask for the recorded duty cycles.

    u = f(duty vbat) / f_max, with the platform's curve f of the thrust over the voltage at a motor.
    """
    shape = windows.states.shape[:2]
    commands = np.zeros((*shape, 4))
    ceilings = np.zeros(shape)
    for number, flight in enumerate(windows.flights):
        rows = slice(0, len(flight.t))
        ceilings[number, rows] = compute_motor_thrust(platform, flight.vbat)
        volts = flight.duty * flight.vbat[:, None]
        commands[number, rows] = (
            compute_motor_thrust(platform, volts) / platform.firmware.thrust_max
        )
    return MotorInputs(commands, ceilings)


def compute_motor_thrust(platform: Platform, volts: Vec) -> Vec:
    """Return the thrust in N of a motor at these voltages, by the platform's curve."""
    c0, c1, c2, c3 = platform.rotor.voltage
    return np.maximum(c0 + volts * (c1 + volts * (c2 + volts * c3)), 0.0)


def _follow(
    windows: FlightWindows, platform: Platform, inputs: MotorInputs, factor: float
) -> tuple[Mat, Mat]:
    """Run the rotors of the plant over the flights, with their thrusts times the factor.

    Returns the thrusts and goals (f, n, 8) in N, and the accelerations (f, n, 6) of the plant at the recorded states.
    """
    count, rows = windows.states.shape[:2]
    rotors = np.empty((count, rows, 8))
    slopes = np.empty((count, rows, 6))
    for first in range(0, count, LANE_COUNT):
        lanes = np.minimum(np.arange(first, first + LANE_COUNT), count - 1)
        used = min(LANE_COUNT, count - first)
        block = make_block(platform)
        block[MOTOR_FACTOR_1 : MOTOR_FACTOR_1 + 4 * LANE_COUNT] *= factor
        own_rotors = np.empty((LANE_COUNT, rows, 8))
        own_slopes = np.empty((LANE_COUNT, rows, 6))
        follow_flights(
            block,
            inputs.commands[lanes],
            inputs.ceilings[lanes],
            windows.states[lanes],
            own_rotors,
            own_slopes,
        )
        rotors[first : first + used] = own_rotors[:used]
        slopes[first : first + used] = own_slopes[:used]
    return rotors, slopes
