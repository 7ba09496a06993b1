"""Compare flights of real drones with their simulation in closed loop."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from crazychoir.simulation.identification.closed_loop import FlownAgain
from crazychoir.simulation.identification.flights import FLIGHT_TIME_STEP
from crazychoir.types import Ints, Mat, Vec


class ClosedLoopScoreRules(NamedTuple):
    """How flights are scored."""

    settling_rows: int = 200
    """Rows after take-off that are not counted."""
    ending_rows: int = 50
    """Rows before landing that are not counted."""
    longest_lag_rows: int = 120
    """Longest lag behind the set-points that is looked for."""
    circle_tolerance: float = 0.01
    """Share of its radius within which the set-points of a circle lie."""
    phases: int = 72
    """Places on a circle at which laps are compared."""
    medium_speed: float = 0.6
    """m/s: mean speed of the set-points from which a flight is medium."""
    fast_speed: float = 0.85
    """m/s: mean speed of the set-points from which a flight is fast."""


SCORE_RULES = ClosedLoopScoreRules()


@dataclass(frozen=True, slots=True)
class LoopFigures:
    """Figures of one drone, real or simulated, in one flight."""

    tracking_mm: float
    """RMSE against the set-points."""
    lag_s: float
    """Lag behind the set-points with the least RMSE."""
    rest_mm: float
    """RMSE behind that lag."""
    height_mm: float
    """Mean height above the set-points."""
    tilt_deg: float
    """Standard deviations of roll and pitch, added."""
    scatter_mm: float | None
    """Scatter of the radius at one phase of a circle over its laps; None for other figures."""


@dataclass(frozen=True, slots=True)
class ClosedLoopScore:
    """One flight and its simulation."""

    flight: str
    """Name of the flight."""
    speed: str
    """slow, medium or fast."""
    real: LoopFigures
    """Figures of the recorded drone."""
    simulated: LoopFigures
    """Figures of the simulated drone."""
    difference_mm: float
    """RMSE of the simulated places against the recorded ones."""

    @property
    def ratio(self) -> float:
        """Simulated over real tracking RMSE."""
        return self.simulated.tracking_mm / self.real.tracking_mm

    def figures(self) -> dict[str, Any]:
        """Return everything for JSON."""
        return {**asdict(self), "ratio": self.ratio}


def score_closed_loop(flown: FlownAgain) -> ClosedLoopScore:
    """Return the figures of a flight."""
    a, b = flown.flight.airborne
    rows = np.arange(a + SCORE_RULES.settling_rows, b - SCORE_RULES.ending_rows)
    moves = np.linalg.norm(np.diff(flown.setpoints[rows, :3], axis=0), axis=1)
    speed = float(moves.mean()) / FLIGHT_TIME_STEP
    recorded = flown.flight.states
    apart = flown.states[rows, :3] - recorded[rows, :3]
    return ClosedLoopScore(
        flight=flown.flight.name,
        speed=_name_speed(speed),
        real=_find_figures(recorded, flown.setpoints, rows),
        simulated=_find_figures(flown.states, flown.setpoints, rows),
        difference_mm=_find_rms(apart),
    )


def find_medians(scores: Sequence[ClosedLoopScore]) -> dict[str, dict[str, float]]:
    """Return {speed: medians of difference_mm and ratio over its flights}."""
    medians = {}
    for speed in ("slow", "medium", "fast"):
        own = [score for score in scores if score.speed == speed]
        if own:
            medians[speed] = {
                "flights": float(len(own)),
                "difference_mm": float(np.median([one.difference_mm for one in own])),
                "ratio": float(np.median([one.ratio for one in own])),
            }
    return medians


def _name_speed(speed: float) -> str:
    if speed < SCORE_RULES.medium_speed:
        return "slow"
    return "medium" if speed < SCORE_RULES.fast_speed else "fast"


def _find_rms(differences: Mat) -> float:
    """Return the root mean square length in mm of differences (n, 3) in m."""
    return float(1e3 * np.sqrt((differences**2).sum(axis=1).mean()))


def _find_figures(states: Mat, setpoints: Mat, rows: Ints) -> LoopFigures:
    """Return the figures of states (n, 13) against set-points (n, 4), in these rows."""
    p = states[rows, :3]
    behind = [
        _find_rms(p - setpoints[rows - lag, :3])
        for lag in range(SCORE_RULES.longest_lag_rows)
    ]
    best = int(np.argmin(behind))
    angles = Rotation.from_quat(states[rows, 6:10]).as_euler("ZYX", degrees=True)
    return LoopFigures(
        tracking_mm=behind[0],
        lag_s=best * FLIGHT_TIME_STEP,
        rest_mm=behind[best],
        height_mm=float(1e3 * (p[:, 2] - setpoints[rows, 2]).mean()),
        tilt_deg=float(angles[:, 1:].std(axis=0).sum()),
        scatter_mm=_find_scatter(p[:, :2], setpoints[rows, :2]),
    )


def _find_scatter(p: Mat, setpoints: Mat) -> float | None:
    """Return the scatter in mm of the radius over the laps of a circle, None without two laps of one.

    It is the standard deviation over the laps, quadratically averaged over the phases. The first
    lap is not counted: the drone comes from the middle.
    p, setpoints: (n, 2) m: places and set-points
    """
    centre = 0.5 * (setpoints.max(axis=0) + setpoints.min(axis=0))
    wanted = setpoints - centre
    radii = np.linalg.norm(wanted, axis=1)
    radius = float(np.median(radii))
    on_circle = np.abs(radii - radius) < SCORE_RULES.circle_tolerance * radius
    if radius == 0.0 or on_circle.mean() < 0.9:
        return None
    angle = np.unwrap(np.arctan2(wanted[on_circle, 1], wanted[on_circle, 0]))
    turned = np.abs(angle - angle[0]) / (2.0 * np.pi)
    laps = _find_lap_radii(turned, np.linalg.norm(p[on_circle] - centre, axis=1))
    if len(laps) < 2:
        return None
    return float(1e3 * np.sqrt(laps.var(axis=0, ddof=1).mean()))


def _find_lap_radii(turned: Vec, radii: Vec) -> Mat:
    """Return the radii (laps, phases) of the whole laps but the first.

    turned: (n,): laps since the beginning
    radii: (n,) m
    """
    grid = np.arange(SCORE_RULES.phases) / SCORE_RULES.phases
    whole = int(turned[-1])
    return np.array([np.interp(lap + grid, turned, radii) for lap in range(1, whole)])
