"""A Kalman filter of the poses of motion capture that knows the commands of its drone."""

import math
from dataclasses import dataclass

from crazychoir.filters.command_history import RATE_LOOP_MODEL, compute_history_size
from crazychoir.filters.motion import CommandedMotion
from crazychoir.filters.place_noise import PLACE_NOISE
from crazychoir.filters.row_filter import RowFilter
from crazychoir.filters.rows import FilterKind, FilterTable
from crazychoir.types import Mat


@dataclass(frozen=True, slots=True)
class KalmanNoise:
    """Deviations of the measured poses, and densities of the noises that drive the model."""

    place: float | None = None
    """m, standard deviation of a position per axis; None: the filter measures it from its poses.

    Cameras differ from 0.03 to 0.5 mm, and the gains depend on the ratio of jerk and noise.
    """
    angle: float = math.radians(0.25)
    """rad, standard deviation of an attitude per axis; 0.25 deg for good motion capture."""
    jerk: float = 0.1
    """m2/s5, density of n_j: a thrust that is 10 % wrong for about 0.1 s while the jerk is 10 m/s3.

    Without commands d must follow the whole jerk. If `place` is right and at most 0.5 mm, the same
    density is then within 20 % of the best, in slow and fast flights and from 25 to 240 Hz.
    """
    push: float = 3e-5
    """m2/s3, density of n_s: the error of f from an attitude that is wrong behind the filter.

    The default covers 2 mrad for about 0.03 s.
    """
    swing: float = 0.3
    """rad2/s3, density of n_g: a lag of the rates that is 10 ms wrong.

    The default covers it for about 0.03 s while the rates change by 20 rad/s2.
    """


KALMAN_NOISE = KalmanNoise()


class KalmanFilter(RowFilter):
    """Kalman filter of position and velocity, and error-state filter of attitude and body rates.

    The poses may come at any rate.

        p' = v,  v' = f(q, u) + d + n_s,  d' = n_j,      z_p = p + n_p
        q' = 1/2 q (w, 0),  w' = (r - w) / lag + n_g,      z_q = q exp(n_a)

    f: the acceleration of the dynamics of CommandedMotion under the commands u
    d: the remaining acceleration, from a thrust that differs from the command and from wind
    n_s, n_j, n_g, n_p, n_a: white noises
    r: the commanded rates u_2..4, with lag = RATE_LAG

    Without a `motion`, or with motors off, f = 0, d is the whole acceleration, and w' = n_g.

    If the `loop` on board is known, r is the response of the loop to the commands alone, and
    lag = RATE_LOOP_MODEL.lag. One axis of the loop, which runs down while no thrust is commanded:

        lag_r r'' + r' = sat(kp e + ki (integral of e) - kd r'),  e = u_2..4 - r,  |sat| <= most

    Each noise is equal in all axes. So x, y and z share one covariance of (p, v, d), and the three
    angles of the error a, q = q_est exp(a), share one covariance of (a, w). Both are discretised
    exactly for the measured time h between two poses:

        F = [1 h h^2/2; 0 1 h; 0 0 1]
        Q = jerk [h^5/20 h^4/8 h^3/6; h^4/8 h^3/3 h^2/2; h^3/6 h^2/2 h]
            + push [h^3/3 h^2/2 0; h^2/2 h 0; 0 0 0]
        F_a = [1 h; 0 1],  Q_a = swing [h^3/3 h^2/2; h^2/2 h]

    F_a omits the lag of the rates, which is not known well enough. The update has Joseph's form;
    only its upper triangle is kept.

    A pose is refused, and counts as missing, if it is not finite, if the length of its quaternion is
    outside 0.5 to 2, or if it is beyond the gate: |e|^2 / variance of its innovation e exceeds
    KALMAN_GATE.chi_square in position or attitude; this variance includes a manoeuvre since the pose
    before. After KALMAN_GATE.doubts poses in a row beyond the gate the filter accepts the newest: it
    starts again there, with the velocities that it had. After a gap longer than the horizon it starts
    again with the mean velocity of the gap.

    While the thrust does not lift a drone from the floor, its velocity and d are zero.

    The state is extrapolated from the time of the measurement to `now` under the commands of that
    time, which are recorded: `commanded` is valid from one call to the next. Without poses the
    extrapolation goes on, and d decays with the time constant DISTURBANCE_FADE_TIME. The times follow
    the period of the cameras as in VelocityFilter, and the attributes are the same.

    horizon: s, longest prediction
    period: s, of the cameras; 0 if they have no steady rate
    motion: the dynamics under commands; None if the filter gets no commands
    noise: n_p, n_a, n_j = jerk, n_s = push and n_g = swing
    loop: (3, 5): lag_r s, kp 1/s, ki 1/s2, kd, most rad/s2 of roll, pitch, yaw; None if not known
    table: record of the drone, shared with a table of many drones; None for a record of its own
    Source: Bar-Shalom, Li & Kirubarajan 2001, the Wiener process acceleration model, for Q;
        Lefferts, Markley & Shuster 1982 for the error state.
    """

    def __init__(
        self,
        horizon: float = 0.5,
        period: float = 0.0,
        motion: CommandedMotion | None = None,
        noise: KalmanNoise = KALMAN_NOISE,
        loop: Mat | None = None,
        table: FilterTable | None = None,
    ) -> None:
        if table is None:
            table = FilterTable.allocate(1, compute_history_size(horizon, period))
        super().__init__(table, FilterKind.KALMAN, horizon, period, math.inf)
        self._set_motion(motion)
        self._set_noise(noise)
        if motion is not None and loop is not None:
            self._set_loop(loop)

    def _set_noise(self, noise: KalmanNoise) -> None:
        """Write the noise into the record."""
        place = PLACE_NOISE.start if noise.place is None else noise.place
        self._row["measures_noise"] = noise.place is None
        self._row["place_variance"] = place**2
        self._row["attitude_variance"] = noise.angle**2
        self._row["jerk_density"] = noise.jerk
        self._row["push_density"] = noise.push
        self._row["swing_density"] = noise.swing

    def _set_loop(self, loop: Mat) -> None:
        """Write the rate loop on board, (3, 5), into the record."""
        self._row["knows_loop"] = 1
        self._row["loop"] = loop
        self._row["rate_lag"] = RATE_LOOP_MODEL.lag
