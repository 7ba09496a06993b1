"""Read recorded flights of real drones: motion capture, gyroscope, motors and battery.

A flight is a file .npz of NumPy with one row each 10 ms, see `FLIGHT_COLUMNS`. The world is ENU, z up; the body has
x forward, y left, z up.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.signal import savgol_filter
from scipy.spatial.transform import Rotation

from crazychoir.errors import ConfigError
from crazychoir.numerics.math3d import STANDARD_GRAVITY
from crazychoir.simulation.identification.array_files import read_array_file
from crazychoir.simulation.onboard.units import FULL_THRUST_COMMAND
from crazychoir.types import Bools, Mat, Vec

FLIGHT_TIME_STEP = 0.01
"""Seconds between two rows of a flight."""
FLIGHT_COLUMNS = {
    "t": (),
    "p": (3,),
    "q": (4,),
    "gyro": (3,),
    "duty": (4,),
    "vbat": (),
    "delay": (),
    "gap": (),
}
"""Shape of a row of each array that a flight must have.

t: s, on the clock of motion capture
p: m, world: place of the markers
q: [x, y, z, w], markers to world
gyro: rad/s, body, on the clock of the drone
duty: 0..1, duty cycles of motors 1 to 4 after battery compensation, on the clock of the drone
vbat: V under load, on the clock of the drone
delay: s: what the drone recorded at t happened at t - delay
gap: s: time between the two packets of telemetry around the row; longer times were interpolated
"""
SETPOINT_COLUMNS = {"sp": (3,), "sp_yaw": ()}
"""Shape of a row of the arrays that a flight may have, if it was flown by set-points of positions.

sp: m, world: set-point that the firmware followed, on the clock of the drone
sp_yaw: rad: its heading
"""
REQUEST_COLUMNS = {"cmd_thrust": ()}
"""Shape of a row of the array that a flight with the firmware's PID controller may have.

cmd_thrust: 0..65535, thrust that the controller asked for, before battery compensation, on the clock of the drone
"""


class FlightRules(NamedTuple):
    """How a recorded flight is read."""

    longest_gap: float = 0.035
    """Longest time in s between two packets of telemetry; rows in longer gaps are left out."""
    flying_height: float = 0.2
    """Height in m above the floor from which the drone counts as flying."""
    shortest_flight: float = 5.0
    """Least duration in s in the air."""
    smoothing_rows: int = 11
    """Rows of the polynomial that gives velocities from places: 110 ms, centred."""
    margin_rows: int = 100
    """Rows after take-off and before landing that do not count for the tilt of the markers."""
    still_duty: float = 0.02
    """Largest duty cycle of a motor that stands still."""


FLIGHT_RULES = FlightRules()


@dataclass(frozen=True, slots=True)
class RealFlight:
    """A recorded flight on one clock, that of motion capture, with n rows each 10 ms."""

    name: str
    """Name of the file without its suffix."""
    t: Vec
    """(n,) s."""
    p: Mat
    """(n, 3) m, world: place above the floor z = 0, where the drone stood before take-off."""
    v: Mat
    """(n, 3) m/s, world: derivative of the place, from 50 ms before to 50 ms after."""
    q: Mat
    """(n, 4) [x, y, z, w], body to world; z is the axis of the thrust."""
    w: Mat
    """(n, 3) rad/s, body: gyroscope."""
    duty: Mat
    """(n, 4), 0..1: duty cycles of motors 1 to 4."""
    vbat: Vec
    """(n,) V: battery under load."""
    is_known: Bools
    """(n,): whether the row lies outside the gaps of the telemetry."""
    airborne: tuple[int, int]
    """Rows [a, b) in which the drone flies."""
    marker_tilt: tuple[float, float]
    """rad: tilt of the thrust axis in the frame of the markers, towards x and towards y."""
    setpoints: Mat | None = None
    """(n, 4) m, rad: place above the floor and heading that the firmware followed; None if not recorded."""
    request: Vec | None = None
    """(n,): share of the greatest thrust that a PID controller asked for; None if not recorded."""
    notes: tuple[str, ...] = ()
    """What was found and done when it was read: gaps, clocks, what is missing."""

    @property
    def states(self) -> Mat:
        """(n, 13): p, v, q, w."""
        return np.hstack([self.p, self.v, self.q, self.w])

    @property
    def left_out(self) -> float:
        """Share of the rows in the air that lie in gaps of the telemetry."""
        a, b = self.airborne
        return 1.0 - float(np.mean(self.is_known[a:b]))


def read_flight(path: Path) -> RealFlight:
    """Read one flight: align its clocks, mark its gaps and correct the tilt of its markers.

    Raises ConfigError if the file is no flight of this form, or too short.
    """
    return make_real_flight(path.stem, _read_columns(path), where=str(path))


def make_real_flight(
    name: str, columns: Mapping[str, Mat], notes: Sequence[str] = (), where: str = ""
) -> RealFlight:
    """Align the clocks of a flight, mark its gaps and correct the tilt of its markers.

    name: of the recording
    columns: arrays of FLIGHT_COLUMNS, and of SETPOINT_COLUMNS and REQUEST_COLUMNS if recorded
    notes: what was found when they were read
    where: file, for errors; without one, the name
    Raises ConfigError if the drone does not fly long enough.
    """
    t = columns["t"]
    floor = _find_floor(columns)
    p = columns["p"] - [0.0, 0.0, floor]
    airborne = find_airborne_rows(where or name, p[:, 2])
    v = savgol_filter(
        p, FLIGHT_RULES.smoothing_rows, 3, deriv=1, delta=FLIGHT_TIME_STEP, axis=0
    )
    tilt = _estimate_marker_tilt(p, v, columns["q"], airborne)
    happened = np.maximum.accumulate(t - columns["delay"])
    return RealFlight(
        name=name,
        t=t,
        p=p,
        v=v,
        q=_correct_tilt(columns["q"], tilt),
        w=_align(t, happened, columns["gyro"]),
        duty=_align(t, happened, columns["duty"]),
        vbat=np.interp(t, happened, columns["vbat"]),
        is_known=np.interp(t, happened, columns["gap"]) <= FLIGHT_RULES.longest_gap,
        airborne=airborne,
        marker_tilt=tilt,
        setpoints=_find_setpoints(columns, happened, floor),
        request=_find_request(columns, happened),
        notes=tuple(notes),
    )


def _find_setpoints(
    columns: Mapping[str, Mat], happened: Vec, floor: float
) -> Mat | None:
    """Return the set-points (n, 4) above the floor on the clock of motion capture, None without."""
    if not columns.keys() >= SETPOINT_COLUMNS.keys():
        return None
    places = columns["sp"] - [0.0, 0.0, floor]
    return _align(columns["t"], happened, np.column_stack([places, columns["sp_yaw"]]))


def _find_request(columns: Mapping[str, Mat], happened: Vec) -> Vec | None:
    """Return the requested share of the greatest thrust (n,) on the clock of motion capture, None without."""
    if "cmd_thrust" not in columns:
        return None
    shares = columns["cmd_thrust"] / FULL_THRUST_COMMAND
    return np.interp(columns["t"], happened, shares)


def _read_columns(path: Path) -> dict[str, Mat]:
    """Return the arrays of FLIGHT_COLUMNS, and arrays that a flight may have, as float64.

    Raises ConfigError if one is missing, has another shape, or is not finite.
    """
    allowed = f"an .mcap of --record, or a file .npz with {', '.join(FLIGHT_COLUMNS)}"
    arrays = read_array_file(path, allowed)
    missing = [name for name in FLIGHT_COLUMNS if name not in arrays]
    if missing:
        raise ConfigError(str(path), f"no {', '.join(missing)}", allowed)
    shapes = FLIGHT_COLUMNS | {
        name: shape
        for name, shape in (SETPOINT_COLUMNS | REQUEST_COLUMNS).items()
        if name in arrays
    }
    columns = {name: np.asarray(arrays[name], float) for name in shapes}
    rows = columns["t"].shape[0] if columns["t"].ndim == 1 else 0
    for name, shape in shapes.items():
        column = columns[name]
        if column.shape != (rows, *shape):
            raise ConfigError(
                f"{path}: {name}", f"shape {column.shape}", f"{(rows, *shape)}"
            )
        if not np.isfinite(column).all():
            raise ConfigError(
                f"{path}: {name}", "a number that is not finite", "finite numbers"
            )
    steps = np.diff(columns["t"])
    if rows < 2 or np.abs(steps - FLIGHT_TIME_STEP).max() > 1e-4:
        raise ConfigError(
            f"{path}: t", f"{rows} rows", "rows at a distance of exactly 0.01 s"
        )
    return columns


def _find_floor(columns: Mapping[str, Mat]) -> float:
    """Return the height in m of the markers before the motors turn for the first time."""
    turning = np.flatnonzero(columns["duty"].max(axis=1) > FLIGHT_RULES.still_duty)
    standing = columns["p"][: max(int(turning[0]), 1) if len(turning) else 1, 2]
    return float(np.median(standing))


def find_airborne_rows(name: str, height: Vec) -> tuple[int, int]:
    """Return the rows [a, b) from the first to the last above the flying height.

    Raises ConfigError if the drone does not fly long enough.
    """
    flying = np.flatnonzero(height > FLIGHT_RULES.flying_height)
    a = int(flying[0]) if len(flying) else 0
    b = int(flying[-1]) + 1 if len(flying) else 0
    seconds = (b - a) * FLIGHT_TIME_STEP
    if seconds < FLIGHT_RULES.shortest_flight:
        raise ConfigError(
            name,
            f"{seconds:.2f} s above {FLIGHT_RULES.flying_height} m",
            f"{FLIGHT_RULES.shortest_flight} s or more in the air",
        )
    return a, b


def _estimate_marker_tilt(
    p: Mat, v: Mat, q: Mat, airborne: tuple[int, int]
) -> tuple[float, float]:
    """Return the tilt of the thrust axis in the frame of the markers, rad.

        s_c = tan(tilt_c) s_z - d_c v_c,   c = x, y

    s is the specific force from the places and v the velocity, both in the frame of the markers; the drag d is found
    with the tilt, by least squares over the whole flight.
    """
    a, b = airborne
    margin = min(FLIGHT_RULES.margin_rows, (b - a) // 4)
    rows = slice(a + margin, b - margin)
    acceleration = savgol_filter(
        p, FLIGHT_RULES.smoothing_rows, 3, deriv=2, delta=FLIGHT_TIME_STEP, axis=0
    )
    markers = Rotation.from_quat(q[rows])
    force = markers.inv().apply(acceleration[rows] + [0.0, 0.0, STANDARD_GRAVITY])
    speed = markers.inv().apply(v[rows])
    tilt = []
    for c in range(2):
        terms = np.column_stack([force[:, 2], speed[:, c]])
        slope = np.linalg.lstsq(terms, force[:, c], rcond=None)[0][0]
        tilt.append(float(np.arctan(slope)))
    return tilt[0], tilt[1]


def _correct_tilt(q: Mat, tilt: tuple[float, float]) -> Mat:
    """Return the attitudes (n, 4) of the body, with z along (tan tilt_x, tan tilt_y, 1) of the markers."""
    axis = np.array([np.tan(tilt[0]), np.tan(tilt[1]), 1.0])
    axis /= np.linalg.norm(axis)
    angle = np.arccos(axis[2])
    across = np.array([-axis[1], axis[0], 0.0]) / max(np.sin(angle), 1e-12)
    turned: Mat = (
        Rotation.from_quat(q) * Rotation.from_rotvec(angle * across)
    ).as_quat()
    return turned


def _align(t: Vec, happened: Vec, columns: Mat) -> Mat:
    """Return the columns (n, c), recorded at the times `happened`, at the times t."""
    return np.column_stack([np.interp(t, happened, column) for column in columns.T])
