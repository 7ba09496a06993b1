"""Trajectories for the memory of a Crazyflie: at most 31 pieces of degree 7 in single precision."""

from dataclasses import dataclass

import numpy as np

from crazychoir.errors import ConfigError
from crazychoir.firmware.memories import TRAJECTORY_MEMORY
from crazychoir.numerics.math3d import wrap_angle
from crazychoir.planning.piecewise import Piecewise
from crazychoir.planning.polynomial import Polynomial7th
from crazychoir.planning.trajectory import Trajectory
from crazychoir.types import Mat, Vec

FIT_INSTANTS = 33  # number of times of each piece at which the fit is checked
SHORTEST_PIECE = 0.01  # s, least length of a piece
FIT_TIMES = np.linspace(0.0, 1.0, FIT_INSTANTS)
"""Times of a piece at which the fit is checked, as shares of its length."""
FREE_POLYNOMIALS = (FIT_TIMES**2 * (1.0 - FIT_TIMES) ** 2)[:, None] * FIT_TIMES[
    :, None
] ** np.arange(4)
"""Polynomials that leave yaw and yaw' at both ends unchanged, at FIT_TIMES."""
FREE_FIT = np.linalg.pinv(FREE_POLYNOMIALS)
"""Matrix from values at FIT_TIMES to the factors of FREE_POLYNOMIALS."""


@dataclass(frozen=True)
class TrajectoryUpload:
    """The contents of the trajectory memory."""

    pieces: Piecewise
    """The pieces as the drone evaluates them, rounded to single precision."""
    error: float
    """m: the largest distance from the trajectory."""
    yaw_error: float
    """rad: the largest yaw angle from the trajectory."""

    @property
    def memory(self) -> bytes:
        """132 bytes a piece: 33 little-endian floats.

        They are c0..c7 of x, of y, of z, of yaw, then the duration in s.
        """
        k = len(self.pieces.durations)
        return (
            np.column_stack(
                [self.pieces.coefficients.reshape(k, -1), self.pieces.durations]
            )
            .astype("<f4")
            .tobytes()
        )


def require_memory(path: Piecewise) -> None:
    """Raise ConfigError for a trajectory with more pieces than the memory of a Crazyflie has room for."""
    pieces = len(path.durations)
    size = 4 * TRAJECTORY_MEMORY.piece_size
    if pieces > TRAJECTORY_MEMORY.most_pieces:
        raise ConfigError(
            "trajectory on board",
            f"{pieces} pieces, {pieces * size} bytes",
            f"at most {TRAJECTORY_MEMORY.most_pieces} pieces of {size} bytes: the memory has "
            f"{TRAJECTORY_MEMORY.byte_count}",
            "Fly it without --on-board, or split it.",
        )


def fit_upload(
    trajectory: Trajectory, tolerance: float = 0.001, yaw_tolerance: float = 0.01
) -> TrajectoryUpload:
    """Return the trajectory in at most 31 pieces.

    Pieces of degree 7 are used unchanged. Any other trajectory is cut, from its start on, into the
    longest pieces that fit: polynomials that have its p, v, a, j, yaw and yaw' at both ends. So the
    pieces join as smoothly as the trajectory does.

    trajectory: the trajectory
    tolerance: m, largest distance from it
    yaw_tolerance: rad, largest yaw angle from it
    Raises ConfigError if 31 pieces are not enough, with the error that they leave.
    """
    for name, value in (("tolerance", tolerance), ("yaw_tolerance", yaw_tolerance)):
        if not value > 0.0:
            raise ConfigError(f"upload: {name}", value, "a positive number")
    upload = _round_pieces(
        trajectory, _fit_pieces(trajectory, tolerance, yaw_tolerance)
    )
    widened = 1.0
    while upload is None:  # how much tolerance would be needed
        widened *= 1.5
        upload = _round_pieces(
            trajectory,
            _fit_pieces(trajectory, widened * tolerance, widened * yaw_tolerance),
        )
    if not (upload.error <= tolerance and upload.yaw_error <= yaw_tolerance):
        k = len(upload.pieces.durations)
        found = f"{k} pieces that are {upload.error:.2g} m and {upload.yaw_error:.2g} rad off"
        allowed = f"{tolerance:g} m and {yaw_tolerance:g} rad with at most {TRAJECTORY_MEMORY.most_pieces} pieces"
        raise ConfigError(
            "upload", found, allowed, "Split the trajectory, or allow a larger error."
        )
    return upload


def _round_pieces(
    trajectory: Trajectory, pieces: Piecewise | None
) -> TrajectoryUpload | None:
    """Return the pieces in single precision, with their errors; None without pieces."""
    if pieces is None:
        return None
    rounded = Piecewise(np.float32(pieces.coefficients), np.float32(pieces.durations))
    return TrajectoryUpload(rounded, *compute_difference(trajectory, rounded))


def compute_difference(a: Trajectory, b: Trajectory) -> tuple[float, float]:
    """Return the largest distance m and yaw angle rad between two trajectories.

    They are compared at 1000 equal times.
    """
    times = np.linspace(0.0, min(a.duration, b.duration), 1000)
    return _compute_reference_difference(
        _sample_trajectory(a, times), _sample_trajectory(b, times)
    )


def _sample_trajectory(trajectory: Trajectory, times: Vec) -> Mat:
    """Return the references of a trajectory at these times."""
    return np.array([trajectory.sample(t).flat for t in times.tolist()])


def _compute_reference_difference(x: Mat, y: Mat) -> tuple[float, float]:
    """Return the largest distance and yaw angle between references."""
    turns = [abs(wrap_angle(angle)) for angle in (x[:, 12] - y[:, 12]).tolist()]
    return float(np.linalg.norm(x[:, 0:3] - y[:, 0:3], axis=1).max()), max(turns)


def _fit_pieces(
    trajectory: Trajectory, tolerance: float, yaw_tolerance: float
) -> Piecewise | None:
    """Return the trajectory itself if it has few enough pieces, else the longest pieces that fit.

    Returns None if these are too many.
    """
    if (
        isinstance(trajectory, Piecewise)
        and len(trajectory.durations) <= TRAJECTORY_MEMORY.most_pieces
    ):
        return trajectory
    pieces: list[Mat] = []
    knots = [0.0]
    while trajectory.duration - knots[-1] > 1e-9:
        if len(pieces) == TRAJECTORY_MEMORY.most_pieces:
            return None
        knots.append(
            knots[-1]
            + _find_longest_piece(trajectory, knots[-1], tolerance, yaw_tolerance)
        )
        pieces.append(_fit_piece(trajectory, *knots[-2:]).coefficients[0])
    return Piecewise(np.array(pieces), np.diff(knots))


def _fit_piece(trajectory: Trajectory, t: float, until: float) -> Piecewise:
    """Return the polynomial from t to `until`.

    Its yaw is fitted in between, and turns as the trajectory does.
    """
    a = trajectory.sample(t)
    b = trajectory.sample(until)
    duration = until - t
    c = Polynomial7th(a, b, duration).coefficients.copy()
    turn = b.yaw - a.yaw
    r0 = a.flat[13] * duration
    r1 = b.flat[13] * duration
    cubic = np.array([a.yaw, r0, 3.0 * turn - 2.0 * r0 - r1, r0 + r1 - 2.0 * turn])
    yaws = np.array(
        [trajectory.sample(t + s * duration).yaw for s in FIT_TIMES.tolist()]
    )
    free = FREE_FIT @ (yaws - FIT_TIMES[:, None] ** np.arange(4) @ cubic)
    c[0, 3] = np.convolve(free, (0.0, 0.0, 1.0, -2.0, 1.0))
    c[0, 3, 0:4] += cubic
    c[0, 3] /= duration ** np.arange(8.0)
    return Piecewise(c, [duration])


def _find_longest_piece(
    trajectory: Trajectory, t: float, tolerance: float, yaw_tolerance: float
) -> float:
    """Return the length in s of the longest piece from t on that fits, to 2 %.

    It is at least SHORTEST_PIECE.
    """

    def fits(length: float) -> bool:
        times = FIT_TIMES * length
        piece = _fit_piece(trajectory, t, t + length)
        error, yaw_error = _compute_reference_difference(
            _sample_trajectory(trajectory, times + t), _sample_trajectory(piece, times)
        )
        return error <= 0.9 * tolerance and yaw_error <= 0.9 * yaw_tolerance

    left = trajectory.duration - t
    if left <= SHORTEST_PIECE or fits(left):
        return left
    short = SHORTEST_PIECE
    long = left
    while long / short > 1.02:
        middle = (short * long) ** 0.5
        short, long = (middle, long) if fits(middle) else (short, middle)
    return short
