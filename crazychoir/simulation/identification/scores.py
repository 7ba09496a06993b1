"""Errors of open-loop predictions."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from crazychoir.simulation.identification.flights import FLIGHT_TIME_STEP
from crazychoir.simulation.identification.windows import FlightWindows
from crazychoir.types import Ints, Mat

SCORED_ROWS = (10, 25, 50)
"""Rows after the start of a window at which predictions are scored: 0.1, 0.25 and 0.5 s."""
ERROR_NAMES = ("position_mm", "velocity_m_s", "attitude_deg", "rates_rad_s")
"""Lengths of the errors of position, velocity and rates, and the angle between two attitudes."""


@dataclass(frozen=True, slots=True)
class OpenLoopErrors:
    """Errors of one model."""

    model: str
    """Name of the model."""
    flight: Ints
    """(w,): number of each window's flight."""
    errors: Mat
    """(w, rows + 1, 4): errors of each window at each row, as ERROR_NAMES."""

    def rmse(self, row: int, flight: int | None = None) -> Mat:
        """Return the root mean squares (4,) of the errors at a row, of one flight or all."""
        errors = self.errors[:, row]
        if flight is not None:
            errors = errors[self.flight == flight]
        return np.asarray(np.sqrt(np.mean(errors**2, axis=0)))

    def mae(self, row: int) -> Mat:
        """Return the means (4,) of the errors at a row."""
        return np.asarray(self.errors[:, row].mean(axis=0))

    def figures(self) -> dict[str, Any]:
        """Return RMSE and MAE at the scored times, for JSON."""
        return {
            f"{row * FLIGHT_TIME_STEP:g}": {
                "rmse": dict(zip(ERROR_NAMES, self.rmse(row).tolist(), strict=True)),
                "mae": dict(zip(ERROR_NAMES, self.mae(row).tolist(), strict=True)),
            }
            for row in SCORED_ROWS
        }


def score(model: str, windows: FlightWindows, states: Mat) -> OpenLoopErrors:
    """Compare predicted states (w, rows + 1, 13) with the recorded ones."""
    errors = np.empty((*states.shape[:2], len(ERROR_NAMES)))
    for row in range(states.shape[1]):
        predicted = states[:, row]
        recorded = windows.recorded(row)
        difference = predicted - recorded
        errors[:, row, 0] = 1e3 * np.linalg.norm(difference[:, :3], axis=1)
        errors[:, row, 1] = np.linalg.norm(difference[:, 3:6], axis=1)
        errors[:, row, 2] = np.degrees(
            np.linalg.norm(attitude_errors(predicted, recorded), axis=1)
        )
        errors[:, row, 3] = np.linalg.norm(difference[:, 10:], axis=1)
    return OpenLoopErrors(model, windows.flight, errors)


def attitude_errors(predicted: Mat, recorded: Mat) -> Mat:
    """Return the rotation vectors (w, 3) in rad from the predicted to the recorded attitudes, body."""
    turn = Rotation.from_quat(predicted[:, 6:10]).inv() * Rotation.from_quat(
        recorded[:, 6:10]
    )
    return np.asarray(turn.as_rotvec())
