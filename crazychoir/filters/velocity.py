"""Velocities from the poses of motion capture, by a derivative and a low-pass."""

from crazychoir.filters.motion import CommandedMotion
from crazychoir.filters.row_filter import RowFilter
from crazychoir.filters.rows import FilterKind, FilterTable


class VelocityFilter(RowFilter):
    """Derivative and first-order low-pass of position and attitude, for poses at any rate.

        v' = cutoff (p' - v),   w' = cutoff (log(q_k^-1 q_k+1) / h - w)

    It is integrated exactly for a p that is linear between two samples:

        v_k = e v_k-1 + (1 - e) (p_k - p_k-1) / h,   e = exp(-cutoff h)

    h is the measured time between the samples. w is in body axes; no angle wraps.

    The state is extrapolated from the time of the measurement to `now` at constant velocity. Without
    poses it continues from there by the model `motion` under `commanded`. Its arrays are read-only:
    many readers share them.

    Cameras have a steady rate, but their poses arrive some 0.1 ms late, and sometimes later. So the
    time of a measurement follows the rate of the cameras, and is corrected slowly by the times at
    which poses arrive. Then h does not jitter.

    Poses that are not finite count as missing, and so do poses with a quaternion length outside
    0.5 to 2.

    cutoff: rad/s
    horizon: s, longest prediction
    period: s, of the cameras; 0 if they have no steady rate
    motion: the dynamics under commands, used without poses; None for constant velocity
    table: record of the drone, shared with a table of many drones; None for a record of its own
    """

    def __init__(
        self,
        cutoff: float = 50.0,
        horizon: float = 0.5,
        period: float = 0.0,
        motion: CommandedMotion | None = None,
        table: FilterTable | None = None,
    ) -> None:
        if table is None:
            table = FilterTable.allocate(1, history_size=1)
        super().__init__(table, FilterKind.DERIVATIVE, horizon, period, cutoff)
        self._set_motion(motion)
