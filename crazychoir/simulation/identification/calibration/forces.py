"""Find thrust, drag and the tilt of the thrust axis from the forces of a flight."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from crazychoir.numerics.math3d import STANDARD_GRAVITY
from crazychoir.simulation.identification.calibration.flight import (
    CalibrationFlight,
    smooth,
)
from crazychoir.simulation.identification.calibration.instruments import (
    IdentifiedValues,
    make_basis,
    number_blocks,
    shift_setpoint,
    solve_linear,
)
from crazychoir.types import Mat, Vec


@dataclass(frozen=True, slots=True)
class BodyMotion:
    """Specific force and velocity in a frame that turns with the drone, smoothed over 110 ms."""

    force: Mat
    """(n, 3) m/s2."""
    velocity: Mat
    """(n, 3) m/s."""


def measure_motion(flight: CalibrationFlight, tilt: Vec) -> BodyMotion:
    """Return the motion in the frame of the body.

    tilt: (2,) rad: trim (roll, pitch) of the markers, see `estimate_sideways`; zeros give the frame of the markers
    """
    body = (Rotation.from_quat(flight.q) * make_trim(tilt).inv()).inv()
    up = np.array([0.0, 0.0, STANDARD_GRAVITY])
    return BodyMotion(
        force=body.apply(smooth(flight.p, 2) + up),
        velocity=body.apply(smooth(flight.p, 1)),
    )


def make_trim(tilt: Vec) -> Rotation:
    """Return q_tilt of q_measured = q_body q_tilt, R = Ry(pitch) Rx(roll), as [mocap] has it."""
    roll, pitch = tilt
    return Rotation.from_euler("y", pitch) * Rotation.from_euler("x", roll)


def estimate_sideways(flight: CalibrationFlight) -> IdentifiedValues:
    """Return trim roll and pitch in rad, and drag over mass along x and y in 1/s: (4,).

        s_c = tan(tilt_c) s_z - d_c v_c,   c = x, y

    s and v are specific force and velocity in the frame of the markers. The z axis of the markers is tilted by
    (-pitch, roll) towards x and y.
    """
    motion = measure_motion(flight, np.zeros(2))
    chosen = flight.is_usable
    basis = _make_basis(flight)
    block = number_blocks(chosen)
    slopes = []
    for c in range(2):
        terms = np.column_stack([motion.force[:, 2], -motion.velocity[:, c]])
        slopes.append(
            solve_linear(motion.force[chosen, c], terms[chosen], basis, block)
        )
    x, y = slopes
    values = np.array(
        [
            np.arctan(y.values[0]),
            -np.arctan(x.values[0]),
            x.values[1],
            y.values[1],
        ]
    )
    variance = [
        y.covariance[0, 0],
        x.covariance[0, 0],
        x.covariance[1, 1],
        y.covariance[1, 1],
    ]
    return IdentifiedValues(values, np.diag(variance))


def estimate_thrust(
    flight: CalibrationFlight, motion: BodyMotion, thrust: Vec
) -> IdentifiedValues:
    """Return the thrust as a share of the platform's, and the drag over mass along z in 1/s: (2,).

        s_z = k F - d_z v_z

    thrust: (n,) m/s2: F, what the platform's rotors make of the duty cycles, over its mass
    """
    chosen = flight.is_usable
    terms = np.column_stack([smooth(thrust), -motion.velocity[:, 2]])
    return solve_linear(
        motion.force[chosen, 2],
        terms[chosen],
        _make_basis(flight),
        number_blocks(chosen),
    )


def _make_basis(flight: CalibrationFlight) -> Mat | None:
    if flight.sp is None:
        return None
    ones = np.ones(len(flight.t))
    return make_basis(
        np.column_stack([shift_setpoint(flight.sp), ones])[flight.is_usable]
    )
