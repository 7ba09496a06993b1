"""A recorded flight, ready to be calibrated with: aligned, without gaps, with what moves its rotors."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.signal import savgol_filter

from crazychoir.errors import ConfigError
from crazychoir.platforms import Platform
from crazychoir.simulation.identification.calibration.telemetry import (
    align_clock,
    find_interpolated,
)
from crazychoir.simulation.identification.flights import (
    FLIGHT_RULES,
    FLIGHT_TIME_STEP,
    find_airborne_rows,
)
from crazychoir.types import Bools, Mat, Vec

MEMORY_ROWS = 30
"""Rows after a gap in which the rotors still remember it."""
LEAST_HEIGHT = 0.35
"""m: lower rows are left out, because the floor lifts the drone."""
LEAST_SHARE = 0.3
"""Share of the rows in the air that must be usable."""
GYRO_FILTER_DELAY = 0.0028
"""s: delay of the firmware's low-pass of 80 Hz for the gyroscope."""


@dataclass(frozen=True, slots=True)
class CalibrationFlight:
    """One flight with n rows each 10 ms, on the clock of motion capture."""

    name: str
    """Name of the recording."""
    t: Vec
    """(n,) s."""
    p: Mat
    """(n, 3) m, world."""
    q: Mat
    """(n, 4) [x, y, z, w], markers to world."""
    gyro: Mat
    """(n, 3) rad/s, body."""
    duty: Mat
    """(n, 4): duty cycles."""
    vbat: Vec
    """(n,) V: voltage, slow."""
    acc: Mat | None
    """(n, 3) m/s2, body: accelerometer, None if it was not recorded."""
    sp: Mat | None
    """(n, 3) m, world: set-point, None if it was not recorded."""
    is_usable: Bools
    """(n,): rows in the air, high enough, outside gaps and what follows them."""
    airborne: tuple[int, int]
    """Rows [a, b) in the air."""
    notes: tuple[str, ...]
    """What was found and done: gaps, clocks, missing columns."""

    @property
    def seconds(self) -> float:
        """Usable s."""
        return float(self.is_usable.sum()) * FLIGHT_TIME_STEP


def make_flight(name: str, columns: Mapping[str, Mat]) -> CalibrationFlight:
    """Align the columns of `columns.read_columns` and find the rows that can be used.

    Raises ConfigError if the drone does not fly long enough outside gaps.
    """
    t = columns["t"]
    duty = columns["duty"]
    turning = np.flatnonzero(duty.max(axis=1) > FLIGHT_RULES.still_duty)
    first = int(turning[0]) if len(turning) else 0
    height = columns["p"][:, 2] - np.median(columns["p"][: max(first, 1), 2])
    airborne = find_airborne_rows(name, height)
    notes: list[str] = []
    is_known = ~find_interpolated(columns["gyro"])
    if "gap" in columns:
        is_known &= columns["gap"] <= FLIGHT_RULES.longest_gap
    delay = find_delay(columns, is_known, airborne, notes)
    onboard = _align_columns(columns, t - delay)
    is_known = np.interp(t, np.maximum.accumulate(t - delay), is_known) > 0.99
    usable = _leave_out(is_known) & (height > LEAST_HEIGHT)
    a, b = airborne
    usable[:a] = False
    usable[b:] = False
    share_in_gaps = 1.0 - float(is_known[a:b].mean())
    if share_in_gaps > 0.0:
        notes.append(
            f"packets were lost: {share_in_gaps:.1%} of the flight was interpolated and is left out"
        )
    if "acc" not in columns:
        notes.append("no accelerometer (acc): lag and delay stay at their defaults")
    if "sp" not in columns:
        notes.append("no set-point (sp): plain least squares, which feedback may bias")
    if usable.sum() * FLIGHT_TIME_STEP < FLIGHT_RULES.shortest_flight:
        raise ConfigError(
            name,
            f"{usable.sum() * FLIGHT_TIME_STEP:.1f} s of flight outside gaps, above {LEAST_HEIGHT:g} m",
            f"{FLIGHT_RULES.shortest_flight:g} s or more; a minute with turns, steps and circles is good",
        )
    return CalibrationFlight(
        name=name,
        t=t,
        p=columns["p"],
        q=columns["q"],
        gyro=onboard["gyro"],
        duty=onboard["duty"],
        vbat=onboard["vbat"],
        acc=onboard.get("acc"),
        sp=columns.get("sp"),
        is_usable=usable,
        airborne=airborne,
        notes=tuple(notes),
    )


def find_delay(
    columns: Mapping[str, Mat],
    is_known: Bools,
    airborne: tuple[int, int],
    notes: list[str],
) -> Vec:
    """Return the delay (n,) in s of the drone's clock, as recorded or found, and note it.

    columns: t, q and gyro, and delay if it is known
    is_known: (n,): rows outside gaps
    airborne: rows [a, b) in the air
    notes: receives what was found
    """
    t = columns["t"]
    if "delay" in columns:
        return columns["delay"]
    clock = align_clock(t, columns["q"], columns["gyro"], is_known, slice(*airborne))
    if clock is None:
        notes.append("too calm to align the clocks: they are taken as equal")
        return np.zeros(len(t))
    notes.append(
        f"clock of the drone: {1e3 * clock.offset:.0f} ms late, drifts by {6e4 * clock.drift:.0f} ms a minute: aligned"
    )
    return clock.delays(t)


def _align_columns(columns: Mapping[str, Mat], happened: Vec) -> dict[str, Mat]:
    """Return the columns of the drone at the times of motion capture.

    The gyroscope's filter delays it, and clocks are aligned with it; the other columns are later than it by that.
    """
    t = columns["t"]
    happened = np.maximum.accumulate(happened)
    aligned: dict[str, Mat] = {}
    for name in ("gyro", "duty", "vbat", "acc"):
        if name not in columns:
            continue
        late = 0.0 if name == "gyro" else GYRO_FILTER_DELAY
        column = columns[name]
        flat = column.reshape(len(t), -1)
        moved = np.column_stack(
            [np.interp(t, happened + late, part) for part in flat.T]
        )
        aligned[name] = moved[:, 0] if column.ndim == 1 else moved
    return aligned


def _leave_out(is_known: Bools) -> Bools:
    """Return the known rows that are not next to a gap, and in which the rotors have forgotten it."""
    around = FLIGHT_RULES.smoothing_rows // 2 + 1
    usable = is_known.copy()
    for row in np.flatnonzero(~is_known):
        usable[max(row - around, 0) : row + MEMORY_ROWS] = False
    return usable


def smooth(columns: Mat, derivative: int = 0) -> Mat:
    """Return columns (n, ...) smoothed over 110 ms, or their derivative of an order."""
    return np.asarray(
        savgol_filter(
            columns,
            FLIGHT_RULES.smoothing_rows,
            3,
            deriv=derivative,
            delta=FLIGHT_TIME_STEP,
            axis=0,
        )
    )


def compute_motor_thrusts(platform: Platform, duty: Mat, vbat: Vec) -> Mat:
    """Return the thrusts (n, 4) in N that the platform's curve gives for duty cycles and voltages (n,)."""
    c0, c1, c2, c3 = platform.rotor.voltage
    volts = np.minimum(duty, 1.0) * vbat[:, None]
    return np.maximum(c0 + volts * (c1 + volts * (c2 + volts * c3)), 0.0)
